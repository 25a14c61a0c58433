// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <string>
#include <vector>

#include "axon_crowd.hpp"
#include "shared_array.hpp"

namespace axon::bench {

/// What one standard client did.
struct alignas(64) HerdSlot {
    std::atomic<std::uint32_t> data{0}, signals{0};
    std::atomic<std::uint32_t> refused{0};       ///< of both, for whatever reason
    std::atomic<std::uint32_t> disconnected{0};  ///< times it lost its connection
    std::atomic<std::uint32_t> leases_lost{0};
    std::atomic<std::uint32_t> received{0};  ///< raw data of its entities
};
using HerdBoard = SharedArray<HerdSlot>;

/// The standard clients of tables 5.3 and 5.4, in a process of their own, each with its two connections and a
/// thread: among them the entities PREFIX-0 … are partitioned, each held by one. When the board says go, each
/// client sends to each of its own entities every 500 ms, at random data or a signal (reset, clear, or a
/// stop, after which it rearms). More clients than entities: the last ones are connected and hold nothing.
/// `open`: the entities are OpenEntity, each client holds all of them, and nothing needs to be rearmed. Runs
/// until its parent dies.
int runHerd(const std::string& board_file, std::size_t clients, const std::string& server,
            const std::string& prefix, std::size_t entities, std::uint64_t seed, bool open);

class Herd {
  public:
    /// Returns when all have connected and hold theirs. Throws std::runtime_error with the log, or how many
    /// were there in time.
    Herd(const std::filesystem::path& folder, std::size_t clients, const AxonServer& server,
         const std::string& prefix, std::size_t entities, bool open = false);
    void go() { board_.go() = 1; }
    /// As Subject::ended().
    std::string ended() const { return whichHasEnded({{"the clients' process", &child_}}); }
    struct Sums {
        std::uint64_t data = 0, signals = 0, refused = 0, disconnected = 0, leases_lost = 0, received = 0;
    };
    Sums sums();

  private:
    HerdBoard board_;
    Child child_;
};

}  // namespace axon::bench
