// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <mutex>

#include "common/clock.hpp"

namespace axon::client {

/// What waits for the server, or for an Entity Manager on a direct path, to read it on the data lane, and the
/// threads that wait for it to become less. One for each session with a server. Threads: any.
class Backlog {
  public:
    void add(std::size_t its_bytes) {
        ++messages_;
        bytes_ += its_bytes;
    }
    // Who waits counts itself before it looks, and who removes counts down before it looks for one: one of
    // the two sees the other. At half, not at each message, so that sender and socket do not wake each other
    // by turns.
    void remove(std::size_t its_bytes) {
        --messages_;
        bytes_ -= its_bytes;
        if (waiting_ == 0 || !little(2)) return;
        { const std::lock_guard lock(mutex_); }
        changed_.notify_all();
    }
    /// Until little waits, or `wait` is over.
    void awaitLittle(Duration wait) {
        if (little(1)) return;
        std::unique_lock lock(mutex_);
        ++waiting_;
        changed_.wait_for(lock, std::chrono::nanoseconds(wait), [this] { return little(2); });
        --waiting_;
    }
    std::size_t messages() const { return messages_; }
    std::size_t bytes() const { return bytes_; }

  private:
    /// Enough to keep the socket full; more would only fill memory, which comes back cold.
    bool little(std::size_t parts) const {
        constexpr std::size_t kMessages = 32;
        constexpr std::size_t kBytes = 2 * 1024 * 1024;
        return messages_ <= kMessages / parts && bytes_ <= kBytes / parts;
    }

    std::atomic<std::size_t> messages_{0}, bytes_{0};
    std::atomic<int> waiting_{0};
    std::mutex mutex_;
    std::condition_variable changed_;
};

}  // namespace axon::client
