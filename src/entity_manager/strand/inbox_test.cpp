// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/strand/inbox.hpp"

#include <gtest/gtest.h>

#include <atomic>
#include <string>
#include <thread>

namespace axon::entity_manager {
namespace {

using Signal = Inbox::Signal;

class InboxTest : public testing::Test {
  protected:
    Inbox::Event note(char c) {
        return [this, c] { seen += c; };
    }
    void drain(Inbox& inbox) {
        while (auto event = inbox.take()) event();
    }
    std::string seen;
};

TEST_F(InboxTest, ASignalOvertakesEverythingThatWaits) {
    Inbox inbox;
    inbox.pushControl(note('a'));
    inbox.pushData(note('b'), 10);
    inbox.pushSignal(Signal::Stop, note('S'));
    drain(inbox);
    EXPECT_EQ(seen, "Sab");
}

TEST_F(InboxTest, FullDataDropsTheOldestDataAndNeverControl) {
    Inbox inbox({.control_events = 10, .data_events = 2, .data_bytes = 1000});
    inbox.pushData(note('1'), 10);
    inbox.pushControl(note('c'));
    inbox.pushData(note('2'), 10);
    inbox.pushData(note('3'), 10);
    EXPECT_EQ(inbox.droppedData(), 1U);
    inbox.pushData(note('4'), 995);  // the bytes are the bound now
    EXPECT_EQ(inbox.droppedData(), 3U);
    drain(inbox);
    EXPECT_EQ(seen, "c4");
}

TEST_F(InboxTest, ControlOverflowIsReportedAndChangesNothing) {
    Inbox inbox({.control_events = 1, .data_events = 2, .data_bytes = 1000});
    EXPECT_EQ(inbox.pushControl(note('a')), Inbox::Verdict::Scheduled);
    Inbox::Event second = note('b');
    EXPECT_EQ(inbox.pushControl(std::move(second)), Inbox::Verdict::Overflow);
    EXPECT_TRUE(second) << "who may wait still has it";
    drain(inbox);
    EXPECT_EQ(seen, "a");
}

TEST_F(InboxTest, WhoCanWaitLeavesHalfToThoseWhoCannot) {
    Inbox inbox({.control_events = 4, .control_bytes = 100});
    const auto push = [&](char name, std::size_t bytes) {
        return inbox.pushControl(note(name), bytes, Inbox::Share::Half);
    };
    EXPECT_EQ(push('a', 0), Inbox::Verdict::Scheduled);
    EXPECT_EQ(push('b', 0), Inbox::Verdict::AlreadyScheduled);
    EXPECT_EQ(push('c', 0), Inbox::Verdict::Overflow) << "half is taken";
    EXPECT_EQ(inbox.pushControl(note('d')), Inbox::Verdict::AlreadyScheduled);
    EXPECT_EQ(inbox.pushControl(note('e')), Inbox::Verdict::AlreadyScheduled);
    EXPECT_EQ(inbox.pushControl(note('f')), Inbox::Verdict::Overflow);
    drain(inbox);
    EXPECT_EQ(push('g', 60), Inbox::Verdict::Scheduled) << "more than half, but alone";
    EXPECT_EQ(push('h', 1), Inbox::Verdict::Overflow);
    EXPECT_EQ(inbox.pushControl(note('i'), 40), Inbox::Verdict::AlreadyScheduled);
    drain(inbox);
    EXPECT_EQ(seen, "abdegi");
}

// Not with each event that is handled.
TEST_F(InboxTest, WhoWaitsForRoomGoesOnWhenAQuarterIsTaken) {
    Inbox inbox({.control_events = 8, .control_bytes = 100});
    const auto push = [&] { return inbox.pushControl(note('x'), 5, Inbox::Share::Half); };
    EXPECT_FALSE(inbox.scheduled());
    EXPECT_TRUE(inbox.hasRoom(50));
    EXPECT_TRUE(inbox.hasRoom(60)) << "alone";
    while (push() != Inbox::Verdict::Overflow) {
    }
    EXPECT_TRUE(inbox.scheduled());
    for (int left = 4; left > 2; --left) {
        EXPECT_FALSE(inbox.hasRoom(5)) << left;
        inbox.take();
    }
    EXPECT_TRUE(inbox.hasRoom(40));
    EXPECT_FALSE(inbox.hasRoom(41)) << "it would not fit into the half";
    EXPECT_NE(push(), Inbox::Verdict::Overflow);
    drain(inbox);
    EXPECT_FALSE(inbox.scheduled());
}

TEST_F(InboxTest, OnlyTheFirstPushAfterEmptyNeedsToWakeTheStrand) {
    Inbox inbox;
    EXPECT_EQ(inbox.pushData(note('a'), 1), Inbox::Verdict::Scheduled);
    EXPECT_EQ(inbox.pushSignal(Signal::Stop, note('b')), Inbox::Verdict::AlreadyScheduled);
    drain(inbox);
    EXPECT_EQ(inbox.pushSignal(Signal::Stop, note('c')), Inbox::Verdict::Scheduled);
}

TEST_F(InboxTest, ControlIsBoundedByItsBytesToo) {
    Inbox inbox({.control_events = 10, .control_bytes = 100});
    EXPECT_EQ(inbox.pushControl(note('a'), 60), Inbox::Verdict::Scheduled);
    EXPECT_EQ(inbox.pushControl(note('b'), 60), Inbox::Verdict::Overflow);
    drain(inbox);
    EXPECT_EQ(inbox.pushControl(note('c'), 60), Inbox::Verdict::Scheduled);
    drain(inbox);
    EXPECT_EQ(seen, "ac");
}

TEST_F(InboxTest, AStopThatWaitsIsNotLostToAFloodOfDrillsAndResets) {
    Inbox inbox;
    inbox.pushSignal(Signal::Stop, note('S'));
    for (int i = 0; i < 200; ++i) inbox.pushSignal(Signal::Passing, note('x'));
    EXPECT_TRUE(inbox.wouldDrop(kServersOwn));
    EXPECT_EQ(inbox.pushSignal(Signal::Passing, note('x')), Inbox::Verdict::Dropped);
    drain(inbox);
    EXPECT_EQ(seen, "S" + std::string(63, 'x'));
}

TEST_F(InboxTest, TheDrillsOfOneSenderLeaveRoomForThoseOfOthers) {
    Inbox inbox;
    for (int i = 0; i < 200; ++i) inbox.pushSignal(Signal::Passing, note('x'), senderKey("flood"));
    EXPECT_TRUE(inbox.wouldDrop(senderKey("flood")));
    EXPECT_FALSE(inbox.wouldDrop(senderKey("honest")));
    EXPECT_EQ(inbox.pushSignal(Signal::Passing, note('h'), senderKey("honest")),
              Inbox::Verdict::AlreadyScheduled);
    EXPECT_EQ(inbox.pushSignal(Signal::Stop, note('S'), senderKey("flood")),
              Inbox::Verdict::AlreadyScheduled);
    drain(inbox);
    EXPECT_EQ(seen, std::string(16, 'x') + "hS");
    EXPECT_FALSE(inbox.wouldDrop(senderKey("flood")));
}

TEST_F(InboxTest, TheDrillsOfManySendersLeaveRoomForWhatMayNotBeLost) {
    Inbox inbox;
    for (int i = 0; i < 100; ++i)
        inbox.pushSignal(Signal::Passing, note('x'), senderKey("flood" + std::to_string(i)));
    for (int i = 0; i < 16; ++i)
        EXPECT_EQ(inbox.pushSignal(Signal::Client, note('C')), Inbox::Verdict::AlreadyScheduled);
    drain(inbox);
    EXPECT_EQ(seen, std::string(48, 'x') + std::string(16, 'C'));
}

TEST_F(InboxTest, AStopThatFindsTheRingFullTakesThePlaceOfTheOldestThatIsNone) {
    Inbox inbox;
    inbox.pushSignal(Signal::Stop, note('S'));
    inbox.pushSignal(Signal::Passing, note('o'));
    for (int i = 0; i < 62; ++i) inbox.pushSignal(Signal::Passing, note('x'));
    inbox.pushSignal(Signal::Stop, note('T'));
    inbox.pushSignal(Signal::Client, note('C'));
    drain(inbox);
    EXPECT_EQ(seen, "S" + std::string(61, 'x') + "TC");
}

TEST_F(InboxTest, WhatPeersRepeatTakesNoMoreThanItsPartOfTheRingAndGoesFirst) {
    Inbox inbox;
    for (int i = 0; i < 48; ++i) inbox.pushSignal(Signal::Peer, note('p'));
    EXPECT_EQ(inbox.pushSignal(Signal::Peer, note('q')), Inbox::Verdict::Dropped);
    for (int i = 0; i < 16; ++i) inbox.pushSignal(Signal::Passing, note('x'));
    inbox.pushSignal(Signal::Stop, note('S'));
    drain(inbox);
    EXPECT_EQ(seen, std::string(47, 'p') + std::string(16, 'x') + "S");
    inbox.pushSignal(Signal::Peer, note('r'));
    drain(inbox);
    EXPECT_EQ(seen.back(), 'r') << "there is room again";
}

TEST_F(InboxTest, AmongNothingButStopsTheNewestAlwaysFits) {
    Inbox inbox;
    for (int i = 0; i < 100; ++i) inbox.pushSignal(Signal::Stop, note('s'));
    EXPECT_EQ(inbox.pushSignal(Signal::Stop, note('L')), Inbox::Verdict::AlreadyScheduled);
    drain(inbox);
    EXPECT_EQ(seen, std::string(63, 's') + "L");
}

TEST_F(InboxTest, TheLossOfAClientTakesThePlaceOfAStopThatIsNotTheNewest) {
    Inbox inbox;
    for (int i = 0; i < 62; ++i) inbox.pushSignal(Signal::Stop, note('s'));
    inbox.pushSignal(Signal::Stop, note('o'));
    inbox.pushSignal(Signal::Stop, note('N'));
    EXPECT_EQ(inbox.pushSignal(Signal::Client, note('C')), Inbox::Verdict::AlreadyScheduled);
    drain(inbox);
    EXPECT_EQ(seen, std::string(62, 's') + "NC");
}

TEST_F(InboxTest, ASignalThatMayNotBeLostAndFindsNothingThatMayIsReported) {
    Inbox inbox;
    inbox.pushSignal(Signal::Stop, note('S'));
    for (int i = 0; i < 63; ++i) inbox.pushSignal(Signal::Client, note('c'));
    EXPECT_EQ(inbox.pushSignal(Signal::Client, note('d')), Inbox::Verdict::Overflow);
    drain(inbox);
    EXPECT_EQ(seen, "S" + std::string(63, 'c'));
}

TEST_F(InboxTest, AWakeWithoutAnEventIsAskedOfTheStrandOnce) {
    Inbox inbox;
    EXPECT_EQ(inbox.wake(), Inbox::Verdict::Scheduled);
    EXPECT_EQ(inbox.wake(), Inbox::Verdict::AlreadyScheduled);
    EXPECT_FALSE(inbox.take());
    EXPECT_EQ(inbox.wake(), Inbox::Verdict::Scheduled);
}

}  // namespace
}  // namespace axon::entity_manager
