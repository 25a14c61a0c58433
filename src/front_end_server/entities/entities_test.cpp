// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/entities/entities.hpp"

#include <gtest/gtest.h>

namespace axon::front_end_server {
namespace {

using namespace std::chrono_literals;

class EntitiesTest : public testing::Test {
  protected:
    static Registration registration(const std::string& entity, const std::string& server = "es1") {
        Registration out;
        out.entity = entity;
        out.server = server;
        return out;
    }
    std::optional<Entities::News> join(const std::string& entity, const std::string& server = "es1") {
        return entities.update(Presence::Joined, registration(entity, server), "profile");
    }
    std::optional<Entities::News> leave(const std::string& entity, const std::string& server = "es1") {
        return entities.update(Presence::Left, registration(entity, server), {});
    }
    Entities::RecordRef status(EntityState state, std::int64_t number, const std::string& server = "es1") {
        EntityStatus out;
        out.entity = "a";
        out.server = server;
        out.state = state;
        return entities.update(out, number, Via::Straight);
    }
    std::string serverOf(const std::string& entity) const {
        const auto server = entities.serverOf(entity, Lane::Data);
        EXPECT_EQ(server != nullptr, entities.has(entity, Lane::Signal)) << "both lanes know the same";
        return server ? *server : "nobody";
    }

    ManualClock clock;
    SeededRandom random{1};
    OtherServers others{"fe1", random, [](const std::string&) {}, [](Lane) {}};
    OtherServers::Group& servers{others.add({.name = "entity server", .timeouts = {}})};
    Entities entities{false, servers, clock};
};

TEST_F(EntitiesTest, WhatIsAnnouncedAgainIsNoNews) {
    EXPECT_EQ(join("a")->presence, Presence::Joined);
    EXPECT_FALSE(join("a"));
    const auto changed = entities.update(Presence::Joined, registration("a"), "another profile");
    ASSERT_TRUE(changed);
    EXPECT_EQ(changed->presence, Presence::Changed);
    EXPECT_EQ(leave("a")->presence, Presence::Left);
    EXPECT_FALSE(leave("a"));
}

TEST_F(EntitiesTest, NothingIsKnownOfOneThatHasNotJoined) {
    EXPECT_FALSE(status(EntityState::IDLE, 1));
    EXPECT_FALSE(leave("a"));
    EXPECT_EQ(entities.find("a"), nullptr);
    EXPECT_EQ(serverOf("a"), "nobody");
    EXPECT_EQ(entities.targets("a") + entities.targets(""), 0U);
}

TEST_F(EntitiesTest, AnEntityIsOfTheServerThatAnnouncedItsJoiningLast) {
    join("a", "es1");
    EXPECT_FALSE(entities.update(Presence::Changed, registration("a", "es2"), "profile"))
        << "it is not its own";
    EXPECT_EQ(serverOf("a"), "es1");
    EXPECT_EQ(join("a", "es2")->presence, Presence::Changed);
    EXPECT_EQ(serverOf("a"), "es2");
    EXPECT_FALSE(leave("a", "es1")) << "late";
    EXPECT_EQ(serverOf("a"), "es2");
    EXPECT_TRUE(entities.forget("es1", {}).records.empty());
    EXPECT_EQ(entities.forget("es2", {}).records.size(), 1U);
}

TEST_F(EntitiesTest, WhenOneLeavesThatAnotherServerSpokeOfAllAreAsked) {
    join("a", "es1");
    join("b", "es1");
    EXPECT_FALSE(status(EntityState::IDLE, 1, "es2"));
    EXPECT_FALSE(leave("b")->disputed);
    EXPECT_TRUE(leave("a")->disputed);
    join("a", "es1");
    EXPECT_FALSE(leave("a")->disputed) << "that was settled";
    join("a", "es1");
    EXPECT_FALSE(entities.update(Presence::Changed, registration("a", "es2"), "profile"));
    EXPECT_TRUE(entities.forget("es1", {}).disputed);
}

TEST_F(EntitiesTest, TheNewestCopyOfAStatusCountsInWhateverOrderTheyCome) {
    join("a");
    EXPECT_TRUE(status(EntityState::BUSY, 2));
    EXPECT_FALSE(status(EntityState::BUSY, 2)) << "the other copy";
    EXPECT_FALSE(status(EntityState::IDLE, 1)) << "older";
    EXPECT_EQ(entities.find("a")->status.state, EntityState::BUSY);
    EXPECT_FALSE(status(EntityState::BUSY, 4)) << "nothing new to tell";
    EXPECT_FALSE(status(EntityState::IDLE, 3)) << "but newer than this";
    const auto before = status(EntityState::IDLE, 5);
    ASSERT_TRUE(before);
    EXPECT_EQ(before->status.state, EntityState::BUSY);
    EXPECT_EQ(entities.find("a")->status.state, EntityState::IDLE);
    join("a", "es2");
    EXPECT_TRUE(status(EntityState::BUSY, 1, "es2")) << "another server counts for itself";
}

TEST_F(EntitiesTest, AListThatLacksAnEntityOfItsServerTakesItAway) {
    for (const auto* entity : {"a", "b", "c"}) join(entity);
    join("d", "es2");
    const auto left = entities.forget("es1", {"b", "never here"});
    EXPECT_EQ(left.records.size(), 2U);
    EXPECT_FALSE(left.disputed);
    EXPECT_EQ(entities.targets(""), 2U);
    EXPECT_EQ(entities.records().size(), entities.known());
}

TEST_F(EntitiesTest, AServerThatIsGoneBringsNobody) {
    servers.heard(Lane::Signal, {"es1", "instance", {}}, clock.now());
    join("a", "es1");
    clock.advance(10s);
    others.onTimer(clock.now());
    ASSERT_TRUE(servers.lost("es1"));
    entities.forget("es1", {});
    EXPECT_FALSE(join("a", "es1")) << "late";
    EXPECT_EQ(serverOf("a"), "nobody");
}

TEST_F(EntitiesTest, AServerIsWatchedCloselyWhileATaskRunsOnOneOfItsEntities) {
    servers.heard(Lane::Signal, {"es1", "instance", {}}, clock.now());
    join("a");
    status(EntityState::BUSY, 1);
    const auto silence = [&](Duration time) {
        clock.advance(time);
        others.onTimer(clock.now());
        return servers.lost("es1");
    };
    EXPECT_FALSE(silence(249ms));
    EXPECT_TRUE(silence(1ms));
    servers.heard(Lane::Signal, {"es1", "instance", {}}, clock.now());
    others.onTimer(clock.now());
    entities.forget("es1", {});
    EXPECT_FALSE(silence(1999ms)) << "the task has gone with its entity";
    EXPECT_TRUE(silence(1ms));
}

TEST_F(EntitiesTest, TheOnlyServerIsNeverInDoubt) {
    Entities alone{true, servers, clock};
    EXPECT_TRUE(alone.update(Presence::Joined, registration("a", ""), "profile"));
    EXPECT_EQ(*alone.serverOf("a", Lane::Data), "");
    EXPECT_EQ(servers.size(), 0U) << "nobody is awaited";
}

}  // namespace
}  // namespace axon::front_end_server
