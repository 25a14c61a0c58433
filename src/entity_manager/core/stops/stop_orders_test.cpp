// SPDX-License-Identifier: GPL-2.0-or-later
// What every stop does beside its generation and its receipt, without the rest of the Entity Manager.
// Receipts are claimed in stop_ledger_test.cpp.
#include "entity_manager/core/stops/stop_orders.hpp"

#include <axon/link.pb.h>
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "tests/support/core_rig.hpp"
#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

/// In the order in which they come about.
using Steps = std::vector<std::string>;

struct NotingBackEnd final : BackEndPort {
    explicit NotingBackEnd(Steps& happened) : steps(happened) {}
    bool send(const proto::EmToEi&) override { return true; }
    void stop(std::uint32_t generation, StopCause) override {
        steps.push_back("command " + std::to_string(generation));
    }
    void setBusy(bool) override {}
    Steps& steps;
};

struct NotingJournal final : Journal {
    explicit NotingJournal(Steps& happened) : steps(happened) {}
    bool append(const JournalRecord& record) override {
        records.push_back(record);
        steps.push_back("journal " + std::to_string(record.generation));
        return true;
    }
    void replay(const std::function<void(const JournalRecord&)>&) override {}
    Steps& steps;
    std::vector<JournalRecord> records;
};

struct NotingOthers final : StopOrders::Others {
    explicit NotingOthers(Steps& happened) : steps(happened) {}
    void stopReachesTasks(bool ends) override { steps.push_back(ends ? "tasks end" : "tasks"); }
    TaskCounts taskCounts() const override { return {2, 3}; }
    bool robotMoves() const override { return true; }
    Steps& steps;
};

struct TheStopOrders : testing::Test {
    TheStopOrders() {
        ledger.linkUp();
        head.sender = {"client", "Ada", Role::Operator};
        head.sequence = 7;
    }
    Steps happened() { return std::exchange(steps, {}); }
    static std::string at(const std::string& step, std::uint32_t generation) {
        return step + ' ' + std::to_string(generation);
    }

    Steps steps;
    Header head;
    test::MemoryStorage storage;
    StopGenerations stop_generations;
    NotingBackEnd back_end{steps};
    NotingJournal book{steps};
    NotingOthers others{steps};
    test::FakeTurn turn;
    JournalWriter journal{turn, &book};
    StopLedger ledger{turn, storage, stop_generations, back_end};
    StopOrders orders{others, ledger, journal};
};

TEST_F(TheStopOrders, ARequestThatEndsTasksSaysAsWhichStopAndByWhom) {
    const auto given = [&](Event event) {
        Incident request{event, &head};
        StopOrders::giveReason(request);
        return request;
    };
    EXPECT_EQ(given(Event::Release).cause, StopCause::Released);
    EXPECT_EQ(given(Event::Release).reason.message, named(head.sender) + " released the entity.");
    EXPECT_EQ(given(Event::Clear).cause, StopCause::Clear);
    EXPECT_EQ(given(Event::Clear).reason.code, RefusalCode::Stopped);
    EXPECT_EQ(given(Event::Reset).cause, StopCause::Reset);
    EXPECT_TRUE(given(Event::Reset).reason.ok());
    EXPECT_EQ(given(Event::Task).cause, StopCause::Unspecified);
}

TEST_F(TheStopOrders, AnOwnStopIsCommandedBeforeAnythingElseIsDoneAboutIt) {
    Incident lost{Event::ServerDown};
    lost.cause = StopCause::ServerLost;
    lost.reason = {RefusalCode::NotConnected, "The server is lost.", {}};
    orders.stop(lost);
    EXPECT_EQ(lost.generation, ledger.generation());
    EXPECT_EQ(happened(),
              (Steps{at("command", lost.generation), "tasks end", at("journal", lost.generation)}));
    EXPECT_EQ(book.records[0].code, toString(StopCause::ServerLost));
    EXPECT_EQ(book.records[0].text, "The server is lost.");
    EXPECT_EQ(book.records[0].who, "");
}

TEST_F(TheStopOrders, AResetVoidsNoCommandAndLeavesTheApplicationsOwnAccountAlone) {
    const auto required = ledger.required();
    Incident reset{Event::Reset, &head};
    reset.cause = StopCause::Reset;
    orders.stop(reset);
    EXPECT_EQ(ledger.required(), required);
    EXPECT_EQ(happened(), (Steps{at("command", reset.generation), "tasks", at("journal", reset.generation)}));
}

TEST_F(TheStopOrders, AStopOfTheSignalThreadIsNotCommandedAgainAndIsNotedWithItsSender) {
    Incident stop{Event::Stop, &head};
    stop.cause = StopCause::Requested;
    stop.generation = *stop_generations.raise("client", 7);
    orders.arrived(stop);
    EXPECT_TRUE(ledger.allHandled());
    EXPECT_EQ(happened(), (Steps{"tasks end", at("journal", stop.generation)}));
    EXPECT_EQ(book.records[0].who, named(head.sender));
}

TEST_F(TheStopOrders, TheReceiptOfAResetSaysWhatEndedAndThatOfAClearAlsoWhatWasRemoved) {
    for (const auto event : {Event::Reset, Event::Clear, Event::Release}) {
        Incident incident{event, &head};
        orders.stop(incident);
        orders.acknowledge(incident);
    }
    ASSERT_EQ(turn.told.size(), 3U);
    const auto receipt = [&](std::size_t i) { return turn.told[i].message.receipt(); };
    EXPECT_EQ(receipt(0).tasks_ended(), 2U);
    EXPECT_EQ(receipt(0).tasks_removed(), 0U);
    EXPECT_EQ(receipt(1).tasks_ended(), 2U);
    EXPECT_EQ(receipt(1).tasks_removed(), 3U);
    EXPECT_EQ(receipt(2).tasks_ended(), 0U);
}

TEST_F(TheStopOrders, WhatALostApplicationHasNotConfirmedIsOrderedOnceMoreWhenOneLinks) {
    orders.deliver();
    EXPECT_TRUE(steps.empty()) << "nothing is owed";
    Incident stop{Event::Stop, &head};
    stop.generation = *stop_generations.raise("client", 7);
    orders.arrived(stop);
    orders.acknowledge(stop);
    ledger.linkDown("it has been silent", LinkEnd::Silent);
    ledger.linkUp();
    happened();
    orders.deliver();
    const auto again = ledger.generation();
    EXPECT_GT(again, stop.generation);
    EXPECT_EQ(happened(), (Steps{at("command", again), "tasks end", at("journal", again)}));
}

}  // namespace
}  // namespace axon::entity_manager
