// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/collaboration/run_records.hpp"

#include "messages/values.hpp"

namespace axon::entity_manager {

namespace {

constexpr const char* kRunsKey = "runs";

/// A run as it is told later; of a large one the values are left out.
proto::RunRecord trimmed(proto::RunRecord record) {
    if (record.ByteSizeLong() <= RunRecords::kRunBytes) return record;
    for (auto& step : *record.mutable_steps()) {
        step.clear_params();
        step.clear_results();
        step.clear_feedback();
    }
    return record;
}

}  // namespace

RunRecords::RunRecords(Storage& storage) : storage_(storage) {
    const auto kept = storage_.load(kRunsKey);
    if (!kept || !runs_.ParseFromString(*kept)) {
        runs_.Clear();
        return;
    }
    for (auto& run : *runs_.mutable_runs()) {
        if (run.state() >= proto::RUN_SUCCEEDED) continue;
        run.set_state(proto::RUN_UNKNOWN);
        *run.mutable_reason() = toProto(Refusal{
            RefusalCode::OutcomeUnknown,
            "The Entity Manager of the master ended while it ran. The others have stopped by themselves.",
            {}});
        for (auto& step : *run.mutable_steps())
            if (step.state() != proto::TASK_UNSPECIFIED && step.state() < proto::TASK_SUCCEEDED)
                step.set_state(proto::TASK_UNKNOWN);
    }
}

void RunRecords::keep(const proto::RunRecord& record) {
    proto::RunHistory next;
    auto& newest = *next.add_runs();
    newest = trimmed(record);
    auto bytes = newest.ByteSizeLong();
    for (auto& run : *runs_.mutable_runs()) {
        if (run.run_id() == record.run_id()) continue;
        bytes += run.ByteSizeLong();
        if (next.runs_size() == kRuns || bytes > kBytes) break;
        next.add_runs()->Swap(&run);
    }
    runs_.Swap(&next);
    storage_.keep(kRunsKey, runs_.SerializeAsString());
}

proto::RunHistory RunRecords::history(const proto::RunRecord* present, std::uint32_t most) const {
    auto history = runs_;
    if (present != nullptr && history.runs_size() > 0 && history.runs(0).run_id() == present->run_id())
        *history.mutable_runs(0) = trimmed(*present);
    if (most > 0)
        while (static_cast<std::uint32_t>(history.runs_size()) > most) history.mutable_runs()->RemoveLast();
    return history;
}

}  // namespace axon::entity_manager
