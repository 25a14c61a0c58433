// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <thread>

namespace axon::client {

/// Runs the program's callbacks one at a time, in the order of post(), and has the queue before them.
///
/// A callback runs on the thread that this object owns, or on a thread that brings news and calls runHere():
/// waking another thread takes longer than most callbacks (ADR 0030). One thread at a time runs callbacks;
/// the others leave what they post to it.
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
    static constexpr std::size_t kRunHere = 32;  ///< that one runHere() calls at most

    CallbackQueue();
    ~CallbackQueue();
    CallbackQueue(const CallbackQueue&) = delete;
    CallbackQueue& operator=(const CallbackQueue&) = delete;

    /// Returns false if the queue is full of callbacks that must not be left out; this one was not taken
    /// then. The callback runs after the next wake() or runHere(). A thread that posts under a lock which
    /// callbacks also take calls them when it has released that lock.
    bool post(std::function<void()> callback, bool may_be_left_out);
    /// What was posted runs on this object's thread, or on the one that runs callbacks now.
    void wake();
    /// Runs what was posted on the calling thread, unless another one runs callbacks now. After kRunHere the
    /// rest is left to this object's thread, so that the caller comes back to its own work.
    void runHere();
    /// Whether the calling thread is inside a callback.
    bool isThisThread() const;
    /// More waits than runHere() runs: the own thread is to be woken rather than waited for.
    bool crowded() const;
    std::uint64_t leftOut() const;
    /// No callback runs after it has returned. Must not be called from a callback.
    void close();

  private:
    struct Entry {
        std::function<void()> callback;
        bool may_be_left_out;
    };
    void runOnOwnThread();
    /// At most so many, one after the other, as the one thread that runs them; what is left is for the own
    /// thread. `lock` is held before and after.
    void run(std::unique_lock<std::mutex>& lock, std::size_t most);

    mutable std::mutex mutex_;
    std::condition_variable changed_;
    // Guarded by mutex_:
    std::deque<Entry> queue_;
    std::size_t optional_ = 0;
    std::uint64_t left_out_ = 0;
    std::thread::id runner_;  // none: nobody runs callbacks
    bool woken_ = false;      // the own thread is to run what there is
    bool closed_ = false;

    std::thread thread_;
};

}  // namespace axon::client
