// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/collaboration/run_records.hpp"

#include <gtest/gtest.h>

#include "tests/support/core_rig.hpp"

namespace axon::entity_manager {
namespace {

proto::RunRecord run(const std::string& id, proto::RunState state) {
    proto::RunRecord record;
    record.set_run_id(id);
    record.set_state(state);
    record.add_steps()->set_state(state == proto::RUN_RUNNING ? proto::TASK_RUNNING : proto::TASK_SUCCEEDED);
    return record;
}

TEST(RunRecordsOfAnEntity, TheNewestIsFirstAndTakesThePlaceOfItself) {
    test::MemoryStorage storage;
    RunRecords records(storage);
    records.keep(run("a", proto::RUN_SUCCEEDED));
    records.keep(run("b", proto::RUN_RUNNING));
    records.keep(run("b", proto::RUN_FAILED));
    const auto history = records.history(nullptr, 0);
    ASSERT_EQ(history.runs_size(), 2);
    EXPECT_EQ(history.runs(0).run_id(), "b");
    EXPECT_EQ(history.runs(0).state(), proto::RUN_FAILED);
    EXPECT_EQ(records.history(nullptr, 1).runs_size(), 1);
}

TEST(RunRecordsOfAnEntity, TheRunUnderWayIsToldAsItIsNow) {
    test::MemoryStorage storage;
    RunRecords records(storage);
    records.keep(run("a", proto::RUN_RUNNING));
    const auto now = run("a", proto::RUN_PAUSED);
    EXPECT_EQ(records.history(&now, 0).runs(0).state(), proto::RUN_PAUSED);
    const auto not_begun = run("b", proto::RUN_RUNNING);
    EXPECT_EQ(records.history(&not_begun, 0).runs(0).run_id(), "a");
}

TEST(RunRecordsOfAnEntity, ARunOfAnEarlierLifeThatHadNotEndedIsUnknown) {
    test::MemoryStorage storage;
    RunRecords(storage).keep(run("a", proto::RUN_RUNNING));
    const auto history = RunRecords(storage).history(nullptr, 0);
    ASSERT_EQ(history.runs_size(), 1);
    EXPECT_EQ(history.runs(0).state(), proto::RUN_UNKNOWN);
    EXPECT_EQ(history.runs(0).steps(0).state(), proto::TASK_UNKNOWN);
}

TEST(RunRecordsOfAnEntity, AreBoundedAndALargeRunKeepsNoValues) {
    test::MemoryStorage storage;
    RunRecords records(storage);
    for (int i = 0; i < RunRecords::kRuns + 5; ++i)
        records.keep(run("run " + std::to_string(i), proto::RUN_SUCCEEDED));
    EXPECT_EQ(records.history(nullptr, 0).runs_size(), RunRecords::kRuns);
    auto large = run("large", proto::RUN_SUCCEEDED);
    large.mutable_steps(0)->set_feedback(std::string(RunRecords::kRunBytes, 'x'));
    records.keep(large);
    EXPECT_TRUE(records.history(nullptr, 1).runs(0).steps(0).feedback().empty());
}

}  // namespace
}  // namespace axon::entity_manager
