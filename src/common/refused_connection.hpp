// SPDX-License-Identifier: MIT
#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "common/refusal.hpp"

// What Ice says of incoming connections that it does not accept or closes, for people. Ice tells nobody but
// its traces (category "Network", with Ice.Trace.Network=2). Uses no Ice. All functions are pure.
namespace axon {

enum class RefusedAt : std::uint8_t {
    TlsHandshake,
    WebSocket,  ///< the HTTP request that opens it
    Protocol,   ///< when the connection was accepted
};

struct RefusedConnection {
    RefusedAt at = RefusedAt::Protocol;
    std::string peer;   ///< the address of the other end, "10.0.0.7:50122"; or "an unknown address"
    std::string local;  ///< the one here
    std::string why;    ///< a clause: "the certificate has expired"
    std::string said;   ///< Ice's own words, on one line
    RefusalCode code = RefusalCode::Malformed;
};

/// What one message of these traces says of a connection that was refused. Nothing for other messages, for a
/// connection that this program has ended for a reason of its own, and for one that its peer has ended,
/// unless that was within a TLS handshake (without a WebSocket): IceSSL may report a peer without a
/// certificate so, and one that does not accept the certificate of this program. Of one that was refused at
/// Protocol the message does not say whether it was incoming: it was if something listens on the port of
/// `local` (listeningAt()). Ice names no cause where a connection that it had accepted was silent for too
/// long, so these are not found.
std::optional<RefusedConnection> refusedConnection(const std::string& trace);

/// "127.0.0.1:10414" of the message that Ice listens there; nothing for other messages.
std::optional<std::string> listeningAt(const std::string& trace);

/// The port of "10.0.0.7:50122"; empty where there is none.
std::string_view portIn(std::string_view address);

/// What OpenSSL or IceSSL says of a certificate, for people; null for what is not known.
const char* meaningOfTlsError(std::string_view said);

/// Why Ice closed a connection with this exception ("::Ice::BadMagicException"), for people; null where that
/// is not because its peer does not keep to the protocol.
const char* meaningOfProtocolError(std::string_view exception);

}  // namespace axon
