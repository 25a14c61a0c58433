// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <utility>

#include "common/ids.hpp"
#include "common/planted_bug.hpp"

namespace axon::direct {

/// Whether a message may be lost on its way.
enum class Keeping : std::uint8_t {
    Kept,      ///< arrives once, in order
    Droppable  ///< bulk data: at most once, in order
};

/// What becomes of a message that has come.
enum class Verdict : std::uint8_t {
    Pass,
    HeldBack,
    LeftOut,  ///< it has come by the other way, or by a path that is over
    Overflow  ///< too much is held back: the path is over, and its owner ends its connections
};

/// How much a receiver holds back of what came by the direct way before its mark. Beyond it the path is given
/// up; what is forgotten then comes by the relayed way.
struct HeldBounds {
    std::size_t messages = 16384;
    std::size_t bytes = 16 * 1024 * 1024;
};

/// The receiver's half of one direction: what of two ways is passed on, so that every message that may not be
/// lost comes once and in the order of sending (ADR 0021).
///
/// Where in the flow: above the two connections, below the core. Two rules. *A mark*: what comes by a path is
/// held back until the sender's last message on the relayed way, the mark with this path's number, has come
/// there; so nothing overtakes what was sent before. *A number*: from the first mark on a message passes when
/// its sequence number is above that of the last that has passed, by whichever way; so what is sent again
/// after a break comes once. It follows that nothing is missing: each way keeps its order, and a sender that
/// leaves the direct way sends everything that was not acknowledged by the relayed one, so that the first
/// number that is new there is the next that is missing.
///
///     relayed ── open(path) ──► held back ── mark(path) ──► both ways, by number
///        ▲                          │  ▲                          │
///        └────────── close() ───────┘  └───────── open() ─────────┘   (after the first mark: by number for
///        ever)
///
/// Threads: none of its own, not thread-safe; its owner confines it. Bounds: HeldBounds.
template <class Message>
class IncomingWay {
  public:
    IncomingWay() = default;
    explicit IncomingWay(HeldBounds bounds) : bounds_(bounds) {}

    /// A path is there, beside or instead of an earlier one, of which nothing counts any more.
    void open(const Id128& path) {
        path_ = path;
        marked_ = false;
        forgetHeld();
    }
    /// Nothing of this path counts any more. What it brought and was held back comes by the relayed way.
    void close(const Id128& path) {
        if (path_ != path) return;
        path_ = Id128{};
        marked_ = false;
        forgetHeld();
    }
    /// By the relayed way.
    Verdict relayed(Keeping keeping, std::int64_t sequence) { return judge(keeping, sequence, ordered_); }
    /// By a path. `message` is moved from when it is held back.
    Verdict direct(const Id128& path, Keeping keeping, std::int64_t sequence, std::size_t bytes,
                   Message& message) {
        if (path.isZero() || path != path_) return Verdict::LeftOut;
        if (marked_ || AXON_PLANTED(MarkNotAwaited)) return judge(keeping, sequence, true);
        if (held_.size() >= bounds_.messages || held_bytes_ + bytes > bounds_.bytes) {
            close(path);
            return Verdict::Overflow;
        }
        held_bytes_ += bytes;
        held_.push_back({keeping, sequence, std::move(message)});
        return Verdict::HeldBack;
    }
    /// By the relayed way: the mark of this path. `pass(message)` is called for each that was held back and
    /// counts.
    template <class Pass>
    void mark(const Id128& path, Pass&& pass) {
        if (path.isZero() || path != path_ || marked_) return;
        marked_ = ordered_ = true;
        held_bytes_ = 0;
        for (auto& held : std::exchange(held_, {}))
            if (judge(held.keeping, held.sequence, true) == Verdict::Pass) pass(std::move(held.message));
    }

    /// What may be acknowledged: this message that may not be lost has passed, and all before it.
    std::int64_t passed() const { return kept_passed_; }
    /// What comes by the path now is held back.
    bool waits() const { return !path_.isZero() && !marked_; }
    /// Something waits for a mark.
    bool holdsBack() const { return !held_.empty(); }

  private:
    struct Held {
        Keeping keeping;
        std::int64_t sequence;
        Message message;
    };
    Verdict judge(Keeping keeping, std::int64_t sequence, bool by_number) {
        // Data never keeps a message out: what servers may drop they might also reorder.
        const auto last = keeping == Keeping::Kept ? kept_passed_ : std::max(kept_passed_, droppable_passed_);
        if (by_number && sequence <= last && !AXON_PLANTED(SentAgainPassesTwice)) return Verdict::LeftOut;
        auto& passed = keeping == Keeping::Kept ? kept_passed_ : droppable_passed_;
        passed = std::max(passed, sequence);
        return Verdict::Pass;
    }
    void forgetHeld() {
        held_.clear();
        held_bytes_ = 0;
    }

    HeldBounds bounds_;
    Id128 path_;            // zero: none
    bool marked_ = false;   // of path_
    bool ordered_ = false;  // there has been a mark
    std::int64_t kept_passed_ = 0;
    std::int64_t droppable_passed_ = 0;
    std::deque<Held> held_;
    std::size_t held_bytes_ = 0;
};

}  // namespace axon::direct
