// SPDX-License-Identifier: MIT
#pragma once
#include <cstdint>
#include <string>

#include "common/refusal.hpp"

namespace axon {

/// How much of the queue to a peer that reads slowly a message may use.
enum class QueueShare : std::uint8_t {
    OfSender,  ///< its sender's part; beyond it the message is refused
    Whole      ///< all: the peer belongs to the sender, or has asked it; a queue that overflows disconnects the peer
};

/// OVERLOADED: no more messages of this sender are taken for `consumer`, who reads slowly.
Refusal queueShareFull(const std::string& consumer);

}  // namespace axon
