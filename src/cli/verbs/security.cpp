// SPDX-License-Identifier: GPL-2.0-or-later
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <sstream>

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

/// Of "HOST:PORT", "ssl://HOST:PORT", and of a router's proxy: "Axon.Clients/router:ssl -h HOST -p PORT:tcp
/// -h …".
Exposure exposureOf(const std::string& server) {
    Exposure exposure;
    if (server.find(" -") == std::string::npos) {
        const auto scheme = server.find("://");
        const auto from = scheme == std::string::npos ? 0 : scheme + 3;
        exposure.tls = server.starts_with("ssl://") || server.starts_with("wss://");
        exposure.some_tls = exposure.tls;
        exposure.here = isHere(server.substr(from, server.rfind(':') - from));
        return exposure;
    }
    std::istringstream words(server);
    for (std::string word; words >> word;) {
        const auto kind =
            word.substr(word.find_last_of(':') == std::string::npos ? 0 : word.find_last_of(':') + 1);
        if (kind == "tcp" || kind == "ws") exposure.tls = false;
        if (kind == "ssl" || kind == "wss") exposure.some_tls = true;
        if (word != "-h" || !(words >> word)) continue;
        exposure.here = exposure.here && isHere(word.substr(0, word.find(':')));
    }
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

}  // namespace

void checkSecurity(Report& report, Session& session) {
    const auto exposure = exposureOf(session.settings.server);
    checkExposure(report, session.settings.server, exposure);
    checkLogIn(report, session, exposure);
    checkStateFolders(report);
}

}  // namespace axon::cli
