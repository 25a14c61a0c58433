// SPDX-License-Identifier: GPL-2.0-or-later
// What the server knows of the entity, and when its silence is judged, without the rest of the Entity
// Manager.
#include "entity_manager/core/presence/presence.hpp"

#include <axon/link.pb.h>
#include <gtest/gtest.h>

#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;

struct NotingServer final : ServerPort {
    void wantConnection(bool wanted) override { wishes.push_back(wanted); }
    void sendBasicPrfl(const Registration& registration, const proto::BasicProfile& profile) override {
        registrations.emplace_back(registration, profile);
    }
    void sendStatus(const EntityStatus& status) override { states.push_back(status.state); }
    void sendToClient(Lane, const Header&, const proto::ToClient&) override {}
    void sendToPeer(Lane, const Header&, const proto::ToEntity&) override {}
    void sendToClientDataSeq(const Header&, const proto::ToClient&) override {}

    std::vector<bool> wishes;
    std::vector<std::pair<Registration, proto::BasicProfile>> registrations;
    std::vector<EntityState> states;
};

struct Presences : testing::Test {
    static EntityStatus in(EntityState state) {
        EntityStatus status;
        status.entity = "u";
        status.state = state;
        return status;
    }
    static proto::BasicProfile profile() {
        proto::BasicProfile basic;
        basic.set_name("PeopleBot");
        return basic;
    }
    void moveTo(double x) {
        proto::PositionNote position;
        position.set_xpos(x);
        presence.positionIs(position);
    }
    std::vector<Event> fired() const {
        std::vector<Event> events;
        for (const auto& one : turn.fired) events.push_back(one.event);
        return events;
    }
    test::FakeTurn turn;
    NotingServer server;
    Presence presence{turn, server, {"u", "an application", 250ms, 10s}};
};

TEST_F(Presences, AServerIsSilentAfterTheWatchdogOfWhatTheEntityDoes) {
    EXPECT_EQ(presence.nextDeadline(), TimePoint::max()) << "nobody is watched without a session";
    presence.up();
    presence.setBusy(true);
    turn.clock.advance(249ms);
    EXPECT_FALSE(presence.whySilent());
    turn.clock.advance(1ms);
    EXPECT_EQ(presence.whySilent().value_or(""), "it has been silent for 250 ms");
    presence.heard();
    presence.setBusy(false);
    turn.clock.advance(9999ms);
    EXPECT_FALSE(presence.whySilent());
}

TEST_F(Presences, ASessionThatFellSilentIsGivenUpBeforeAnotherIsWanted) {
    presence.up();
    turn.clock.advance(11s);
    presence.onTimer();
    ASSERT_EQ(fired(), std::vector{Event::ServerDown});
    EXPECT_EQ(turn.fired[0].reason.message,
              "The Entity Manager lost the server: it has been silent for 10000 ms");
    presence.seek();
    EXPECT_EQ(server.wishes, (std::vector{false, true}));
    presence.seek();
    EXPECT_EQ(server.wishes, (std::vector{false, true, true})) << "once";
}

TEST_F(Presences, ASessionThatReplacesAnotherEndsThatOneFirst) {
    presence.sessionBegan();
    EXPECT_EQ(fired(), std::vector{Event::ServerUp});
    turn.on_fire = [this](Incident& incident) {
        EXPECT_EQ(presence.connected(), incident.event == Event::ServerUp);
    };
    presence.sessionBegan();
    EXPECT_EQ(fired(), (std::vector{Event::ServerUp, Event::ServerDown, Event::ServerUp}));
}

TEST_F(Presences, ALeaseThatHasOutlivedTheSessionIsFoundAgainByTheNextOne) {
    turn.lease.emplace();
    turn.in_state = EntityState::ENVCONN;
    presence.sessionBegan();
    EXPECT_EQ(fired(), std::vector{Event::ServerReturned});
}

TEST_F(Presences, ASessionThatIsThereAlreadyWhenOneIsSoughtCountsAsUp) {
    turn.in_state = EntityState::ENVCONN;
    presence.seek();
    EXPECT_TRUE(fired().empty());
    presence.up();
    presence.seek();
    EXPECT_EQ(fired(), std::vector{Event::ServerUp});
}

TEST_F(Presences, ALateServerIsWarnedOfBeforeItCountsAsLostAndOnceAMinute) {
    presence.up();
    presence.setBusy(false);
    turn.clock.advance(presence.nextDeadline() - turn.now());
    EXPECT_FALSE(presence.whySilent());
    presence.onTimer();
    ASSERT_EQ(turn.warnings.size(), 1U);
    presence.heard();
    turn.clock.advance(9s);
    presence.onTimer();
    EXPECT_EQ(turn.warnings.size(), 1U);
}

TEST_F(Presences, WithoutAProfileTheEntityIsRegisteredUnderItsApplicationsName) {
    presence.registerEntity();
    ASSERT_EQ(server.registrations.size(), 1U);
    EXPECT_EQ(server.registrations[0].first.name, "an application");
    EXPECT_EQ(server.registrations[0].first.heartbeat_busy_ms, 50);
    EXPECT_EQ(server.registrations[0].first.heartbeat_idle_ms, 2000);
    presence.profileIs(profile());
    presence.registerEntity();
    EXPECT_EQ(server.registrations[1].first.name, "PeopleBot");
    EXPECT_EQ(server.registrations[1].second.entity_id(), "u");
}

TEST_F(Presences, ThePositionIsTheNewestAndGoesOutFiveTimesASecondAtMost) {
    moveTo(1);  // before the profile is good, and kept for it
    presence.up();
    presence.profileIs(profile());
    presence.registerEntity();
    ASSERT_EQ(server.registrations.size(), 1U);
    EXPECT_EQ(server.registrations[0].second.xpos(), 1);

    moveTo(2);
    moveTo(3);
    EXPECT_EQ(server.registrations.size(), 1U);
    EXPECT_EQ(presence.nextDeadline(), turn.now() + 200ms);
    turn.clock.advance(200ms);
    presence.onTimer();
    ASSERT_EQ(server.registrations.size(), 2U);
    EXPECT_EQ(server.registrations[1].second.xpos(), 3);
}

TEST_F(Presences, AStatusIsToldOncePerSession) {
    presence.tell(in(EntityState::IDLE));
    EXPECT_TRUE(server.states.empty()) << "there is no session";
    presence.up();
    presence.tell(in(EntityState::IDLE));
    presence.tell(in(EntityState::IDLE));
    EXPECT_EQ(server.states.size(), 1U);
    presence.down();
    presence.up();
    presence.tell(in(EntityState::IDLE));
    EXPECT_EQ(server.states.size(), 2U);
}

TEST_F(Presences, ARestBetweenTwoStepsIsToldOnlyIfItLasts) {
    presence.up();
    presence.tell(in(EntityState::BUSY));
    presence.tell(in(EntityState::SLAVE));
    EXPECT_EQ(server.states.size(), 1U);
    EXPECT_EQ(presence.nextDeadline(), turn.now() + 20ms);
    presence.tell(in(EntityState::BUSY));
    turn.clock.advance(1s);
    EXPECT_EQ(server.states.size(), 1U) << "the next step has begun";

    presence.tell(in(EntityState::SLAVE));
    turn.clock.advance(20ms);
    presence.tell(in(EntityState::SLAVE));
    EXPECT_EQ(server.states, (std::vector{EntityState::BUSY, EntityState::SLAVE}));
}

}  // namespace
}  // namespace axon::entity_manager
