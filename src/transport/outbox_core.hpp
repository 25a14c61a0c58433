// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <deque>
#include <list>
#include <optional>
#include <utility>

namespace axon::transport {

/// What may happen to a message when its consumer does not read.
enum class Traffic : std::uint8_t {
    Signal,     ///< never queued: sent at once, or the consumer is disconnected
    /// Left out while the one before is unsent; the next one repeats the level. Other messages do not hold it back: with the
    /// same period as theirs it would be left out each time, and the server be taken for silent.
    Heartbeat,
    Control,    ///< queued in order; overflow disconnects the consumer
    Data        ///< queued in order; overflow drops the oldest data
};

struct OutboxLimits {
    std::size_t window_bytes = 256 * 1024;  ///< given to Ice and not yet written to the socket
    /// Waiting behind the window; one message of the largest size fits. A larger one waits alone.
    std::size_t data_bytes = (4096 + 64) * 1024;
    std::size_t data_messages = 4096;
    std::size_t control_bytes = 8 * 1024 * 1024;
    std::size_t control_messages = 16384;
    std::size_t signals_unsent = 4096;  ///< a stop for each of 2048 entities, twice
};

struct OutboxCounts {
    std::uint64_t sent = 0;
    std::uint64_t dropped = 0;  ///< data, and heartbeats left out
    std::size_t unsent_bytes = 0;
    std::size_t waiting = 0;  ///< messages in the queue
};

/// Decides what happens to each message for one consumer: now, later, or never. I/O-free and not thread-safe;
/// the rim (outbox.hpp) locks around each call and never while it sends.
///
/// Ice queues without a bound whatever a socket does not take. So at most `window_bytes` are given to it; the
/// rest waits here, in the order of arrival and within bounds. While anything waits, or is being taken out of
/// the queue, nothing but signals and a heartbeat is sent past it.
///
///     idle ── offer ──► Send …… sent() ──► idle
///     window full ── offer ──► Queued …… sent() → startPump() → next()* → none
///     closed ◄── close(), Overflow
///
/// `Parcel` is an owning copy of a message, made only when it must wait.
template <class Parcel>
class OutboxCore {
  public:
    enum class Verdict : std::uint8_t {
        Send,  ///< the caller sends now and reports sent(bytes)
        Queued,
        Dropped,   ///< this message was left out
        Overflow,  ///< the consumer must be disconnected; the outbox is closed now
        Closed
    };
    struct Item {
        Parcel parcel;
        std::size_t bytes;
        Traffic traffic;
    };

    explicit OutboxCore(OutboxLimits limits) : limits_(limits) {}

    /// `make` returns the Parcel; called only for Queued.
    template <class Make>
    Verdict offer(Traffic traffic, std::size_t bytes, Make&& make) {
        if (closed_) return Verdict::Closed;
        switch (traffic) {
            case Traffic::Signal:
                if (unsent_signals_ >= limits_.signals_unsent) {
                    close();
                    return Verdict::Overflow;
                }
                ++unsent_signals_;
                return launch(bytes);
            case Traffic::Heartbeat:
                if (heartbeat_unsent_) {
                    ++counts_.dropped;
                    return Verdict::Dropped;
                }
                heartbeat_unsent_ = true;
                return launch(bytes);
            case Traffic::Control:
                if (mayPass()) return launch(bytes);
                if (control_messages_ >= limits_.control_messages ||
                    control_bytes_ + bytes > limits_.control_bytes) {
                    close();
                    return Verdict::Overflow;
                }
                ++control_messages_;
                control_bytes_ += bytes;
                queue_.push_back({make(), bytes, traffic});
                return Verdict::Queued;
            case Traffic::Data:
                break;
        }
        if (mayPass()) return launch(bytes);
        while (!data_.empty() &&
               (data_bytes_ + bytes > limits_.data_bytes || data_.size() >= limits_.data_messages)) {
            data_bytes_ -= data_.front()->bytes;
            queue_.erase(data_.front());
            data_.pop_front();
            ++counts_.dropped;
        }
        queue_.push_back({make(), bytes, traffic});
        data_.push_back(std::prev(queue_.end()));
        data_bytes_ += bytes;
        return Verdict::Queued;
    }

    /// A message left for the kernel.
    void sent(Traffic traffic, std::size_t bytes) {
        unsent_bytes_ -= bytes;
        if (traffic == Traffic::Signal) --unsent_signals_;
        if (traffic == Traffic::Heartbeat) heartbeat_unsent_ = false;
        ++counts_.sent;
    }

    /// Whether the caller is the one who must empty the queue now, by next() until there is none.
    bool startPump() {
        if (closed_ || pumping_ || queue_.empty() || unsent_bytes_ >= limits_.window_bytes) return false;
        pumping_ = true;
        return true;
    }

    /// The next message to send, counted as unsent; none ends the pump.
    std::optional<Item> next() {
        if (closed_ || queue_.empty() || unsent_bytes_ >= limits_.window_bytes) {
            pumping_ = false;
            return std::nullopt;
        }
        auto first = queue_.begin();
        if (first->traffic == Traffic::Data) {
            data_.pop_front();
            data_bytes_ -= first->bytes;
        } else {
            --control_messages_;
            control_bytes_ -= first->bytes;
        }
        Item item = std::move(*first);
        queue_.erase(first);
        launch(item.bytes);
        return item;
    }

    /// Nothing is sent any more; what waits is forgotten.
    void close() {
        closed_ = true;
        queue_.clear();
        data_.clear();
        data_bytes_ = control_bytes_ = control_messages_ = 0;
    }

    bool closed() const { return closed_; }
    OutboxCounts counts() const {
        auto counts = counts_;
        counts.unsent_bytes = unsent_bytes_;
        counts.waiting = queue_.size();
        return counts;
    }

    /// Whether control and data need not wait.
    bool mayPass() const { return !pumping_ && queue_.empty() && unsent_bytes_ < limits_.window_bytes; }

  private:
    Verdict launch(std::size_t bytes) {
        unsent_bytes_ += bytes;
        return Verdict::Send;
    }

    OutboxLimits limits_;
    std::list<Item> queue_;
    std::deque<typename std::list<Item>::iterator> data_;  // the data in queue_, oldest first
    std::size_t data_bytes_ = 0;
    std::size_t control_bytes_ = 0;
    std::size_t control_messages_ = 0;
    std::size_t unsent_bytes_ = 0;
    std::size_t unsent_signals_ = 0;
    bool heartbeat_unsent_ = false;
    bool pumping_ = false;
    bool closed_ = false;
    OutboxCounts counts_;
};

}  // namespace axon::transport
