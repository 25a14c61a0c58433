// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <mutex>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "entity_manager/ports.hpp"

namespace axon::entity_manager {

/// The journal in a folder, one JSON object in each line: <folder>/tasks.jsonl has the tasks that were
/// dispatched and how they ended, <folder>/journal.jsonl all else; so no number of refusals, check-outs or
/// stops drives a task's id out. Before each the files tasks.1.jsonl (the newest of them) to tasks.<files -
/// 1>.jsonl, and so on.
///
/// Where in the flow: the core appends on its strand; people read the files with any text tool. A dispatch is
/// in the kernel's hands when append() returns: it outlives a kill of the process, and a loss of power may
/// cost the last seconds (docs/adr/0013-journal.md says why that is harmless). A thread of its own writes
/// everything else, so that no stop waits for the disk. Bounded: a file that would exceed `file_bytes` is put
/// aside, and the oldest of `files` is deleted; kWaiting entries wait for the thread. Threads: one at a time,
/// and that one. Failure: the constructor throws std::system_error where the folder cannot be used; append()
/// answers false on a full disk, for what the thread writes from the next entry on, and leaves no half line
/// behind. A last line that was torn is cut off, other lines that cannot be read are passed over; findings()
/// says which.
class FileJournal final : public Journal {
  public:
    struct Bounds {
        std::uint64_t file_bytes = 4U << 20U;
        int files = 4;
    };
    FileJournal(std::filesystem::path folder, Bounds bounds);
    explicit FileJournal(std::filesystem::path folder) : FileJournal(std::move(folder), Bounds{}) {}
    /// Writes what waits.
    ~FileJournal() override;
    FileJournal(const FileJournal&) = delete;
    FileJournal& operator=(const FileJournal&) = delete;

    static constexpr std::size_t kWaiting = 1024;

    bool append(const JournalRecord& record) override;
    /// Those of tasks last, the entries of each of the two in their order.
    void replay(const std::function<void(const JournalRecord&)>& each) override;

    /// What was wrong with the files, for the operator's log: one sentence for each file, with the line's
    /// number.
    const std::vector<std::string>& findings() const { return findings_; }

  private:
    /// The present file of one name and those before it.
    class Files {
      public:
        Files(std::filesystem::path folder, std::string name, Bounds bounds,
              std::vector<std::string>& findings);
        ~Files();
        bool append(const std::string& line);
        void replay(const std::function<void(const JournalRecord&)>& each);

      private:
        std::filesystem::path fileOf(int age) const;
        bool open();
        bool rotate();
        void cutTornLine();

        const std::filesystem::path folder_;
        const std::string name_;
        const Bounds bounds_;
        std::vector<std::string>& findings_;
        std::mutex mutex_;        // a dispatch and the end of another task are written by two threads
        int fd_ = -1;             // guarded by mutex_
        std::uint64_t size_ = 0;  // guarded by mutex_; of the present file
    };
    void run();

    std::vector<std::string> findings_;
    Files story_, tasks_;
    std::atomic<bool> failing_{false};  ///< the last line of the thread could not be written
    std::mutex mutex_;
    std::condition_variable wake_;
    std::deque<std::pair<Files*, std::string>> waiting_;  // guarded by mutex_
    bool ending_ = false;                                 // guarded by mutex_
    std::thread thread_;                                  // last: it uses the others
};

}  // namespace axon::entity_manager
