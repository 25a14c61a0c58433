// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/inbox.hpp"

#include <gtest/gtest.h>

#include <string>

namespace axon::entity_manager {
namespace {

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
    inbox.pushSignal(note('S'));
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
    EXPECT_EQ(inbox.pushControl(note('b')), Inbox::Verdict::Overflow);
    drain(inbox);
    EXPECT_EQ(seen, "a");
}

TEST_F(InboxTest, OnlyTheFirstPushAfterEmptyNeedsToWakeTheStrand) {
    Inbox inbox;
    EXPECT_EQ(inbox.pushData(note('a'), 1), Inbox::Verdict::Scheduled);
    EXPECT_EQ(inbox.pushSignal(note('b')), Inbox::Verdict::AlreadyScheduled);
    drain(inbox);
    EXPECT_EQ(inbox.pushSignal(note('c')), Inbox::Verdict::Scheduled);
}

TEST_F(InboxTest, TheNewestSignalAlwaysFits) {
    Inbox inbox;
    for (int i = 0; i < 100; ++i) inbox.pushSignal(note('x'));
    inbox.pushSignal(note('L'));
    drain(inbox);
    EXPECT_EQ(seen, std::string(63, 'x') + "L");
}

}  // namespace
}  // namespace axon::entity_manager
