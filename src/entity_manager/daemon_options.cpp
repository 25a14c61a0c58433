// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/daemon_options.hpp"

#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdlib>
#include <iostream>
#include <set>
#include <stdexcept>

#include "common/release.hpp"
#include "messages/unexpected_words.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/properties.hpp"
#include "transport/ice/tls.hpp"
#include "transport/process/logging.hpp"
#include "transport/sessions/routed_session.hpp"

namespace axon::entity_manager {

namespace {

namespace fs = std::filesystem;

constexpr const char* kRouter = "Ice.Default.Router";

const std::set<std::string> kKeys{kRouter,
                                  "Axon.Application",
                                  "Axon.Instance",
                                  "Axon.Server",
                                  "Axon.User",
                                  "Axon.Password",
                                  "Axon.Ports",
                                  "Axon.PortsFile",
                                  "Axon.Users",
                                  "Axon.State",
                                  "Axon.LogLevel",
                                  "Axon.WatchdogBusyMs",
                                  "Axon.WatchdogIdleMs",
                                  "Axon.Address",
                                  "Axon.Datagrams",
                                  "Axon.Direct",
                                  "Axon.Direct.Spin",
                                  "Axon.LockMemory",
                                  "Axon.LeaseGrace",
                                  "Axon.LinkWatchdogBusyMs",
                                  "Axon.LinkWatchdogIdleMs",
                                  "Axon.AnswerWithinMs",
                                  "Axon.ResourceBytesMax",
                                  "Axon.Audit.Folder",
                                  "Axon.Audit.Size",
                                  "Axon.Audit.Files"};

fs::path defaultStateFolder(const std::string& application, const std::string& instance) {
    const char* state = std::getenv("XDG_STATE_HOME");
    const char* home = std::getenv("HOME");
    fs::path root =
        state && *state ? fs::path(state) : fs::path(home && *home ? home : "/var/lib") / ".local/state";
    return root / "axon" / (instance.empty() ? application : application + "-" + instance);
}

std::int64_t integerBetween(const std::string& what, const std::string& text, std::int64_t low,
                            std::int64_t high) {
    std::size_t used = 0;
    std::int64_t value = 0;
    try {
        value = std::stoll(text, &used);
    } catch (const std::exception&) {
        used = 0;
    }
    if (used != text.size() || text.empty() || value < low || value > high)
        throw std::runtime_error(what + ": expected a whole number from " + std::to_string(low) + " to " +
                                 std::to_string(high) + ", not '" + text + "'");
    return value;
}

std::chrono::milliseconds secondsBetween(const std::string& what, const std::string& text, double low,
                                         double high) {
    std::size_t used = 0;
    double value = 0;
    try {
        value = std::stod(text, &used);
    } catch (const std::exception&) {
        used = 0;
    }
    if (used != text.size() || text.empty() || !(value >= low && value <= high))
        throw std::runtime_error(what + ": expected a number of seconds from " +
                                 std::to_string(static_cast<int>(low)) + " to " +
                                 std::to_string(static_cast<int>(high)) + ", not '" + text + "'");
    return std::chrono::milliseconds(std::lround(value * 1000));
}

template <class T>
T accepted(Result<T> result) {
    if (!result) throw std::runtime_error(result.refusal().message);
    return std::move(result).value();
}

/// "on", "off", an address, a port, or both.
DatagramSettings datagramsOf(const std::string& what, const std::string& text) {
    DatagramSettings settings;
    if (text == "off") return settings;
    settings.offered = true;
    if (text == "on") return settings;
    if (const auto both = datagrams::Endpoint::parse(text)) {
        settings.address = text.substr(0, text.rfind(':'));
        settings.port = both->port;
    } else if (datagrams::parseAddress(text)) {
        settings.address = text;
    } else if (const auto port = datagrams::Endpoint::parse("0.0.0.0:" + text)) {
        settings.port = port->port;
    } else {
        throw std::runtime_error(
            what +
            ": expected on, off, an address of four numbers, a port, or ADDRESS:PORT, as "
            "192.168.0.7:10420, not '" +
            text + "'");
    }
    return settings;
}

/// "on", "off", an address, a range of ports, or both.
DirectSettings directOf(const std::string& what, const std::string& text) {
    DirectSettings settings;
    if (text == "off") return settings;
    settings.offered = true;
    if (text == "on") return settings;
    const auto fail = [&] {
        throw std::runtime_error(
            what +
            ": expected on, off, an address of four numbers, at least two ports from 1024 to "
            "65535, or "
            "ADDRESS:FIRST-LAST, as 192.168.0.7:10430-10439, not '" +
            text + "'");
    };
    const auto colon = text.find(':');
    auto ports = colon == std::string::npos ? text : text.substr(colon + 1);
    if (colon != std::string::npos) settings.address = text.substr(0, colon);
    if (colon == std::string::npos && datagrams::parseAddress(text)) {
        settings.address = text;
        return settings;
    }
    if (!settings.address.empty() && !datagrams::parseAddress(settings.address)) fail();
    const auto dash = ports.find('-');
    if (dash == std::string::npos) fail();
    const auto port = [&](const std::string& digits) {
        const auto number = datagrams::Endpoint::parse("0.0.0.0:" + digits);
        if (!number || number->port < 1024) fail();
        return number->port;
    };
    settings.ports = {port(ports.substr(0, dash)), port(ports.substr(dash + 1))};
    if (settings.ports.last <= settings.ports.first ||
        (colon != std::string::npos && settings.address.empty()))
        fail();
    return settings;
}

}  // namespace

DaemonOptions readDaemonOptions(int argc, const char* const* argv) {
    CLI::App app{
        "The Entity Manager: stands beside one robot application and connects it to the Axon server.\n"
        "It decides who may command the robot and when a task runs, and it makes sure that a stop stops.\n\n"
        "  axon-entity-manager --application hello\n"
        "  axon-entity-manager --application peoplebot --server lab.example:10412 --config "
        "entitymanager.cfg\n"};
    app.set_version_flag("--version", std::string("axon-entity-manager ") + kRelease);
    std::string config, application, instance, server, ports, ports_file, users, address, state, log_level;
    app.add_option(
        "-c,--config", config,
        "Configuration file with lines KEY = VALUE (docs/reference/settings_files.md); the options "
        "below override it");
    app.add_option("-a,--application", application,
                   "Name the robot application gives its Entity Interfacer (Axon.Application)");
    app.add_option("--instance", instance,
                   "Which of several applications of the same name on this host (Axon.Instance)");
    app.add_option("-s,--server", server, "host:port of the entity server (Axon.Server) [127.0.0.1:10412]");
    app.add_option("--ports", ports, "Port range to look for the application in (Axon.Ports) [5500-8000]");
    app.add_option("--ports-file", ports_file, "ports.cfg to read the range from (Axon.PortsFile)");
    app.add_option("--users", users,
                   "Users of this machine, besides this one and root, whose process the application may be, "
                   "names or numbers (Axon.Users)");
    app.add_option("--address", address, "Address where the application listens (Axon.Address) [127.0.0.1]");
    app.add_option(
        "--state", state,
        "Folder for identity, leases and resources (Axon.State) [~/.local/state/axon/APPLICATION]");
    app.add_option(
        "--log-level", log_level,
        "Least severe messages to log: " + std::string(transport::kLogLevels) + " (Axon.LogLevel) [info]");

    DaemonOptions options;
    try {
        app.parse(argc, argv);
    } catch (const CLI::ExtrasError&) {
        std::vector<std::string> known;
        for (const auto* option : app.get_options())
            for (const auto& name : option->get_lnames()) known.push_back("--" + name);
        std::cerr << unexpectedWords("axon-entity-manager", app.remaining(), known) << std::endl;
        options.exit_code = 2;
        return options;
    } catch (const CLI::ParseError& e) {
        options.exit_code = app.exit(e) == 0 ? 0 : 2;
        return options;
    }
    auto properties = config.empty() ? transport::Properties() : transport::readProperties(config, kKeys);
    options.ice_properties = std::move(properties.ice);
    const auto& file = properties.own;
    const auto chosen = [&file](const std::string& option, const char* key, const std::string& otherwise) {
        if (!option.empty()) return option;
        const auto found = file.find(key);
        return found == file.end() ? otherwise : found->second.value;
    };
    // Of what only the file can say; messages name the line.
    const auto read = [&file](const char* key, const char* otherwise, auto parse) {
        const auto found = file.find(key);
        if (found == file.end()) return parse(key, otherwise);
        return parse(found->second.where + ": " + key, found->second.value);
    };
    const auto integer = [&](const char* key, const char* otherwise, std::int64_t low, std::int64_t high) {
        return read(key, otherwise, [=](const std::string& what, const std::string& text) {
            return integerBetween(what, text, low, high);
        });
    };
    const auto milliseconds = [&](const char* key, const char* otherwise, int low, int high) {
        return std::chrono::milliseconds(integer(key, otherwise, low, high));
    };

    options.core.application = chosen(application, "Axon.Application", "");
    if (options.core.application.empty())
        throw std::runtime_error(
            "no application named; say --application NAME, the name that the robot application gives its "
            "Entity Interfacer, or Axon.Application=NAME in the configuration file");
    options.back_end.application = options.core.application;
    options.back_end.manager = "axon-entity-manager, process " + std::to_string(::getpid());
    options.back_end.instance = chosen(instance, "Axon.Instance", "");
    if (const auto from = chosen(ports_file, "Axon.PortsFile", ""); !from.empty()) {
        options.back_end.where = accepted(readPorts(from));
        options.back_end.ports_from = from;
    }
    if (const auto range = chosen(ports, "Axon.Ports", ""); !range.empty()) {
        options.back_end.where.ports = accepted(parsePorts("Axon.Ports = " + range, "--ports")).ports;
        options.back_end.ports_from = ports.empty() ? "Axon.Ports in " + config : "--ports";
    }
    if (const auto names = chosen(users, "Axon.Users", ""); !names.empty())
        options.back_end.where.users =
            accepted(LinkUsers::parse(names, users.empty() ? "Axon.Users in " + config : "--users"));
    options.back_end.where.address = chosen(address, "Axon.Address", options.back_end.where.address);

    if (file.contains(kRouter) && file.contains("Axon.Server"))
        throw std::runtime_error(
            config +
            ": Ice.Default.Router and Axon.Server are both there; expected one of them: the way "
            "to the entity server is either through a router or without one");
    if (server.empty()) options.server.router = chosen("", kRouter, "");
    const auto at = chosen(server, "Axon.Server", "127.0.0.1:10412");
    try {
        const auto called = transport::parseEndpoint(at);
        options.server.host = called.host;
        options.server.port = called.port;
        options.server.tls = called.tls;
    } catch (const std::invalid_argument& error) {
        throw std::runtime_error(std::string("--server: ") + error.what());
    }
    if (auto& router = options.server.router; !router.empty()) {
        router = transport::wayToRouter(router, transport::speaksTls(options.ice_properties));
        options.server.tls = transport::isTlsRouter(router);
        if (const auto tried = transport::routerTriedFor(router))
            options.ice_properties.try_emplace("Ice.Override.ConnectTimeout", std::to_string(*tried));
    }
    if (options.server.port == 0)
        throw std::runtime_error(
            "--server: expected host:port with a port from 1 to 65535, as 127.0.0.1:10412, not '" + at + "'");
    if (options.server.tls && !transport::speaksTls(options.ice_properties))
        throw std::runtime_error(transport::certificateMissing(options.server.text(), "entity"));
    options.server.user = chosen("", "Axon.User", "");
    options.server.password = chosen("", "Axon.Password", "");

    options.core.server_watchdog_busy = milliseconds("Axon.WatchdogBusyMs", "250", 50, 2000);
    options.core.server_watchdog_idle = milliseconds("Axon.WatchdogIdleMs", "10000", 250, 60000);
    options.datagrams = read("Axon.Datagrams", "on", datagramsOf);
    options.direct = read("Axon.Direct", "on", directOf);
    options.direct.spin =
        std::chrono::microseconds(integer("Axon.Direct.Spin", "0", 0, direct::lane::kSpinMost.count()));
    options.lock_memory = integer("Axon.LockMemory", "1", 0, 1) != 0;
    options.core.lease_grace = read(
        "Axon.LeaseGrace", "5",
        [](const std::string& what, const std::string& text) { return secondsBetween(what, text, 0, 600); });
    options.back_end.watchdog_busy = milliseconds("Axon.LinkWatchdogBusyMs", "250", 50, 2000);
    options.back_end.watchdog_idle = milliseconds("Axon.LinkWatchdogIdleMs", "500", 100, 10000);
    options.core.answer_within = milliseconds("Axon.AnswerWithinMs", "10000", 100, 600000);
    options.core.resource_bytes_max =
        static_cast<std::uint64_t>(integer("Axon.ResourceBytesMax", "1073741824", 1, std::int64_t{1} << 40U));
    const auto ordered = [](const char* busy, Duration shorter, const char* idle, Duration longer) {
        if (shorter > longer)
            throw std::runtime_error(
                std::string(busy) + " is longer than " + idle +
                ": expected the watchdog of a running task to be the shorter one; lower the first or "
                "raise the second");
    };
    ordered("Axon.WatchdogBusyMs", options.core.server_watchdog_busy, "Axon.WatchdogIdleMs",
            options.core.server_watchdog_idle);
    ordered("Axon.LinkWatchdogBusyMs", options.back_end.watchdog_busy, "Axon.LinkWatchdogIdleMs",
            options.back_end.watchdog_idle);
    options.log_level = chosen(log_level, "Axon.LogLevel", "info");
    if (!transport::isLogLevel(options.log_level))
        throw std::runtime_error("--log-level (Axon.LogLevel): expected " +
                                 std::string(transport::kLogLevels) + ", not '" + options.log_level + "'");
    options.state_folder =
        chosen(state, "Axon.State", defaultStateFolder(options.core.application, options.back_end.instance));
    if (const auto folder = chosen("", "Axon.Audit.Folder", ""); !folder.empty())
        options.audit.folder = options.state_folder / folder;  // or the folder itself, if it is absolute
    using Bounds = audit::Files::Bounds;
    options.audit.files.bytes = static_cast<std::uint64_t>(
        integer("Axon.Audit.Size", "16777216", Bounds::kBytesLeast, Bounds::kBytesMost));
    options.audit.files.files =
        static_cast<int>(integer("Axon.Audit.Files", "8", Bounds::kFilesLeast, Bounds::kFilesMost));
    return options;
}

}  // namespace axon::entity_manager
