// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <atomic>
#include <cstdint>
#include <string>

namespace axon::bench {

/// So many of its last tasks a receiver remembers.
inline constexpr int kTaskMarks = 32;

/// What one receiver noted, in memory shared by the processes of a run. Times are CLOCK_MONOTONIC in nanoseconds.
struct alignas(64) Slot {
    std::atomic<std::int64_t> stop_at{0};
    std::atomic<std::int64_t> data_at{0};
    std::atomic<std::uint32_t> stops{0};
    std::atomic<std::uint32_t> data{0};
    std::atomic<std::uint32_t> corrupt{0};
    std::atomic<std::uint32_t> tasks{0};  ///< ever
    std::array<std::atomic<std::int64_t>, kTaskMarks> task_at{};

    /// When the handler of its task with this number, from 0, was entered.
    std::int64_t entered(std::uint32_t task) const { return task_at[task % kTaskMarks]; }
};

/// A file of slots, mapped by the sender and by the process of the receivers. Throws std::system_error.
class Board {
  public:
    Board(const std::string& file, std::size_t slots, bool create);
    ~Board();
    Board(const Board&) = delete;
    Board& operator=(const Board&) = delete;

    Slot& operator[](std::size_t i) { return slots_[i]; }
    std::size_t size() const { return count_; }
    /// How many receivers are ready.
    std::atomic<std::uint32_t>& ready() { return slots_[count_].stops; }

  private:
    std::size_t count_;
    Slot* slots_;
};

std::int64_t nowNs();

/// 35,137 bytes as chapter 5 sends them, less the header; the content is checked by whoever receives it.
std::string batch(std::size_t bytes);
bool batchIntact(const char* begin, std::size_t size);

}  // namespace axon::bench
