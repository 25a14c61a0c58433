// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <signal.h>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <string>
#include <thread>
#include <utility>

#include "audit/files.hpp"
#include "audit/note.hpp"
#include "audit/ring.hpp"
#include "audit/shares.hpp"
#include "audit/slots.hpp"
#include "common/clock.hpp"
#include "host/wake_up.hpp"

namespace axon::audit {

/// What the configuration says of the audit (docs/reference/audit.md).
struct TrailSettings {
    std::filesystem::path folder;  ///< empty: nothing is recorded
    Files::Bounds files;
    std::size_t waiting = 4096;                  ///< notes that wait for the disk
    ShareBounds shares;                          ///< of commands and refusals; more in a second are counted
    std::chrono::milliseconds retry_first{100};  ///< after a write that failed, and twice as long each time
    std::chrono::milliseconds retry_most{5000};
};

/// The trail of one program: notes from any thread, in files that a thread of its own writes.
///
/// A caller copies its note into a queue, and never waits for the disk. While the disk is full or broken the
/// queue fills; what does not fit is counted, and the count becomes a record when the disk takes records
/// again, at most once a second and at the end. The same holds for commands and refusals above `shares`, so
/// that nobody drives the records of others out of the trail by asking for much. Stops, rearms, log-ins,
/// sessions and ownership are not limited.
///
/// What waits is in memory that outlives a kill of the process (Slots), and the next life writes it. So
/// kill -9 costs no note() that has returned; a restart of the machine costs what was not on the disk.
///
/// Life: the constructor notes that the program has started; the destructor writes what waits, if the disk
/// takes it at once, and else leaves it to the next life. Threads: any; one of its own, "axon-audit", with
/// SCHED_BATCH. A limit on the size of files is a disk that is full, also in a program that SIGXFSZ would
/// end. Failure: the constructor throws std::runtime_error for a folder that cannot be used; later failures
/// are told to `report`, once each time, and once when it is over.
class Trail final : public AuditTrail {
  public:
    /// On the trail's thread, and on that of the constructor.
    using Report = std::function<void(const std::string& line)>;

    /// `name`: of the program; `started`: what the first record says, such as its release; `clock`: null for
    /// the steady one.
    Trail(const TrailSettings& settings, const std::string& name, const std::string& started, Report report,
          Files::Write write = {}, const Clock* clock = nullptr, Files::Sync sync = {});
    ~Trail() override;
    Trail(const Trail&) = delete;
    Trail& operator=(const Trail&) = delete;

    void note(const Note& note) override;
    /// Records that could not be kept since the last one of kind Lost.
    std::uint64_t lost() const { return lost_.load(std::memory_order_relaxed); }

  private:
    /// On the thread that makes it, as long as it lives, SIGXFSZ has no effect.
    class NoSizeSignal {
      public:
        NoSizeSignal();
        ~NoSizeSignal();
        NoSizeSignal(const NoSizeSignal&) = delete;
        NoSizeSignal& operator=(const NoSizeSignal&) = delete;

      private:
        sigset_t before_{};
    };

    void run();
    bool writeWaiting();
    bool writeLosses();
    bool write(const Record& record);
    bool failed();
    void waitFor(int milliseconds);

    const TrailSettings settings_;
    const Report report_;
    const SteadyClock steady_{};
    const Clock& clock_;
    Shares shares_;
    std::atomic<std::uint64_t> lost_{0}, left_out_{0};
    /// How often its thread looks into the queue. A note does not wake it: that can cost more than a stop.
    static constexpr std::chrono::milliseconds kLook{10};
    static constexpr std::chrono::seconds kTellLosses{1}, kSync{1};

    std::atomic<bool> ending_{false};
    WakeUp wake_up_;                                       // for the end only
    std::optional<NoSizeSignal> starting_{std::in_place};  // during the constructor, for what makes files
    // Of its thread only, after the constructor; but the ring:
    Files files_;
    Slots slots_;
    Ring ring_;
    TimePoint losses_again_{}, sync_again_{};  // when they may be told, and the file synced, again
    bool failing_ = false;
    std::chrono::milliseconds pause_;
    std::thread thread_;  // last: it uses the others
};

}  // namespace axon::audit
