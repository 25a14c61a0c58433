// SPDX-License-Identifier: GPL-2.0-or-later
#include <pthread.h>
#include <unistd.h>

#include <csignal>
#include <cstdlib>
#include <iostream>
#include <thread>

#include "cli/client_station.hpp"
#include "cli/command_line.hpp"
#include "cli/invoker.hpp"
#include "cli/password.hpp"
#include "cli/view.hpp"
#include "common/clock.hpp"
#include "transport/process/logging.hpp"

namespace {

using namespace axon;

/// How long a verb may take to end in order after Ctrl-C.
constexpr unsigned kPatience_s = 4;

/// Takes the signals one by one. The second Ctrl-C ends the process at once (where a verb answers more than
/// one itself, the one after those), and so does the alarm after the first.
void takeSignals(sigset_t signals, cli::Invoker& invoker) {
    for (unsigned count = 1;; ++count) {
        int signal = 0;
        if (::sigwait(&signals, &signal) != 0) continue;
        const bool final = signal == SIGALRM || count > invoker.interrupts();
        if (!invoker.interrupt(signal == SIGALRM ? SIGINT : signal)) continue;
        if (final) ::_exit(cli::kInterrupted);
        ::alarm(kPatience_s);
    }
}

}  // namespace

int main(int argc, char** argv) {
    ::signal(SIGPIPE, SIG_IGN);
    sigset_t signals;
    ::sigemptyset(&signals);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGALRM}) ::sigaddset(&signals, signal);
    ::pthread_sigmask(SIG_BLOCK, &signals, nullptr);  // before the first thread, which inherits it
    // Standard output is what the verbs print, read by programs too. The agent's standard error is its log.
    transport::logToStderr("warn");

    auto parsed =
        cli::parseCommandLine({argv + 1, argv + argc}, [](const char* name) { return std::getenv(name); });
    std::cout << parsed.out;
    std::cerr << parsed.err;
    if (!parsed.line) return parsed.exit;
    const auto& line = *parsed.line;

    cli::Invoker invoker(line.settings, cli::connectStation, [](const cli::Settings& settings) {
        return cli::askPassword(settings.user, settings.server);
    });
    std::thread(takeSignals, signals, std::ref(invoker)).detach();
    const SteadyClock clock{};
    int exit = cli::kDone;
    {
        const auto terminal = cli::Terminal::ofStandardOutput();
        // What the command under checkout prints is its own: we speak on the error stream then.
        cli::PersonView person(line.command.empty() ? std::cout : std::cerr, std::cerr, terminal, clock);
        cli::JsonView json(line.command.empty() ? std::cout : std::cerr);
        cli::Events& view = line.settings.json ? static_cast<cli::Events&>(json) : person;
        if (std::string_view(line.verb->name) == "agent" && line.args.value("action", "") == "run") {
            exit = invoker.serveAgent(STDOUT_FILENO);
        } else if (!line.command.empty()) {
            exit = invoker.holdWhile(line.args, line.command, view);
        } else {
            exit = invoker.perform(*line.verb, line.args, view);
        }
    }
    std::cout.flush();
    transport::flushLog();
    // Not through static destructors: the signals' thread, and an upload that was left behind, still run.
    ::_exit(exit);
}
