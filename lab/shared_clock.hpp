// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstdint>
#include <string>

#include "common/clock.hpp"

namespace axon::lab {

/// The laboratory's time in a small file that other programs map: 8 bytes "AXONCLK1", then nanoseconds since
/// the laboratory's start as a little-endian 64-bit number that is written atomically after each step. It
/// never goes back, also not by a reset. Throws std::system_error. Threads: set() by one; readers are other
/// processes.
class SharedClock {
  public:
    explicit SharedClock(const std::string& path);
    ~SharedClock();
    SharedClock(const SharedClock&) = delete;
    SharedClock& operator=(const SharedClock&) = delete;
    void set(Duration age) { page_->nanoseconds.store(age.count(), std::memory_order_release); }

  private:
    struct Page {
        char magic[8];
        std::atomic<std::int64_t> nanoseconds;
    };
    static_assert(std::atomic<std::int64_t>::is_always_lock_free);
    Page* page_ = nullptr;
};

}  // namespace axon::lab
