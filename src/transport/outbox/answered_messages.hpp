// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <vector>

#include "transport/outbox/outbox_core.hpp"

namespace axon::transport {

/// Which control messages and data are to be answered, where only an answer says that a message has reached
/// its consumer (Until::Answered), and which have reached it. A consumer takes its messages in their order,
/// so an answer holds for all before it. While one is awaited, the next message need not be answered, up to
/// `ask_bytes` or 64 messages; so one after another is answered each, and of a burst few are.
///
/// What follows the last one that was to be answered stays unanswered until another message is sent: less
/// than `ask_bytes`. That one of these did not reach its consumer is not told; that a consumer has gone is,
/// by heartbeats and by the router. Threads that send at the same time may do so in another order than that
/// of onSend(), so that an answer may come before a message that it holds for: one for each thread. I/O-free
/// and not thread-safe, as OutboxCore.
class AnsweredMessages {
  public:
    struct Message {
        Traffic traffic;
        std::size_t bytes;
        SenderKey from;
    };

    explicit AnsweredMessages(std::size_t ask_bytes) : ask_bytes_(ask_bytes) {}

    /// A message is sent now. Its number if it is to be answered, 0 otherwise.
    std::uint64_t onSend(const Message& message) {
        unanswered_.push_back(message);
        ++last_;
        bytes_ += message.bytes;
        if (asked_ > answered_ && bytes_ < ask_bytes_ && last_ - asked_ < kAskMessages) return 0;
        bytes_ = 0;
        return asked_ = last_;
    }
    /// From now on each is to be answered: before an orderly end, so that it can wait for the last answer.
    void askAlways() { ask_bytes_ = 0; }
    /// What has reached its consumer, oldest first, with the answer to `number`; nothing if a later one was
    /// answered before.
    std::vector<Message> onAnswer(std::uint64_t number) {
        const auto count = static_cast<std::ptrdiff_t>(number - std::min(number, answered_));
        const auto end = unanswered_.begin() + count;
        std::vector<Message> reached(unanswered_.begin(), end);
        unanswered_.erase(unanswered_.begin(), end);
        answered_ = std::max(answered_, number);
        return reached;
    }

  private:
    static constexpr std::uint64_t kAskMessages = 64;

    std::size_t ask_bytes_;
    std::deque<Message> unanswered_;  // the messages answered_ + 1 to last_
    std::uint64_t last_ = 0, asked_ = 0, answered_ = 0;
    std::size_t bytes_ = 0;  // since the one that was to be answered
};

}  // namespace axon::transport
