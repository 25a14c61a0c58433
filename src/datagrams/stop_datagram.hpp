// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string_view>

#include "common/ids.hpp"
#include "common/routed.hpp"

namespace axon::datagrams {

/// The stop, and its acknowledgement, as one datagram of a fixed size
/// (docs/reference/datagrams.md has the layout).
///
/// Where in the flow: client → Entity Manager, beside the stop on the TCP signal lane and under the same
/// sender and sequence number, so that the Entity Manager takes the two for one. No server vouches for its
/// sender: the lease's 128-bit key does, which only the holder and the Entity Manager know. Pure functions;
/// any thread.
struct StopDatagram {
    enum class Kind : std::uint8_t { Stop = 1, Ack = 2 };

    Kind kind = Kind::Stop;
    StopCause cause = StopCause::Requested;  ///< a client gives no other
    LeaseNumber lease;
    std::uint32_t generation =
        0;  ///< stop: the newest that its sender has seen; ack: that of this stop, 0 = not known
    std::int64_t sequence = 0;    ///< of the stop, from 1, as on the signal lane
    std::int64_t sent_at_us = 0;  ///< the sender's monotonic clock at this copy; an ack repeats it
    Id128 sender;                 ///< session UUID of the client; an ack repeats it

    bool operator==(const StopDatagram&) const = default;
};

inline constexpr std::size_t kStopDatagramBytes = 68;
inline constexpr std::size_t kLeaseKeyBytes = 16;
using StopDatagramBytes = std::array<char, kStopDatagramBytes>;

/// `key` has kLeaseKeyBytes bytes.
StopDatagramBytes encode(const StopDatagram& datagram, std::string_view key);

/// The lease that a datagram names, when it looks like one of ours; nothing is authenticated yet. Cheap: to
/// find the key, and to pass over what is none.
std::optional<LeaseNumber> leaseOf(std::string_view bytes);

/// The fields, when the MAC is right under this key and every field is in its range; otherwise nothing.
/// Compares in constant time.
std::optional<StopDatagram> decode(std::string_view bytes, std::string_view key);

}  // namespace axon::datagrams
