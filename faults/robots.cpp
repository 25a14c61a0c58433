// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots.hpp"

#include <fcntl.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <asio/post.hpp>
#include <asio/thread_pool.hpp>
#include <cstdio>
#include <fstream>
#include <memory>
#include <sstream>
#include <thread>
#include <vector>

#include "board.hpp"
#include "common/descriptor.hpp"
#include "entity_interfacer/axon/entity_interfacer.hpp"
#include "entity_manager/entity_manager.hpp"
#include "entity_manager/links/server/server_communicators.hpp"
#include "entity_manager/storage/file_journal.hpp"
#include "entity_manager/storage/file_resources.hpp"
#include "entity_manager/storage/file_storage.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/process/logging.hpp"

namespace axon::faults {

namespace {

using namespace std::chrono_literals;
namespace fs = std::filesystem;
using Seconds = std::chrono::duration<double>;

constexpr std::uint16_t kFirstPort = 5500;

constexpr const char* kServices =
    "<ServiceProfile count=\"2\">"
    "<Service name=\"Drive\" type=\"SMPL\" active=\"true\" blocking=\"true\" descr=\"Moves until it is "
    "stopped.\"/>"
    "<Service name=\"Step\" type=\"SMPL\" active=\"true\" blocking=\"true\" descr=\"Moves for a "
    "while.\"><Parameters>"
    "<Param name=\"Seconds\" type=\"INPUT\" data_type=\"DBL\" units=\"s\" value=\"0.001\" ready=\"true\" "
    "savable=\"true\" minimum=\"0\" maximum=\"3600\"/>"
    "</Parameters></Service></ServiceProfile>";

void waitForTheEndOfTheRun() {
    const auto parent = ::getppid();
    while (::getppid() == parent) std::this_thread::sleep_for(200ms);
}

/// The lines that say which task began when. A process that is killed loses nothing that it has said.
class MotionLog {
  public:
    explicit MotionLog(const fs::path& file)
        : fd_(::open(file.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600)) {
        if (!fd_.open()) throw std::system_error(errno, std::generic_category(), file.string());
    }
    void add(const Motion& motion) const {
        char line[96];
        const int size = std::snprintf(line, sizeof line, "%s %zu %lld\n", motion.task.c_str(), motion.robot,
                                       static_cast<long long>(motion.at));
        if (::write(fd_.get(), line, static_cast<std::size_t>(size)) != size) std::perror("log of motions");
    }

  private:
    const Descriptor fd_;
};

}  // namespace

std::string robotName(std::size_t i) {
    return "robot-" + std::to_string(i);
}
std::string applicationName(std::size_t i) {
    return "faults-" + std::to_string(i);
}
std::uint16_t linkPort(std::size_t i) {
    return static_cast<std::uint16_t>(kFirstPort + i);
}

bool parseMotion(const std::string& line, Motion& motion) {
    std::istringstream words(line);
    return static_cast<bool>(words >> motion.task >> motion.robot >> motion.at);
}

int runApplication(const RobotsPlan& plan) {
    Board board(plan.board, plan.entities, false);
    const MotionLog log(plan.folder / "motions");
    const auto services = plan.folder / "services.xml";
    std::ofstream(services) << kServices;
    std::vector<std::unique_ptr<EntityInterfacer>> robots;
    for (std::size_t i = 0; i < plan.entities; ++i) {
        const auto basic = plan.folder / ("basic-" + std::to_string(i) + ".xml");
        std::ofstream(basic) << "<BasicProfile name=\"" << robotName(i)
                             << "\" category=\"ROBOT\" type=\"MOBILE\" xpos=\"0\" ypos=\"0\" zpos=\"0\"/>";
        EntityInterfacer::Options options;
        options.application = applicationName(i);
        options.first_port = options.last_port = linkPort(i);
        options.address = plan.address;
        options.watch_profiles = false;
        auto robot = std::make_unique<EntityInterfacer>(options);
        robot->uploadBasicProfile(basic);
        robot->uploadServiceProfile(services);
        auto& slot = board[i];
        slot.moving = 0;
        robot->onStop([&slot, at = robot.get()](const StopSignal& stop) {
            slot.stopped(static_cast<std::uint32_t>(stop.cause));
            slot.moving = 0;  // this robot brakes at once
            at->standstill();
        });
        const auto begin = [&slot, &log, i](const Task& task) {
            const auto now = nowNs();
            log.add({task.id(), i, now});
            slot.started_at = now;
            ++slot.starts;
            slot.moving = task.stopRequested() ? 0 : 1;
        };
        robot->onRaw([&slot](const std::vector<std::string>& blocks, const std::string&) {
            slot.received += static_cast<std::uint32_t>(blocks.size());
        });
        robot->onTask("Drive", [&slot, begin](Task& task) {
            begin(task);
            while (task.waitFor(Seconds(3600))) {
            }
            slot.moving = 0;
        });
        robot->onTask("Step", [&slot, begin](Task& task) {
            begin(task);
            task.waitFor(Seconds(task.number("Seconds")));
            slot.moving = 0;
        });
        robot->start();
        robots.push_back(std::move(robot));
    }
    ++board.desk().applications;
    waitForTheEndOfTheRun();
    ::_exit(0);
}

int runManagers(const RobotsPlan& plan) {
    using namespace entity_manager;
    transport::logToStderr("info");
    SteadyClock clock;
    asio::thread_pool executor(1);
    asio::post(executor, [] { transport::requestRealTime(transport::kReceiptPriority); });  // as the daemon's
    const auto ice = std::make_shared<ServerCommunicators>(2, 1);
    const auto colon = plan.server.rfind(':');
    ServerAddress server;
    server.host = plan.server.substr(0, colon);
    server.port = static_cast<std::uint16_t>(std::stoi(plan.server.substr(colon + 1)));
    struct Member {
        explicit Member(const fs::path& folder)
            : storage(folder, urgent), resources(folder), journal(folder, urgent) {}
        static void urgent() { transport::requestRealTime(transport::kReceiptPriority); }
        SystemRandom random;
        FileStorage storage;
        FileResourceStore resources;
        FileJournal journal;
        std::shared_ptr<EntityManager> manager;
    };
    std::vector<std::unique_ptr<Member>> members;
    const auto end = plan.count == 0 ? plan.entities : plan.first + plan.count;
    for (auto i = plan.first; i < end; ++i) {
        auto member = std::make_unique<Member>(plan.folder / ("state-" + std::to_string(i)));
        EntityManagerCoreSettings core;
        core.application = applicationName(i);
        core.lease_grace = std::chrono::duration_cast<Duration>(Seconds(kLeaseGrace));
        BackEndSettings link;
        link.application = core.application;
        link.manager = "axon-faults";
        link.where.address = plan.address;
        link.where.ports.first = link.where.ports.last = linkPort(i);
        member->manager = EntityManager::create(
            executor.get_executor(), ice, core, server, EntityManager::overTcp(link, member->random), clock,
            member->random, member->storage, member->resources, &member->journal);
        member->manager->start();
        members.push_back(std::move(member));
        // Logging in costs the server; 32 at a time keeps every handshake within its time-out.
        while (members.size() > 32 && members[members.size() - 33]->manager->state() != EntityState::IDLE)
            std::this_thread::sleep_for(1ms);
    }
    std::puts("ready");
    std::fflush(stdout);
    waitForTheEndOfTheRun();
    ::_exit(0);
}

}  // namespace axon::faults
