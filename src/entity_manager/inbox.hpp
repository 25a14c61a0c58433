// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>

namespace axon::entity_manager {

/// What waits to be handled by one Entity Manager's strand. Signals overtake everything else; data is dropped
/// oldest-first when it piles up; control overflow is reported, so that the owner can drop the peer.
///
/// Threads: push…() from any; take() from the strand alone. Signals have a mutex and preallocated slots of their own,
/// so that no amount of data holds up a stop (invariant 3).
class Inbox {
  public:
    using Event = std::function<void()>;

    struct Bounds {
        std::size_t control_events = 4096;
        std::size_t data_events = 1024;
        std::size_t data_bytes = 8U << 20U;
    };
    enum class Verdict { Scheduled, AlreadyScheduled, Overflow };

    explicit Inbox(Bounds bounds) : bounds_(bounds) {}
    Inbox() : Inbox(Bounds{}) {}

    /// Always fits: when all slots are taken the strand has 64 signals to handle and one more changes nothing but
    /// its receipt, so the newest takes the place of the second newest.
    Verdict pushSignal(Event event);
    Verdict pushControl(Event event);
    /// May drop older data to make room. `bytes` counts towards the bound.
    Verdict pushData(Event event, std::size_t bytes);

    /// The next event, signals first, then control and data in the order of their arrival; empty = nothing left,
    /// and the next push answers Scheduled.
    Event take();

    std::uint64_t droppedData() const;

  private:
    struct Waiting {
        Event event;
        std::size_t data_bytes = 0;  // 0 = control
        bool data = false;
    };
    Verdict wake() { return scheduled_.exchange(true) ? Verdict::AlreadyScheduled : Verdict::Scheduled; }
    Event next();

    const Bounds bounds_;

    mutable std::mutex signal_mutex_;
    std::array<Event, 64> signals_;   // guarded by signal_mutex_: a ring
    std::size_t signal_first_ = 0;    // guarded by signal_mutex_
    std::size_t signal_count_ = 0;    // guarded by signal_mutex_
    std::atomic<bool> scheduled_{false};  // whether the strand will come; no lock, so that data takes none of signals

    mutable std::mutex mutex_;
    std::deque<Waiting> waiting_;     // guarded by mutex_
    std::size_t control_events_ = 0;  // guarded by mutex_
    std::size_t data_events_ = 0;     // guarded by mutex_
    std::size_t data_bytes_ = 0;      // guarded by mutex_
    std::uint64_t dropped_ = 0;       // guarded by mutex_
};

}  // namespace axon::entity_manager
