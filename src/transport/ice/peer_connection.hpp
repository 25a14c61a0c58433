// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>

#include "transport/ice/convert.hpp"

namespace axon::transport {

/// Why a connection ended, for a person, and whether the peer's behaviour is to blame (oversize, protocol
/// error, messages not read, flood) rather than its loss.
struct CloseReason {
    bool improper = false;
    std::string text;
};

/// What carries one session: a session answers only over it, and ends when it does. Two kinds: a connection
/// of the peer itself, and the way through a router (routed_connection.hpp). States: open, closed. Threads:
/// any; disconnect() does not wait.
class PeerConnection {
  public:
    virtual ~PeerConnection() = default;

    /// `closed` is called once, on a thread of Ice, with no lock held. Replaces the one before.
    virtual void onClosed(std::function<void(const CloseReason&)> closed) = 0;
    /// Closes: orderly, after the replies that are under way, or at once. Does not wait. The first reason
    /// given is the one that is reported.
    virtual void disconnect(CloseReason reason, bool orderly) = 0;
    /// Throws Ice::ObjectNotExistException when the call came another way: to others there is no session.
    virtual void require(const Ice::Current& current) = 0;
    /// There is a router between: nothing that is written to a socket here has reached the peer.
    virtual bool routed() const = 0;
    /// Of which there is one session.
    virtual const void* key() const = 0;
    /// What tells the connection from others: its own, or its router's, by which others come, too; null until
    /// a router has brought its first call.
    virtual const void* connection() const = 0;
    /// "127.0.0.1:50122", for logs.
    virtual std::string peer() const = 0;
    /// What no other connection that is open has (bothEnds()); empty behind a router, and once it has closed.
    virtual std::string ends() const = 0;
    /// The address of this side that the peer connected to; empty when not TCP.
    virtual std::string localAddress() const = 0;
    /// The peer itself, or its router, came by TLS.
    virtual bool tls() const = 0;

    /// The head as the cores take it. A peer whose head is not proper (convert.hpp) is disconnected for its
    /// behaviour, and the call ends with Ice::ObjectNotExistException.
    Header properHead(ice::Header&& head, const Ice::Current& current);
};

/// A connection of the peer's own: one session for each.
class DirectConnection final : public PeerConnection {
  public:
    explicit DirectConnection(std::shared_ptr<Ice::Connection> connection)
        : connection_(std::move(connection)) {}

    /// Replaces the callback of the connection, of which there is one.
    void onClosed(std::function<void(const CloseReason&)> closed) override;
    void disconnect(CloseReason reason, bool orderly) override;
    void require(const Ice::Current& current) override;
    bool routed() const override { return false; }
    const void* key() const override { return connection_.get(); }
    const void* connection() const override { return connection_.get(); }
    std::string peer() const override { return peerOf(*connection_); }
    std::string ends() const override { return endsOf(*connection_); }
    std::string localAddress() const override;
    bool tls() const override;

    const Ice::Connection* get() const { return connection_.get(); }
    /// The two ends of a connection as "127.0.0.1:50122".
    static std::string peerOf(const Ice::Connection& connection);
    static std::string localOf(const Ice::Connection& connection);
    /// Both in one (bothEnds()); empty once it has closed.
    static std::string endsOf(const Ice::Connection& connection);
    /// The peer's own address; empty when not TCP.
    static std::string remoteAddressOf(const Ice::Connection& connection);
    /// The header `Origin` with which a browser opened a WebSocket; none of other connections.
    static std::optional<std::string> originOf(const Ice::Connection& connection);

  private:
    struct Told {
        std::mutex mutex;
        std::unique_ptr<CloseReason> reason;  // guarded by mutex
    };
    const std::shared_ptr<Ice::Connection> connection_;
    const std::shared_ptr<Told> told_ = std::make_shared<Told>();
};

}  // namespace axon::transport
