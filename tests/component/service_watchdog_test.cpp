// SPDX-License-Identifier: GPL-2.0-or-later
// The watchdog of the service manager, fed by the threads that do the work.
#include <gtest/gtest.h>

#include <asio/post.hpp>
#include <atomic>
#include <chrono>
#include <future>

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

}  // namespace
}  // namespace axon::test
