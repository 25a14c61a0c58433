// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <deque>
#include <utility>

#include "common/planted_bug.hpp"

namespace axon::direct {

/// How much a sender keeps of what the other side has not acknowledged. Beyond it the direct way is given up.
struct KeptBounds {
    std::size_t messages = 16384;
    std::size_t bytes = 8 * 1024 * 1024;  ///< one message may be larger, if it is kept alone
};

/// The sender's half of one direction between a client and an Entity Manager: which way its messages go, and
/// what must go once more when the direct way breaks (ADR 0021).
///
/// Where in the flow: below the cores, above the two connections. Messages that may not be lost have sequence
/// numbers that grow (Header::sequence). While the direct way is open each is kept until the other side has
/// acknowledged it or a later one. When the way is over, what is left is sent again by the relayed way, in
/// order and before anything else; the other side leaves out what it has (IncomingWay). So the relayed way
/// needs to know nothing of the break, and it does no harm to send too much.
///
///     relayed ── begin() ──► direct ── end() ──► relayed
///
/// begin() comes after the mark, the last message on the relayed way. Threads: none of its own, not
/// thread-safe; its owner confines it. Bounds: KeptBounds.
template <class Message>
class OutgoingWay {
  public:
    struct Kept {
        std::int64_t sequence;
        std::size_t bytes;
        Message message;
    };

    explicit OutgoingWay(KeptBounds bounds = {}) : bounds_(bounds) {}

    bool direct() const { return direct_; }
    /// Whether one more message of this size can be kept. Where not, the owner ends the direct way first.
    bool hasRoom(std::size_t bytes) const {
        return kept_.empty() || (kept_.size() < bounds_.messages && bytes_ + bytes <= bounds_.bytes);
    }

    /// From the next message on the direct way is taken. The mark has been sent.
    void begin() { direct_ = true; }
    /// A message that may not be lost goes the direct way now. Its number is above all before it.
    void keep(std::int64_t sequence, std::size_t bytes, Message message) {
        bytes_ += bytes;
        kept_.push_back({sequence, bytes, std::move(message)});
    }
    /// The other side has this message and all before it. What it says late, or wrongly, does no harm: a peer
    /// that acknowledges what it has not got loses its own messages only.
    void acknowledged(std::int64_t sequence) {
        while (!kept_.empty() && kept_.front().sequence <= sequence) {
            bytes_ -= kept_.front().bytes;
            kept_.pop_front();
        }
    }
    /// The direct way is over: what the other side may not have, oldest first, to go by the relayed way
    /// before anything else does. Empty when it was over already.
    std::deque<Kept> end() {
        direct_ = false;
        bytes_ = 0;
        if (AXON_PLANTED(NotSentAgain)) kept_.clear();
        return std::exchange(kept_, {});
    }

    std::size_t keptMessages() const { return kept_.size(); }
    std::size_t keptBytes() const { return bytes_; }

  private:
    KeptBounds bounds_;
    bool direct_ = false;
    std::deque<Kept> kept_;
    std::size_t bytes_ = 0;
};

}  // namespace axon::direct
