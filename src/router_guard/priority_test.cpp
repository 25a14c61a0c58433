// SPDX-License-Identifier: GPL-2.0-or-later
#include "router_guard/priority.hpp"

#include <gtest/gtest.h>
#include <sched.h>
#include <sys/resource.h>
#include <unistd.h>

#include <atomic>
#include <string>
#include <thread>
#include <vector>

#include "support/loopback.hpp"

namespace axon::router_guard {
namespace {

using namespace std::chrono_literals;
using axon::test::waitUntil;

TEST(CpuBudget, WhoUsesLittleKeepsRealTime) {
    CpuBudget budget;
    for (int i = 0; i < 10'000; ++i) ASSERT_TRUE(budget.allows(1ms, 10ms));
}

TEST(CpuBudget, ABurstIsNoFlood) {
    CpuBudget budget;
    for (int i = 0; i < 5; ++i) ASSERT_TRUE(budget.allows(10ms, 10ms)) << i;  // 43.75 of 50 ms
    EXPECT_FALSE(budget.allows(10ms, 10ms));
}

TEST(CpuBudget, AFloodHasNoneUntilTheStoreIsFullAgain) {
    CpuBudget budget;
    for (int i = 0; i < 100; ++i) budget.allows(20ms, 10ms);  // two processors
    for (int i = 0; i < 39; ++i) ASSERT_FALSE(budget.allows(0ms, 10ms)) << i;
    EXPECT_TRUE(budget.allows(0ms, 10ms));
    for (int i = 0; i < 5; ++i) ASSERT_TRUE(budget.allows(10ms, 10ms)) << i;
    EXPECT_FALSE(budget.allows(10ms, 10ms));
}

TEST(CpuBudget, AFloodThatGoesOnGetsNothingBack) {
    CpuBudget budget;
    for (int i = 0; i < 100; ++i) budget.allows(10ms, 10ms);
    for (int i = 0; i < 1000; ++i) ASSERT_FALSE(budget.allows(1250us, 10ms)) << i;
}

/// This thread, and those that it starts, on one processor; afterwards it is as it was.
class OneProcessor {
  public:
    OneProcessor() {
        ::sched_getaffinity(0, sizeof before_, &before_);
        cpu_set_t one;
        CPU_ZERO(&one);
        CPU_SET(::sched_getcpu(), &one);
        ::sched_setaffinity(0, sizeof one, &one);
    }
    ~OneProcessor() {
        const sched_param none{};
        ::sched_setscheduler(0, SCHED_OTHER, &none);
        ::setpriority(PRIO_PROCESS, 0, nice_);
        ::sched_setaffinity(0, sizeof before_, &before_);
    }
    OneProcessor(const OneProcessor&) = delete;
    OneProcessor& operator=(const OneProcessor&) = delete;

  private:
    cpu_set_t before_{};
    const int nice_ = ::getpriority(PRIO_PROCESS, 0);
};

TEST(Priority, AFloodOnTheOnlyProcessorLosesRealTimeAndGetsItBackWhenItEnds) {
    const OneProcessor only;
    std::vector<std::string> told;
    Priority priority([&](const std::string& sentence) { told.push_back(sentence); });
    priority.begin();
    if (::sched_getscheduler(0) == SCHED_OTHER) {  // as without CAP_SYS_NICE
        ASSERT_FALSE(told.empty());
        EXPECT_NE(told.back().find("LimitRTPRIO=10"), std::string::npos) << told.back();
        return;
    }
    std::atomic<bool> enough{false}, ends{false};
    std::atomic<pid_t> thread{0}, batch{0};
    std::thread waits([&] {
        const sched_param none{};
        ::sched_setscheduler(0, SCHED_BATCH, &none);
        batch = ::gettid();
        ends.wait(false);
    });
    EXPECT_TRUE(waitUntil([&] { return batch != 0; }));
    std::thread floods([&] {
        thread = ::gettid();
        while (!enough) {
        }
    });
    // This thread does not run before the flood has lost real time.
    EXPECT_TRUE(waitUntil([&] { return thread != 0 && ::sched_getscheduler(thread) == SCHED_OTHER; }));
    EXPECT_EQ(::sched_getscheduler(0), SCHED_OTHER);
    EXPECT_EQ(::sched_getscheduler(batch), SCHED_BATCH);
    enough = true;
    floods.join();
    EXPECT_TRUE(waitUntil([] { return ::sched_getscheduler(0) == SCHED_FIFO; }));
    EXPECT_EQ(::sched_getscheduler(batch), SCHED_BATCH) << "as the thread of the audit trail";
    ends = true;
    ends.notify_all();
    waits.join();
}

}  // namespace
}  // namespace axon::router_guard
