// SPDX-License-Identifier: GPL-2.0-or-later
// Generations, answers that overtake their news, and receipts, without the rest of the Entity Manager. What a
// stop does to tasks and lease is claimed in stops_test.cpp.
#include "entity_manager/core/stops/stop_ledger.hpp"

#include <axon/link.pb.h>
#include <gtest/gtest.h>

#include "entity_manager/core/entity_manager_core.hpp"
#include "tests/support/core_rig.hpp"
#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using proto::StopReceipt;

struct NotingBackEnd final : BackEndPort {
    bool send(const proto::EmToEi&) override { return true; }
    void stop(std::uint32_t generation, StopCause) override { stopped.push_back(generation); }
    void setBusy(bool) override {}
    std::vector<std::uint32_t> stopped;
};

struct StopLedgers : testing::Test {
    StopLedgers() { ledger.linkUp(); }
    static Header from(const std::string& client, std::int64_t sequence) {
        Header head;
        head.sender.id = client;
        head.sequence = sequence;
        return head;
    }
    static proto::StopDone done(std::uint32_t generation,
                                StopReceipt::Stage stage = StopReceipt::CALLBACK_RETURNED) {
        proto::StopDone answer;
        answer.set_stop_generation(generation);
        answer.set_stage(stage);
        return answer;
    }
    std::uint32_t stop(const std::string& client, std::int64_t sequence) {
        const auto generation = *stop_generations.raise(client, sequence);
        ledger.arrived(generation);
        ledger.acknowledge(from(client, sequence), StopCause::Requested, generation, true, std::nullopt);
        return generation;
    }
    StopReceipt::Stage lastStage() const { return turn.told.back().message.receipt().stage(); }

    test::MemoryStorage storage;
    StopGenerations stop_generations;
    NotingBackEnd back_end;
    test::FakeTurn turn;
    StopLedger ledger{turn, storage, stop_generations, back_end};
};

TEST_F(StopLedgers, AnAnswerThatOvertakesTheNewsOfItsStopConfirmsItOnceThatHasCome) {
    const auto generation = *stop_generations.raise("client1", 1);  // the signal thread has passed it on
    ledger.answered(done(generation));
    ledger.settle();
    EXPECT_FALSE(ledger.standing());
    EXPECT_TRUE(turn.told.empty());

    ledger.arrived(generation);
    ledger.acknowledge(from("client1", 1), StopCause::Requested, generation, true, std::nullopt);
    ledger.settle();
    EXPECT_TRUE(ledger.standing());
    EXPECT_EQ(lastStage(), StopReceipt::CALLBACK_RETURNED);
}

TEST_F(StopLedgers, AnOwnStopDoesNotHideOneThatIsStillOnItsWayToTheStrand) {
    const auto under_way = *stop_generations.raise("client1", 1);
    const auto own = ledger.order(StopCause::ServerLost, true);
    EXPECT_EQ(back_end.stopped, std::vector{own});
    EXPECT_LT(ledger.generation(), under_way);
    EXPECT_FALSE(ledger.allHandled());
    EXPECT_EQ(ledger.required(), own);

    ledger.arrived(under_way);
    EXPECT_EQ(ledger.generation(), own);
    EXPECT_TRUE(ledger.allHandled());
}

TEST_F(StopLedgers, ACommandCountsOnlyIfItsSenderHadSeenTheNewestStop) {
    stop("client1", 1);
    EXPECT_EQ(ledger.whyNot(0).code, RefusalCode::OldGeneration);
    EXPECT_EQ(ledger.whyNot(1).code, RefusalCode::Ok);
    EXPECT_EQ(ledger.whyNot(2).code, RefusalCode::Malformed);
    stop_generations.raise("client2", 1);
    EXPECT_EQ(ledger.whyNot(1).code, RefusalCode::OldGeneration) << "a stop is on its way to the strand";
}

TEST_F(StopLedgers, ANextLifeBeginsAboveEveryGenerationThatWasTold) {
    for (int i = 0; i < 2500; ++i) ledger.order(StopCause::LinkLost, true);
    StopGenerations next_stops;
    const StopLedger next(turn, storage, next_stops, back_end);
    EXPECT_GT(next.generation(), ledger.generation());
    EXPECT_EQ(next_stops.generation(), next.generation());
}

TEST_F(StopLedgers, ADamagedGenerationIsNoReasonToBeginAtZero) {
    storage.save(kGenerationKey, "12x");
    StopGenerations next_stops;
    EXPECT_THROW(StopLedger(turn, storage, next_stops, back_end), std::runtime_error);
}

TEST_F(StopLedgers, OneAnswerConfirmsAllStopsBeforeIt) {
    stop("client1", 1);
    const auto second = stop("client2", 1);
    turn.told.clear();
    ledger.answered(done(second));
    ASSERT_EQ(turn.told.size(), 2U);
    for (const auto& told : turn.told) {
        EXPECT_EQ(told.lane, Lane::Signal);
        EXPECT_EQ(told.message.receipt().stage(), StopReceipt::CALLBACK_RETURNED) << told.to.id;
    }
}

TEST_F(StopLedgers, AnAnswerToAStopThatNobodyGaveIsCountedAndConfirmsNothing) {
    const auto generation = stop("client1", 1);
    ledger.answered(done(generation + 1));
    EXPECT_EQ(turn.counted.unexpected, 1U);
    EXPECT_FALSE(ledger.standing());
}

TEST_F(StopLedgers, ACallbackThatThrowsIsToldAndConfirmsNothing) {
    const auto generation = stop("client1", 1);
    auto thrown = done(generation);
    thrown.set_fault("the port is closed");
    ledger.answered(thrown);
    EXPECT_FALSE(ledger.standing());
    EXPECT_EQ(turn.told.back().message.receipt().fault(), "the port is closed");
    ASSERT_EQ(turn.warnings.size(), 1U);
    EXPECT_NE(turn.warnings.front().find("the port is closed"), std::string::npos);
}

TEST_F(StopLedgers, AStopThatALostApplicationHasNotConfirmedIsOwedToTheNextOne) {
    stop("client1", 1);
    EXPECT_TRUE(ledger.owed());
    ledger.linkDown("it has been silent", LinkEnd::Silent);
    turn.link = false;
    EXPECT_EQ(lastStage(), StopReceipt::NO_APPLICATION);
    turn.link = true;
    ledger.linkUp();
    EXPECT_TRUE(ledger.cameBack());
    EXPECT_TRUE(ledger.owed());
    ledger.answered(done(ledger.order(StopCause::LinkLost, true)));
    EXPECT_FALSE(ledger.owed());
}

TEST_F(StopLedgers, ACopyOfAStopFromBeforeTheRearmIsNotAnsweredWhileATaskRuns) {
    const auto generation = stop("client1", 1);
    ledger.answered(done(generation));
    ledger.rearmed();
    turn.told.clear();
    ledger.repeated(from("client1", 1), StopCause::Requested, generation, true);
    EXPECT_TRUE(turn.told.empty());
    ledger.repeated(from("client1", 1), StopCause::Requested, generation, false);
    ASSERT_EQ(turn.told.size(), 1U);
    EXPECT_EQ(lastStage(), StopReceipt::CALLBACK_RETURNED);
}

}  // namespace
}  // namespace axon::entity_manager
