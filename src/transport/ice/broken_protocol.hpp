// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <functional>
#include <memory>
#include <string>

// Who comes to a port of Ice and does not speak its protocol. Ice closes such a connection and tells nobody.
namespace axon::transport {

/// For a communicator, before it is made.
void prepareBrokenProtocol(Ice::InitializationData& init);

/// The same, afterwards. `told` hears of each incoming connection that Ice has closed because what came over
/// it is not its protocol, or is too large: the address of the other end, the adapter that it came to, and
/// why, for people. A TLS handshake that fails is not meant (onRefused()). On Ice's threads, under a lock of
/// the connection, and as often as strangers cause it; it must not wait, nor use the connection. At a
/// communicator that was not prepared nothing is told.
void onBrokenProtocol(
    const std::shared_ptr<Ice::Communicator>& communicator,
    std::function<void(const std::string& peer, const std::string& adapter, const std::string& why)> told);

}  // namespace axon::transport
