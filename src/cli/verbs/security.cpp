// SPDX-License-Identifier: GPL-2.0-or-later
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>

#include "cli/verbs/doctor_report.hpp"
#include "cli/words.hpp"
#include "host/port_range.hpp"

// axon doctor --security
namespace axon::cli {
namespace {

namespace fs = std::filesystem;

/// "ssl://lab:10410" and "ssl -h lab -p 10410".
bool isTls(const std::string& server) {
    return server.starts_with("ssl:") || server.starts_with("wss:") || server.find("ssl -") != std::string::npos ||
           server.find("wss -") != std::string::npos;
}

/// Of "127.0.0.1:10410", "tcp://127.0.0.1:10410" and "localhost:10410".
bool staysHere(std::string server) {
    if (const auto scheme = server.find("://"); scheme != std::string::npos) server.erase(0, scheme + 3);
    const auto host = server.substr(0, server.rfind(':'));
    return host == "localhost" || isLoopback(host);
}

void checkWay(Report& report, const std::string& server) {
    if (isTls(server))
        report.ok("way", "TLS to " + server);
    else if (staysHere(server))
        report.ok("way", "plain TCP to " + server + ", which does not leave this machine");
    else
        report.bad("way",
                   "plain TCP to " + server + ": whoever is on the way reads passwords and leases, and may stop and order robots",
                   "axon certs makes certificates; then give the server ssl endpoints (docs/reference/tls.md)");
}

/// Whether somebody without a password, or with no more than is said here, is let in.
void checkLogIn(Report& report, Session& session) {
    const auto mine = session.connect(session.settings);
    if (!mine) {
        const auto event = noServerEvent(mine.refusal(), session.settings.server);
        report.bad("log-in", event.value("message", ""), event.value("mend", ""));
        return;
    }
    if (mine.value()->self().role == Role::Admin && !session.settings.user.empty())
        report.warn("role", "you are " + session.settings.user + ", an administrator, who may take robots over and rearm those of others",
                    "log in as an operator for daily work, as an observer to look on");
    auto nobody = session.settings;
    nobody.user.clear();
    nobody.password.clear();
    nobody.properties.erase("IceSSL.CertFile");
    nobody.properties.erase("IceSSL.KeyFile");
    const auto let_in = session.connect(nobody);
    if (!let_in) {
        report.ok("log-in", "who gives neither user nor certificate is refused");
        return;
    }
    const auto role = let_in.value()->self().role;
    const auto message = std::string("whoever reaches the server is let in without a password, as ") +
                         (role == Role::Observer ? "an observer" : role == Role::Operator ? "an operator" : "an administrator");
    const std::string mend = "axon-server --users users.cfg --add-user NAME, for each; then start the server with --users users.cfg";
    if (staysHere(session.settings.server))
        report.warn("log-in", message + "; only processes of this machine reach it by this address", mend);
    else
        report.bad("log-in", message, mend);
}

/// What the Entity Managers of this user keep here: the leases' keys and the secrets that prove who a robot is.
void checkStateFolders(Report& report) {
    const char* state = std::getenv("XDG_STATE_HOME");
    const char* home = std::getenv("HOME");
    const auto root = (state != nullptr && *state != '\0' ? fs::path(state)
                                                          : fs::path(home != nullptr && *home != '\0' ? home : "/var/lib") / ".local/state") /
                      "axon";
    std::error_code none;
    std::size_t folders = 0;
    bool open = false;
    for (const auto& folder : fs::directory_iterator(root, none)) {
        struct stat found {};
        if (::stat(folder.path().c_str(), &found) != 0 || !S_ISDIR(found.st_mode)) continue;
        ++folders;
        if (found.st_uid == ::getuid() && (found.st_mode & 0077U) == 0) continue;
        open = true;
        report.bad("state", "others may look into " + folder.path().string() + ", where a robot keeps its secret and its leases",
                   "chown and chmod 700 " + shellWord(folder.path().string()));
    }
    if (folders > 0 && !open)
        report.ok("state", std::to_string(folders) + (folders == 1 ? " folder" : " folders") + " of robots in " + root.string() +
                               (folders == 1 ? " is" : " are") + " private");
}

}  // namespace

void checkSecurity(Report& report, Session& session) {
    checkWay(report, session.settings.server);
    checkLogIn(report, session);
    checkStateFolders(report);
}

}  // namespace axon::cli
