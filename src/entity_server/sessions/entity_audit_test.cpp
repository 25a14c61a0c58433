// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/sessions/entity_audit.hpp"

#include <gtest/gtest.h>

#include "support/recorded_audit.hpp"

namespace axon::entity_server {
namespace {

using audit::Kind;

struct EntityAuditTest : testing::Test {
    static EntityStatus heldBy(const std::string& id, const std::string& name,
                               const std::string& reason = {}) {
        EntityStatus status;
        status.entity = "e1";
        status.holder = {id, name, Role::Operator};
        status.reason = reason;
        return status;
    }
    test::RecordedAudit trail;
    EntityAudit audit{&trail};
};

TEST_F(EntityAuditTest, ChangesOfTheHolderAreOwnershipOrATakeOver) {
    audit.holder("Cart", heldBy("", ""), heldBy("c1", "ann"));
    EXPECT_EQ(trail.last(), "ownership|ann|c1|e1|Cart is checked out|");
    audit.holder("Cart", heldBy("c1", "ann"), heldBy("c1", "ann", "another status"));
    EXPECT_EQ(trail.notes().size(), 1U) << "nothing has changed";
    audit.holder("Cart", heldBy("c1", "ann"), heldBy("c9", "ann"));
    EXPECT_EQ(trail.last(), "ownership|ann|c9|e1|Cart is still held, by another session than c1|");
    auto other_lease = heldBy("c2", "bob", "forced");
    other_lease.held.number = 2;
    audit.holder("Cart", heldBy("c1", "ann"), other_lease);
    EXPECT_EQ(trail.last(), "take-over|bob|c2|e1|Cart is taken from ann (c1): forced|");
    audit.holder("Cart", heldBy("c2", "bob"), heldBy("", "", "its client is lost"));
    EXPECT_EQ(trail.last(), "ownership|||e1|Cart is free, held by bob (c2) before: its client is lost|");
    auto between = heldBy("", "", "admin took it over: fire");
    between.state = EntityState::IDLE;
    audit.holder("Cart", heldBy("c2", "bob"), between);
    EXPECT_EQ(trail.last(), "take-over|||e1|Cart is taken from bob (c2): admin took it over: fire|");
}

TEST_F(EntityAuditTest, EntitiesComeAndGoByName) {
    audit.joined({"e1", "Cart"});
    EXPECT_EQ(trail.last(), "session|Cart||e1|entity joined|OK");
    audit.left("e1", "Cart", "it was silent");
    EXPECT_EQ(trail.last(), "session|Cart||e1|entity left: it was silent|");
}

TEST_F(EntityAuditTest, AStopSaysWhoseItIsAndForHowMany) {
    Header head;
    head.sender = {"c1", "ann", Role::Operator};
    head.entity = "e1";
    audit.signal("stop", head, 0);
    EXPECT_EQ(trail.last(), "stop|ann|c1|e1|stop|");
    head.entity.clear();
    audit.signal("stop", head, 0);
    EXPECT_EQ(trail.last(), "stop|ann|c1||stop to all entities|");
    audit.signal("drill", head, 3);
    EXPECT_EQ(trail.last(), "command|ann|c1||drill to 3 entities|");
    audit.stoppedForLostClient(heldBy("c1", "ann"));
    EXPECT_EQ(trail.last(), "stop|ann|c1|e1|its holder's front-end server is gone|");
}

TEST_F(EntityAuditTest, WhatOrdersSomethingIsRecordedAndNothingElse) {
    Header head;
    head.sender = {"c1", "ann", Role::Operator};
    head.entity = "e1";
    for (const auto* other : {kMsgText, kMsgRaw, kMsgParam, kMsgStatus, "OF_THE_FUTURE"}) {
        head.msg_type = other;
        audit.command(head);
    }
    EXPECT_TRUE(trail.notes().empty());
    head.msg_type = kMsgTask;
    audit.command(head);
    EXPECT_EQ(trail.last(), "command|ann|c1|e1|TASK|OK");
    head.msg_type = kMsgRearm;
    audit.command(head);
    EXPECT_EQ(trail.last(), "rearm|ann|c1|e1|REARM|OK");
}

TEST_F(EntityAuditTest, WithoutATrailNothingIsRecorded) {
    const EntityAudit none(nullptr);
    none.joined({"e1", "Cart"});
    EXPECT_TRUE(trail.notes().empty());
}

}  // namespace
}  // namespace axon::entity_server
