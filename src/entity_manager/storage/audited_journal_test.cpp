// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/storage/audited_journal.hpp"

#include <gmock/gmock.h>

#include <vector>

#include "support/recorded_audit.hpp"

namespace axon::entity_manager {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::StartsWith;
using Kind = JournalRecord::Kind;

struct KeptJournal final : Journal {
    bool append(const JournalRecord& record) override {
        records.push_back(record);
        return takes;
    }
    void replay(const std::function<void(const JournalRecord&)>& each) override {
        for (const auto& record : records) each(record);
    }
    std::vector<JournalRecord> records;
    Later<bool> appendDispatch(const JournalRecord& record) override {
        if (answers_at_once) return append(record);
        records.push_back(record);
        waiting.push_back(Later<bool>::pending());
        return waiting.back();
    }
    void onAnswer(std::function<void()> come) override { come_ = std::move(come); }
    /// What the thread of a journal on a disk does.
    void answer(bool written) {
        waiting.front().set(written);
        waiting.erase(waiting.begin());
        if (come_) come_();
    }
    bool takes = true, answers_at_once = true;
    std::vector<Later<bool>> waiting;
    std::function<void()> come_;
};

struct AuditedJournalTest : testing::Test {
    KeptJournal kept;
    test::RecordedAudit trail;
    AuditedJournal journal{kept, trail, "e1"};
};

TEST_F(AuditedJournalTest, EveryKindOfEntryHasItsKindInTheTrail) {
    for (std::size_t i = 0; i < kJournalKinds.size(); ++i) journal.append({.kind = static_cast<Kind>(i)});
    EXPECT_THAT(
        trail.notes(),
        ElementsAre(StartsWith("started|"), StartsWith("ownership|"), StartsWith("ownership|"),
                    StartsWith("ownership|"), StartsWith("take-over|"), StartsWith("ownership|"),
                    StartsWith("refusal|"), StartsWith("stop|"), StartsWith("rearm|"), StartsWith("command|"),
                    StartsWith("command|"), StartsWith("command|"), StartsWith("command|")));
    EXPECT_EQ(kept.records.size(), kJournalKinds.size());
}

TEST_F(AuditedJournalTest, SaysWhoDidWhatToWhichEntity) {
    SeededRandom random(1);
    const auto task = Id128::random(random);
    journal.setEntity("e2");
    EXPECT_TRUE(
        journal
            .appendDispatch(
                {.kind = Kind::Dispatched, .who = "ann", .client = "c1", .task = task, .service = "Driving"})
            .value());
    EXPECT_EQ(trail.last(), "command|ann|c1|e2|dispatched Driving (task " + task.toString() + ")|");
    journal.append(
        {.kind = Kind::Stopped, .generation = 7, .who = "bob", .code = "REQUESTED", .text = "why"});
    EXPECT_EQ(trail.last(), "stop|bob||e2|stopped, generation 7: why|REQUESTED");
}

TEST_F(AuditedJournalTest, WhatIsOnlyMentionedIsInTheTrailAndNotInTheJournal) {
    journal.mention({.kind = Kind::Controlled, .who = "ann", .client = "c1", .text = "PAUSE"});
    EXPECT_EQ(trail.last(), "command|ann|c1|e1|controlled: PAUSE|");
    journal.mention({.kind = Kind::Refused, .who = "ann", .code = "MALFORMED", .text = "why"});
    EXPECT_EQ(trail.last(), "refusal|ann||e1|refused: why|MALFORMED");
    EXPECT_TRUE(kept.records.empty());
}

TEST_F(AuditedJournalTest, WhatTheJournalDoesNotTakeIsRecordedUnlessItIsATaskThatMayNotBegin) {
    kept.takes = false;
    EXPECT_FALSE(journal.append({.kind = Kind::Stopped}));
    EXPECT_FALSE(journal.appendDispatch({.kind = Kind::Dispatched}).value());
    EXPECT_THAT(trail.notes(), ElementsAre(StartsWith("stop|")));
}

TEST_F(AuditedJournalTest, ATaskIsDispatchedWhenTheJournalHasIt) {
    kept.answers_at_once = false;
    int come = 0;
    journal.onAnswer([&] {
        ++come;
        EXPECT_EQ(trail.notes().size(), 1U) << "its task may begin before it is recorded";
    });
    const auto dispatch = [this](const char* service) {
        return journal.appendDispatch({.kind = Kind::Dispatched, .service = service});
    };
    const auto first = dispatch("Driving"), second = dispatch("Lifting");
    EXPECT_TRUE(trail.notes().empty());
    kept.answer(true);
    kept.answer(false);
    EXPECT_TRUE(first.value());
    EXPECT_FALSE(second.value());
    EXPECT_EQ(come, 2);
    EXPECT_THAT(trail.notes(), ElementsAre(HasSubstr("dispatched Driving")));
}

TEST_F(AuditedJournalTest, ATaskIsDispatchedBeforeItEnds) {
    kept.answers_at_once = false;
    const auto written = journal.appendDispatch({.kind = Kind::Dispatched, .service = "Driving"});
    kept.waiting.front().set(true);  // seen by who asks, before the journal says so
    journal.append({.kind = Kind::TaskEnded, .service = "Driving"});
    EXPECT_THAT(trail.notes(),
                ElementsAre(HasSubstr("dispatched Driving"), testing::Not(HasSubstr("dispatched"))));
    EXPECT_TRUE(written.value());
}

TEST_F(AuditedJournalTest, WhatIsReadBackIsNotRecordedAgain) {
    kept.records = {{.kind = Kind::Granted}};
    int read = 0;
    journal.replay([&read](const JournalRecord&) { ++read; });
    EXPECT_EQ(read, 1);
    EXPECT_TRUE(trail.notes().empty());
}

}  // namespace
}  // namespace axon::entity_manager
