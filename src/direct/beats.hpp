// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>

#include "common/backoff.hpp"
#include "common/clock.hpp"
#include "common/liveness.hpp"

// Times of a direct path. The client beats on its signal connection, each 50 ms while it is busy and each 2 s
// otherwise, and the Entity Manager answers each beat: so both know of either direction, and there is one
// pace, which the client names. A path is busy while its entity moves, and for a second after each message
// that the client sends.
namespace axon::direct {

/// Silence of so long ends a path: while it is busy, and otherwise. Those of the hop to the server
/// (docs/explanation/safety.md, "Watchdogs").
inline constexpr Duration kWatchdogBusy = std::chrono::milliseconds{250};
inline constexpr Duration kWatchdogIdle = std::chrono::seconds{10};
inline constexpr Duration kBeatBusy = std::chrono::milliseconds{50};
inline constexpr Duration kBeatIdle = std::chrono::seconds{2};
/// So long after a message of the client's a path is busy, so that a break is seen at once and not with the
/// next idle beat.
inline constexpr Duration kLively = std::chrono::seconds{1};
/// While something that it sent is not acknowledged, the Entity Manager asks the client for a sign of life in
/// this interval, which must come within it. Two watchdogs: the client may have no processor for one.
inline constexpr Duration kAsks = 2 * kWatchdogBusy;
/// What is held back waits so long for its mark. The relayed way is slow then, or has lost it.
inline constexpr Duration kMarkWithin = kWatchdogBusy;
/// After this many bytes or messages their receiver acknowledges at once instead of with the next beat. Rare,
/// because an acknowledgement wakes a thread on both sides; and not too rare, because a client keeps 24 MiB
/// and 12288 messages for all its paths together, of which it has up to 64.
inline constexpr std::size_t kAcknowledgeAfter = 256 * 1024;
inline constexpr std::size_t kAcknowledgeAfterMessages = 128;

/// The other end of a path. Becoming busy always counts as a sign of life, because a path is busy for at
/// least kLively, in which a silent end is noticed.
inline Liveness livenessOfEnd(TimePoint now) {
    return Liveness(kWatchdogBusy, kWatchdogIdle, now, Liveness::ShortPause::Sign);
}

/// When a path is tried again: after 1 s, each time twice as long, up to 30 s; from the beginning after one
/// that stood for 30 s. Not thread-safe.
class Retry {
  public:
    static constexpr Duration kFirst = std::chrono::seconds{1};
    static constexpr Duration kLast = std::chrono::seconds{30};

    /// `stood`: how long the path was there; zero for an attempt that failed.
    Duration after(Duration stood) {
        if (stood >= kLast) backoff_.reset();
        return backoff_.next();
    }

  private:
    Backoff backoff_{kFirst, kLast};
};

/// Counts what has come since it was last acknowledged. Not thread-safe.
class Unacknowledged {
  public:
    /// Whether it is time to acknowledge.
    bool add(std::size_t bytes) {
        bytes_ += bytes;
        ++messages_;
        if (bytes_ < kAcknowledgeAfter && messages_ < kAcknowledgeAfterMessages) return false;
        bytes_ = 0;
        messages_ = 0;
        return true;
    }

  private:
    std::size_t bytes_ = 0;
    std::size_t messages_ = 0;
};

}  // namespace axon::direct
