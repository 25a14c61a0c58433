// SPDX-License-Identifier: GPL-2.0-or-later
#include <google/protobuf/text_format.h>

#include <filesystem>
#include <fstream>
#include <iostream>

#include "compatibility/samples.hpp"
#include "entity_manager/core/collaboration/run_records.hpp"
#include "entity_manager/core/inputs/saved_values.hpp"
#include "entity_manager/core/kept_identity.hpp"
#include "entity_manager/core/stops/stop_ledger.hpp"
#include "entity_manager/core/turn/lease_book.hpp"
#include "entity_manager/identity.hpp"
#include "entity_manager/storage/file_journal.hpp"
#include "entity_manager/storage/file_storage.hpp"

// Writes down what this release writes, once for each release (README.md beside this file).
namespace axon::compatibility {
namespace {

namespace fs = std::filesystem;
namespace em = entity_manager;

void recordMessages(const fs::path& file) {
    std::ofstream out(file);
    google::protobuf::TextFormat::Printer printer;
    printer.SetSingleLineMode(true);
    for (const auto* type : enumerations()) {
        out << "enum " << type->full_name();
        for (int i = 0; i < type->value_count(); ++i)
            out << ' ' << type->value(i)->name() << '=' << type->value(i)->number();
        out << '\n';
    }
    for (const auto* type : messageTypes()) {
        for (const auto& sample : samplesOf(type)) {
            std::string text;
            printer.PrintToString(*sample, &text);
            out << "message " << type->full_name() << "\n bytes " << hexOf(sample->SerializeAsString())
                << "\n text " << text << '\n';
        }
    }
}

void recordFrames(const fs::path& file) {
    std::ofstream out(file);
    for (const auto& [name, bytes] : encodedNow()) out << name << ' ' << hexOf(bytes) << '\n';
}

/// A folder that an Entity Manager of this release has left, after it was rearmed and released.
void recordState(const fs::path& folder) {
    SeededRandom random(1);
    {
        em::FileStorage storage(folder);
        em::loadUuid(storage, random, em::identityIn(storage, random).uuid);
        const em::LeaseBook leases(storage, random);  // NOLINT: the constructor saves the epoch
        storage.save(em::kGenerationKey, "1005");
        em::SavedValues values(storage);
        proto::CtrlParam meta;
        meta.set_name("Range Threshold");
        meta.set_units("mm");
        meta.set_savable(true);
        meta.set_type(proto::CONFIG);
        proto::Param param;
        param.add_values()->set_int_(500);
        values.set("Driving", meta, param);
        em::RunRecords runs(storage);
        proto::RunRecord run;
        run.set_run_id("0123456789abcdef");
        run.set_by("client1@lab");
        run.set_state(proto::RUN_SUCCEEDED);
        runs.keep(run);
    }
    {
        em::FileJournal journal(folder);
        for (const auto& record : sampleJournal()) journal.append(record);
    }
    fs::remove(folder / "lock");
}

}  // namespace
}  // namespace axon::compatibility

int main(int argc, char** argv) {
    if (argc != 2) {
        std::cerr << "usage: record_wire_format FOLDER, such as tests/compatibility/0.2\n";
        return 2;
    }
    const std::filesystem::path folder = argv[1];
    if (std::filesystem::exists(folder)) {
        std::cerr << folder.string()
                  << " exists already; a record is never written again; fix: name a new folder\n";
        return 2;
    }
    std::filesystem::create_directories(folder / "state");
    axon::compatibility::recordMessages(folder / "messages.txt");
    axon::compatibility::recordFrames(folder / "frames.txt");
    axon::compatibility::recordState(folder / "state");
    return 0;
}
