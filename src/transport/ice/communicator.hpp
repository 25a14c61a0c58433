// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <exception>
#include <map>
#include <memory>
#include <string>

#include "common/result.hpp"
#include "common/routed.hpp"

namespace axon::transport {

/// The largest message anybody accepts, in KiB: an uncompressed camera picture fits. Whoever sends a larger
/// one is disconnected by the receiver.
inline constexpr int kMessageSizeMaxKib = 4096;
/// The same for what a signal lane receives: a stop of 8,192 entities by their ids fits. Whoever may send
/// there makes nobody's stop wait for a list to be unpacked.
inline constexpr int kSignalSizeMaxKib = 512;

/// SCHED_RR priorities of signal lanes: above ordinary threads, below the kernel's own interrupt threads
/// (50). Receipts give way to stops.
inline constexpr int kStopPriority = 10;
inline constexpr int kReceiptPriority = 5;

/// SCHED_RR for the calling thread, where permitted; where not, that is logged once and nothing changes.
/// Threads that it starts afterwards do not inherit it.
void requestRealTime(int priority);

/// What differs between the project's communicators; all else is decided in makeCommunicator, in one place.
struct CommunicatorSettings {
    std::string name = "axon";  ///< of its threads; up to 15 characters are shown by ps and gdb
    Lane lane = Lane::Data;     ///< the signal lane's threads ask for real-time scheduling
    int server_threads = 1;     ///< for each adapter, unless the adapter has a pool of its own
    int client_threads = 1;     ///< dispatches callbacks that arrive over outgoing connections
    /// Ice properties that win over the defaults: those of a configuration file.
    std::map<std::string, std::string> properties;
    int priority = kStopPriority;  ///< of the signal lane's threads, where permitted
};

/// An Ice communicator with the project's defaults: bounded message size, no retries (a new connection has no
/// session), connections kept alive by their client side and closed by their server side when silent for a
/// minute, calls in order on each connection, IPv4, and TLS where the properties name a certificate. The
/// threads of a signal-lane communicator run under SCHED_RR where that is permitted; where not, that is
/// logged once and they run as ordinary threads.
///
/// Ownership: the holder destroys it, which closes its connections and joins its threads.
/// Failure: throws std::runtime_error for properties that Ice does not accept (misconfiguration).
Ice::CommunicatorHolder makeCommunicator(const CommunicatorSettings& settings);

/// Whether a router says by it that the server that it asked for a session, or to verify a password, did not
/// answer.
bool isWithoutServer(const std::exception_ptr& error);

/// The one place where Ice's exceptions become refusals. Also for the contracts' own RequestRefused and for
/// standard exceptions (INTERNAL). `setting_up_tls`: a connection over TLS was being made.
Refusal translate(std::exception_ptr error, bool setting_up_tls = false);

/// "tcp -h 127.0.0.1 -p 10410" of "127.0.0.1:10410", "ssl -h …" of "ssl://…". Throws std::invalid_argument
/// that says how to fix it.
std::string tcpEndpoint(const std::string& host_and_port);

/// Whether the proxy calls its peer back: over the connection of `current` (it has no endpoints), or at the
/// address from which that comes. A peer that names another address would have the server connect where the
/// peer says. Not for peers behind a Glacier2 router, whose callbacks name the router's own endpoints.
bool callsBack(const Ice::ObjectPrx& given, const Ice::Current& current);

/// The callback proxy to send on: an endpoint-less one is bound to the connection it came over, a routed or
/// ordinary one is taken as it is; oneway and without time-out in any case. Null when none was given.
template <class Prx>
std::shared_ptr<Prx> callbackProxy(const std::shared_ptr<Prx>& given, const Ice::Current& current) {
    if (!given) return nullptr;
    auto proxy = given;
    if (given->ice_getEndpoints().empty() && given->ice_getAdapterId().empty() && current.con) {
        proxy = Ice::uncheckedCast<Prx>(current.con->createProxy(given->ice_getIdentity()));
    }
    return proxy->ice_oneway()->ice_invocationTimeout(-1);
}

}  // namespace axon::transport
