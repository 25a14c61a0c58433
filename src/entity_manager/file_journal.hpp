// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "entity_manager/ports.hpp"

namespace axon::entity_manager {

/// The journal in a folder: <folder>/journal.jsonl, one JSON object in each line, and the files before it,
/// journal.1.jsonl (the newest of them) to journal.<files - 1>.jsonl.
///
/// Where in the flow: the core appends on its strand; people read the files with any text tool. An entry is
/// in the kernel's hands when append() returns: it outlives a kill of the process, and a loss of power may
/// cost the last seconds (docs/adr/0013-journal.md says why that is harmless). Bounded: a file that would
/// exceed `file_bytes` is put aside, and the oldest of `files` is deleted. Threads: one at a time. Failure:
/// the constructor throws std::system_error where the folder cannot be used; append() answers false on a full
/// disk and leaves no half line behind. A last line that was torn is cut off, other lines that cannot be read
/// are passed over; findings() says which.
class FileJournal final : public Journal {
  public:
    struct Bounds {
        std::uint64_t file_bytes = 4U << 20U;
        int files = 4;
    };
    FileJournal(std::filesystem::path folder, Bounds bounds);
    explicit FileJournal(std::filesystem::path folder) : FileJournal(std::move(folder), Bounds{}) {}
    ~FileJournal() override;
    FileJournal(const FileJournal&) = delete;
    FileJournal& operator=(const FileJournal&) = delete;

    bool append(const JournalRecord& record) override;
    void replay(const std::function<void(const JournalRecord&)>& each) override;

    /// What was wrong with the files, for the operator's log: one sentence for each file, with the line's
    /// number.
    const std::vector<std::string>& findings() const { return findings_; }

  private:
    std::filesystem::path fileOf(int age) const;
    bool open();
    bool rotate();
    void cutTornLine();

    const std::filesystem::path folder_;
    const Bounds bounds_;
    int fd_ = -1;
    std::uint64_t size_ = 0;  ///< of the present file
    std::vector<std::string> findings_;
};

}  // namespace axon::entity_manager
