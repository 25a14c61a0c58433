// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>

#include "common/queue_share.hpp"

namespace axon::entity_manager {

/// What waits to be handled by one Entity Manager's strand. Signals overtake everything else; data is dropped
/// oldest-first when it piles up; control overflow is reported, so that the owner can drop the peer.
///
/// A stop is never lost: when all signal slots are taken it takes the place of a signal that may be dropped,
/// and among nothing but stops that of the second newest, whose effect the newest has too. A client's loss or
/// return is not lost either. What else finds the slots full is dropped; so is what may be dropped of a
/// sender who has a quarter of the slots already, so that nobody's drills and resets leave none for those of
/// others.
///
/// Threads: push…() from any; take() from the strand alone. Signals have a mutex and preallocated slots of
/// their own, so that no amount of data holds up a stop (invariant 3).
class Inbox {
  public:
    using Event = std::function<void()>;

    struct Bounds {
        std::size_t control_events = 4096;
        std::size_t control_bytes = 16U << 20U;
        std::size_t data_events = 1024;
        std::size_t data_bytes = 8U << 20U;
    };
    enum class Verdict { Scheduled, AlreadyScheduled, Overflow, Dropped };
    enum class Signal : std::uint8_t {
        Stop,
        Client,   ///< a client was lost, came back, or has left
        Passing,  ///< may be dropped: reset, clear, a drill, a repeated stop; at most kPassingOfOne of one
                  ///< sender wait, kPassing of all
        Peer,     ///< of another entity, whose next one repeats it; at most kPeerSignals wait
    };
    static constexpr std::size_t kSignals = 64;
    static constexpr std::size_t kPassingOfOne = kSignals / 4;  ///< that may be dropped, of one sender
    static constexpr std::size_t kPassing = 48;                 ///< … and of all
    static constexpr std::size_t kPeerSignals = 48;  ///< a master of many slaves hears them all at once

    explicit Inbox(Bounds bounds) : bounds_(bounds) {}
    Inbox() : Inbox(Bounds{}) {}

    /// Dropped: a passing one or a peer's found no slot. Overflow: one that may not be lost found nothing
    /// that may.
    Verdict pushSignal(Signal kind, Event event, SenderKey from = kServersOwn);
    /// Whether a passing signal of this sender would be dropped now. False stays false until a signal is
    /// pushed.
    bool wouldDrop(SenderKey from) const;
    /// Half of the bounds is for those who can wait (hasRoom); the rest is left to those who cannot. One
    /// event alone always fits.
    enum class Share : std::uint8_t { Whole, Half };
    /// On Overflow the event is still the caller's.
    Verdict pushControl(Event&& event, std::size_t bytes = 0, Share share = Share::Whole);
    /// Whether a quarter of the bounds is taken at most and so many bytes fit into the half: who waits for
    /// room goes on then, and not with each event.
    bool hasRoom(std::size_t bytes) const;
    /// May drop older data to make room. `bytes` counts towards the bound.
    Verdict pushData(Event event, std::size_t bytes);

    /// The next event, signals first, then control and data in the order of their arrival; empty = nothing
    /// left, and the next push answers Scheduled.
    Event take();
    /// The strand will come. On the strand: where not, nothing waits. Takes no lock.
    bool scheduled() const { return scheduled_; }
    /// The strand is to come although there is no event, as tests want it. Takes no lock.
    Verdict wake() { return scheduled_.exchange(true) ? Verdict::AlreadyScheduled : Verdict::Scheduled; }

    std::uint64_t droppedData() const;

  private:
    struct Waiting {
        Event event;
        std::size_t bytes = 0;
        bool data = false;
    };
    struct WaitingSignal {
        Signal kind = Signal::Passing;
        Event event;
        SenderKey from = kServersOwn;
    };
    WaitingSignal& signalAt(std::size_t i) { return signals_[(signal_first_ + i) % signals_.size()]; }
    const WaitingSignal& signalAt(std::size_t i) const {
        return signals_[(signal_first_ + i) % signals_.size()];
    }
    bool noRoomForPassing(SenderKey from) const;
    std::size_t victimFor(Signal kind);
    Event next();

    const Bounds bounds_;

    mutable std::mutex signal_mutex_;
    std::array<WaitingSignal, kSignals> signals_;  // guarded by signal_mutex_: a ring
    std::size_t signal_first_ = 0;                 // guarded by signal_mutex_
    std::size_t signal_count_ = 0;                 // guarded by signal_mutex_
    std::size_t peers_ = 0;                        // guarded by signal_mutex_: of the waiting signals
    std::atomic<bool> scheduled_{
        false};  // whether the strand will come; no lock, so that data takes none of signals
    // How many there are of each, written under their locks: the strand takes no lock where there is nothing.
    std::atomic<std::size_t> signals_left_{0}, events_left_{0};

    bool fits(std::size_t bytes, Share share) const {
        const std::size_t part = share == Share::Half ? 2 : 1;
        return control_events_ == 0 || (control_events_ < bounds_.control_events / part &&
                                        control_bytes_ + bytes <= bounds_.control_bytes / part);
    }

    mutable std::mutex mutex_;
    std::deque<Waiting> waiting_;     // guarded by mutex_
    std::size_t control_events_ = 0;  // guarded by mutex_
    std::size_t control_bytes_ = 0;   // guarded by mutex_
    std::size_t data_events_ = 0;     // guarded by mutex_
    std::size_t data_bytes_ = 0;      // guarded by mutex_
    std::uint64_t dropped_ = 0;       // guarded by mutex_
};

}  // namespace axon::entity_manager
