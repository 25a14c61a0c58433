// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/commutil.h>

#include <string_view>
#include <utility>

#include "common/result.hpp"
#include "common/routed.hpp"

// Between the contracts' generated types (namespace ice here) and the plain structs that the cores use.
// Strings are moved where the source is given as an rvalue.
namespace axon::transport {

namespace ice = ::Axon::CommUtil;

/// How a ["cpp:array"] parameter arrives and is sent; it points into somebody else's memory.
using ByteRange = std::pair<const Ice::Byte*, const Ice::Byte*>;

inline std::string_view toView(const ByteRange& range) {
    return {reinterpret_cast<const char*>(range.first), static_cast<std::size_t>(range.second - range.first)};
}
inline ByteRange toRange(std::string_view bytes) {
    const auto* begin = reinterpret_cast<const Ice::Byte*>(bytes.data());
    return {begin, begin + bytes.size()};
}

/// The longest string, in bytes, that the head of a proper message has: names have at most 256, ids 36.
inline constexpr std::size_t kHeadStringMax = 1024;
inline constexpr std::string_view kImproperHead =
    "it sent a message with a malformed head (expected strings of at most 1024 bytes)";
/// The bytes of the head's strings.
std::size_t stringBytes(const Header& head);
bool isProper(const Header& head);
/// Cuts the strings of a head that is not proper. A string that was cut names no entity.
void cutStrings(Header& head);

/// A number that a peer sent as a double, which may be anything. Returns 0 unless it is a whole number below
/// 2^53.
std::int64_t whole(double value);

Sender fromIce(ice::Sender&& sender);
Header fromIce(ice::Header&& head);
Registration fromIce(ice::Registration&& registration);
EntityStatus fromIce(ice::EntityStatus&& status);
ServerAnnouncement fromIce(ice::ServerAnnouncement&& server);

ice::Sender toIce(const Sender& sender);
ice::Header toIce(const Header& head);
ice::Registration toIce(const Registration& registration);
ice::EntityStatus toIce(const EntityStatus& status);
ice::ServerAnnouncement toIce(const ServerAnnouncement& server);

// The enumerators have the same numbers (convert_test.cpp). Ice has already checked the value that a
// peer sends against the range of the enumeration.
inline StopCause fromIce(ice::StopCause cause) {
    return static_cast<StopCause>(cause);
}
inline Presence fromIce(ice::Presence presence) {
    return static_cast<Presence>(presence);
}
inline ClientChange fromIce(ice::ClientChange change) {
    return static_cast<ClientChange>(change);
}
inline Lane fromIce(ice::Lane lane) {
    return static_cast<Lane>(lane);
}
inline ice::StopCause toIce(StopCause cause) {
    return static_cast<ice::StopCause>(cause);
}
inline ice::Presence toIce(Presence presence) {
    return static_cast<ice::Presence>(presence);
}
inline ice::ClientChange toIce(ClientChange change) {
    return static_cast<ice::ClientChange>(change);
}
inline ice::Lane toIce(Lane lane) {
    return static_cast<ice::Lane>(lane);
}

ice::RequestRefused toIce(const Refusal& refusal);

/// The value, or the refusal thrown as the contracts' exception. For servants.
template <class T>
T valueOrThrow(Result<T>&& result) {
    if (!result.ok()) throw toIce(result.refusal());
    if constexpr (!std::is_void_v<T>) return std::move(result).value();
}

}  // namespace axon::transport
