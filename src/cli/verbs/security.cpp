// SPDX-License-Identifier: GPL-2.0-or-later
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <map>
#include <optional>
#include <sstream>
#include <string_view>
#include <utility>
#include <vector>

#include "certificates/folder.hpp"
#include "cli/verbs/doctor_report.hpp"
#include "cli/words.hpp"
#include "host/port_range.hpp"

// axon doctor --security
namespace axon::cli {
namespace {

namespace fs = std::filesystem;

/// What others could see of the way to the server.
struct Exposure {
    bool tls = true;  ///< by every endpoint that is offered
    bool some_tls = false;
    bool here = true;  ///< all of them are on this machine
};

bool isHere(const std::string& host) {
    return host == "localhost" || isLoopback(host);
}

/// Of "HOST:PORT", "ssl://HOST:PORT", several of these with ',' between them, and of Ice's endpoints and
/// proxies: "Axon.Clients/router:ssl -h HOST -p PORT:tcp -h …". An endpoint of Ice without a host is at every
/// address of its machine.
Exposure exposureOf(const std::string& server) {
    Exposure exposure;
    std::istringstream words(server);
    if (server.find(" -") == std::string::npos) {
        for (std::string one; std::getline(words, one, ',');) {
            const auto scheme = one.find("://");
            const auto from = scheme == std::string::npos ? 0 : scheme + 3;
            const bool tls = one.starts_with("ssl://") || one.starts_with("wss://");
            exposure.tls = exposure.tls && tls;
            exposure.some_tls = exposure.some_tls || tls;
            exposure.here = exposure.here && isHere(one.substr(from, one.rfind(':') - from));
        }
        return exposure;
    }
    std::size_t endpoints = 0, hosts = 0;
    for (std::string word; words >> word;) {
        const auto kind =
            word.substr(word.find_last_of(':') == std::string::npos ? 0 : word.find_last_of(':') + 1);
        const bool tls = kind == "ssl" || kind == "wss";
        const bool plain = kind == "tcp" || kind == "ws" || kind == "default";
        if (plain) exposure.tls = false;
        if (tls) exposure.some_tls = true;
        if (tls || plain) ++endpoints;
        if (word != "-h" || !(words >> word)) continue;
        ++hosts;
        // "127.0.0.1:tcp", where the next endpoint begins.
        const auto colon = word.find(':');
        exposure.here = exposure.here && isHere(word.substr(0, colon));
        if (colon == std::string::npos) continue;
        const auto next = word.substr(colon + 1);
        if (next == "tcp" || next == "ws" || next == "default") exposure.tls = false;
        if (next == "ssl" || next == "wss") exposure.some_tls = true;
        ++endpoints;
    }
    if (hosts < endpoints) exposure.here = false;
    if (endpoints == 0) exposure.tls = exposure.here = false;  // nothing that could be understood
    return exposure;
}

void checkExposure(Report& report, const std::string& server, const Exposure& exposure) {
    if (exposure.tls)
        report.ok("connection", "TLS to " + server);
    else if (exposure.here)
        report.ok("connection", "plain TCP to " + server + ", which does not leave this machine");
    else if (exposure.some_tls)
        report.warn("connection",
                    server + " offers plain TCP beside TLS, and clients without certificates use it",
                    "remove the tcp endpoint from the configuration of the router");
    else
        report.bad(
            "connection",
            "plain TCP to " + server +
                ": anyone on the network in between can read passwords and leases, and can stop and command "
                "robots",
            "axon certs makes certificates; then give the server ssl endpoints (docs/reference/tls.md)");
}

/// Whether somebody without a password is let in.
void checkLogIn(Report& report, Session& session, const Exposure& exposure) {
    const auto mine = session.connect(session.settings);
    if (!mine) {
        const auto event = noServerEvent(mine.refusal(), session.settings.server);
        report.bad("log-in", event.value("message", ""), event.value("fix", ""));
        return;
    }
    if (mine.value()->self().role == Role::Admin && !session.settings.user.empty())
        report.warn("role",
                    "you are " + session.settings.user +
                        ", an administrator, who may take robots over and rearm those of others",
                    "log in as an operator for daily work, or as an observer to watch");
    const bool shows_certificate = std::any_of(
        session.settings.properties.begin(), session.settings.properties.end(),
        [](const auto& one) { return one.first == "IceSSL.CertFile" || one.first == "IceSSL.FindCert"; });
    if (shows_certificate) {
        report.ok(
            "log-in",
            "you log in with a certificate; whether the server admits clients without one was not tried");
        return;
    }
    auto nobody = session.settings;
    nobody.user.clear();
    nobody.password.clear();
    const auto let_in = session.connect(nobody);
    if (!let_in && let_in.refusal().code == RefusalCode::PermissionDenied) {
        report.ok("log-in", "clients without a password are refused");
        return;
    }
    if (!let_in) {
        report.warn(
            "log-in",
            "cannot find out whether clients without a password are admitted: " + let_in.refusal().message,
            "try again later");
        return;
    }
    const auto role = let_in.value()->self().role;
    const auto message = std::string("the server admits clients without a password, you as ") +
                         (role == Role::Observer   ? "an observer"
                          : role == Role::Operator ? "an operator"
                                                   : "an administrator");
    const std::string fix =
        "add each user with axon-server --users users.cfg --add-user NAME, then start the server with "
        "--users users.cfg";
    if (exposure.here)
        report.warn("log-in", message + "; only processes on this machine can reach this address", fix);
    else
        report.bad("log-in", message, fix);
}

/// What the Entity Managers of this user keep here: the leases' keys and the secrets that prove who a robot
/// is.
void checkStateFolders(Report& report) {
    const char* state = std::getenv("XDG_STATE_HOME");
    const char* home = std::getenv("HOME");
    const auto root =
        (state != nullptr && *state != '\0'
             ? fs::path(state)
             : fs::path(home != nullptr && *home != '\0' ? home : "/var/lib") / ".local/state") /
        "axon";
    std::error_code none;
    std::size_t folders = 0;
    bool open = false;
    for (const auto& folder : fs::directory_iterator(root, none)) {
        struct stat found {};
        if (::stat(folder.path().c_str(), &found) != 0 || !S_ISDIR(found.st_mode)) continue;
        ++folders;
        const auto name = folder.path().string();
        if (found.st_uid != ::getuid()) {
            open = true;
            report.bad("state",
                       name + ", where a robot keeps its secret and its leases, belongs to another user",
                       "chown -R $USER " + shellWord(name) + ", as that user or root");
        } else if ((found.st_mode & 0077U) != 0) {
            open = true;
            report.bad("state",
                       "other users can read " + name + ", where a robot keeps its secret and its leases",
                       "chmod 700 " + shellWord(name));
        }
    }
    if (folders > 0 && !open)
        report.ok("state", std::to_string(folders) + (folders == 1 ? " folder" : " folders") +
                               " of robots in " + root.string() + (folders == 1 ? " is" : " are") +
                               " private; folders elsewhere (Axon.State) are not checked");
}

using Properties = std::map<std::string, std::string>;
constexpr const char* kServersFile = "/etc/axon/server.cfg";

/// As Ice reads a file of properties: "key = value # comment", where a backslash makes '#' and '=' letters.
Properties propertiesIn(const std::string& text) {
    Properties properties;
    std::istringstream lines(text);
    for (std::string line; std::getline(lines, line);) {
        std::string key, part;
        bool has_value = false;
        for (std::size_t i = 0; i < line.size() && line[i] != '#'; ++i) {
            if (line[i] == '\\' && i + 1 < line.size() && std::strchr("\\#=", line[i + 1]) != nullptr) {
                part += line[++i];
            } else if (line[i] == '=' && !has_value) {
                has_value = true;
                key = std::exchange(part, {});
            } else {
                part += line[i];
            }
        }
        const auto trimmed = [](const std::string& its) {
            const auto from = its.find_first_not_of(" \t\r");
            return from == std::string::npos ? std::string()
                                             : its.substr(from, its.find_last_not_of(" \t\r") - from + 1);
        };
        if (has_value && !trimmed(key).empty()) properties[trimmed(key)] = trimmed(part);
    }
    return properties;
}

/// A link between servers: who may be at the other end, if `bound_by` limits who that is.
struct Link {
    const char* key;  ///< what it begins with, where it ends in '.', or all of it
    const char* peers;
    const char* issue;
    const char* bound_by;  ///< a setting of IceSSL; null: the program itself looks at the kinds
};
constexpr const char* kIssueServer = "axon certs issue --front-end NAME HOST, or --entity-server NAME HOST";
constexpr const char* kIssueStorm = "axon certs issue --storm HOST";
constexpr const char* kIssueRouter = "axon certs issue --router HOST";
constexpr Link kLinks[] = {
    {"FrontEndServerTopic.Endpoints", "entity servers and IceStorm may connect", kIssueServer, nullptr},
    {"FrontEndServerTopicSignal.Endpoints", "entity servers may connect", kIssueServer, nullptr},
    {"FrontEndServerRouter.Endpoints", "routers and front-end servers may connect", kIssueServer, nullptr},
    {"EntityServerTopic.Endpoints", "the other servers and IceStorm may connect", kIssueServer, nullptr},
    {"EntityServerTopicSignal.Endpoints", "the other servers may connect", kIssueServer, nullptr},
    {"EntityServerRouter.Endpoints", "routers and entity servers may connect", kIssueServer, nullptr},
    {"Server.TopicManager", "IceStorm is spoken to", kIssueServer, nullptr},
    {"Server.Peer.", "the server of that name is spoken to", kIssueServer, nullptr},
    {"IceStorm.TopicManager.Endpoints", "the kinds of IceSSL.TrustOnly.Server may connect", kIssueStorm,
     "IceSSL.TrustOnly.Server"},
    {"IceStorm.Publish.Endpoints", "the kinds of IceSSL.TrustOnly.Server may connect", kIssueStorm,
     "IceSSL.TrustOnly.Server"},
    {"Glacier2.Server.Endpoints", "the kinds of IceSSL.TrustOnly.Server.Glacier2.Server may connect",
     kIssueRouter, "IceSSL.TrustOnly.Server.Glacier2.Server"},
    {"Glacier2.SessionManager", "the kinds of IceSSL.TrustOnly.Client are spoken to", kIssueRouter,
     "IceSSL.TrustOnly.Client"},
    {"Glacier2.PermissionsVerifier", "the kinds of IceSSL.TrustOnly.Client are spoken to", kIssueRouter,
     "IceSSL.TrustOnly.Client"},
    {"Glacier2.SSLSessionManager", "the kinds of IceSSL.TrustOnly.Client are spoken to", kIssueRouter,
     "IceSSL.TrustOnly.Client"},
    {"Glacier2.SSLPermissionsVerifier", "the kinds of IceSSL.TrustOnly.Client are spoken to", kIssueRouter,
     "IceSSL.TrustOnly.Client"},
};

const Link* linkOf(const std::string& key) {
    for (const auto& link : kLinks) {
        const std::string_view its = link.key;
        if (its.ends_with('.') ? key.starts_with(its) : key == its) return &link;
    }
    return nullptr;
}

std::string valueOf(const Properties& properties, const char* key) {
    const auto found = properties.find(key);
    return found == properties.end() ? std::string() : found->second;
}

/// What is wrong with the certificate that the file names.
std::optional<std::string> certificateFor(const Properties& properties) {
    const auto file = valueOf(properties, "IceSSL.CertFile");
    if (file.empty()) return "no certificate is configured (IceSSL.CertFile)";
    std::vector<certificates::Certificate> its;
    try {
        its = certificates::readCertificateFile(fs::path(valueOf(properties, "IceSSL.DefaultDir")) / file);
    } catch (const certificates::Unusable& unusable) {
        return unusable.what();
    }
    using certificates::Kind;
    const auto some = [&](std::initializer_list<std::string_view> beginnings) {
        return std::any_of(properties.begin(), properties.end(), [&](const auto& one) {
            return std::any_of(beginnings.begin(), beginnings.end(),
                               [&](std::string_view its_begin) { return one.first.starts_with(its_begin); });
        });
    };
    const bool front_end = some({"FrontEndServer"}), entity = some({"EntityServer"});
    const bool server = front_end || entity || some({"Server."});
    const bool several =
        some({"FrontEndServerTopic", "EntityServerTopic", "Server.TopicManager", "Server.Peer."});
    std::vector<Kind> kinds;
    if (server && (front_end || !entity)) kinds.push_back(Kind::FrontEnd);
    if (server && (entity || !front_end)) kinds.push_back(Kind::EntityServer);
    if (server && !several) kinds.push_back(Kind::Server);  // the only one, with routers
    if (!server) kinds.push_back(some({"IceStorm."}) ? Kind::Storm : Kind::Router);
    const auto kind = certificates::kindOf(its.front().unit);
    std::string expected;
    for (const auto one : kinds)
        expected += (expected.empty() ? "" : " or ") + std::string(certificates::toString(one));
    if (!kind || std::find(kinds.begin(), kinds.end(), *kind) == kinds.end())
        return "the certificate is of the kind '" + its.front().unit + "'; expected " + expected;
    const auto name = valueOf(properties, "Server.Name");
    if (server && *kind != Kind::Server && its.front().name != name)
        return "the certificate is that of '" + its.front().name + "'; expected that of Server.Name, '" +
               name + "'";
    return std::nullopt;
}

/// Of an alternative of IceSSL.TrustOnly, "OU=front-end,O=Axon": whether it names a kind of servers.
bool isOfServers(const std::string& alternative) {
    std::istringstream parts(alternative);
    for (std::string part; std::getline(parts, part, ',');) {
        std::erase_if(part, [](char c) { return c == ' ' || c == '\t' || c == '"'; });
        if (!part.starts_with("OU=")) continue;
        const auto kind = certificates::kindOf(part.substr(3));
        return kind && *kind != certificates::Kind::Client && *kind != certificates::Kind::Entity;
    }
    return alternative.find_first_not_of(" \t") == std::string::npos ||
           alternative[alternative.find_first_not_of(" \t")] == '!';  // whom it keeps out
}

/// Why somebody else than those of the link may be at its other end.
std::optional<std::string> unbound(const Properties& properties, const Link& link,
                                   const std::optional<std::string>& certificate) {
    if (certificate) return certificate;
    const auto verifies = valueOf(properties, "IceSSL.VerifyPeer");
    if (link.bound_by == nullptr)  // 2 unless it says otherwise
        return verifies.empty() || verifies == "1" || verifies == "2"
                   ? std::nullopt
                   : std::optional("IceSSL.VerifyPeer=" + verifies + " lets in whoever shows no certificate");
    // By default Ice asks for a certificate on both sides, and the caller's may be missing no less.
    if (verifies == "0" || verifies == "1")
        return "IceSSL.VerifyPeer=" + verifies + " lets in whoever shows no certificate";
    std::string key = link.bound_by;
    if (valueOf(properties, link.bound_by).empty()) key = "IceSSL.TrustOnly";
    const auto trusted = valueOf(properties, key.c_str());
    if (trusted.empty())
        return std::string("whoever has a certificate of the laboratory, such as a client, is let in: ") +
               link.bound_by + " names no kind (OU)";
    std::istringstream alternatives(trusted);
    for (std::string one; std::getline(alternatives, one, ';');)
        if (!isOfServers(one)) return key + "=" + trusted + " lets in more than servers: " + one;
    return std::nullopt;
}

}  // namespace

void checkLinks(Report& report, const std::string& file) {
    Properties properties;
    try {
        properties =
            propertiesIn(certificates::readFile(file, "name a file that you may read: --links FILE"));
    } catch (const certificates::Unusable& unusable) {
        return report.bad("links", unusable.what(), unusable.fix());
    }
    const auto certificate = certificateFor(properties);
    bool any = false;
    for (const auto& [key, value] : properties) {
        const auto* const link = linkOf(key);
        if (link == nullptr || value.empty()) continue;
        any = true;
        const auto its = key + "=" + value;
        const auto exposure = exposureOf(value);
        if (!exposure.tls && exposure.here) {
            report.ok("links", its + ": loopback only; processes on this machine are believed");
        } else if (!exposure.tls) {
            report.bad(
                "links",
                its +
                    ": open: whoever reaches this address without TLS is believed, and could move every "
                    "robot",
                std::string("name an address of this machine alone (-h 127.0.0.1), or ssl -h HOST -p PORT "
                            "with the lines of ") +
                    link->issue + " (docs/reference/tls.md)");
        } else if (const auto wrong = unbound(properties, *link, certificate)) {
            report.bad("links", its + ": TLS, but " + *wrong,
                       std::string("take over the lines of ") + link->issue + " (docs/reference/tls.md)");
        } else {
            report.ok("links", its + ": TLS; only " + link->peers);
        }
    }
    if (!any)
        report.ok("links", file + " sets no link between servers; those that are not set are on loopback");
}

void checkSecurity(Report& report, Session& session) {
    const auto exposure = exposureOf(session.settings.server);
    checkExposure(report, session.settings.server, exposure);
    checkLogIn(report, session, exposure);
    checkStateFolders(report);
    // On the machine of a server that came as a package; whoever may not read the file does not run it.
    const auto named = session.args.value("links", std::string());
    if (!named.empty() || ::access(kServersFile, R_OK) == 0)
        checkLinks(report, named.empty() ? kServersFile : named);
}

}  // namespace axon::cli
