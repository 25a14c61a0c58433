// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <string>

#include "transport/convert.hpp"

namespace axon::transport {

/// Why a connection ended, for a person, and whether the peer's behaviour is to blame (oversize, protocol
/// error, messages not read, flood) rather than its loss.
struct CloseReason {
    bool improper = false;
    std::string text;
};

/// The connection under one session. A session answers only on the connection that opened it; when the
/// connection ends, the session does. States: open, closed. Threads: any; disconnect() does not wait.
class PeerConnection {
  public:
    explicit PeerConnection(std::shared_ptr<Ice::Connection> connection)
        : connection_(std::move(connection)) {}

    /// `closed` is called once, on a thread of Ice, with no lock held. Replaces the callback of the
    /// connection, of which there is one: one session for each connection.
    void onClosed(std::function<void(const CloseReason&)> closed);

    /// Closes: orderly, after the replies that are under way, or at once. Does not wait. The first reason
    /// given is the one that is reported.
    void disconnect(CloseReason reason, bool orderly);

    /// Throws Ice::ObjectNotExistException when the call came over another connection: to others there is no
    /// session.
    void require(const Ice::Current& current) const;
    /// The head as the cores take it. A peer whose head is not proper (convert.hpp) is disconnected for its
    /// behaviour, and the call ends with Ice::ObjectNotExistException.
    Header properHead(ice::Header&& head, const Ice::Current& current);
    const Ice::Connection* get() const { return connection_.get(); }
    /// "127.0.0.1:50122", for logs.
    std::string peer() const;
    /// The address of this side that the peer connected to; empty when not TCP.
    std::string localAddress() const;
    /// This side with its port, as peer().
    std::string local() const;

  private:
    struct Told {
        std::mutex mutex;
        std::unique_ptr<CloseReason> reason;  // guarded by mutex
    };
    const std::shared_ptr<Ice::Connection> connection_;
    const std::shared_ptr<Told> told_ = std::make_shared<Told>();
};

}  // namespace axon::transport
