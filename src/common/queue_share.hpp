// SPDX-License-Identifier: MIT
#pragma once
#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "common/refusal.hpp"

namespace axon {

/// How much of the queue to a peer that reads slowly a message may use.
enum class QueueShare : std::uint8_t {
    OfSender,  ///< its sender's part; beyond it the message is refused
    Whole  ///< all: the peer belongs to the sender, or has asked it; a queue that overflows disconnects the
           ///< peer
};

/// Whose message it is. Many peers' messages share a queue, and none of them may fill it.
using SenderKey = std::uint64_t;
inline constexpr SenderKey kServersOwn = 0;

/// Whose share a message of the peer with this id counts towards. All sessions of one user have the same: the
/// UUIDs at the end of their ids begin with userPart(), 48 bits that are made of the user's name. UUIDs of
/// clients are of version 8, as are those of entities that are bound to a secret; whoever has tried 2^48
/// secrets has one that begins like a user's (ADR 0024).
SenderKey senderKey(std::string_view id, QueueShare share = QueueShare::OfSender);
/// Of stops: each session has its own, so that no program of a user keeps the user's own stop back.
SenderKey sessionKey(std::string_view id);

/// The characters of a UUID before its version, which is at this index.
inline constexpr std::size_t kUserDigits = 14;
/// The beginning of the ids of a user's sessions, such as "0a1b2c3d-4e5f-"; the same at all servers.
std::string userPart(std::string_view user);

/// OVERLOADED: the queue of `consumer`, which reads slowly, takes no more messages of this sender.
Refusal queueShareFull(const std::string& consumer);

}  // namespace axon
