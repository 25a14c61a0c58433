// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <atomic>
#include <cstdint>
#include <optional>
#include <string>

#include "shared_array.hpp"

namespace axon::bench {

enum class Kind : std::uint8_t { Stop, Data };

/// When messages of one kind arrived at one receiver: the last kRemembered of them, by their number. Times
/// are CLOCK_MONOTONIC in nanoseconds. Written by one thread, read by the sender's process.
struct Arrivals {
    static constexpr std::uint32_t kRemembered = 64;

    std::atomic<std::uint32_t> next{
        0};  ///< the number after the newest one; without gaps, how many there were
    std::array<std::atomic<std::int64_t>, kRemembered> at{};

    void note(std::uint32_t number, std::int64_t when) {
        at[number % kRemembered] = when;
        next = number + 1;
    }
    /// Of the message with this number; what is older than its sending is of another one, and it has not
    /// arrived.
    std::int64_t of(std::uint32_t number) const { return at[number % kRemembered]; }
};

/// What one receiver noted, in memory shared by the processes of a run.
struct alignas(64) Slot {
    Arrivals stops, data;
    Arrivals tasks;
    std::array<std::atomic<std::uint32_t>, Arrivals::kRemembered>
        generations{};                      ///< of `stops`, at an Entity Manager
    std::atomic<std::uint32_t> intact{0};   ///< messages with content that have arrived as they were sent
    std::atomic<std::uint32_t> corrupt{0};  ///< content that is not what was sent
    std::atomic<std::uint32_t> misplaced{
        0};  ///< not the one after the one before: lost, doubled or out of order

    Arrivals& of(Kind kind) { return kind == Kind::Stop ? stops : data; }
    /// A message with content, received at `when`. Checks every byte of it and its place in the row.
    void arrived(Kind kind, std::int64_t when, const char* bytes, std::size_t size);
    /// A stop at an Entity Manager, the next one in its row.
    void stopped(std::uint32_t generation, std::int64_t when) {
        generations[stops.next % Arrivals::kRemembered] = generation;
        stops.note(stops.next, when);
    }
    /// At a robot application, whose row of stops is by generation: those that this one overtook have reached
    /// it with it.
    void reachedGeneration(std::uint32_t generation, std::int64_t when) {
        auto first = stops.next.load();
        if (generation < first) return;  // by itself, or once more
        if (generation - first >= Arrivals::kRemembered) first = generation - Arrivals::kRemembered + 1;
        for (auto one = first; one <= generation; ++one) stops.note(one, when);
    }
    /// When the stop with this number in the row of an Entity Manager reached its robot application.
    std::int64_t reached(std::uint32_t number, const Slot& manager) const {
        return stops.of(manager.generations[number % Arrivals::kRemembered]);
    }
};

using Board = SharedArray<Slot>;

std::int64_t nowNs();

/// What is sent as data: a serialized ByteStream of five-character strings, of which 5000 are the 35,000
/// bytes of chapter 5 (its 35,137 are with the call's arguments), cut off at `bytes`. The first string holds
/// a number below 2^30.
std::string content(std::size_t bytes);
void setNumber(std::string& content, std::uint32_t number);
/// The number, or nothing when any byte is not as content() and setNumber() made it.
std::optional<std::uint32_t> readContent(const char* begin, std::size_t size);

inline constexpr std::size_t kDataBytes = 35000;
inline constexpr std::size_t kSmallBytes = 60;

}  // namespace axon::bench
