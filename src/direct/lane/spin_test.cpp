// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/lane/spin.hpp"

#include <gtest/gtest.h>

#include <memory>
#include <thread>

namespace axon::direct::lane {
namespace {

using namespace std::chrono_literals;

constexpr Duration kLongest = 50us;

/// A thread that waits as its budget says, beside a peer whose messages the test sends.
struct Waiter {
    explicit Waiter(Duration longest = kLongest) : budget(longest) {}

    /// A message that comes so long after the wait has begun. With `shares_core` it comes only once the
    /// thread sleeps. Returns whether the spin found it.
    bool wait(Duration until_it_comes, bool shares_core = false) {
        const auto began = clock.now();
        const auto spin = budget.begin(began);
        const bool found = spin > Duration{} && !shares_core && until_it_comes <= spin;
        clock.set(began + until_it_comes + (shares_core ? spin : Duration{}));
        if (found) {
            useful += until_it_comes;
            budget.found(clock.now());
            return true;
        }
        if (spin > Duration{}) {
            in_vain += spin;
            ++vain;
            budget.inVain();
        }
        budget.came(clock.now());
        return false;
    }
    /// Waits until so much time has passed.
    void waitFor(Duration time, Duration until_each_comes, bool shares_core = false) {
        for (const auto end = clock.now() + time; clock.now() < end;) wait(until_each_comes, shares_core);
    }

    ManualClock clock;
    SpinBudget budget;
    Duration useful{}, in_vain{};
    int vain = 0;
};

TEST(SpinBudget, OfZeroNeverSpins) {
    Waiter waiter(0us);
    for (int i = 0; i < 1000; ++i) EXPECT_FALSE(waiter.wait(0us));
    EXPECT_EQ(waiter.in_vain, 0us);
}

TEST(SpinBudget, MessagesInQuickSuccessionAreFoundFromTheThirdOn) {
    Waiter waiter;
    EXPECT_FALSE(waiter.wait(1s));
    EXPECT_FALSE(waiter.wait(60us)) << "the wait before was long";
    for (int i = 0; i < 1000; ++i) EXPECT_TRUE(waiter.wait(5us));
    EXPECT_EQ(waiter.vain, 0);
}

TEST(SpinBudget, MessagesThatComeSeldomCostNothing) {
    Waiter waiter;
    waiter.waitFor(10s, 250us);
    EXPECT_EQ(waiter.in_vain, 0us);
}

TEST(SpinBudget, AfterABurstItSpinsInVainOnce) {
    Waiter waiter;
    waiter.waitFor(10ms, 5us);
    const auto before = waiter.vain;
    waiter.wait(1s);
    waiter.waitFor(10s, 10ms);
    EXPECT_EQ(waiter.vain, before + 1);
}

TEST(SpinBudget, WhereItBringsNothingItTakesHalfAPercentOfTheTime) {
    // Each message a little too late, and each of a peer that shares the core.
    for (const bool shares_core : {false, true}) {
        Waiter waiter;
        waiter.waitFor(10s, shares_core ? 8us : 70us, shares_core);
        EXPECT_EQ(waiter.useful, 0us);
        EXPECT_LE(waiter.in_vain, 4 * kLongest + Duration{10s} / 200);
        EXPECT_GE(waiter.in_vain, Duration{10s} / 250) << "it does not try again";
    }
}

TEST(SpinBudget, APeerThatSharesTheCoreIsHeldUpFourTimesAndThenSeldom) {
    Waiter waiter;
    waiter.wait(8us);
    for (int i = 0; i < 4; ++i) waiter.wait(8us, true);
    EXPECT_EQ(waiter.vain, 4);
    for (int i = 0; i < 1000; ++i) waiter.wait(8us, true);  // 8 ms
    EXPECT_EQ(waiter.vain, 4);
    for (int i = 0; i < 1000; ++i) waiter.wait(8us, true);
    EXPECT_EQ(waiter.vain, 5);
}

TEST(SpinBudget, WhenThePeerHasMovedToAnotherCoreItSpinsAgainAfterTenMilliseconds) {
    Waiter waiter;
    waiter.waitFor(1s, 8us, true);
    const auto moved = waiter.clock.now();
    while (!waiter.wait(60us) && waiter.clock.now() < moved + 1s) {
        // Awake, both answer sooner.
        if (waiter.budget.begin(waiter.clock.now()) > Duration{}) break;
    }
    EXPECT_LE(waiter.clock.now(), moved + 10ms + 60us);
    for (int i = 0; i < 1000; ++i) EXPECT_TRUE(waiter.wait(5us));
}

TEST(SpinBudget, ANowAndThenLateMessageDoesNotEndIt) {
    Waiter waiter;
    waiter.wait(60us);
    int found = 0;
    for (int i = 1; i <= 10000; ++i) found += waiter.wait(i % 20 == 0 ? 60us : 5us);
    EXPECT_EQ(found, 9500);
}

TEST(SpinBudget, InVainIsNeverMoreThanItsShareAndWhatHelped) {
    // All patterns of soon, late and long, of every length of period up to six.
    for (int period = 1; period <= 6; ++period)
        for (int pattern = 0, all = 1 << (2 * period); pattern < all; ++pattern) {
            Waiter waiter;
            const auto start = waiter.clock.now();
            for (int i = 0; i < 600; ++i) {
                const int kind = (pattern >> (2 * (i % period))) & 3;
                waiter.wait(kind == 0 ? 5us : kind == 1 ? 49us : kind == 2 ? 51us : 300us);
            }
            const auto passed = waiter.clock.now() - start;
            ASSERT_LE(waiter.in_vain, 4 * kLongest + passed / 200 + waiter.useful)
                << period << ' ' << pattern;
        }
}

class SpinnerTest : public ::testing::Test {
  protected:
    /// Has waited for a short time, and so may spin.
    std::unique_ptr<Spinner> warm() {
        auto spinner = std::make_unique<Spinner>(kLongest, clock, 2);
        EXPECT_TRUE(spinner->spins());
        EXPECT_FALSE(spinner->spin([] { return true; }));
        spinner->came();
        return spinner;
    }
    ManualClock clock;
};

TEST_F(SpinnerTest, LooksUntilItFindsSomething) {
    const auto spinner = warm();
    int looks = 0, begun = 0, ended = 0;
    EXPECT_TRUE(spinner->spin([&] { ++begun; },
                              [&] {
                                  clock.advance(1us);
                                  return ++looks == 30;
                              },
                              [&] { ++ended; }));
    EXPECT_EQ(looks, 30);
    EXPECT_EQ(begun, 1);
    EXPECT_EQ(ended, 1);
}

TEST_F(SpinnerTest, GivesUpWhenItsTimeIsOver) {
    const auto spinner = warm();
    int looks = 0, ended = 0;
    const auto look = [&] {
        clock.advance(1us);
        return ++looks < 0;
    };
    EXPECT_FALSE(spinner->spin([] {}, look, [&] { ++ended; }));
    EXPECT_EQ(looks, 50);
    EXPECT_EQ(ended, 1);
    for (int i = 0; i < 10; ++i) {
        spinner->came();
        spinner->spin(look);
    }
    EXPECT_EQ(looks, 4 * 50) << "four times, and then not for a while";
}

TEST_F(SpinnerTest, OneThreadOfAProcessSpinsAtATime) {
    const auto one = warm(), other = warm();
    bool looked = false, both = false;
    EXPECT_TRUE(one->spin([&] {
        looked = true;
        other->spin([&] { return both = true; });
        return true;
    }));
    EXPECT_TRUE(looked);
    EXPECT_FALSE(both);
    EXPECT_TRUE(other->spin([] { return true; })) << "the first one has ended";
}

TEST(Spinner, OnOneCoreOrToldZeroItDoesNotSpin) {
    EXPECT_FALSE(Spinner(0us).spins());
    const SteadyClock clock;
    Spinner spinner(kLongest, clock, 1);
    EXPECT_FALSE(spinner.spins());
    EXPECT_FALSE(spinner.spin([] { return true; }));
    EXPECT_TRUE(Spinner(kLongest, clock, 2).spins());
}

}  // namespace
}  // namespace axon::direct::lane
