// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <memory>
#include <string>
#include <vector>

#include "transport/ice/endpoint.hpp"

namespace axon::transport {

/// Who closes the connections of peers from which nothing comes.
enum class Idle : std::uint8_t {
    ClosedAfterAMinute,  ///< Ice
    ClosedAfterASecond,  ///< Ice, where no call is under way
    Watched              ///< ConnectionLimits, which whoever listens asks to watch these endpoints
};

/// An object adapter that listens and is not active yet. With `threads`, the calls of one connection run in
/// parallel on that many threads. Without, they run in order, on as many threads as the communicator has for
/// each adapter. Except where idle peers have a minute, a caller hears twice a second that this process lives
/// while its call is being carried out. Throws std::runtime_error, saying how to fix it, if it cannot listen.
std::shared_ptr<Ice::ObjectAdapter> listen(Ice::Communicator& communicator, const std::string& name,
                                           const std::string& endpoint, int threads = 0,
                                           Idle idle = Idle::ClosedAfterAMinute);

/// Where peers are told to call it: as configured, else as it listens, with the port that was taken where 0
/// was asked for, and an empty host where it listens on all addresses of this machine.
std::vector<Endpoint> publishedEndpoints(const Ice::ObjectAdapter& adapter);
/// Where it listens; an empty host where that is every address of this machine.
std::vector<Endpoint> listenedEndpoints(const Ice::ObjectAdapter& adapter);
/// Where whoever calls this proxy connects; none where it names no address.
std::vector<Endpoint> endpointsOf(const Ice::ObjectPrx& proxy);
/// "127.0.0.1:10410", and with ',' between them where it listens at several: "ssl://…,127.0.0.1:10410".
std::string addressOf(const Ice::ObjectAdapter& adapter);

}  // namespace axon::transport
