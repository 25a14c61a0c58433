// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <optional>
#include <string>
#include <utility>

#include "common/refusal.hpp"

namespace axon::client {

/// What may wait on the way to the server before a user's message is refused: messages, and their bytes. The
/// connection's own queue holds more than this (server_connection.cpp), so that what was admitted is neither
/// dropped nor the end of the connection.
inline constexpr std::size_t kWaitingMax = 256;
inline constexpr std::size_t kWaitingBytesMax = 16 * 1024 * 1024;
/// Envelope and header of a message on the wire, generously.
inline constexpr std::size_t kMessageOverhead = 1024;
/// The content of one message: what the lanes take (server_connection.cpp), without room for its header.
inline constexpr std::size_t kMessageBytesMax = (4096 - 64) * 1024;

/// Of more the connection ends. A program may stop its entities one by one, and a stop is sent again until it
/// is confirmed: 2048 of them, eight times, to a server that takes none.
inline constexpr std::size_t kSignalsUnsent = 16 * 1024;

/// Whether a message of `bytes` may join what waits for the server.
inline Refusal admission(std::size_t messages, std::size_t waiting_bytes, std::size_t bytes) {
    if (messages >= kWaitingMax) {
        return {RefusalCode::Overloaded,
                std::to_string(kWaitingMax) + " messages wait for the server to read them. Send more slowly.",
                {}};
    }
    if (waiting_bytes + bytes + kMessageOverhead > kWaitingBytesMax) {
        return {RefusalCode::Overloaded,
                std::to_string(kWaitingBytesMax >> 20U) +
                    " MiB wait for the server to read them. Send more slowly.",
                {}};
    }
    return {};
}

/// Messages between the core, which orders them, and the threads that send them.
///
/// Flow: the core's owner puts messages while it holds the core's lock; afterwards each thread takes up to
/// the last one that it put itself, or leaves it to the sender's thread, which takes all there are. No other
/// thread becomes the sender of the others, however fast they put. Bytes count as waiting from put() until
/// sent(). Threads: any; the lock is held for a look-up. Bound: that of whoever asks waiting() before putting
/// (MessageSender::admit).
template <class Message>
class SendQueue {
  public:
    struct Waiting {
        std::size_t messages = 0, bytes = 0;
    };
    struct Item {
        Message message;
        std::size_t bytes;
    };

    /// Returns the number of the message; the first is 1.
    std::uint64_t put(Message message, std::size_t bytes) {
        const std::lock_guard lock(mutex_);
        queue_.push_back({std::move(message), bytes});
        waiting_.bytes += bytes;
        ++waiting_.messages;
        return ++last_;
    }
    /// The number of the message that was put last.
    std::uint64_t last() const {
        const std::lock_guard lock(mutex_);
        return last_;
    }
    /// The oldest message, if its number is not above `ticket`.
    std::optional<Item> take(std::uint64_t ticket) {
        const std::lock_guard lock(mutex_);
        if (queue_.empty() || last_ - queue_.size() + 1 > ticket) return std::nullopt;
        Item item = std::move(queue_.front());
        queue_.pop_front();
        return item;
    }
    /// A message that was taken is on its way.
    void sent(std::size_t bytes) {
        const std::lock_guard lock(mutex_);
        waiting_.bytes -= bytes;
        --waiting_.messages;
    }
    /// Forgets what has not been taken.
    void clear() {
        const std::lock_guard lock(mutex_);
        for (const auto& item : queue_) waiting_.bytes -= item.bytes;
        waiting_.messages -= queue_.size();
        queue_.clear();
    }
    Waiting waiting() const {
        const std::lock_guard lock(mutex_);
        return waiting_;
    }

  private:
    mutable std::mutex mutex_;
    // guarded by mutex_
    std::deque<Item> queue_;
    std::uint64_t last_ = 0;
    Waiting waiting_;
};

}  // namespace axon::client
