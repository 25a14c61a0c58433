// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <memory>
#include <string>

namespace axon::transport {

/// An object adapter that listens, not active yet. With `threads`, calls of one connection run beside each
/// other on so many; without, in order, on as many as the communicator has for each adapter. Throws
/// std::runtime_error with the mend where it cannot.
std::shared_ptr<Ice::ObjectAdapter> listen(Ice::Communicator& communicator, const std::string& name,
                                           const std::string& endpoint, int threads = 0);

/// The port that was taken, where 0 was asked for.
int portOf(const Ice::ObjectAdapter& adapter);
/// The address that it listens on; empty for all of this machine's.
std::string hostOf(const Ice::ObjectAdapter& adapter);
/// "127.0.0.1:10410".
std::string addressOf(const Ice::ObjectAdapter& adapter);

}  // namespace axon::transport
