// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include "axon/client.hpp"
#include "client/connection/server_connection.hpp"
#include "common/result.hpp"

namespace axon::client {

/// A session's two communicators, one for each lane, and the adapters through which the server's pushes come
/// in. They outlast connections that are lost. Threads: open() before anything else; destroy() joins Ice's
/// threads.
class Communicators {
  public:
    /// MALFORMED for options that Ice or Axon does not accept, INTERNAL for what fails besides.
    Result<void> open(const Options& options);
    /// Ends connections, and a login that another thread may be waiting for.
    void destroy();

    const LaneHome& data() const { return data_; }
    const LaneHome& signal() const { return signal_; }
    bool routed() const { return data_.router != nullptr; }

  private:
    Ice::CommunicatorHolder data_communicator_, signal_communicator_;
    LaneHome data_, signal_;
};

}  // namespace axon::client
