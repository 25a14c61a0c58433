// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/sending/departure.hpp"

#include <gtest/gtest.h>

#include <functional>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace axon::client::test {
namespace {

/// Notes what it is given while its lock is held, and what has left after it.
struct Owner {
    std::vector<std::string> collect(bool urgent = false) {
        urgent_seen = urgent;
        held_at_collect = !lock.try_lock();
        if (!held_at_collect) lock.unlock();
        return std::exchange(noted, {});
    }
    void depart(const std::vector<std::string>& leaving) noexcept {
        free_at_departure = lock.try_lock();
        if (free_at_departure) lock.unlock();
        sent.insert(sent.end(), leaving.begin(), leaving.end());
        ++departures;
        if (at_departure) std::exchange(at_departure, nullptr)();
    }

    std::mutex lock;
    std::vector<std::string> noted, sent;
    std::function<void()> at_departure;
    int departures = 0;
    bool urgent_seen = false, held_at_collect = false, free_at_departure = false;
    Departure<Owner> departure{*this, lock};
};

TEST(DepartureTest, WhatIsNotedUnderTheLockLeavesAfterIt) {
    Owner owner;
    owner.departure.after([&] {
        EXPECT_FALSE(owner.lock.try_lock()) << "a use has the core to itself";
        owner.noted = {"stop", "stop again"};
        EXPECT_TRUE(owner.sent.empty());
    });
    EXPECT_EQ(owner.sent, (std::vector<std::string>{"stop", "stop again"}));
    EXPECT_TRUE(owner.held_at_collect);
    EXPECT_TRUE(owner.free_at_departure);
}

TEST(DepartureTest, WhatAUseReturnsComesAfterTheDeparture) {
    Owner owner;
    // An answer that can only be moved, as results with handles in them are.
    const auto answer = owner.departure.after([&] {
        owner.noted = {"task"};
        return std::make_unique<int>(7);
    });
    EXPECT_EQ(*answer, 7);
    EXPECT_EQ(owner.sent.size(), 1U);
}

TEST(DepartureTest, AReferenceToTheCoreDoesNotOutliveTheLock) {
    Owner owner;
    std::string of_the_core = "held";
    auto answer = owner.departure.after([&]() -> std::string& { return of_the_core; });
    of_the_core = "changed by somebody else";
    EXPECT_EQ(answer, "held");
}

TEST(DepartureTest, WhatWasNotedBeforeAUseThrowsLeavesAllTheSame) {
    Owner owner;
    EXPECT_THROW(owner.departure.after([&] {
        owner.noted = {"stop"};
        throw std::runtime_error("no memory for the receipts");
    }),
                 std::runtime_error);
    EXPECT_EQ(owner.sent, std::vector<std::string>{"stop"});
    EXPECT_TRUE(owner.free_at_departure);
    EXPECT_TRUE(owner.lock.try_lock()) << "and the next one may come in";
    owner.lock.unlock();
}

TEST(DepartureTest, ADepartureMayUseTheCoreAgain) {
    Owner owner;
    owner.at_departure = [&] { owner.departure.after([&] { owner.noted = {"second"}; }); };
    owner.departure.after([&] { owner.noted = {"first"}; });
    EXPECT_EQ(owner.sent, (std::vector<std::string>{"first", "second"}));
    EXPECT_EQ(owner.departures, 2);
}

TEST(DepartureTest, HowItLeavesIsPassedOn) {
    Owner owner;
    owner.departure.after([] {}, true);
    EXPECT_TRUE(owner.urgent_seen);
}

}  // namespace
}  // namespace axon::client::test
