// SPDX-License-Identifier: GPL-2.0-or-later
#include <chrono>

#include "cli/holding.hpp"
#include "cli/open_page.hpp"
#include "cli/reach.hpp"
#include "cli/verbs/console_address.hpp"

// axon console: the web console that axon-server serves
namespace axon::cli {
namespace {

constexpr int kConsolePort = 7;  // after the port for clients

bool isThisMachine(const std::string& host) {
    return host == "localhost" || host.starts_with("127.");
}

std::optional<HostPort> consoleOf(const std::string& server) {
    auto its = hostPortOf(server);
    if (!its || its->port >= 65535 - kConsolePort) return std::nullopt;
    its->port = static_cast<std::uint16_t>(its->port + kConsolePort);
    return its;
}

int console(Session& session) {
    const auto& server = session.settings.server;
    const auto at = consoleOf(server);
    const auto address = consoleAddress(server);
    if (!at || !address)
        return misused(session,
                       "the server " + server + " has no address from which that of its console follows",
                       "name the server itself, such as --server 127.0.0.1:10410; or open the address after "
                       "console= in the line that axon-server prints when it is ready");
    const auto patience = std::chrono::milliseconds(static_cast<long>(session.settings.timeout_s * 1000));
    if (reach(at->host, at->port, patience) != Reach::Open)
        return refuseWith(
            session, {RefusalCode::NotConnected, "no web console answers at " + *address, {}},
            "start axon-server; if it runs, open the address after console= in the line that it "
            "prints when it is ready, or see why its log has left the console out");
    const bool open = !session.args.value("print", false) && hasDisplay();
    const int error = open ? openPage(*address) : 0;
    session.events.emit({{"event", "line"}, {"text", *address}});
    if (error == 0) return kDone;
    session.events.emit(
        {{"event", "notice"}, {"message", "xdg-open cannot show it; fix: open that address in a browser"}});
    return kRefused;
}

}  // namespace

std::optional<std::string> consoleAddress(const std::string& server) {
    const auto at = consoleOf(server);
    if (!at) return std::nullopt;
    const bool tls = server.starts_with("ssl://") && !isThisMachine(at->host);
    return (tls ? "https://" : "http://") + at->host + ":" + std::to_string(at->port) + "/";
}

extern const Verb kConsole{"console",
                           "Open the web console of the server in a browser, or print its address",
                           "  axon console\n"
                           "  axon console --print              print the address only\n"
                           "Without a graphical session it prints the address.\n",
                           Runs::Local,
                           {},
                           {{"print", Takes::Nothing, "Print the address and open nothing"}},
                           console};

}  // namespace axon::cli
