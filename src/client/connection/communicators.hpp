// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <map>
#include <memory>
#include <mutex>
#include <string>

#include "axon/client.hpp"
#include "client/connection/server_connection.hpp"
#include "common/result.hpp"
#include "direct/lane/tls_channel.hpp"

namespace axon::client {

/// A session's two communicators, one for each lane, and the adapters through which the server's pushes come
/// in; and what direct paths over TLS need. They outlast connections that are lost. Threads: open() before
/// anything else, then any; destroy() joins Ice's threads.
class Communicators {
  public:
    /// MALFORMED for options that Ice or Axon does not accept, INTERNAL for what fails besides.
    Result<void> open(const Options& options);
    /// Ends connections, and a login that another thread may be waiting for.
    void destroy();

    const LaneHome& data() const { return data_; }
    const LaneHome& signal() const { return signal_; }
    bool routed() const { return data_.router != nullptr; }

    /// With what data lanes of direct paths are opened over TLS; null where no certificate is configured, or
    /// one that only IceSSL can use.
    const std::shared_ptr<const direct::lane::Tls>& tls() const { return tls_; }
    /// Where their signal lanes are opened: a communicator that takes the certificates of entities. Where it
    /// must be made first, this takes some milliseconds. Throws std::runtime_error; after destroy(), too.
    LaneHome directSignal();

  private:
    void openTls(const std::map<std::string, std::string>& properties);

    Ice::CommunicatorHolder data_communicator_, signal_communicator_;
    LaneHome data_, signal_;
    std::map<std::string, std::string> properties_;  // constant after open(), as is the next one
    std::shared_ptr<const direct::lane::Tls> tls_;
    std::mutex mutex_;
    // Guarded by mutex_:
    Ice::CommunicatorHolder direct_communicator_;  // none before the first directSignal()
    LaneHome direct_;
    bool destroyed_ = false;
};

}  // namespace axon::client
