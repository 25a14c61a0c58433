// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/options.hpp"

#include <CLI/CLI.hpp>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>
#include <filesystem>
#include <functional>
#include <iostream>
#include <map>
#include <set>
#include <stdexcept>

#include "common/release.hpp"
#include "host/port_range.hpp"
#include "messages/unexpected_words.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/properties.hpp"
#include "transport/process/logging.hpp"
#include "users/users_file.hpp"

namespace axon::server {
namespace {

constexpr int kConsolePort = 7;  // after the first of the family; those of its sessions follow
constexpr int kConsolePorts = 3;
constexpr int kPortMax = 65535;

std::string lowerOrWithout() {
    return "choose a port for clients (--base-port) of at most " +
           std::to_string(kPortMax - kConsolePort - kConsolePorts + 1) +
           ", name others with --console-endpoint, or leave the console out with --no-console";
}

std::vector<transport::Endpoint> endpointsOf(const std::string& where, const std::string& text) {
    try {
        return transport::parseEndpoints(text);
    } catch (const std::invalid_argument& error) {
        throw std::runtime_error(where + ": " + error.what());
    }
}

long number(const std::string& where, const std::string& text, long least, long most) {
    long value = 0;
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
    if (error != std::errc{} || end != text.data() + text.size() || value < least || value > most) {
        throw std::runtime_error(where + ": '" + text + "': expected a number from " + std::to_string(least) +
                                 " to " + std::to_string(most));
    }
    return value;
}

void setRole(ServerSettings& settings, const std::string& role) {
    settings.role = role == "front-end" ? ServerRole::FrontEnd
                    : role == "entity"  ? ServerRole::Entity
                                        : ServerRole::Both;
    if (settings.role == ServerRole::Both) {
        if (settings.topic_manager.empty()) return;
        throw std::runtime_error(
            "Server.TopicManager is set, but is only for one of several servers; fix: add --role front-end "
            "or --role entity, or remove the key from the configuration");
    }
    if (settings.name.empty())
        throw std::runtime_error("--role " + role +
                                 ": expected Server.Name in the configuration; fix: add a name that no other "
                                 "server has, such as Server.Name=" +
                                 (role == "entity" ? "es1" : "fe1"));
    if (settings.topic_manager.empty())
        throw std::runtime_error("--role " + role +
                                 ": expected Server.TopicManager in the configuration; fix: add it, such as "
                                 "Server.TopicManager=IceStorm/TopicManager:tcp -h 127.0.0.1 -p 10430");
}

/// The folder "inside the server's installation directory" of the thesis (A.4). One that somebody has named
/// must be there; the default one may come later, or never.
void findGlobalServices(ServerSettings& settings, const std::vector<std::string>& files) {
    auto& folder = settings.global_services;
    if (folder.empty()) {
        const std::filesystem::path beside = files.empty() ? "" : files.front();
        folder = (beside.parent_path() / "globalservices").string();
        return;
    }
    std::error_code failure;
    if (settings.role == ServerRole::Entity || std::filesystem::is_directory(folder, failure)) return;
    throw std::runtime_error(
        "'" + folder +
        "' is not a folder: expected the folder with the profiles of the global services "
        "(Server.GlobalServices, --global-services); fix: create it, or leave the setting out");
}

/// Words apart by blanks or commas.
std::vector<std::string> wordsOf(const std::string& text) {
    constexpr const char* kApart = " \t,";
    std::vector<std::string> words;
    for (auto at = text.find_first_not_of(kApart); at != std::string::npos;
         at = text.find_first_not_of(kApart, at)) {
        const auto end = std::min(text.find_first_of(kApart, at), text.size());
        words.push_back(text.substr(at, end - at));
        at = end;
    }
    return words;
}

struct ConsolePort {
    std::string* endpoint;
    const char* option;
    const char* key;
};

std::array<ConsolePort, 3> consolePorts(ConsoleSettings& console) {
    return {{{&console.endpoint, "console", "Console.Endpoints"},
             {&console.session_endpoint, "console-session", "ConsoleSession.Endpoints"},
             {&console.signal_endpoint, "console-signal", "ConsoleSignal.Endpoints"}}};
}

/// The endpoints that somebody has named: an option wins, and the others are moved as those of clients are.
void moveConsole(ConsoleSettings& console, const std::map<std::string, std::string>& options,
                 const std::string& listen, int base_port) {
    int port = base_port + kConsolePort;
    for (const auto& [endpoint, option, key] : consolePorts(console)) {
        const int its_port = port++;
        if (const auto& given = options.at(option); !given.empty()) {
            *endpoint = given;
        } else if (!endpoint->empty() && (!listen.empty() || base_port >= 0)) {
            auto one = endpointsOf(key, *endpoint).front();
            // What is configured for this machine alone stays there: who wants browsers of others says so.
            if (!listen.empty() && (isLoopback(listen) || !isLoopback(one.host))) one.host = listen;
            if (base_port == 0) one.port = 0;
            if (base_port > 0) {
                if (its_port > kPortMax)
                    throw std::runtime_error("--base-port " + std::to_string(base_port) + ": " + key +
                                             " would be at port " + std::to_string(its_port) +
                                             ", and there is none; fix: " + lowerOrWithout());
                one.port = static_cast<std::uint16_t>(its_port);
            }
            *endpoint = one.text();
        }
    }
}

/// The port after this one; 0 stays 0, a free one.
std::string portAfter(const std::string& endpoint, const char* key) {
    auto its = endpointsOf(key, endpoint).front();
    if (its.port == kPortMax)
        throw std::runtime_error(std::string(key) + ": there is no port after that of '" + endpoint +
                                 "'; fix: set " + key + ", or choose a lower one");
    if (its.port != 0) ++its.port;
    return its.text();
}

/// Where nobody has said where the console is, it follows the port for clients, so that two servers have two.
/// Then it is for this machine only: who wants browsers of others to reach it says so.
void placeConsole(ServerSettings& settings) {
    auto& its = settings.console;
    its.required = !its.endpoint.empty() || !its.session_endpoint.empty() || !its.signal_endpoint.empty();
    if (!its.required && settings.role != ServerRole::Both) return;
    if (its.endpoint.empty()) {
        auto pages = transport::parseEndpoints(settings.client_endpoint).front();
        if (pages.port > kPortMax - kConsolePort - kConsolePorts + 1) {
            const auto why = "its ports follow that for clients, and there are none after " +
                             std::to_string(kPortMax) + "; fix: " + lowerOrWithout();
            if (its.required) throw std::runtime_error("Console.Endpoints: " + why);
            its.left_out = why;
            return;
        }
        if (pages.port != 0) pages.port = static_cast<std::uint16_t>(pages.port + kConsolePort);
        if (pages.tls || !isLoopback(pages.host)) pages = {"127.0.0.1", pages.port, false};
        its.endpoint = pages.text();
    }
    if (its.session_endpoint.empty())
        its.session_endpoint = portAfter(its.endpoint, "ConsoleSession.Endpoints");
    if (its.signal_endpoint.empty())
        its.signal_endpoint = portAfter(its.session_endpoint, "ConsoleSignal.Endpoints");
    for (const auto& [endpoint, option, key] : consolePorts(its))
        checkEndpoints(*endpoint, !settings.users_file.empty(), settings.plain_tcp);
    std::error_code unknown;
    if (!its.folder.empty() && !std::filesystem::is_directory(its.folder, unknown))
        throw std::runtime_error("'" + its.folder +
                                 "' is not a folder: expected that of the built console (Console.Files, "
                                 "--console-files); fix: correct it, or leave the setting out");
}

void addUser(const std::string& file, const std::string& name, const std::string& role) {
    if (file.empty())
        throw std::runtime_error("--add-user: expected the file to write to; fix: add --users FILE");
    const auto its_role = users::userRole(role);
    if (!its_role)
        throw std::runtime_error("--user-role '" + role + "': expected observer, operator, admin or entity");
    users::writeUser(file, name, *its_role, users::readNewPassword());
    std::fprintf(stderr,
                 "%s: '%s' may log in as %s; servers that run say in their logs when they have taken that "
                 "over (users: taken)\n",
                 file.c_str(), name.c_str(), users::toString(*its_role));
}

}  // namespace

void readConfiguration(const std::string& file, ServerSettings& settings) {
    const auto milliseconds = [](Duration& to, long least, long most) {
        return [&to, least, most](const std::string& where, const std::string& text) {
            to = std::chrono::milliseconds{number(where, text, least, most)};
        };
    };
    const auto endpoint = [](std::string& to) {
        return [&to](const std::string& where, const std::string& text) {
            to = transport::textOf(endpointsOf(where, text));
        };
    };
    const auto published = [&](const std::string& adapter) {
        return [&settings, key = adapter + ".PublishedEndpoints"](const std::string& where,
                                                                  const std::string& text) {
            settings.ice_properties[key] = transport::textOf(endpointsOf(where, text));
        };
    };
    const std::map<std::string, std::function<void(const std::string&, const std::string&)>> keys = {
        {"FrontEndServer.Endpoints", endpoint(settings.client_endpoint)},
        {"FrontEndServerSignal.Endpoints", endpoint(settings.client_signal_endpoint)},
        {"FrontEndServerSignal.PublishedEndpoints", published("FrontEndServerSignal")},
        {"EntityServer.Endpoints", endpoint(settings.entity_endpoint)},
        {"EntityServerSignal.Endpoints", endpoint(settings.entity_signal_endpoint)},
        {"EntityServerSignal.PublishedEndpoints", published("EntityServerSignal")},
        {"FrontEndServerRouter.Endpoints", endpoint(settings.client_router_endpoint)},
        {"EntityServerRouter.Endpoints", endpoint(settings.entity_router_endpoint)},
        {"FrontEndServer.WatchdogBusyMs", milliseconds(settings.front_end.watchdog_busy, 50, 2000)},
        {"FrontEndServer.WatchdogIdleMs", milliseconds(settings.front_end.watchdog_idle, 1000, 600'000)},
        {"FrontEndServer.ClientsMax",
         [&](const auto& where, const auto& text) {
             settings.front_end.clients_max = static_cast<std::size_t>(number(where, text, 1, 1'000'000));
         }},
        {"FrontEndServer.UserSessions",
         [&](const auto& where, const auto& text) {
             settings.front_end.user_sessions = static_cast<std::size_t>(number(where, text, 1, 1'000'000));
         }},
        {"FrontEndServer.UserCheckOuts",
         [&](const auto& where, const auto& text) {
             settings.front_end.user_check_outs = static_cast<std::size_t>(number(where, text, 0, 1'000'000));
         }},
        {"FrontEndServer.UserMessages",
         [&](const auto& where, const auto& text) {
             settings.front_end.user_messages_per_second =
                 static_cast<std::uint32_t>(number(where, text, 10, 10'000'000));
         }},
        {"FrontEndServer.UserBytes",
         [&](const auto& where, const auto& text) {
             settings.front_end.user_bytes_per_second =
                 static_cast<std::uint32_t>(number(where, text, 1024, 2'000'000'000));
         }},
        {"EntityServer.EntitiesMax",
         [&](const auto& where, const auto& text) {
             settings.entity.entities_max = static_cast<std::size_t>(number(where, text, 1, 1'000'000));
         }},
        {"Axon.DrillPeriod",
         [&](const auto& where, const auto& text) {
             settings.entity.drill_period = std::chrono::seconds{number(where, text, 0, 86'400)};
         }},
        {"Axon.Audit.Folder", [&](const auto&, const auto& text) { settings.audit.folder = text; }},
        {"Axon.Audit.Size",
         [&](const auto& where, const auto& text) {
             using Bounds = audit::Files::Bounds;
             settings.audit.files.bytes =
                 static_cast<std::uint64_t>(number(where, text, Bounds::kBytesLeast, Bounds::kBytesMost));
         }},
        {"Axon.Audit.Files",
         [&](const auto& where, const auto& text) {
             using Bounds = audit::Files::Bounds;
             settings.audit.files.files =
                 static_cast<int>(number(where, text, Bounds::kFilesLeast, Bounds::kFilesMost));
         }},
        {"FrontEndServerTopic.Endpoints", endpoint(settings.topic_endpoint)},
        {"FrontEndServerTopicSignal.Endpoints", endpoint(settings.topic_signal_endpoint)},
        {"EntityServerTopic.Endpoints", endpoint(settings.topic_endpoint)},
        {"EntityServerTopicSignal.Endpoints", endpoint(settings.topic_signal_endpoint)},
        {"FrontEndServerTopic.PublishedEndpoints", published("FrontEndServerTopic")},
        {"FrontEndServerTopicSignal.PublishedEndpoints", published("FrontEndServerTopicSignal")},
        {"EntityServerTopic.PublishedEndpoints", published("EntityServerTopic")},
        {"EntityServerTopicSignal.PublishedEndpoints", published("EntityServerTopicSignal")},
        {"Server.Console",
         [&](const auto& where, const auto& text) {
             settings.console.wanted = number(where, text, 0, 1) != 0;
         }},
        {"Console.Endpoints", endpoint(settings.console.endpoint)},
        {"ConsoleSession.Endpoints", endpoint(settings.console.session_endpoint)},
        {"ConsoleSignal.Endpoints", endpoint(settings.console.signal_endpoint)},
        {"Console.Files", [&](const auto&, const auto& text) { settings.console.folder = text; }},
        {"Console.Names", [&](const auto&, const auto& text) { settings.console.names = wordsOf(text); }},
        {"Console.Proxies", [&](const auto&, const auto& text) { settings.console.proxies = wordsOf(text); }},
        {"Server.Name",
         [&](const auto& where, const auto& text) {
             if (!isServerName(text))
                 throw std::runtime_error(where + ": '" + text +
                                          "': expected 1 to 32 letters, digits, '-' or '_', such as fe1");
             settings.name = text;
         }},
        {"Server.TopicManager", [&](const auto&, const auto& text) { settings.topic_manager = text; }},
        {"Server.GlobalServices", [&](const auto&, const auto& text) { settings.global_services = text; }},
        {"Server.Users", [&](const auto&, const auto& text) { settings.users_file = text; }},
        {"Server.PlainTcp",
         [&](const auto& where, const auto& text) { settings.plain_tcp = number(where, text, 0, 1) != 0; }},
        {"Server.DataThreads",
         [&](const auto& where, const auto& text) {
             settings.data_threads = static_cast<int>(number(where, text, 1, 256));
         }},
        {"Server.LockMemory",
         [&](const auto& where, const auto& text) { settings.lock_memory = number(where, text, 0, 1) != 0; }},
        {"Server.WatchdogS",
         [&](const auto& where, const auto& text) {
             settings.stuck_for = std::chrono::seconds{number(where, text, 0, 3600)};
         }},
        {"Server.SignalThreads",
         [&](const auto& where, const auto& text) {
             settings.signal_threads = static_cast<int>(number(where, text, 1, 256));
         }},
    };
    const std::string peer = "Server.Peer.";
    std::set<std::string> known{peer};
    for (const auto& [key, set] : keys) known.insert(key);
    const auto properties = transport::readProperties(file, known);
    for (const auto& [key, value] : properties.ice) settings.ice_properties[key] = value;
    for (const auto& [key, setting] : properties.own) {
        if (const auto found = keys.find(key); found != keys.end())
            found->second(setting.where + ": " + key, setting.value);
        else
            settings.neighbours[key.substr(peer.size())] = setting.value;
    }
    if (settings.front_end.watchdog_busy > settings.front_end.watchdog_idle)
        throw std::runtime_error(
            file +
            ": FrontEndServer.WatchdogBusyMs is longer than FrontEndServer.WatchdogIdleMs: expected the "
            "watchdog "
            "of a running task to be the shorter one; fix: lower the first or raise the second");
}

Parsed parseOptions(int argc, char** argv) {
    CLI::App app{
        "The Axon server: entities and clients connect to it. Without options it serves this machine only."};
    app.name("axon-server");
    app.set_version_flag("--version", std::string("axon-server ") + kRelease);
    std::vector<std::string> files;
    std::string listen;
    std::string role = "both";
    std::string user_role;
    std::string users;
    std::string user_to_add;
    std::string global_services;
    std::string console_files;
    bool plain_tcp = false;
    bool no_console = false;
    int base_port = -1;
    std::map<std::string, std::string> endpoints;
    Options options;
    app.add_option("--config", files,
                   "Configuration file (frontendserver.cfg, entityserver.cfg) with lines KEY = VALUE; repeat "
                   "it for several files (docs/reference/server_configuration.md)");
    app.add_option("--listen", listen, "Address on which all ports listen (127.0.0.1)");
    app.add_option("--base-port", base_port,
                   "First of the four ports, which follow each other (10410); the console's are the eighth "
                   "to tenth. 0 takes free ports. The endpoint options below override it")
        ->check(CLI::Range(0, 65532));
    app.add_option("--client-endpoint", endpoints["client"],
                   "HOST:PORT or ssl://HOST:PORT for clients (127.0.0.1:10410); port 0 chooses a free port");
    app.add_option("--client-signal-endpoint", endpoints["client-signal"],
                   "HOST:PORT for the signal lane of clients (127.0.0.1:10411)");
    app.add_option("--entity-endpoint", endpoints["entity"],
                   "HOST:PORT for Entity Managers (127.0.0.1:10412)");
    app.add_option("--entity-signal-endpoint", endpoints["entity-signal"],
                   "HOST:PORT for the signal lane of Entity Managers (127.0.0.1:10413)");
    app.add_option(
        "--console-endpoint", endpoints["console"],
        "HOST:PORT or ssl://HOST:PORT for the pages of the web console (the port for clients and 7 "
        "more)");
    app.add_option("--console-session-endpoint", endpoints["console-session"],
                   "HOST:PORT for the sessions of the web console (the port of its pages and 1 more)");
    app.add_option("--console-signal-endpoint", endpoints["console-signal"],
                   "HOST:PORT for the signal lane of these sessions (their port and 1 more)");
    app.add_option("--console-files", console_files, "Folder of the built web console (Console.Files)");
    app.add_flag("--no-console", no_console, "Serve no web console (Server.Console=0)");
    app.add_flag("--plain-tcp", plain_tcp,
                 "Let other machines connect without TLS, in a network that you trust (Server.PlainTcp)");
    app.add_option("--users", users,
                   "File of users who may log in (users.cfg). Without it the server listens on loopback only "
                   "and asks for no password");
    app.add_option(
        "--global-services", global_services,
        "Folder with the profiles (*.xml) of the global services (Server.GlobalServices). Default: "
        "globalservices beside the first file of --config, or else in the working folder");
    app.add_option("--add-user", user_to_add,
                   "Write this user into the file of --users and exit. The password is asked for, or read "
                   "from the first line of standard input");
    app.add_option(
        "--user-role", user_role,
        "Role of the user of --add-user: observer, operator, admin, or entity (for Entity Managers)");
    app.add_option("--role", role,
                   "both (default), or front-end or entity for one of several servers that IceStorm "
                   "connects. Those need Server.Name and Server.TopicManager in their configuration")
        ->check(CLI::IsMember({"both", "front-end", "entity"}));
    app.add_option("--log-level", options.log_level,
                   "Least severe messages to log: " + std::string(transport::kLogLevels) + " (info)")
        ->check([](const std::string& level) {
            return transport::isLogLevel(level) ? std::string()
                                                : "expected " + std::string(transport::kLogLevels);
        });
    try {
        app.parse(argc, argv);
    } catch (const CLI::ExtrasError&) {
        std::vector<std::string> known;
        for (const auto* option : app.get_options())
            for (const auto& name : option->get_lnames()) known.push_back("--" + name);
        std::cerr << unexpectedWords("axon-server", app.remaining(), known) << std::endl;
        return {std::nullopt, 2};
    } catch (const CLI::ParseError& error) {
        return {std::nullopt, app.exit(error) == 0 ? 0 : 2};
    }
    auto& settings = options.settings;
    for (const auto& file : files) readConfiguration(file, settings);
    if (!users.empty()) settings.users_file = users;
    if (!global_services.empty()) settings.global_services = global_services;
    settings.plain_tcp = settings.plain_tcp || plain_tcp;
    if (!console_files.empty()) settings.console.folder = console_files;
    if (!user_to_add.empty()) {
        addUser(settings.users_file, user_to_add, user_role);
        return {std::nullopt, 0};
    }
    if (!user_role.empty())
        throw std::runtime_error(
            "--user-role is only for --add-user; fix: leave it out, or add --add-user NAME");
    setRole(settings, role);
    findGlobalServices(settings, files);
    int port = base_port;
    struct Lane {
        std::string name;
        std::string* endpoints;
        const char* key;
    };
    const Lane lanes[] = {
        {"client", &settings.client_endpoint, "FrontEndServer.Endpoints"},
        {"client-signal", &settings.client_signal_endpoint, "FrontEndServerSignal.Endpoints"},
        {"entity", &settings.entity_endpoint, "EntityServer.Endpoints"},
        {"entity-signal", &settings.entity_signal_endpoint, "EntityServerSignal.Endpoints"}};
    for (const auto& [name, to, key] : lanes) {
        if (!endpoints[name].empty()) {
            *to = endpoints[name];
        } else if (!listen.empty() || base_port >= 0) {
            auto all = transport::parseEndpoints(*to);
            if (base_port > 0 && all.size() > 1)
                throw std::runtime_error("--base-port gives each lane one port, and " + std::string(key) +
                                         " has several endpoints in the configuration; fix: change their "
                                         "ports there, and leave --base-port out");
            for (auto& endpoint : all) {
                if (!listen.empty()) endpoint.host = listen;
                if (base_port >= 0) endpoint.port = static_cast<std::uint16_t>(port);
            }
            *to = transport::textOf(all);
        }
        if (base_port > 0) ++port;
        const bool unused = name.starts_with("client") ? settings.role == ServerRole::Entity
                                                       : settings.role == ServerRole::FrontEnd;
        if (!unused) checkEndpoints(*to, !settings.users_file.empty(), settings.plain_tcp);
    }
    if (no_console || !settings.console.wanted || settings.role == ServerRole::Entity) {
        settings.console = {};
    } else {
        moveConsole(settings.console, endpoints, listen, base_port);
        placeConsole(settings);
    }
    return {std::move(options), 0};
}

}  // namespace axon::server
