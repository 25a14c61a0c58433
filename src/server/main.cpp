// SPDX-License-Identifier: GPL-2.0-or-later
#include <spdlog/spdlog.h>

#include <csignal>
#include <cstdio>
#include <exception>
#include <utility>

#include "server/options.hpp"
#include "server/server.hpp"
#include "transport/process/descriptor_limit.hpp"
#include "transport/process/logging.hpp"
#include "transport/process/memory_lock.hpp"
#include "transport/process/service_manager.hpp"

int main(int argc, char** argv) {
    // Before any thread exists, so that all inherit it: these signals are waited for below.
    sigset_t awaited;
    sigemptyset(&awaited);
    for (const int signal : {SIGINT, SIGTERM, SIGUSR1}) sigaddset(&awaited, signal);
    // Of a terminal that is closed, unless nohup has it ignored.
    struct sigaction hang_up {};
    if (sigaction(SIGHUP, nullptr, &hang_up) == 0 && hang_up.sa_handler != SIG_IGN)
        sigaddset(&awaited, SIGHUP);
    pthread_sigmask(SIG_BLOCK, &awaited, nullptr);
    std::signal(SIGPIPE, SIG_IGN);
    std::signal(SIGXFSZ,
                SIG_IGN);  // a file that may not grow is a write that fails, not the end of the program

    try {
        auto parsed = axon::server::parseOptions(argc, argv);
        if (!parsed.options) return parsed.exit_code;
        axon::transport::logToStderr(parsed.options->log_level);
        axon::transport::raiseDescriptorLimit();
        if (parsed.options->settings.lock_memory) axon::transport::lockMemory();
        auto watchdog = axon::transport::ServiceWatchdog::fromEnvironment();  // outlives the server
        if (const auto period = parsed.options->settings.stuck_for;
            !watchdog && period > axon::Duration::zero())
            watchdog = axon::transport::ServiceWatchdog::ofTheKernel(period);
        parsed.options->settings.watchdog = watchdog.get();
        const axon::server::Server server(std::move(parsed.options->settings));
        std::printf("%s\n", server.readyLine().c_str());
        std::fflush(stdout);
        axon::transport::tellServiceManagerReady();

        int received = 0;
        while (sigwait(&awaited, &received) != 0 || received == SIGUSR1) {
            for (const auto& line : server.margins()) spdlog::info("{}", line);
        }
        spdlog::info("shutting down on {}", received == SIGINT   ? "SIGINT"
                                            : received == SIGHUP ? "SIGHUP"
                                                                 : "SIGTERM");
    } catch (const std::exception& error) {
        std::fprintf(stderr, "axon-server: %s\n", error.what());
        return 2;
    }
    return 0;
}
