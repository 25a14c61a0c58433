// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <array>
#include <atomic>
#include <cstddef>
#include <cstdint>
#include <string>

namespace axon::faults {

/// CLOCK_MONOTONIC in nanoseconds: the same clock in every process of a run.
std::int64_t nowNs();

/// When the stop callback was called, and why.
struct StopMark {
    std::atomic<std::int64_t> at{0};
    std::atomic<std::uint32_t> cause{0};
};

/// What happened to one robot. Written by its application; `gone_at` by the operator's process.
struct alignas(64) Slot {
    static constexpr std::size_t kMarks = 64;  ///< the newest are kept
    std::atomic<std::uint32_t> stops{0};       ///< calls of the stop callback, ever
    std::atomic<std::uint32_t> starts{0};      ///< motions begun, ever
    std::atomic<std::int64_t> started_at{0};
    std::atomic<std::uint32_t> moving{0};
    std::atomic<std::int64_t> gone_at{
        0};  ///< the client was told that it is UNAV or has left; 0 = it is there
    std::array<StopMark, kMarks> marks;

    // Of the robot under load (load.hpp): what its application has received, and what its client did.
    std::atomic<std::uint32_t> received{0};
    std::atomic<std::uint32_t> sent{0}, refused{0};
    std::atomic<std::uint32_t> disconnected{0}, leases_lost{0}, left{0};  ///< times the client noticed it

    /// Called on one thread at a time: the Entity Interfacer has one for stops.
    void stopped(std::uint32_t cause);
    /// The first stop after the first `before` ones that was not before `since`; null = none yet.
    const StopMark* firstStop(std::uint32_t before, std::int64_t since) const;
};

/// What the run tells the operator's process, and what that answers.
struct alignas(64) Desk {
    std::atomic<std::uint32_t> prepare{0};   ///< "see that every robot moves", a number for each such order
    std::atomic<std::uint32_t> prepared{0};  ///< the newest order that was carried out
    std::atomic<std::uint32_t> wedged{0};    ///< 1: keep_running says no; 2: it does not return
    std::atomic<std::uint32_t> together{
        0};                                ///< 1: the robots move as steps of one run; 2: of the first one's
    std::atomic<std::uint32_t> master{0};  ///< whose run it is
    std::atomic<std::uint32_t> movers{0};  ///< the first so many robots are made to move; 0: all
    std::atomic<std::uint32_t> applications{0};
    std::atomic<std::uint32_t> load{0};     ///< 1: the clients of the load send
    std::atomic<std::uint32_t> loaders{0};  ///< so many of them hold their robot
};

/// A file of slots in memory that all processes of a run share. What is written there survives whoever wrote
/// it. Throws std::system_error.
class Board {
  public:
    Board(const std::string& file, std::size_t slots, bool create);
    ~Board();
    Board(const Board&) = delete;
    Board& operator=(const Board&) = delete;

    Slot& operator[](std::size_t i) { return slots_[i]; }
    std::size_t size() const { return count_; }
    /// How many robots are made to move.
    std::size_t movers() const {
        return desk_->movers == 0 ? count_ : std::min<std::size_t>(desk_->movers, count_);
    }
    Desk& desk() { return *desk_; }

  private:
    std::size_t count_;
    void* memory_;
    Desk* desk_;
    Slot* slots_;
};

}  // namespace axon::faults
