// SPDX-License-Identifier: MIT
#include "common/shared_clock.hpp"

#include <gtest/gtest.h>
#include <sys/mman.h>
#include <unistd.h>

#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <thread>

#include "common/waiting.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;
namespace fs = std::filesystem;

TimePoint real() {
    return SteadyClock{}.now();
}
TimePoint at(Duration time) {
    return TimePoint{time};
}

/// A folder with the page of a laboratory whose hands are the test's.
class SharedClockTest : public ::testing::Test {
  protected:
    void SetUp() override {
        std::string name = (fs::temp_directory_path() / "axon-clock-XXXXXX").string();
        folder_ = ::mkdtemp(name.data());
        std::ofstream(file()) << std::string(sizeof(SharedClockPage), '\0');
        {
            const std::unique_ptr<FILE, int (*)(FILE*)> opened(std::fopen(file().c_str(), "r+"),
                                                               &std::fclose);
            page_ =
                static_cast<SharedClockPage*>(::mmap(nullptr, sizeof(SharedClockPage), PROT_READ | PROT_WRITE,
                                                     MAP_SHARED, ::fileno(opened.get()), 0));
        }
        ASSERT_NE(static_cast<void*>(page_), MAP_FAILED);
        std::memcpy(page_->magic, SharedClockPage::kMagic.data(), sizeof page_->magic);
        tell(1000s, 1);
    }
    void TearDown() override {
        ::unsetenv("AXON_CLOCK");
        ::munmap(page_, sizeof(SharedClockPage));
        fs::remove_all(folder_);
    }
    std::string file() const { return folder_ / "clock"; }
    void tell(Duration time, double rate) { tell(time, rate, real()); }
    void tell(Duration time, double rate, TimePoint when) {
        page_->told_ns = when.time_since_epoch().count();
        page_->rate = rate;
        page_->time_ns = time.count();
    }
    static std::string refusal(const std::string& path) {
        try {
            const SharedClock clock(path);
        } catch (const std::runtime_error& error) {
            return error.what();
        }
        return "accepted";
    }

    fs::path folder_;
    SharedClockPage* page_ = nullptr;
};

TEST_F(SharedClockTest, IsTheTimeThatTheLaboratoryTellsAndNothingBetween) {
    const SharedClock clock(file());
    EXPECT_EQ(clock.now(), at(1000s));
    for (const auto begin = real(); real() < begin + 2ms;) EXPECT_EQ(clock.now(), at(1000s));
    tell(1000s + 4ms, 1);
    EXPECT_EQ(clock.now(), at(1000s + 4ms));
}

TEST_F(SharedClockTest, AFastLaboratoryIsWaitedForLess) {
    const SharedClock clock(file());
    EXPECT_EQ(clock.realTimeUntil(at(1000s + 4ms)), 4ms);
    tell(1000s, 4);
    EXPECT_EQ(clock.realTimeUntil(at(1000s + 4ms)), 1ms);
    EXPECT_EQ(clock.realTimeUntil(at(1001s)), SharedClock::kLongestWait) << "the pace may change meanwhile";
    EXPECT_EQ(clock.realTimeUntil(TimePoint::max()), SharedClock::kLongestWait);
    EXPECT_GT(clock.realTimeUntil(at(1000s + 1ns)), 100us) << "it comes with the next step only: no spinning";
    EXPECT_LE(clock.realTimeUntil(at(1000s)), 0ns);
    EXPECT_LE(clock.realTimeUntil(at(999s)), 0ns);
}

TEST_F(SharedClockTest, WhileTheLaboratoryStandsNoTimePassesForWhoWaits) {
    tell(1000s, 0);
    const SharedClock clock(file());
    std::mutex mutex;
    std::condition_variable nobody;
    std::unique_lock lock(mutex);
    // It looks again and again, and the time is never up.
    const auto begin = real();
    EXPECT_TRUE(waitUntil(nobody, lock, clock, at(1000s + 10ms), [&] { return real() > begin + 100ms; }));
    tell(1000s + 10ms, 0);
    EXPECT_FALSE(waitUntil(nobody, lock, clock, at(1000s + 10ms), [] { return false; }));
}

TEST_F(SharedClockTest, FourTimesAsFastFourSecondsAreOne) {
    tell(1000s, 4);
    const SharedClock clock(file());
    const auto begin = real();
    std::atomic<bool> over{false};
    std::thread laboratory([&] {
        while (!over) {
            // In steps of 4 ms.
            tell(1000s + (real() - begin) * 4 / 4ms * 4ms, 4);
            std::this_thread::yield();
        }
    });
    std::mutex mutex;
    std::condition_variable nobody;
    {
        std::unique_lock lock(mutex);
        EXPECT_FALSE(waitUntil(nobody, lock, clock, at(1004s), [] { return false; }));
    }
    const auto took = real() - begin;
    over = true;
    laboratory.join();
    EXPECT_GE(took, 1s);
    EXPECT_LT(took, 3s);
}

TEST_F(SharedClockTest, WhenTheLaboratoryIsGoneTimeGoesOnAtThePaceOfTheMachineAndNeverBack) {
    const SharedClock clock(file());
    tell(1000s, 8, real() - SharedClockPage::kGoneAfter - 2s);
    const auto first = clock.now();
    EXPECT_GE(first, at(1002s)) << "watchdogs must not stand still for ever";
    EXPECT_LT(first, at(1060s));
    const auto begin = real();
    while (real() < begin + 2ms) {
    }
    const auto second = clock.now();
    EXPECT_GE(second - first, 2ms);
    tell(1000s, 8);  // one that was only stopped for a while, and does not know where its readers are
    EXPECT_GE(clock.now(), second);
    tell(1100s, 8);
    EXPECT_EQ(clock.now(), at(1100s));
}

TEST_F(SharedClockTest, WhatIsNoLaboratorysTimeIsRefusedWithTheMend) {
    const auto refused = [](const std::string& path, const std::string& why) {
        const auto said = refusal(path);
        EXPECT_NE(said.find("AXON_CLOCK=" + path), std::string::npos) << said;
        EXPECT_NE(said.find(why), std::string::npos) << said;
        EXPECT_NE(said.find("axon-lab --clock"), std::string::npos) << said;
    };
    refused(folder_ / "none", "No such file");
    refused(folder_, "not the clock file of a laboratory");
    std::ofstream(folder_ / "empty");
    refused(folder_ / "empty", "not the clock file of a laboratory");
    std::ofstream(folder_ / "first") << std::string("AXONCLK1") + std::string(8, '\0');
    refused(folder_ / "first", "not the clock file of a laboratory");
    std::ofstream(folder_ / "foreign") << std::string(sizeof(SharedClockPage), 'x');
    refused(folder_ / "foreign", "not the clock file of a laboratory");
    tell(1000s, 1, real() - SharedClockPage::kGoneAfter - 1s);
    refused(file(), "gone");
    tell(1000s, 1, real() + 3600s);  // of an earlier start of the machine
    refused(file(), "gone");
    fs::resize_file(file(), sizeof(SharedClockPage) - 1);
    refused(file(), "not the clock file of a laboratory");
}

TEST_F(SharedClockTest, AProgramTakesTheLaboratorysTimeWhereTheEnvironmentSaysSo) {
    EXPECT_NE(dynamic_cast<const SteadyClock*>(clockFromEnvironment().get()), nullptr);
    ::setenv("AXON_CLOCK", "", 1);
    EXPECT_NE(dynamic_cast<const SteadyClock*>(clockFromEnvironment().get()), nullptr);
    ::setenv("AXON_CLOCK", file().c_str(), 1);
    ::testing::internal::CaptureStderr();
    const auto clock = clockFromEnvironment();
    const auto said = ::testing::internal::GetCapturedStderr();
    EXPECT_EQ(clock->now(), at(1000s));
    EXPECT_NE(said.find(file()), std::string::npos)
        << "a program that is not on the machine's time says so: " << said;
    ::setenv("AXON_CLOCK", "/nowhere", 1);
    EXPECT_THROW(clockFromEnvironment(), std::runtime_error);
}

TEST(Waiting, OnTheMachinesTimeEndsAtTheDeadlineOrWithTheCondition) {
    const SteadyClock clock{};
    std::mutex mutex;
    std::condition_variable changed;
    std::unique_lock lock(mutex);
    EXPECT_EQ(clock.realTimeUntil(TimePoint::max()) > std::chrono::hours{24}, true);
    const auto begin = clock.now();
    EXPECT_FALSE(waitUntil(changed, lock, clock, begin + 20ms, [] { return false; }));
    EXPECT_GE(clock.now(), begin + 20ms);
    bool set = false;
    std::thread other([&] {
        const std::lock_guard guard(mutex);
        set = true;
        changed.notify_one();
    });
    EXPECT_TRUE(waitUntil(changed, lock, clock, TimePoint::max(), [&] { return set; }));
    lock.unlock();
    other.join();
}

}  // namespace
}  // namespace axon
