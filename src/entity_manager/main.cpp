// SPDX-License-Identifier: GPL-2.0-or-later
#include <Ice/Ice.h>
#include <spdlog/spdlog.h>

#include <asio/post.hpp>
#include <asio/thread_pool.hpp>
#include <csignal>
#include <future>
#include <iostream>

#include "audit/trail.hpp"
#include "common/release.hpp"
#include "common/shared_clock.hpp"
#include "entity_manager/daemon_options.hpp"
#include "entity_manager/entity_manager.hpp"
#include "entity_manager/links/server/server_communicators.hpp"
#include "entity_manager/storage/audited_journal.hpp"
#include "entity_manager/storage/file_journal.hpp"
#include "entity_manager/storage/file_resources.hpp"
#include "entity_manager/storage/file_storage.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/process/descriptor_limit.hpp"
#include "transport/process/logging.hpp"
#include "transport/process/memory_lock.hpp"
#include "transport/process/service_manager.hpp"
#include "transport/sessions/routed_session.hpp"

int main(int argc, char** argv) {
    using namespace axon;
    using namespace axon::entity_manager;

    std::promise<void> ended;  // before the handler, which calls upon them until it is gone
    std::atomic_flag once;
    std::signal(SIGXFSZ,
                SIG_IGN);  // a file that may not grow is a write that fails, not the end of the program
    Ice::CtrlCHandler interrupts;  // before all else: it blocks the signals before any thread exists
    try {
        const auto options = readDaemonOptions(argc, argv);
        if (options.exit_code) return *options.exit_code;
        transport::logToStderr(options.log_level);
        transport::raiseDescriptorLimit();
        if (options.lock_memory) transport::lockMemory();

        const auto time = clockFromEnvironment();
        const Clock& clock = *time;
        SystemRandom random;
        // A latch and the entry of a task come to the disk at once on a machine that is busy with something
        // else, too.
        const auto urgent = [] { transport::requestRealTime(transport::kReceiptPriority); };
        FileStorage storage(options.state_folder, urgent);
        FileResourceStore resources(options.state_folder, options.core.resource_bytes_max);
        FileJournal journal(options.state_folder, urgent);
        std::unique_ptr<audit::Trail> trail;
        if (!options.audit.folder.empty())
            trail = std::make_unique<audit::Trail>(options.audit, options.trailName(),
                                                   std::string("axon-entity-manager ") + kRelease,
                                                   [](const std::string& line) { spdlog::warn("{}", line); });
        AuditedJournal audited(journal, audit::orNone(trail.get()),
                               storage.load(kUuidKey).value_or(std::string()));
        Journal& its_journal = trail ? static_cast<Journal&>(audited) : journal;
        const auto watchdog = transport::ServiceWatchdog::fromEnvironment();  // outlives the executor
        asio::thread_pool executor(1);
        // It beats for the robot application, whose watchdog is the shortest: not behind what else wants the
        // processor.
        asio::post(executor, [] { transport::requestRealTime(transport::kReceiptPriority); });
        const auto ice = std::make_shared<ServerCommunicators>(1, 1, options.ice_properties, trail.get());
        if (!options.server.router.empty())
            transport::routerProxy(*ice->data(), options.server.router);  // or a fix
        const auto manager = EntityManager::create(executor.get_executor(), ice, options.core, options.server,
                                                   EntityManager::overTcp(options.back_end, random), clock,
                                                   random, storage, resources, &its_journal);
        audited.setEntity(manager->uuid());
        for (const auto& finding : journal.findings()) spdlog::warn("{}", finding);

        interrupts.setCallback([&](int) {
            if (!once.test_and_set()) ended.set_value();
        });
        manager->receiveDatagrams(options.datagrams, clock);
        manager->offerDirect(options.direct);
        if (watchdog) manager->watchedBy(watchdog->worker());
        manager->start();
        std::cout << "ready application=" << options.core.application << " entity=" << manager->uuid()
                  << " server=" << options.server.text()
                  << " (now looking for the application and the server)" << std::endl;
        transport::tellServiceManagerReady();
        ended.get_future().wait();
        manager->stop();
        ice->destroy();  // its threads may hold the manager, which must end while all that it uses is still
                         // there
        executor.join();
        return 0;
    } catch (const std::exception& problem) {
        std::cerr << "axon-entity-manager: " << problem.what() << std::endl;
        return 2;
    }
}
