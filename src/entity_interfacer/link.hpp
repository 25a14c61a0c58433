// SPDX-License-Identifier: MIT
#pragma once
#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <string>

#include "common/frame.hpp"
#include "host/wake_up.hpp"

namespace axon::proto {
class EiToEm;
}

namespace axon {

/// The two connections with one Entity Manager, from the second Welcome until the first failure.
///
/// States: up, lost (final). Threads: cut() and the senders may be called from any thread; signal_reader
/// belongs to the stop thread, data_reader and flush() to the data thread. Ownership: shared by the library's
/// threads and by the tasks that this link dispatched; the sockets close with the last of them. Failure:
/// whatever cannot be written in order cuts the link, which is a stop.
class Link {
  public:
    /// What may be dropped when the peer is slower than the application, and what may not.
    enum class Kind { Control, Droppable };

    Link(Descriptor signal, FrameReader signal_reader_, Descriptor data, FrameReader data_reader_,
         std::string manager_, const WakeUp& data_thread);

    const std::string manager;
    FrameReader signal_reader;
    FrameReader data_reader;

    int signalFd() const { return signal_.get(); }
    int dataFd() const { return data_.get(); }

    /// Of the StopLevel when the stop thread took the link, which it does before the data thread has it: a
    /// higher one means that the application has stopped itself since.
    std::uint64_t epoch = 0;

    /// Marks the link as lost: whatever arrives is ignored and no task of it begins. Last words can still be
    /// sent until cut(), which the caller must call next.
    void condemn(const std::string& reason);
    /// Tells the manager the reason, where the socket takes it, and ends both connections; the stop thread
    /// sees it as end of file. The first reason counts. `stopped`: the program ends in order, and its stop
    /// callback has returned.
    void cut(const std::string& reason, bool stopped = false);
    std::string reason() const;
    bool lost() const { return lost_.load(std::memory_order_acquire); }

    /// Written at once and whole, or the link is cut: a signal never queues. No lock.
    void sendSignal(const proto::EiToEm& message);
    /// Written at once as far as the socket takes it; the rest waits in a bounded queue that the data thread
    /// flushes. Full: samples and raw data drop the oldest; anything else cuts the link. False when the
    /// message is larger than a frame.
    bool sendData(const proto::EiToEm& message, Kind kind);
    bool pending() const { return pending_.load(std::memory_order_acquire); }
    void flush();

  private:
    struct Waiting {
        std::string bytes;
        Kind kind;
    };
    void writeLocked();

    const Descriptor signal_, data_;
    const WakeUp& data_thread_;
    std::atomic<bool> lost_{false}, closed_{false};
    std::atomic<bool> pending_{false};
    mutable std::mutex reason_mutex_;
    std::string reason_;  // guarded by reason_mutex_
    std::mutex data_mutex_;
    std::deque<Waiting> waiting_;  // these four guarded by data_mutex_
    std::size_t written_ = 0;      // of the first
    std::size_t bytes_ = 0;
    std::size_t droppable_ = 0;
};

}  // namespace axon
