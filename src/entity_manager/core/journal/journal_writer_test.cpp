// SPDX-License-Identifier: GPL-2.0-or-later
// What every entry of the journal has, and what becomes of what it does not take.
#include "entity_manager/core/journal/journal_writer.hpp"

#include <gtest/gtest.h>

#include "tests/support/core_rig.hpp"
#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using Kind = JournalRecord::Kind;

struct JournalWriters : testing::Test {
    SeededRandom random{1};
    test::FakeTurn turn;
    test::MemoryJournal journal;
    JournalWriter writer{turn, &journal};
};

TEST_F(JournalWriters, AnEntryHasThePresentLeaseGenerationAndTimeWhereItSaysNoOther) {
    turn.lease.emplace().number = {1, 2};
    turn.stopped.generation = 5;
    turn.clock.advance(3s);
    EXPECT_TRUE(writer.note({.kind = Kind::Rearmed}));
    EXPECT_EQ(journal.records[0].lease, (LeaseNumber{1, 2}));
    EXPECT_EQ(journal.records[0].generation, 5U);
    EXPECT_EQ(journal.records[0].at_us, toMicroseconds(turn.now()));
    writer.note({.kind = Kind::Stopped, .lease = {1, 1}, .generation = 4});
    EXPECT_EQ(journal.records[1].lease, (LeaseNumber{1, 1}));
    EXPECT_EQ(journal.records[1].generation, 4U);
}

TEST_F(JournalWriters, WhatIsNotWrittenIsCountedAndWarnedOfOnceUntilSomethingIs) {
    journal.full = true;
    EXPECT_FALSE(writer.note({.kind = Kind::Rearmed}));
    EXPECT_FALSE(writer.note({.kind = Kind::Rearmed}));
    EXPECT_EQ(turn.counted.unrecorded, 2U);
    EXPECT_EQ(turn.warnings.size(), 1U);
    journal.full = false;
    EXPECT_TRUE(writer.note({.kind = Kind::Rearmed}));
    journal.full = true;
    writer.note({.kind = Kind::Rearmed});
    EXPECT_EQ(turn.warnings.size(), 2U);
}

TEST_F(JournalWriters, TheEntryBeforeATaskIsAnsweredWhenTheDiskHasIt) {
    journal.slow = true;
    const auto written = writer.noteDispatch({.kind = Kind::Dispatched});
    EXPECT_FALSE(written.ready());
    journal.answerAll();
    EXPECT_TRUE(written.ready() && written.value());
}

TEST_F(JournalWriters, RefusalsOfOwnershipAreNotedTenASecondAndOthersAreMentioned) {
    writer.noteRefusal({"a", "Ada", Role::Operator}, {}, {RefusalCode::OutOfRange, "why", {}});
    EXPECT_TRUE(journal.records.empty());
    ASSERT_EQ(journal.mentioned.size(), 1U);
    EXPECT_EQ(journal.mentioned[0].client, "a");
    EXPECT_EQ(journal.mentioned[0].code, refusalName(RefusalCode::OutOfRange));
    EXPECT_EQ(journal.mentioned[0].text, "why");
    for (int i = 0; i < 12; ++i)
        writer.noteRefusal({"a", "Ada", Role::Operator}, {}, {RefusalCode::NotHolder, "", {}});
    EXPECT_EQ(journal.records.size(), 10U);
    EXPECT_EQ(turn.counted.unrecorded, 2U);
    EXPECT_EQ(journal.mentioned.size(), 3U) << "an audit has bounds of its own";
    turn.clock.advance(1s);
    writer.noteRefusal({"a", "Ada", Role::Operator}, {}, {RefusalCode::PermissionDenied, "", {}});
    EXPECT_EQ(journal.records.back().code, refusalName(RefusalCode::PermissionDenied));
    EXPECT_EQ(journal.records.size(), 11U);
    EXPECT_EQ(journal.records.back().client, "a");
    writer.noteRefusal({"a", "Ada", Role::Operator}, {}, {});
    EXPECT_EQ(journal.mentioned.size(), 3U) << "that was none";
}

TEST_F(JournalWriters, OfRawDataOnlyRefusalsOfOwnershipAreKeptTenASecond) {
    writer.noteRefusalOfRaw({"a", "Ada", Role::Operator}, {}, {RefusalCode::TooLarge, "", {}});
    EXPECT_TRUE(journal.records.empty());
    for (int i = 0; i < 12; ++i)
        writer.noteRefusalOfRaw({"a", "Ada", Role::Operator}, {}, {RefusalCode::NotHolder, "", {}});
    EXPECT_EQ(journal.records.size(), 10U);
    EXPECT_TRUE(journal.mentioned.empty());
}

TEST_F(JournalWriters, WhatAnEarlierLifeHasDispatchedDoesNotRunAgainAndIsEndedAsUnknown) {
    const auto ended = Id128::random(random);
    const auto open = Id128::random(random);
    journal.records = {{.kind = Kind::Dispatched, .task = ended},
                       {.kind = Kind::TaskEnded, .task = ended, .code = "TASK_SUCCEEDED"},
                       {.kind = Kind::Dispatched, .task = open}};
    TaskMemory memory;
    writer.begin(memory, {3, 0}, "entity u");
    EXPECT_TRUE(memory.whyNotAgain(ended));
    EXPECT_TRUE(memory.whyNotAgain(open));
    EXPECT_FALSE(memory.whyNotAgain(Id128::random(random)));
    ASSERT_EQ(journal.records.size(), 5U);
    EXPECT_EQ(journal.records[3].kind, Kind::Started);
    EXPECT_EQ(journal.records[3].lease, (LeaseNumber{3, 0}));
    EXPECT_EQ(journal.records[4].kind, Kind::TaskEnded);
    EXPECT_EQ(journal.records[4].task, open);
    EXPECT_EQ(journal.records[4].code, "TASK_UNKNOWN");
}

TEST_F(JournalWriters, WithoutAJournalEverythingCountsAsWritten) {
    JournalWriter none{turn, nullptr};
    EXPECT_TRUE(none.note({.kind = Kind::Rearmed}));
    EXPECT_TRUE(none.noteDispatch({.kind = Kind::Dispatched}).value());
    none.mentionControl({"a", "Ada", Role::Operator}, {}, "Pause");
    none.noteRefusal({"a", "Ada", Role::Operator}, {}, {RefusalCode::Malformed, "", {}});
    EXPECT_EQ(turn.counted.unrecorded, 0U);
}

}  // namespace
}  // namespace axon::entity_manager
