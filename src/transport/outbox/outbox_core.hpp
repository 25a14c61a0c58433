// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <limits>
#include <list>
#include <optional>
#include <unordered_map>
#include <utility>

#include "common/queue_share.hpp"

namespace axon::transport {

/// What may happen to a message when its consumer does not read.
enum class Traffic : std::uint8_t {
    Signal,  ///< never queued: sent at once, or the consumer is disconnected
    /// Left out while the one before is unsent; the next one repeats the level. Other messages do not hold it
    /// back: with the same period as theirs it would be left out each time, and the server be taken for
    /// silent.
    Heartbeat,
    Control,  ///< queued in order; overflow disconnects the consumer
    Data      ///< queued in order; overflow drops the oldest data
};

/// Of each sender at most a quarter of the control messages and of the signals, and of all of them three
/// quarters of the control messages; the rest is for the server's own, and for who holds the consumer.
struct OutboxLimits {
    std::size_t window_bytes = 256 * 1024;  ///< given to Ice and not yet written to the socket
    /// Waiting behind the window; one message of the largest size fits. A larger one waits alone.
    std::size_t data_bytes = (4096 + 64) * 1024;
    std::size_t data_messages = 4096;
    std::size_t control_bytes = 8 * 1024 * 1024;
    std::size_t control_messages = 16384;
    std::size_t signals_unsent = 4096;  ///< a stop for each of 2048 entities, twice

    /// Of a connection of the signal lane: what a stop may have in front of it is less.
    static constexpr OutboxLimits ofSignals() {
        OutboxLimits limits;
        limits.window_bytes = 64 * 1024;
        return limits;
    }
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
/// A control message or signal beyond its sender's share is Refused, and the sender to be told. Only the
/// server's own overflow, and that of all signals together, disconnects the consumer. Of data the oldest is
/// dropped, of the sender that has most of what there is too much of.
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
        Refused,   ///< it is beyond its sender's share; nothing has happened
        Overflow,  ///< the consumer must be disconnected; the outbox is closed now
        Closed
    };
    struct Item {
        Parcel parcel;
        std::size_t bytes;
        Traffic traffic;
        SenderKey from;
    };

    explicit OutboxCore(OutboxLimits limits) : limits_(limits) {}

    /// `make` returns the Parcel; called only for Queued.
    template <class Make>
    Verdict offer(Traffic traffic, std::size_t bytes, Make&& make, SenderKey from = kServersOwn) {
        if (closed_) return Verdict::Closed;
        switch (traffic) {
            case Traffic::Signal:
                return offerSignal(bytes, from);
            case Traffic::Heartbeat:
                if (heartbeat_unsent_) {
                    ++counts_.dropped;
                    return Verdict::Dropped;
                }
                heartbeat_unsent_ = true;
                return launch(bytes);
            case Traffic::Control:
                if (mayPass()) return launch(bytes);
                if (from != kServersOwn && !withinShare(from, bytes)) return Verdict::Refused;
                if (control_.messages >= limits_.control_messages ||
                    control_.bytes + bytes > limits_.control_bytes) {
                    close();
                    return Verdict::Overflow;
                }
                control_.add(bytes);
                if (from != kServersOwn) {
                    of_peers_.add(bytes);
                    shares_[from].control.add(bytes);
                }
                queue_.push_back({make(), bytes, traffic, from});
                return Verdict::Queued;
            case Traffic::Data:
                break;
        }
        if (mayPass()) return launch(bytes);
        while (data_.messages > 0) {
            if (data_.bytes + bytes > limits_.data_bytes) {
                dropData(&Waiting::bytes);
            } else if (data_.messages >= limits_.data_messages) {
                dropData(&Waiting::messages);
            } else {
                break;
            }
        }
        queue_.push_back({make(), bytes, traffic, from});
        auto& its = shares_[from];
        its.data_items.push_back(std::prev(queue_.end()));
        its.data.add(bytes);
        data_.add(bytes);
        return Verdict::Queued;
    }

    /// A message left for the kernel; what was offered.
    void sent(Traffic traffic, std::size_t bytes, SenderKey from = kServersOwn) {
        unsent_bytes_ -= bytes;
        if (traffic == Traffic::Signal) {
            --unsent_signals_;
            if (from != kServersOwn) change(from, [](Share& its) { --its.signals; });
        }
        if (traffic == Traffic::Heartbeat) heartbeat_unsent_ = false;
        ++counts_.sent;
    }

    /// From now on nothing waits because much is unsent.
    void openWindow() { limits_.window_bytes = std::numeric_limits<std::size_t>::max(); }

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
            forgetOldestData(shares_.find(first->from));
        } else {
            control_.remove(first->bytes);
            if (first->from != kServersOwn) {
                of_peers_.remove(first->bytes);
                change(first->from, [&](Share& its) { its.control.remove(first->bytes); });
            }
        }
        Item item = std::move(*first);
        queue_.erase(first);
        launch(item.bytes);
        return item;
    }

    /// Drops everything that waits. Nothing is sent afterwards.
    void close() {
        closed_ = true;
        queue_.clear();
        data_ = control_ = of_peers_ = {};
        for (auto share = shares_.begin(); share != shares_.end();) {
            share->second = {.signals = share->second.signals};  // those are still unsent
            share = share->second.signals == 0 ? shares_.erase(share) : std::next(share);
        }
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
    struct Waiting {
        std::size_t messages = 0;
        std::size_t bytes = 0;
        void add(std::size_t more) {
            ++messages;
            bytes += more;
        }
        void remove(std::size_t less) {
            --messages;
            bytes -= less;
        }
    };
    struct Share {
        Waiting control = {}, data = {};
        std::deque<typename std::list<Item>::iterator> data_items = {};  // oldest first
        std::size_t signals = 0;
        bool empty() const { return control.messages == 0 && data.messages == 0 && signals == 0; }
    };
    using Shares = std::unordered_map<SenderKey, Share>;

    static constexpr std::size_t parts(std::size_t limit, std::size_t of_four) { return limit * of_four / 4; }
    Verdict launch(std::size_t bytes) {
        unsent_bytes_ += bytes;
        return Verdict::Send;
    }
    /// No sender's signals are refused for those of others: who has none unsent may send one, or the consumer
    /// is disconnected, and its robot stops by itself.
    Verdict offerSignal(std::size_t bytes, SenderKey from) {
        if (from != kServersOwn) {
            const auto its = shares_.find(from);
            if (its != shares_.end() &&
                its->second.signals >= std::max<std::size_t>(parts(limits_.signals_unsent, 1), 1))
                return Verdict::Refused;
        }
        if (unsent_signals_ >= limits_.signals_unsent) {
            close();
            return Verdict::Overflow;
        }
        ++unsent_signals_;
        if (from != kServersOwn) ++shares_[from].signals;
        return launch(bytes);
    }
    /// One message may wait for each sender, as long as there is room for senders.
    bool withinShare(SenderKey from, std::size_t bytes) const {
        if (of_peers_.messages >= parts(limits_.control_messages, 3) ||
            of_peers_.bytes + bytes > parts(limits_.control_bytes, 3))
            return false;
        const auto found = shares_.find(from);
        if (found == shares_.end() || found->second.control.messages == 0) return true;
        const auto& its = found->second.control;
        return its.messages < parts(limits_.control_messages, 1) &&
               its.bytes + bytes <= parts(limits_.control_bytes, 1);
    }
    void dropData(std::size_t Waiting::*scarce) {
        const auto most =
            std::max_element(shares_.begin(), shares_.end(), [&](const auto& one, const auto& other) {
                return one.second.data.*scarce < other.second.data.*scarce;
            });
        const auto oldest = most->second.data_items.front();
        forgetOldestData(most);
        queue_.erase(oldest);
        ++counts_.dropped;
    }
    /// The item stays in the queue.
    void forgetOldestData(typename Shares::iterator its) {
        const auto bytes = its->second.data_items.front()->bytes;
        its->second.data_items.pop_front();
        its->second.data.remove(bytes);
        data_.remove(bytes);
        if (its->second.empty()) shares_.erase(its);
    }
    template <class Change>
    void change(SenderKey from, Change&& change) {
        const auto its = shares_.find(from);
        if (its == shares_.end()) return;
        change(its->second);
        if (its->second.empty()) shares_.erase(its);
    }

    OutboxLimits limits_;
    std::list<Item> queue_;
    Waiting data_, control_, of_peers_;  // of_peers_: of the control messages that have a sender
    Shares shares_;                      // of who has anything here
    std::size_t unsent_bytes_ = 0;
    std::size_t unsent_signals_ = 0;
    bool heartbeat_unsent_ = false;
    bool pumping_ = false;
    bool closed_ = false;
    OutboxCounts counts_;
};

}  // namespace axon::transport
