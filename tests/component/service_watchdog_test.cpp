// SPDX-License-Identifier: GPL-2.0-or-later
// The watchdog of the service manager, fed by the threads that do the work.
#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <asio/post.hpp>
#include <atomic>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <future>
#include <memory>
#include <string>

#include "common/descriptor.hpp"
#include "common/shared_clock.hpp"
#include "component/with_manager.hpp"
#include "support/loopback.hpp"
#include "transport/process/service_manager.hpp"

namespace axon::test {
namespace {

using namespace std::chrono_literals;

struct Watched : WithManager {
    std::atomic<int> told{0};
    transport::ServiceWatchdog watchdog{60ms, [this] { ++told; }};
};

TEST_F(Watched, AServerWithoutAnyPeersFeedsItFromBothTimerThreads) {
    auto settings = onLoopback();
    settings.watchdog = &watchdog;
    startServer(std::move(settings));
    EXPECT_TRUE(waitUntil([this] { return told > 5; }));
    server_.reset();
}

TEST_F(Watched, AnEntityManagerFeedsItUntilItsExecutorIsBlocked) {
    startServer();
    createManagerOfMemoryRobot();
    manager_->watchedBy(watchdog.worker());
    manager_->start();
    ASSERT_TRUE(waitUntil([this] { return told > 5; }));

    // Another one, which goes on, tells how much time has passed.
    std::atomic<int> periods{0};
    transport::ServiceWatchdog reference{60ms, [&periods] { ++periods; }};
    auto settings = onLoopback();
    settings.watchdog = &reference;
    const server::Server other(std::move(settings));

    std::promise<void> blocked, over;
    asio::post(executor_, [&] {
        blocked.set_value();
        over.get_future().wait();
    });
    blocked.get_future().wait();
    const int before = told;
    const int from = periods;
    EXPECT_TRUE(waitUntil([&] { return periods > from + 10; }));
    EXPECT_EQ(told, before);
    over.set_value();
    EXPECT_TRUE(waitUntil([&] { return told > before + 5; }));
}

/// As where a virtual laboratory is paused.
class StandingClock final : public Clock {
  public:
    TimePoint now() const override { return TimePoint{1000s}; }
    Duration realTimeUntil(TimePoint deadline) const override {
        return std::min<Duration>(deadline - now(), 1ms);
    }
};

struct WatchedWhileTimeStands : Watched {
    const StandingClock standing{};
};

TEST_F(WatchedWhileTimeStands, AnEntityManagerFeedsIt) {
    startServer();
    entity_manager::EntityManagerCoreSettings core;
    core.application = "peoplebot";
    manager_ = EntityManager::create(
        executor_.get_executor(), ice_, core, entity_server_,
        [this](const EntityManager::Strand& strand, const entity_manager::StopGenerations&, const Clock&,
               BackEndEvents& events) {
            auto robot = std::make_unique<MemoryRobot>(strand, events, seen_);
            auto* const its = robot.get();
            return EntityManager::BackEnd{std::move(robot), [its] { its->start(); }, [] {}};
        },
        standing, random_, storage_, storage_, nullptr);
    manager_->watchedBy(watchdog.worker());
    manager_->start();
    EXPECT_TRUE(waitUntil([this] { return told > 5; }));
}

TEST_F(Watched, AServerOfALaboratoryWhoseTimeStandsFeedsIt) {
    std::string name = std::filesystem::temp_directory_path() / "axon-standing-XXXXXX";
    const Descriptor file(::mkstemp(name.data()));
    ASSERT_TRUE(file.open());
    ASSERT_EQ(::ftruncate(file.get(), sizeof(SharedClockPage)), 0);
    auto* const page = static_cast<SharedClockPage*>(
        ::mmap(nullptr, sizeof(SharedClockPage), PROT_READ | PROT_WRITE, MAP_SHARED, file.get(), 0));
    ASSERT_NE(static_cast<void*>(page), MAP_FAILED);
    page->told_ns = clock_.now().time_since_epoch().count();
    page->time_ns = Duration{1000s}.count();
    std::memcpy(page->magic, SharedClockPage::kMagic.data(), sizeof page->magic);
    ::setenv("AXON_CLOCK", name.c_str(), 1);
    auto settings = onLoopback();
    settings.watchdog = &watchdog;
    startServer(std::move(settings));
    ::unsetenv("AXON_CLOCK");
    page->told_ns = (clock_.now() + 1h).time_since_epoch().count();  // it does not count as gone
    EXPECT_TRUE(waitUntil([this] { return told > 5; }));
    EXPECT_EQ(page->time_ns, Duration{1000s}.count());
    server_.reset();
    ::munmap(page, sizeof(SharedClockPage));
    ::unlink(name.c_str());
}

}  // namespace
}  // namespace axon::test
