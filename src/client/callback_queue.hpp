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
/// Bounds: from kBound on the oldest callback that may be left out is (a sample, raw data, a change of an
/// entity, progress of a task), and counted. What must not be left out may be kMost, more than a client hears
/// of at once when it joins; beyond it post() says that the user does not return from callbacks. Threads:
/// any; the destructor and close() join the thread. Failure: what a callback throws is logged and ends
/// nothing.
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

    /// False: the queue is full of callbacks that must not be left out, and this one was not taken. It is
    /// called after the next wake(): who posts under a lock that callbacks take wakes when it has left it.
    bool post(std::function<void()> callback, bool may_be_left_out);
    void wake() { changed_.notify_one(); }
    bool isThisThread() const { return std::this_thread::get_id() == thread_.get_id(); }
    std::uint64_t leftOut() const;
    /// After this nothing is called any more. Not from a callback.
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
