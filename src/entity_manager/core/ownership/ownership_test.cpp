// SPDX-License-Identifier: GPL-2.0-or-later
// Who has the entity and who is next, without the rest of the Entity Manager. What it means for robot and
// tasks is claimed in check_outs_test.cpp and client_loss_test.cpp.
#include "entity_manager/core/ownership/ownership.hpp"

#include <gtest/gtest.h>

#include "messages/values.hpp"
#include "tests/support/core_rig.hpp"
#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;

/// What tasks and profiles would do.
struct NotingOthers final : Ownership::Others {
    explicit NotingOthers(test::FakeTurn& its_turn) : turn(its_turn) {}
    bool finishesAlone() const override { return task_finishes_alone; }
    void loseHolder(Incident& lost) override { turn.fire(lost); }
    void endSpared(const std::string&) override { order.emplace_back("what went on alone ends"); }
    void granted(Incident& granted) override { turn.fire(granted); }
    void takeKeptProfiles() override {
        order.emplace_back("kept profiles are taken");
        if (profile_kept) turn.in_state = EntityState::INIT;
    }
    test::FakeTurn& turn;
    std::vector<std::string> order;  ///< in which these and the events of the state table came
    bool profile_kept = false;
    bool task_finishes_alone = false;
};

struct Ownerships : testing::Test {
    Ownerships() {
        turn.in_state = EntityState::IDLE;
        turn.on_fire = [this](Incident& incident) {
            others.order.emplace_back(toString(incident.event));
            if (incident.event == Event::CheckOutGranted) turn.in_state = EntityState::REG;
            if (incident.event != Event::TakenOver && incident.event != Event::LeaseExpired) return;
            turn.in_state = EntityState::IDLE;
            ownership.end(incident);
        };
    }
    static std::string idOf(const std::string& name) { return name + std::string(16 - name.size(), '.'); }
    template <class Fill>
    void ask(const std::string& client, proto::CheckOutPhase phase, Fill fill) {
        Header head;
        head.sender = {client, client, Role::Operator};
        proto::ToEntity body;
        body.mutable_check_out()->set_request_id(idOf(client));
        body.mutable_check_out()->set_phase(phase);
        fill(*body.mutable_check_out());
        Incident incident{Event::CheckOut, &head, &body};
        ownership.considerCheckOut(incident);
    }
    void ask(const std::string& client, proto::CheckOutPhase phase) {
        ask(client, phase, [](auto&) {});
    }
    void waitFor(const std::string& client) {
        ask(client, proto::TAKE, [](auto& request) { request.set_wait(true); });
    }
    std::string holder() const {
        return ownership.lease().held() ? ownership.lease().held()->holder.id : std::string();
    }
    /// The last that this client was told of its check-out.
    proto::CheckOutReply toldTo(const std::string& client) const {
        for (auto told = turn.told.rbegin(); told != turn.told.rend(); ++told)
            if (told->to.id == client && told->message.has_check_out()) return told->message.check_out();
        return {};
    }
    RefusalCode refusedTo(const std::string& client) const {
        return toRefusal(toldTo(client).refusal()).code;
    }
    void lose() {
        Incident lost{Event::ClientLost};
        lost.reason = {RefusalCode::ClientLost, "It was lost.", {}};
        ownership.orphan(lost);
    }

    SeededRandom random{1};
    test::MemoryStorage storage;
    test::FakeTurn turn;
    ServiceProfiler profiler;
    JournalWriter journal{turn, nullptr};
    NotingOthers others{turn};
    Ownership ownership{turn, others, journal, storage, random, profiler, {10s, 1000}};
};

TEST_F(Ownerships, WhatIsFreeIsGrantedAndNobodyElseGetsIt) {
    ask("a", proto::TAKE);
    EXPECT_EQ(holder(), "a");
    ASSERT_EQ(turn.fired.size(), 1U);
    EXPECT_EQ(turn.fired[0].event, Event::CheckOutGranted);
    ask("b", proto::TAKE);
    EXPECT_EQ(refusedTo("b"), RefusalCode::AlreadyHeld);
    EXPECT_EQ(holder(), "a");
}

TEST_F(Ownerships, NothingIsGrantedBeforeTheRobotStands) {
    turn.stopped.standing = false;
    ask("a", proto::TAKE);
    ownership.passOn();
    EXPECT_EQ(holder(), "");
    ask("b", proto::TAKE);
    EXPECT_EQ(refusedTo("b"), RefusalCode::Reserved) << "meanwhile it is reserved";
    turn.stopped.standing = true;
    ownership.passOn();
    EXPECT_EQ(holder(), "a");
}

TEST_F(Ownerships, ARobotThatDoesNotConfirmItsStopIsNotWaitedForLong) {
    turn.stopped.standing = false;
    ask("a", proto::TAKE);
    EXPECT_EQ(ownership.nextDeadline(), turn.now() + 4s);
    turn.clock.advance(4s);
    ownership.onTimer();
    EXPECT_EQ(refusedTo("a"), RefusalCode::TimedOut);
    turn.stopped.standing = true;
    ownership.passOn();
    EXPECT_EQ(holder(), "");
}

TEST_F(Ownerships, WhoWaitsGetsItInOrderAndHearsOfANearerPlace) {
    ask("a", proto::TAKE);
    waitFor("b");
    waitFor("c");
    EXPECT_EQ(toldTo("c").place(), 2U);
    ask("b", proto::ABORT);
    ownership.passOn();
    EXPECT_EQ(toldTo("c").place(), 1U);
    EXPECT_EQ(ownership.waiting(), 1U);

    Incident released{Event::Release};
    ownership.end(released);
    turn.in_state = EntityState::IDLE;
    ownership.passOn();
    EXPECT_EQ(holder(), "c");
    EXPECT_EQ(ownership.waiting(), 0U);
}

TEST_F(Ownerships, ALostHolderKeepsItForItsGraceAndForATaskThatGoesOnAlone) {
    ask("a", proto::TAKE);
    lose();
    EXPECT_EQ(ownership.nextDeadline(), turn.now() + 10s);
    turn.clock.advance(10s);
    others.task_finishes_alone = true;
    ownership.passOn();
    EXPECT_EQ(holder(), "a");
    others.task_finishes_alone = false;
    ownership.passOn();
    EXPECT_EQ(turn.fired.back().event, Event::LeaseExpired);
    EXPECT_EQ(turn.fired.back().reason.code, RefusalCode::Expired);
    EXPECT_EQ(holder(), "");
}

TEST_F(Ownerships, TheEndOfAGraceEndsWhatWentOnAloneAndTheNextGetsItAfterKeptProfiles) {
    ask("a", proto::TAKE);
    waitFor("b");
    lose();
    turn.clock.advance(10s);
    others.order.clear();
    ownership.passOn();
    EXPECT_EQ(others.order, (std::vector<std::string>{"what went on alone ends", "LeaseExpired",
                                                      "kept profiles are taken", "CheckOutGranted"}));
    EXPECT_EQ(holder(), "b");
}

TEST_F(Ownerships, WhoWaitsGetsItOnceTheProfilesThatWereKeptAreGood) {
    ask("a", proto::TAKE);
    waitFor("b");
    others.profile_kept = true;
    Incident released{Event::Release};
    ownership.end(released);
    turn.in_state = EntityState::IDLE;
    ownership.passOn();
    EXPECT_EQ(holder(), "") << "its profiles are read";
    others.profile_kept = false;
    turn.in_state = EntityState::IDLE;
    ownership.passOn();
    EXPECT_EQ(holder(), "b");
}

TEST_F(Ownerships, WhoHasTheKeyHasTheLeaseWhateverItsSession) {
    ask("a", proto::TAKE);
    const auto before = *ownership.lease().held();
    lose();
    ask("a2", proto::RESUME_LEASE, [&](auto& request) {
        request.mutable_resume()->set_epoch(static_cast<std::uint32_t>(before.number.epoch));
        request.mutable_resume()->set_number(static_cast<std::uint32_t>(before.number.number));
        request.mutable_resume()->set_key(before.key.bytes());
    });
    EXPECT_EQ(turn.fired.back().event, Event::LeaseResumed);
    EXPECT_EQ(holder(), "a2");
    EXPECT_EQ(ownership.lease().held()->number, before.number);
    EXPECT_FALSE(ownership.lease().orphaned());
}

TEST_F(Ownerships, AHolderThatHandsOverIsToldAndTheAskerGetsIt) {
    ask("a", proto::TAKE);
    ask("b", proto::TAKE, [](auto& request) {
        request.set_ask(true);
        request.set_reason("my turn");
    });
    ASSERT_TRUE(turn.told[turn.told.size() - 2].message.has_hand_over());
    EXPECT_EQ(turn.told[turn.told.size() - 2].message.hand_over().reason(), "my turn");

    Header head;
    head.sender.id = "a";
    proto::ToEntity body;
    body.mutable_hand_over_answer()->set_request_id(idOf("b"));
    body.mutable_hand_over_answer()->set_accept(true);
    ownership.considerHandOver({Event::HandOver, &head, &body});
    EXPECT_EQ(holder(), "b");
    EXPECT_EQ(ownership.taken(), "") << "it is granted again";
}

TEST_F(Ownerships, ASilentHolderKeepsItUnlessItsPolicyYields) {
    ask("a", proto::TAKE);
    ask("b", proto::TAKE, [](auto& request) { request.set_ask(true); });
    EXPECT_EQ(ownership.nextDeadline(), turn.now() + 30s);
    turn.clock.advance(30s);
    ownership.onTimer();
    EXPECT_EQ(refusedTo("b"), RefusalCode::HandOverRefused);
    EXPECT_EQ(holder(), "a");
}

}  // namespace
}  // namespace axon::entity_manager
