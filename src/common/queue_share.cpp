// SPDX-License-Identifier: MIT
#include "common/queue_share.hpp"

#include <cstdio>
#include <functional>

namespace axon {
namespace {

constexpr std::size_t kUuidSize = 36;

/// The UUID at the end of an id is of version 8: that of a client, or of an entity that is bound to a secret.
bool isBound(std::string_view uuid) {
    return uuid.size() == kUuidSize && uuid[kUserDigits] == '8';
}

}  // namespace

SenderKey senderKey(std::string_view id, QueueShare share) {
    if (share == QueueShare::Whole) return kServersOwn;
    const auto uuid = id.size() > kUuidSize ? id.substr(id.size() - kUuidSize) : id;
    return sessionKey(isBound(uuid) ? uuid.substr(0, kUserDigits) : id);
}

SenderKey sessionKey(std::string_view id) {
    return std::hash<std::string_view>{}(id) | 1U;
}

std::string userPart(std::string_view user) {
    // FNV-1a, which is the same in every program.
    std::uint64_t hash = 0xcbf29ce484222325U;
    for (const char c : user) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3U;
    char text[kUserDigits + 1];
    std::snprintf(text, sizeof text, "%08x-%04x-", static_cast<unsigned>(hash >> 32U),
                  static_cast<unsigned>(hash & 0xffffU));
    return text;
}

Refusal queueShareFull(const std::string& consumer) {
    return {RefusalCode::Overloaded,
            consumer +
                " reads slowly, and its queue has no more room for this sender; fix: send less, or try again "
                "in a moment",
            {}};
}

}  // namespace axon
