// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <filesystem>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "common/descriptor.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// The journal in a folder, one JSON object in each line: <folder>/tasks.jsonl has the tasks that were
/// dispatched and how they ended, <folder>/journal.jsonl all else; so no number of refusals, check-outs or
/// stops drives a task's id out. Before each the files tasks.1.jsonl (the newest of them) to tasks.<files -
/// 1>.jsonl, and so on.
///
/// Where in the flow: the core appends on its strand; people read the files with any text tool. No call but
/// the constructor and replay() waits for the disk: each of the two files has a thread that writes, so that
/// no stop waits, and no task behind the story. A dispatch is answered when the kernel has it: it outlives a
/// kill of the process, and a loss of power may cost the last seconds (docs/adr/0013-journal.md says why that
/// is harmless). Bounded: a file that would exceed `file_bytes` is put aside, and the oldest of `files` is
/// deleted; kWaiting entries wait for each thread. Threads: one at a time, and those two. Failure: the
/// constructor throws std::system_error where the folder cannot be used; a dispatch is answered with false on
/// a full disk, append() answers false from the next entry on, and no half line is left behind. A last line
/// that was torn is cut off, other lines that cannot be read are passed over; findings() says which.
class FileJournal final : public Journal {
  public:
    struct Bounds {
        std::uint64_t file_bytes = 4U << 20U;
        int files = 4;
    };
    /// `on_thread` is called first on each of its threads.
    FileJournal(std::filesystem::path folder, Bounds bounds, const std::function<void()>& on_thread = {});
    explicit FileJournal(std::filesystem::path folder, const std::function<void()>& on_thread = {})
        : FileJournal(std::move(folder), Bounds{}, on_thread) {}
    ~FileJournal() override = default;
    FileJournal(const FileJournal&) = delete;
    FileJournal& operator=(const FileJournal&) = delete;

    static constexpr std::size_t kWaiting = 1024;

    bool append(const JournalRecord& record) override;
    Later<bool> appendDispatch(const JournalRecord& record) override;
    void onAnswer(std::function<void()> come) override;
    /// Those of tasks last, the entries of each of the two in their order.
    void replay(const std::function<void(const JournalRecord&)>& each) override;

    /// What was wrong with the files, for the operator's log: one sentence for each file, with the line's
    /// number.
    const std::vector<std::string>& findings() const { return findings_; }

  private:
    /// The present file of one name and those before it, and the thread that writes them.
    class Files {
      public:
        Files(std::filesystem::path folder, std::string name, Bounds bounds,
              std::vector<std::string>& findings, std::function<void()> on_thread);
        /// Writes what waits.
        ~Files();
        /// False: too much waits, or the last line could not be written.
        bool append(std::string line);
        Later<bool> appendAnswered(std::string line);
        void onAnswer(std::function<void()> come);
        void replay(const std::function<void(const JournalRecord&)>& each);

      private:
        struct Line {
            std::string text;
            std::optional<Later<bool>> answer;
        };
        bool add(Line line);
        void run();
        std::filesystem::path fileOf(int age) const;
        bool open();
        bool rotate();
        bool write(const std::string& line);
        void cutTornLine();

        const std::filesystem::path folder_;
        const std::string name_;
        const Bounds bounds_;
        std::vector<std::string>& findings_;
        Descriptor fd_;           // the thread's, once it runs
        std::uint64_t size_ = 0;  // likewise; of the present file

        std::atomic<bool> failing_{false};  // the last line could not be written
        std::mutex mutex_;                  // never held while the disk is at work
        std::condition_variable wake_;
        std::deque<Line> waiting_;  // guarded by mutex_
        bool ending_ = false;       // guarded by mutex_
        std::mutex telling_;
        std::function<void()> come_;  // guarded by telling_
        std::thread thread_;          // last: it uses the others
    };

    std::vector<std::string> findings_;
    Files story_, tasks_;
};

}  // namespace axon::entity_manager
