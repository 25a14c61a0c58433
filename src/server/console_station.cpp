// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/console_station.hpp"

#include <sys/utsname.h>

#include <algorithm>
#include <filesystem>
#include <optional>
#include <stdexcept>
#include <utility>

#include "certificates/certificate.hpp"
#include "common/rate_limit.hpp"
#include "console/built_folder.hpp"
#include "console/core/console_core.hpp"
#include "console/core/visitors.hpp"
#include "console/http_server.hpp"
#include "server/console_desk.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/tls.hpp"

namespace axon::server {
namespace {

std::filesystem::path folderOf(const ConsoleSettings& settings) {
    if (!settings.folder.empty()) return settings.folder;
    std::error_code unknown;
    return console::consoleFolder(std::filesystem::read_symlink("/proc/self/exe", unknown));
}

console::HttpServer::Settings httpSettings(const ConsoleSettings& settings,
                                           const std::map<std::string, std::string>& ice_properties) {
    const auto endpoint = transport::parseEndpoint(settings.endpoint);
    console::HttpServer::Settings its;
    its.host = endpoint.host;
    its.port = endpoint.port;
    if (!settings.proxies.empty()) its.connections_of_proxy_max = its.connections_max;
    if (!endpoint.tls) return its;
    try {
        auto credentials = transport::credentialsOf(ice_properties);
        its.certificate = std::move(credentials.certificate);
        its.key = std::move(credentials.key);
        its.key_password = std::move(credentials.password);
        its.tls_1_2 = credentials.tls_1_2;
    } catch (const certificates::Unusable& unusable) {
        throw std::runtime_error(std::string("the console cannot speak TLS: ") + unusable.what() +
                                 "; fix: " + unusable.fix());
    }
    return its;
}

/// What this machine calls itself. A name that is no host's is left out.
std::vector<std::string> namesOf(const ConsoleSettings& settings) {
    auto names = settings.names;
    utsname machine{};
    if (::uname(&machine) != 0) return names;
    try {
        const std::string its = machine.nodename;
        [[maybe_unused]] const console::Sites tried({false, 0, 0, 0, {its}, {}});
        names.push_back(its);
    } catch (const std::invalid_argument&) {
    }
    return names;
}

const ConsoleSettings& checked(const ConsoleSettings& settings) {
    try {
        [[maybe_unused]] const console::Sites tried({false, 0, 0, 0, settings.names, settings.proxies});
    } catch (const std::invalid_argument& error) {
        throw std::runtime_error(std::string("Console.Names, Console.Proxies: ") + error.what());
    }
    return settings;
}

}  // namespace

struct ConsoleStation::Parts {
    Parts(ConsoleSettings its, const std::map<std::string, std::string>& ice_properties,
          LoginDesk& login_desk, bool has_users, const Clock& its_clock, RandomSource& random, Note its_note)
        : settings(std::move(its)),
          clock(its_clock),
          note(std::move(its_note)),
          visitors(clock, random),
          desk(login_desk, has_users, visitors, [this](const std::string& line) { noteStranger(line); }),
          folder(folderOf(settings), clock, note),
          http(httpSettings(settings, ice_properties)) {}

    /// Of what anybody can cause as often as they like: a few lines in a second, which push no others out of
    /// the log.
    void noteStranger(const std::string& line) {
        if (strangers.admit(clock.now())) note(line);
    }

    const ConsoleSettings settings;
    const Clock& clock;
    const Note note;
    RateLimit strangers{10};
    console::Visitors visitors;
    ConsoleDesk desk;
    console::BuiltFolder folder;
    std::optional<console::Sites> sites;
    std::optional<console::ConsoleCore> core;
    console::HttpServer http;  // last: its thread uses the others
};

ConsoleStation::ConsoleStation(const ConsoleSettings& settings,
                               const std::map<std::string, std::string>& ice_properties, LoginDesk& desk,
                               bool has_users, const Clock& clock, RandomSource& random, Note note)
    : parts_(std::make_unique<Parts>(checked(settings), ice_properties, desk, has_users, clock, random,
                                     std::move(note))) {}

ConsoleStation::~ConsoleStation() = default;

transport::Logins& ConsoleStation::logins() {
    return parts_->desk;
}

transport::Logins& ConsoleStation::signals() {
    return parts_->desk.signals();
}

std::string ConsoleStation::signalEndpoint(const std::string& local,
                                           const std::optional<std::string>& origin) const {
    const auto& sites = parts_->sites.value();
    if (!origin) return sites.ofAddress(local).signal_endpoint;
    const auto site = sites.ofOrigin(*origin, local);
    return site ? site->signal_endpoint : std::string();
}

void ConsoleStation::usersChanged(const users::Users& before, const users::Users& now) {
    parts_->desk.usersChanged(before, now);
}

void ConsoleStation::serve(const transport::DoorPorts& sessions) {
    auto& its = *parts_;
    const auto endpoint = transport::parseEndpoint(its.settings.endpoint);
    const auto& sites = its.sites.emplace(
        console::Sites::Settings{endpoint.tls, its.http.port(), sessions.data, sessions.signal,
                                 namesOf(its.settings), its.settings.proxies});
    its.desk.setSites(sites);
    its.core.emplace(sites, its.folder, its.desk, its.visitors, its.note,
                     [&its](const std::string& line) { its.noteStranger(line); });
    its.http.serve(*its.core, its.clock);
}

std::string ConsoleStation::address() const {
    const auto endpoint = transport::parseEndpoint(parts_->settings.endpoint);
    const auto host = endpoint.host == "0.0.0.0" ? std::string("127.0.0.1") : endpoint.host;
    return (endpoint.tls ? "https://" : "http://") + host + ":" + std::to_string(parts_->http.port()) + "/";
}

}  // namespace axon::server
