// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstdint>
#include <string>

#include "shared_array.hpp"

namespace axon::bench {

/// What a sender of data did, in a process of its own; it sends while go() is 1.
struct alignas(64) StreamSlot {
    std::atomic<std::uint64_t> sent{0}, refused{0};
};
using StreamBoard = SharedArray<StreamSlot>;

/// Holds reader-0 … and stalled-0 … and sends chapter 5's batches to them, one after the other, as fast as
/// the connection takes them. Runs until its parent dies.
int runAxonStream(const std::string& board_file, const std::string& server, std::size_t readers,
                  std::size_t stalled);
/// Likewise to topics 0 … of a broker.
int runMosquittoStream(const std::string& board_file, std::uint16_t port, std::size_t receivers);

}  // namespace axon::bench
