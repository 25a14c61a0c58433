// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/options.hpp"

#include <CLI/CLI.hpp>
#include <cstdlib>
#include <iostream>
#include <set>
#include <stdexcept>

#include "common/release.hpp"
#include "messages/unexpected_words.hpp"
#include "partner/translation.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/properties.hpp"
#include "transport/ice/tls.hpp"
#include "transport/process/logging.hpp"
#include "transport/sessions/routed_session.hpp"

namespace axon::partner {
namespace {

namespace fs = std::filesystem;

constexpr const char* kRouter = "Ice.Default.Router";
const std::set<std::string> kKeys{"Partner.Name",     "Partner.As",    "Partner.Client",  "Partner.Entity",
                                  "Partner.Visitors", "Partner.State", "Partner.LogLevel"};
const std::set<std::string> kEntityKeys{kRouter, "Axon.Server", "Axon.User", "Axon.Password"};

fs::path defaultStateFolder(const std::string& name) {
    const char* state = std::getenv("XDG_STATE_HOME");
    const char* home = std::getenv("HOME");
    const fs::path root =
        state && *state ? fs::path(state) : fs::path(home && *home ? home : "/var/lib") / ".local/state";
    return root / "axon" / ("partner-" + name);
}

std::string laboratory(const std::string& what, const std::string& name, const char* example) {
    if (name.empty()) throw std::runtime_error(what + " is missing; expected a laboratory, as " + example);
    if (!isLaboratoryName(name))
        throw std::runtime_error(what + ": expected 1 to 32 letters, digits, '-' and '_', not '" + name +
                                 "'");
    return name;
}

/// Where and how the Entity Managers of this laboratory log in.
void readHome(GatewaySettings& settings, const std::string& file, const std::string& server) {
    transport::Properties read;
    if (!file.empty()) read = transport::readProperties(file, kEntityKeys);
    settings.home_properties = std::move(read.ice);
    const auto said = [&](const char* key) {
        const auto found = read.own.find(key);
        return found == read.own.end() ? std::string() : found->second.value;
    };
    if (read.own.contains(kRouter) && read.own.contains("Axon.Server"))
        throw std::runtime_error(
            file +
            ": Ice.Default.Router and Axon.Server are both there; expected one of them: the "
            "way to the entity server is either through a router or without one");
    auto& home = settings.home;
    if (server.empty()) home.router = said(kRouter);
    const auto named = !server.empty() ? server : said("Axon.Server");
    const auto at = named.empty() ? std::string("127.0.0.1:10412") : named;
    try {
        const auto called = transport::parseEndpoint(at);
        home.host = called.host;
        home.port = called.port;
        home.tls = called.tls;
    } catch (const std::invalid_argument& error) {
        throw std::runtime_error(std::string("--entity-server: ") + error.what());
    }
    if (home.port == 0)
        throw std::runtime_error(
            "--entity-server: expected host:port with a port from 1 to 65535, as 127.0.0.1:10412, not '" +
            at + "'");
    if (!home.router.empty()) {
        home.router = transport::wayToRouter(home.router, transport::speaksTls(settings.home_properties));
        home.tls = transport::isTlsRouter(home.router);
        if (const auto tried = transport::routerTriedFor(home.router))
            settings.home_properties.try_emplace("Ice.Override.ConnectTimeout", std::to_string(*tried));
    }
    if (home.tls && !transport::speaksTls(settings.home_properties))
        throw std::runtime_error(transport::certificateMissing(home.text(), "entity"));
    home.user = said("Axon.User");
    home.password = said("Axon.Password");
}

/// Where and how a client logs in in the partner's laboratory.
void readThere(GatewaySettings& settings, const std::string& file, const std::string& server) {
    auto& there = settings.there;
    there.server.clear();
    if (!file.empty()) {
        auto read = client::readConfiguration(file, there);
        if (!read) throw std::runtime_error(read.refusal().message);
        there = std::move(read).value();
    }
    if (!server.empty()) there.server = server;
    if (there.server.empty())
        throw std::runtime_error(
            "no server of the partner's laboratory is named; say --server HOST:PORT, where its clients log "
            "in, or "
            "Axon.Server=HOST:PORT in the file of --client-config");
    try {
        if (transport::isRouter(there.server))
            there.server = transport::wayToRouter(there.server, transport::speaksTls(there.properties));
        else
            transport::parseEndpoint(there.server);
    } catch (const std::invalid_argument& error) {
        throw std::runtime_error(std::string("--server: ") + error.what());
    }
    const bool tls = transport::isRouter(there.server) ? transport::isTlsRouter(there.server)
                                                       : transport::parseEndpoint(there.server).tls;
    if (tls && !transport::speaksTls(there.properties))
        throw std::runtime_error(transport::certificateMissing(there.server, "client"));
    there.direct = false;
}

}  // namespace

PartnerOptions readPartnerOptions(int argc, const char* const* argv) {
    CLI::App app{
        "Shows the robots of another laboratory in this one. Clients here see them as\n"
        "NAME/ROBOT and use them like their own; the other laboratory decides about each\n"
        "check-out, as for its own clients, and stops its robots when this gateway or its\n"
        "connections fail. Runs in this laboratory, as a client of the other one.\n\n"
        "  axon-partner --name b --as a --server lab-b.example:10410 --entity-server 127.0.0.1:10412\n"
        "  axon-partner --config /etc/axon/partner.cfg\n\n"
        "The other laboratory lets this program in as a user (its users.cfg says what it\n"
        "may), this one as an entity. Both may want a certificate: the files of\n"
        "--client-config and --entity-config are those of the command axon and of\n"
        "axon-entity-manager.\n"};
    app.set_version_flag("--version", std::string("axon-partner ") + kRelease);
    std::string config, name, as, server, entity_server, client_config, entity_config, state, log_level,
        visitors;
    app.add_option(
        "-c,--config", config,
        "Configuration file with lines KEY = VALUE (docs/reference/settings_files.md); the options "
        "below override it");
    app.add_option(
        "-n,--name", name,
        "What the other laboratory is called here: its PeopleBot is NAME/PeopleBot (Partner.Name)");
    app.add_option("--as", as,
                   "What this laboratory is called there: its holders are AS@CLIENT (Partner.As)");
    app.add_option("-s,--server", server, "host:port where clients log in in the other laboratory");
    app.add_option(
        "--client-config", client_config,
        "File with Axon.Server or Ice.Default.Router, Axon.User, Axon.Password and the certificate for "
        "the other laboratory (Partner.Client)");
    app.add_option("-e,--entity-server", entity_server,
                   "host:port where Entity Managers log in in this laboratory [127.0.0.1:10412]");
    app.add_option("--entity-config", entity_config,
                   "File with the same keys for this laboratory's entity server (Partner.Entity)");
    app.add_option("--visitors", visitors,
                   "How many clients of this laboratory may use entities of the other one at a time "
                   "(Partner.Visitors) [200]");
    app.add_option("--state", state,
                   "Folder for the secret from which the entities have their UUIDs here (Partner.State) "
                   "[~/.local/state/axon/partner-NAME]");
    app.add_option(
        "--log-level", log_level,
        "Least severe messages to log: " + std::string(transport::kLogLevels) + " (Partner.LogLevel) [info]");
    PartnerOptions options;
    try {
        app.parse(argc, argv);
    } catch (const CLI::ExtrasError&) {
        std::vector<std::string> known;
        for (const auto* option : app.get_options())
            for (const auto& its : option->get_lnames()) known.push_back("--" + its);
        std::cerr << unexpectedWords("axon-partner", app.remaining(), known) << std::endl;
        options.exit_code = 2;
        return options;
    } catch (const CLI::ParseError& error) {
        options.exit_code = app.exit(error) == 0 ? 0 : 2;
        return options;
    }
    const auto file = config.empty() ? transport::Properties() : transport::readProperties(config, kKeys);
    if (!file.ice.empty())
        throw std::runtime_error(
            config + ": " + file.ice.begin()->first +
            " belongs to one of the two laboratories; put it into the file of Partner.Client, "
            "for the other one, or of Partner.Entity, for this one");
    const auto chosen = [&](const std::string& option, const char* key, const std::string& otherwise) {
        if (!option.empty()) return option;
        const auto found = file.own.find(key);
        return found == file.own.end() ? otherwise : found->second.value;
    };
    auto& core = options.gateway.core;
    core.laboratory = laboratory("--name (Partner.Name)", chosen(name, "Partner.Name", ""), "--name b");
    core.home = laboratory("--as (Partner.As)", chosen(as, "Partner.As", ""), "--as a");
    const auto count = chosen(visitors, "Partner.Visitors", "200");
    if (count.empty() || count.size() > 5 || count.find_first_not_of("0123456789") != std::string::npos ||
        std::stoul(count) < 1 || std::stoul(count) > 10'000)
        throw std::runtime_error(
            "--visitors (Partner.Visitors): expected a whole number from 1 to 10000, not '" + count + "'");
    core.visitors_max = std::stoul(count);
    readThere(options.gateway, chosen(client_config, "Partner.Client", ""), server);
    readHome(options.gateway, chosen(entity_config, "Partner.Entity", ""), entity_server);
    options.log_level = chosen(log_level, "Partner.LogLevel", "info");
    if (!transport::isLogLevel(options.log_level))
        throw std::runtime_error("--log-level (Partner.LogLevel): expected " +
                                 std::string(transport::kLogLevels) + ", not '" + options.log_level + "'");
    options.state_folder = chosen(state, "Partner.State", defaultStateFolder(core.laboratory));
    return options;
}

}  // namespace axon::partner
