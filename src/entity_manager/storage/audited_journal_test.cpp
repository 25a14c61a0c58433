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
    bool takes = true;
};

struct AuditedJournalTest : testing::Test {
    KeptJournal kept;
    test::RecordedAudit trail;
    AuditedJournal journal{kept, trail, "e1"};
};

TEST_F(AuditedJournalTest, EveryKindOfEntryHasItsKindInTheTrail) {
    for (std::size_t i = 0; i < kJournalKinds.size(); ++i) journal.append({.kind = static_cast<Kind>(i)});
    EXPECT_THAT(trail.notes(),
                ElementsAre(StartsWith("started|"), StartsWith("ownership|"), StartsWith("ownership|"),
                            StartsWith("ownership|"), StartsWith("take-over|"), StartsWith("ownership|"),
                            StartsWith("refusal|"), StartsWith("stop|"), StartsWith("rearm|"),
                            StartsWith("command|"), StartsWith("command|"), StartsWith("command|")));
    EXPECT_EQ(kept.records.size(), kJournalKinds.size());
}

TEST_F(AuditedJournalTest, SaysWhoDidWhatToWhichEntity) {
    SeededRandom random(1);
    const auto task = Id128::random(random);
    journal.setEntity("e2");
    EXPECT_TRUE(
        journal.appendDispatch({.kind = Kind::Dispatched, .who = "ann", .task = task, .service = "Driving"})
            .value());
    EXPECT_EQ(trail.last(), "command|ann||e2|dispatched Driving (task " + task.toString() + ")|");
    journal.append(
        {.kind = Kind::Stopped, .generation = 7, .who = "bob", .code = "REQUESTED", .text = "why"});
    EXPECT_EQ(trail.last(), "stop|bob||e2|stopped, generation 7: why|REQUESTED");
}

TEST_F(AuditedJournalTest, WhatTheJournalDoesNotTakeIsRecordedAndStillRefused) {
    kept.takes = false;
    EXPECT_FALSE(journal.append({.kind = Kind::Stopped}));
    EXPECT_FALSE(journal.appendDispatch({.kind = Kind::Dispatched}).value());
    EXPECT_EQ(trail.notes().size(), 2U);
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
