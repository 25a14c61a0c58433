// SPDX-License-Identifier: GPL-2.0-or-later
// A journal file with anything in it: what can be read is told, and what is written next is read back as it
// was.
#include <unistd.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>

#include "claim.hpp"
#include "common/ids.hpp"
#include "entity_manager/storage/file_journal.hpp"

namespace {

using namespace axon;
using namespace axon::entity_manager;

/// Gone with the process.
struct Folder {
    Folder() {
        auto name = (std::filesystem::temp_directory_path() / "axon-journal-fuzz-XXXXXX").string();
        require(::mkdtemp(name.data()) != nullptr, "there is a folder to write into");
        path = name;
    }
    ~Folder() { std::filesystem::remove_all(path); }
    std::filesystem::path path;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    static const Folder folder;
    std::ofstream(folder.path / "tasks.jsonl", std::ios::binary | std::ios::trunc)
        .write(reinterpret_cast<const char*>(bytes), static_cast<std::streamsize>(size));
    SeededRandom random(7);
    const JournalRecord next{.kind = JournalRecord::Kind::Dispatched,
                             .lease = {3, 4},
                             .generation = 7,
                             .at_us = 12,
                             .who = "client1@lab",
                             .task = Id128::random(random),
                             .service = "Driving"};
    std::size_t before = 0;
    {
        FileJournal journal(folder.path);
        journal.replay([&](const JournalRecord&) { ++before; });
        static_cast<void>(journal.appendDispatch(next));
    }  // writes what waits
    FileJournal journal(folder.path);
    std::size_t after = 0;
    std::optional<JournalRecord> last;
    journal.replay([&](const JournalRecord& record) {
        ++after;
        last = record;
    });
    require(after == before + 1, "nothing that could be read is lost by writing on");
    require(last == next, "what is written behind damage is read back");
    return 0;
}
