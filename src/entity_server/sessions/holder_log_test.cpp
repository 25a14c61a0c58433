// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/sessions/holder_log.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon::entity_server {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;

/// Each of them with a lease of their own.
EntityStatus heldBy(const std::string& holder, const std::string& reason = {}) {
    EntityStatus out;
    out.state = holder.empty() ? EntityState::IDLE : EntityState::REG;
    out.holder = {holder, holder, Role::Operator};
    out.held.number = holder == "bob" ? 2 : 1;
    out.reason = reason;
    return out;
}

TEST(HolderLog, SaysWhoHasItWhoLetItGoAndFromWhomItWasTaken) {
    ManualClock clock;
    HolderLog log;
    const auto line = [&](const EntityStatus& before, const EntityStatus& now) {
        return log.line("Robot", before, now, clock.now());
    };
    EXPECT_EQ(line(heldBy(""), heldBy("ann")), "Robot is checked out by ann");
    EXPECT_EQ(line(heldBy("ann"), heldBy("bob")), "audit: Robot is taken from ann by bob");
    EXPECT_EQ(line(heldBy("bob"), heldBy("")), "Robot is free, released by bob");
    auto again = heldBy("bob");
    again.holder.id = "another session";
    EXPECT_EQ(line(heldBy("bob"), again), "bob goes on with its lease of Robot");
    EXPECT_EQ(line(heldBy("bob"), heldBy("", "by force")), "audit: Robot is taken from bob: by force");
}

TEST(HolderLog, WhatChangesButItsHolderIsNoLineAndCountsForNone) {
    ManualClock clock;
    HolderLog log;
    for (int i = 0; i < 100; ++i)
        EXPECT_EQ(log.line("Robot", heldBy("ann"), heldBy("ann", "why"), clock.now()), "");
    EXPECT_EQ(log.leftOut(), 0U);
    EXPECT_NE(log.line("Robot", heldBy("ann"), heldBy("bob"), clock.now()), "");
}

TEST(HolderLog, WhatIsLeftOutIsToldByTheNextLine) {
    ManualClock clock;
    HolderLog log;
    for (int i = 0; i < 100; ++i) log.line("Robot", heldBy("ann"), heldBy("bob"), clock.now());
    EXPECT_EQ(log.leftOut(), 80U);
    clock.advance(1s);
    EXPECT_THAT(log.line("Robot", heldBy("bob"), heldBy("ann"), clock.now()), HasSubstr("(80 changes"));
    EXPECT_EQ(log.leftOut(), 0U);
    EXPECT_EQ(log.line("Robot", heldBy("ann"), heldBy("bob"), clock.now()),
              "audit: Robot is taken from ann by bob");
}

}  // namespace
}  // namespace axon::entity_server
