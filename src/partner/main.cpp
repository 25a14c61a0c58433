// SPDX-License-Identifier: GPL-2.0-or-later
#include <Ice/Ice.h>
#include <spdlog/spdlog.h>

#include <atomic>
#include <csignal>
#include <future>
#include <iostream>

#include "common/ids.hpp"
#include "common/shared_clock.hpp"
#include "entity_manager/identity.hpp"
#include "entity_manager/storage/file_storage.hpp"
#include "partner/gateway.hpp"
#include "partner/options.hpp"
#include "transport/process/descriptor_limit.hpp"
#include "transport/process/logging.hpp"
#include "transport/process/service_manager.hpp"

int main(int argc, char** argv) {
    using namespace axon;
    using namespace axon::partner;

    std::promise<void> ended;  // before the handler, which calls upon them until it is gone
    std::atomic_flag once;
    std::signal(SIGXFSZ, SIG_IGN);  // a file that may not grow is a write that fails
    Ice::CtrlCHandler interrupts;   // before all else: it blocks the signals before any thread exists
    try {
        auto options = readPartnerOptions(argc, argv);
        if (options.exit_code) return *options.exit_code;
        transport::logToStderr(options.log_level);
        transport::raiseDescriptorLimit();
        const auto time = clockFromEnvironment();
        SystemRandom random;
        entity_manager::FileStorage storage(options.state_folder);
        options.gateway.secret = entity_manager::identityIn(storage, random).secret;
        const auto& core = options.gateway.core;
        const auto ready = "ready partner=" + core.laboratory + " as=" + core.home +
                           " server=" + options.gateway.there.server +
                           " entity-server=" + options.gateway.home.text();
        const auto watchdog = transport::ServiceWatchdog::fromEnvironment();  // outlives the gateway
        const auto gateway = Gateway::create(std::move(options.gateway), *time);
        interrupts.setCallback([&](int) {
            if (!once.test_and_set()) ended.set_value();
        });
        if (watchdog) gateway->watchedBy(watchdog->worker());
        gateway->start();
        std::cout << ready << " (now looking for both)" << std::endl;
        transport::tellServiceManagerReady();
        ended.get_future().wait();
        gateway->stop();
        return 0;
    } catch (const std::exception& problem) {
        std::cerr << "axon-partner: " << problem.what() << std::endl;
        return 2;
    }
}
