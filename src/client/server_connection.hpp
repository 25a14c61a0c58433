// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>
#include <axon/frontendcomm.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "client/backlog.hpp"
#include "client/server_link.hpp"
#include "common/clock.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"
#include "direct/incoming_way.hpp"
#include "transport/endpoint.hpp"
#include "transport/outbox.hpp"
#include "transport/peer_connection.hpp"

namespace axon::client {

/// What arrives over one ServerConnection; `attempt` is its number. On Ice's threads: data and signal lane at
/// the same time, each in order.
class ConnectionEvents {
  public:
    virtual ~ConnectionEvents() = default;
    virtual void newProfile(std::uint64_t attempt, Presence presence, const Registration& registration,
                            std::string_view profile) = 0;
    virtual void newStatus(std::uint64_t attempt, const EntityStatus& status) = 0;
    virtual void newServiceRecord(std::uint64_t attempt, const Header& head, std::string_view record) = 0;
    /// `lane`: where it came, and `keeping` of what was sent on the data lane.
    virtual void newEntityMsg(std::uint64_t attempt, Lane lane, direct::Keeping keeping, const Header& head,
                              std::string_view message) = 0;
    virtual void newRefusal(std::uint64_t attempt, const Header& head, const Refusal& refusal) = 0;
    virtual void newStopAccepted(std::uint64_t attempt, const Header& head, int entities) = 0;
    virtual void newServerText(std::uint64_t attempt, int code, const std::string& text) = 0;
    virtual void newServerHeartbeat(std::uint64_t attempt) = 0;
    /// One of the two connections has ended. May come before open() has returned.
    virtual void closed(std::uint64_t attempt, const std::string& reason) = 0;
};

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
};

/// Two sessions with a server, joined: data and signals, each over a connection of its communicator
/// (handshake: docs/reference/sessions.md).
///
/// Where in the flow: between Session and the network; the only file of the client that knows Ice's proxies.
/// States: open from open() until closed() is reported or leave() or drop() is called; what is sent later is
/// dropped. Threads: any (Part: one at a time). Sends do not wait: they go to the socket from the caller's thread or into the
/// lane's outbox, whose overflow ends the connection. Failure: a failed handshake is a refusal and leaves
/// nothing behind.
class ServerConnection {
  public:
    static Result<std::shared_ptr<const ServerConnection>> open(
        const LaneHome& data, const LaneHome& signal, const Login& login,
        const std::shared_ptr<ConnectionEvents>& events);

    const Sender& me() const { return me_; }
    int entities() const { return entities_; }
    const Watchdogs& watchdogs() const { return watchdogs_; }
    std::uint64_t attempt() const { return attempt_; }

    using Operation = client::Operation;
    void send(Operation operation, const Header& head, std::string bytes) const;

    /// Small messages that go to the socket together: one system call for all of them here, and one turn of a thread
    /// at the server. They are on their way when write() or the destructor returns. Only one part at a time, and whose
    /// order with it matters waits for it (Session's send mutex); stops pass it.
    class Part {
      public:
        explicit Part(std::shared_ptr<const ServerConnection> connection) : connection_(std::move(connection)) {}
        ~Part() { write(); }
        Part(const Part&) = delete;
        Part& operator=(const Part&) = delete;
        const ServerConnection* of() const { return connection_.get(); }
        /// Of the data lane.
        void add(Operation operation, const Header& head, std::string bytes);
        void write();

      private:
        const std::shared_ptr<const ServerConnection> connection_;
        std::vector<transport::SendCallbacks> added_;  // and not yet written
    };

    void sendStopSignal(Lane lane, const Header& head, StopCause cause) const;
    void sendStopSignals(Lane lane, const Header& head, const std::vector<std::string>& entities,
                         StopCause cause) const;
    void keepAlive(std::int64_t sequence) const;
    /// Messages of the data lane that wait for the server to read, and their bytes.
    std::size_t waiting() const { return backlog_->messages(); }
    std::size_t waitingBytes() const { return backlog_->bytes(); }
    void awaitRoom(Duration wait) const { backlog_->awaitLittle(wait); }
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
        std::shared_ptr<Axon::FrontEndComm::ClientSessionPrx> batch;  // oneway; Part writes them
        std::shared_ptr<Axon::FrontEndComm::ClientSessionPrx> paced;  // twoway, without a time limit
        std::shared_ptr<Axon::FrontEndComm::ClientCallbackPrx> callback;
        std::shared_ptr<transport::Outbox> outbox;
    };
    /// `token`: of the other lane; empty for the first.
    static LaneEnd openLane(const LaneHome& home, transport::OutboxLimits limits, const std::string& endpoint,
                            const std::string& token, const Login& login,
                            const std::shared_ptr<ConnectionEvents>& events);
    void sendResetSignal(const Header& head) const;
    void sendClearSignal(const Header& head) const;

    LaneEnd data_, signal_;
    // Shared with the messages that wait: each takes itself off, sent or dropped.
    const std::shared_ptr<Backlog> backlog_ = std::make_shared<Backlog>();
    Sender me_;
    int entities_ = 0;
    Watchdogs watchdogs_;
    std::uint64_t attempt_ = 0;
    bool routed_ = false;
    /// Through a router: a sign of life is on its way whose answer says that the server is there.
    const std::shared_ptr<std::atomic<bool>> asked_ = std::make_shared<std::atomic<bool>>(false);
};

}  // namespace axon::client
