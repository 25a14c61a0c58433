// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>
#include <axon/frontendcomm.h>

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "client/base/lanes.hpp"
#include "client/base/server_link.hpp"
#include "client/connection/backlog.hpp"
#include "client/connection/connection_events.hpp"
#include "common/clock.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/peer_connection.hpp"
#include "transport/outbox/outbox.hpp"
#include "transport/sessions/answered_beats.hpp"

namespace axon::client {

/// One lane's communicator, and the adapter through which the server's pushes come in over its connections.
struct LaneHome {
    std::shared_ptr<Ice::Communicator> communicator;
    std::shared_ptr<Ice::ObjectAdapter> adapter;  ///< without endpoints
    std::shared_ptr<Ice::ObjectPrx> router;       ///< through which to go; null: directly
};

/// Where and as whom to log in.
struct Login {
    transport::Endpoint endpoint;  ///< of no use where there is a router
    std::string user, password, display_name;
    std::uint64_t attempt = 0;
    Duration timeout{};
    /// Of the session before, tried last; null: there is none.
    std::shared_ptr<Ice::Endpoint> lost_router = {};
};

/// Two sessions with a server, joined: data and signals, each over a connection of its communicator
/// (handshake: docs/reference/sessions.md).
///
/// Where in the flow: between Session and the network; the only file of the client that knows Ice's proxies.
/// States: open from open() until closed() is reported or leave() or drop() is called; what is sent later is
/// dropped. Threads: any (add() and write(): one at a time). Sends do not wait: they go to the socket from
/// the caller's thread or into the lane's outbox, whose overflow ends the connection. Failure: a failed
/// handshake is a refusal and leaves nothing behind.
class ServerConnection final : public DataLane, public StopLanes {
  public:
    /// `clock` outlives `events`.
    static Result<std::shared_ptr<const ServerConnection>> open(
        const LaneHome& data, const LaneHome& signal, const Login& login,
        const std::shared_ptr<ConnectionEvents>& events, const Clock& clock);

    const Sender& me() const { return me_; }
    int entities() const { return entities_; }
    /// Where the data lane leads: of a router, for Login::lost_router.
    std::shared_ptr<Ice::Endpoint> endpoint() const;
    const Watchdogs& watchdogs() const { return watchdogs_; }
    std::uint64_t attempt() const { return attempt_; }

    void send(Operation operation, const Header& head, std::string bytes) const override;
    void add(Operation operation, const Header& head, std::string bytes) const override;
    void write() const override;

    void sendStopSignal(Lane lane, const Header& head, StopCause cause) const override;
    void sendStopSignals(Lane lane, const Header& head, const std::vector<std::string>& entities,
                         StopCause cause) const override;
    void keepAlive(std::int64_t sequence) const;
    std::size_t waiting() const override { return backlog_->messages(); }
    std::size_t waitingBytes() const override { return backlog_->bytes(); }
    void awaitRoom(Duration wait) const override { backlog_->awaitLittle(wait); }
    /// The other end of the data lane, or the router's: "192.168.0.9:50122".
    std::string peer() const { return data_.connection->peer(); }
    /// Also for what goes by the direct paths of this session.
    const std::shared_ptr<Backlog>& backlog() const { return backlog_; }

    /// Orderly: the server releases what is held. Waits for its answer, at most a second.
    void leave() const;
    /// At once, without a word.
    void drop() const;

  private:
    struct LaneEnd {
        std::shared_ptr<transport::DirectConnection> connection;        // to the server, or to the router
        std::shared_ptr<Axon::FrontEndComm::ClientSessionPrx> session;  // twoway
        std::shared_ptr<Axon::FrontEndComm::ClientSessionPrx> oneway;
        std::shared_ptr<Axon::FrontEndComm::ClientSessionPrx> batch;  // oneway; write() flushes them
        std::shared_ptr<Axon::FrontEndComm::ClientSessionPrx> paced;  // twoway, without a time limit
        std::shared_ptr<Axon::FrontEndComm::ClientCallbackPrx> callback;
        std::shared_ptr<transport::Outbox> outbox;
    };
    /// `token`: of the other lane; empty for the first.
    static LaneEnd openLane(const LaneHome& home, transport::OutboxLimits limits, const std::string& endpoint,
                            const std::string& token, const Login& login,
                            const std::shared_ptr<ConnectionEvents>& events,
                            const std::shared_ptr<transport::AnsweredBeats>& beats);
    void sendResetSignal(const Header& head) const;
    void sendClearSignal(const Header& head) const;

    LaneEnd data_, signal_;
    mutable std::vector<transport::SendCallbacks> added_;  // and not yet written; of the thread that adds
    // Shared with the messages that wait: each takes itself off, sent or dropped.
    const std::shared_ptr<Backlog> backlog_ = std::make_shared<Backlog>();
    Sender me_;
    int entities_ = 0;
    Watchdogs watchdogs_;
    std::uint64_t attempt_ = 0;
    bool routed_ = false;
    std::shared_ptr<transport::AnsweredBeats> beats_;  // of use through a router; shared with the calls
};

}  // namespace axon::client
