// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <span>
#include <string>
#include <string_view>

#include "common/routed.hpp"
#include "direct/incoming_way.hpp"
#include "direct/lane/frames.hpp"
#include "transport/outbox/outbox_core.hpp"

namespace axon::direct::lane {

/// The sending side of a connection.
class Wire {
  public:
    virtual ~Wire() = default;
    /// Takes what it can of these pieces, in order, and does not wait: how many bytes; 0 = it is full.
    /// Nothing: the connection is over.
    virtual std::optional<std::size_t> write(std::span<const std::string_view> pieces) = 0;
};

/// Messages on their way into a data lane.
///
/// Flow: post() writes the message from the caller's thread, without a copy, when nothing is in the way.
/// Otherwise it waits: OutboxCore says in what order, how much, and what is dropped. flush() is called when
/// the connection takes more again, and writes many messages by one call. As in transport/outbox, at most
/// `window_bytes` are chosen to be written next, and are dropped no more. Threads: any; one mutex, held
/// across Wire::write, which does not wait. Failure: told by what post() and flush() return; the owner then
/// ends the connection.
class LaneOutbox {
  public:
    /// Made for a message that must wait, and destroyed when it does so no more. May be null.
    using Waits = std::function<std::shared_ptr<void>(std::size_t bytes)>;
    enum class Outcome : std::uint8_t {
        Taken,     ///< written, or it waits, or it was dropped because it may be
        Overflow,  ///< too much waits: the connection is to end
        TooLarge,  ///< it cannot be sent here; the same
        Over       ///< the connection is over
    };

    LaneOutbox(transport::OutboxLimits limits, Wire& wire, Waits waits = nullptr)
        : wire_(wire), waits_(std::move(waits)), core_(limits) {}

    Outcome post(Keeping keeping, const Header& head, const std::shared_ptr<const std::string>& message);
    /// Taken or Over.
    Outcome flush();
    /// Something waits until the connection takes more. True before the wire can say that it does, so who
    /// hears that need not take the mutex.
    bool waiting() const { return waiting_.load(); }
    /// Drops everything. Nothing is written afterwards.
    void close();
    transport::OutboxCounts counts() const;

  private:
    struct Parcel {
        HeadBytes head;
        std::shared_ptr<const std::string> message;
        std::shared_ptr<void> waits;
    };
    using Core = transport::OutboxCore<std::unique_ptr<Parcel>>;
    struct Launched {
        std::unique_ptr<Parcel> parcel;
        std::size_t bytes;
        transport::Traffic traffic;
    };
    Outcome flushLocked();
    Outcome over();

    Wire& wire_;
    const Waits waits_;
    mutable std::mutex mutex_;
    // Guarded by mutex_:
    Core core_;
    std::deque<Launched> launched_;  // what the window lets through and the wire has not taken
    std::size_t written_ = 0;        // of the first of them

    std::atomic<bool> waiting_{false};
};

}  // namespace axon::direct::lane
