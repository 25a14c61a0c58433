// SPDX-License-Identifier: GPL-2.0-or-later
// What servers and clients are told of how the entity is, without the rest of the Entity Manager.
#include "entity_manager/core/status_report.hpp"

#include <gtest/gtest.h>

#include <string>

#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;

struct FixedOthers final : StatusReport::Others {
    std::size_t waitingClients() const override { return 3; }
    const std::string& takenFromHolder() const override { return taken; }
    void describeServices(proto::EntityStatus& status) override {
        status.mutable_services()->Add()->set_name("Driving");
    }
    void describeWork(proto::EntityStatus& status) const override {
        status.add_watchdogs()->set_hop("a hop");
    }
    std::string taken = "taken by an administrator";
};

struct StatusReports : testing::Test {
    void hold() {
        turn.lease.emplace().number = {1, 2};
        turn.lease->holder = {"client", "Ada", Role::Operator};
    }
    proto::EntityStatus answerTo(const std::string& client, bool with_services = false) {
        Header head;
        head.sender = {client, "Somebody", Role::Operator};
        proto::ToEntity request;
        request.mutable_status_request()->set_request_id("r1");
        request.mutable_status_request()->set_with_services(with_services);
        report.answer({Event::Status, &head, &request});
        EXPECT_EQ(turn.told.back().to.id, client);
        EXPECT_EQ(turn.told.back().type, kMsgStatus);
        return turn.told.back().message.status();
    }

    test::FakeTurn turn;
    FixedOthers others;
    Readiness readiness{"pilot"};
    TaskMemory memory;
    StatusReport report{turn, others, readiness, memory, "u"};
};

TEST_F(StatusReports, ServersAreToldWhoHoldsTheEntityAndUnderWhichLease) {
    EXPECT_EQ(report.forServers().holder.id, "");
    hold();
    turn.stopped.generation = 5;
    turn.latch = true;
    const auto status = report.forServers();
    EXPECT_EQ(status.entity, "u");
    EXPECT_EQ(status.state, EntityState::REG);
    EXPECT_TRUE(status.latched);
    EXPECT_EQ(status.stop_generation, 5);
    EXPECT_EQ(status.holder.id, "client");
    EXPECT_EQ(status.held, (LeaseNumber{1, 2}));
    EXPECT_FALSE(status.orphaned);
    EXPECT_EQ(status.waiting, 3);
    turn.lease->grace_until = turn.now() + 1s;
    EXPECT_TRUE(report.forServers().orphaned);
}

TEST_F(StatusReports, TheReasonIsWhyTheEntityIsNotReadyAndInIdleWhyItWasTaken) {
    turn.in_state = EntityState::UNAV;
    readiness.notReady("the link is down");
    EXPECT_EQ(report.forServers().reason, "the link is down");
    EXPECT_EQ(answerTo("client").reason(), "the link is down");
    turn.in_state = EntityState::IDLE;
    EXPECT_EQ(report.forServers().reason, "taken by an administrator");
    EXPECT_EQ(answerTo("client").reason(), "");
}

TEST_F(StatusReports, AClientIsAnsweredUnderItsRequestWithTasksAndWatchdogs) {
    hold();
    const auto status = answerTo("other");
    EXPECT_EQ(status.request_id(), "r1");
    EXPECT_EQ(status.state(), static_cast<proto::EntityState>(static_cast<int>(EntityState::REG) + 1));
    EXPECT_EQ(status.holder(), named(turn.lease->holder));
    EXPECT_EQ(status.waiting(), 3U);
    EXPECT_EQ(status.watchdogs_size(), 1);
}

TEST_F(StatusReports, ServicesAreToldToWhoeverAsksForThem) {
    EXPECT_EQ(answerTo("client").services_size(), 0);
    EXPECT_EQ(answerTo("client", true).services_size(), 1);
}

TEST_F(StatusReports, HowTheTasksOfALeaseHaveEndedIsToldToItsHolderAlone) {
    hold();
    proto::TaskEvent ended;
    ended.set_state(proto::TASK_SUCCEEDED);
    memory.ended(*Id128::fromBytes(std::string(16, 'a')), turn.lease->number, ended, turn.now());
    EXPECT_EQ(answerTo("other").ended_size(), 0);
    ASSERT_EQ(answerTo("client").ended_size(), 1);
    turn.lease->number = {1, 3};
    EXPECT_EQ(answerTo("client").ended_size(), 0) << "of an earlier lease";
}

}  // namespace
}  // namespace axon::entity_manager
