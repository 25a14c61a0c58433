// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <condition_variable>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>

namespace axon::client {

/// The one thread that runs the user's callbacks, in order, and the queue before it.
///
/// Bounds: beyond kBound callbacks, the oldest one that may be left out (a sample, raw data, a change of an
/// entity, progress of a task) is dropped and counted. Callbacks that must not be left out may be kMost, more
/// than a client hears of at once when it joins. Beyond kMost, post() reports that the user does not return
/// from callbacks. Threads: any; the destructor and close() join the thread. Failure: an exception from a
/// callback is logged and ends nothing.
class CallbackQueue {
  public:
    static constexpr std::size_t kBound = 4096;
    static constexpr std::size_t kMost =
        65536 +
        kBound;  ///< the entities of a server (EntityServer.EntitiesMax), and as much again as otherwise

    CallbackQueue();
    ~CallbackQueue();
    CallbackQueue(const CallbackQueue&) = delete;
    CallbackQueue& operator=(const CallbackQueue&) = delete;

    /// Returns false if the queue is full of callbacks that must not be left out; this one was not taken
    /// then. The callback runs after the next wake(). A thread that posts under a lock which callbacks also
    /// take calls wake() when it has released that lock.
    bool post(std::function<void()> callback, bool may_be_left_out);
    void wake() { changed_.notify_one(); }
    bool isThisThread() const { return std::this_thread::get_id() == thread_.get_id(); }
    std::uint64_t leftOut() const;
    /// No callback runs after it has returned. Must not be called from a callback.
    void close();

  private:
    struct Entry {
        std::function<void()> callback;
        bool may_be_left_out;
    };
    void run();

    mutable std::mutex mutex_;
    std::condition_variable changed_;
    // Guarded by mutex_:
    std::deque<Entry> queue_;
    std::size_t optional_ = 0;
    std::uint64_t left_out_ = 0;
    bool closed_ = false;

    std::thread thread_;
};

}  // namespace axon::client
