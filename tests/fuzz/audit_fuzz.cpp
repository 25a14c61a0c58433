// SPDX-License-Identifier: GPL-2.0-or-later
// An audit trail with anything in it: the reader says something of every line, and a trail that is whole
// stays whole when a program goes on with it.
#include <unistd.h>

#include <cstdint>
#include <filesystem>
#include <fstream>
#include <optional>
#include <string>

#include "audit/files.hpp"
#include "audit/reader.hpp"
#include "claim.hpp"

namespace {

using namespace axon::audit;

/// Gone with the process.
struct Folder {
    Folder() {
        auto name = (std::filesystem::temp_directory_path() / "axon-audit-fuzz-XXXXXX").string();
        require(::mkdtemp(name.data()) != nullptr, "there is a folder to write into");
        path = name;
    }
    ~Folder() { std::filesystem::remove_all(path); }
    std::filesystem::path path;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    static const Folder folder;
    const auto file = folder.path / "a.1.jsonl";
    std::ofstream(file, std::ios::binary | std::ios::trunc)
        .write(reinterpret_cast<const char*>(bytes), static_cast<std::streamsize>(size));
    std::uint64_t read = 0;
    const auto before =
        readTrails(folder.path, {}, [&read](const std::string&, const Record& record) {
            ++read;
            require(readLine(lineOf(record)).has_value(), "what is read can be written and read again");
        }).at(0);
    require(read == before.records, "every record is told");
    require(before.faults.size() <= before.faulty && before.faults.size() <= Chain::kFaults,
            "faults are bounded");
    {
        Files files(folder.path, "a", {});
        Record record;
        record.at = utcTime(0);
        record.kind = "started";
        require(files.append(record), "what is damaged can be gone on with");
    }
    std::optional<Record> last;
    const auto after =
        readTrails(folder.path, before.hash, [&last](const std::string&, const Record& record) {
            last = record;
        }).at(0);
    require(last && last->kind == "started", "what is written behind damage is read back");
    require(after.whole() == before.whole(), "going on neither repairs nor damages a trail");
    require(before.hash.empty() || after.kept_found, "the last complete line is found by its hash");
    return 0;
}
