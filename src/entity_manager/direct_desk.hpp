// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <asio/any_io_executor.hpp>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "direct/incoming_way.hpp"
#include "direct/outgoing_way.hpp"
#include "entity_manager/direct_door.hpp"
#include "entity_manager/due_timer.hpp"
#include "entity_manager/entity_communicator.hpp"
#include "entity_manager/lease_book.hpp"

namespace axon::entity_manager {

/// The direct path at the Entity Manager (Axon.Direct).
struct DirectSettings {
    bool offered = false;
    std::string address;  ///< to listen at; empty: the one that leads to the server
    DirectPorts ports;
    /// What clients are told to call instead of "host:port" where it listens: a test puts a relay there. Empty: as it listens.
    std::function<std::string(const std::string& endpoint)> named = {};
};

/// Which way messages go between the core and the holder of the lease: by the servers, or by the direct path that the
/// holder has opened (ADR 0021).
///
/// Where in the flow: between EntityManagerCore and EntityCommunicator, as the core's ServerPort; what comes by either way goes
/// through relayed() and arrived() before the core hears of it. The core knows nothing of it. States: closed, or listening and
/// then for each lease: relayed ─ two openings with the right proof ► direct ─ silence, a closed connection, too much
/// unacknowledged ► relayed. The end of the lease ends the path; so do the loss of the holder, who then has no session, and that of the
/// server: what was not acknowledged is lost then, as what is under way between the servers is.
/// Threads: the strand's alone, which its timer comes on as well. Failure: what cannot be opened is refused, logged once a minute at most,
/// and everything goes by the servers as ever.
class DirectDesk final : public ServerPort {
  public:
    DirectDesk(asio::any_io_executor strand, const Clock& clock, EntityCommunicator& server);
    ~DirectDesk() override;

    /// Before anything else: from the next session with the server on it listens.
    void offer(DirectSettings settings, std::shared_ptr<ServerCommunicators> ice, std::string entity, std::weak_ptr<DirectEvents> events);
    bool offered() const { return settings_.offered; }

    /// There is a session with the server: listens at the address where the way there begins, or anew where that is
    /// another one than before. The endpoints to tell holders, data and signals; empty when there are none.
    std::pair<std::string, std::string> listen(const std::string& way_to_server);
    /// Who holds the entity now; a path of somebody else ends. Cheap when nothing has changed.
    void hold(const LeaseBook::Held* held);
    void serverDown();
    /// No path any more, and nobody is let in.
    void close();
    /// After close(), and on another thread: joins the threads of the door.
    void join() { doors_.clear(); }

    void onOpening(const DirectOpening& opening, const LeaseBook::Held* held);
    void onClosed(const Id128& path, const std::string& why);
    /// Beats come faster from now on: looks whether they do.
    void onPace(const Id128& path);

    using Deliver = std::function<void(const Header& head, const std::string& bytes)>;
    /// A message of a client or a peer that came by the servers: whether the core is to hear of it. A mark makes
    /// `deliver` be called for what was held back.
    bool relayed(direct::Keeping keeping, const Header& head, const std::string& bytes, const Deliver& deliver);
    /// By the direct path.
    bool arrived(const Id128& path, direct::Keeping keeping, Header& head, std::string& bytes);
    /// A path is open, and what is sent to its holder goes by it.
    bool direct() const { return path_ && out_.direct(); }

    // ServerPort.
    void wantConnection(bool wanted) override {
        if (!wanted) serverDown();
        server_.wantConnection(wanted);
    }
    void sendBasicPrfl(const Registration& registration, const proto::BasicProfile& profile) override {
        server_.sendBasicPrfl(registration, profile);
    }
    void sendStatus(const EntityStatus& status) override { server_.sendStatus(status); }
    void sendToClient(Lane lane, const Header& head, const proto::ToClient& message) override;
    void sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) override {
        server_.sendToPeer(lane, head, message);
    }
    void sendToClientDataSeq(const Header& head, const proto::ToClient& message) override;

  private:
    struct Path {
        Id128 number;
        LeaseNumber lease;
        Sender holder;
        std::shared_ptr<DirectSigns> signs;
        std::shared_ptr<DirectLane> data, signal;
        TimePoint mark_due = TimePoint::max();  // while something is held back
        TimePoint asked_at{}, answer_due = TimePoint::max();  // while something is not acknowledged
    };
    struct Sent {
        Header head;
        std::shared_ptr<const std::string> message;
    };
    struct Came {
        Header head;
        std::string bytes;
    };
    enum class Rest : std::uint8_t { SendAgain, Forget };
    void begin();
    void end(const std::string& why, Rest rest);
    void watch();
    void ask();
    void acknowledge();

    const asio::any_io_executor strand_;
    const Clock& clock_;
    EntityCommunicator& server_;
    DirectSettings settings_;
    std::shared_ptr<ServerCommunicators> ice_;
    std::string entity_;
    std::weak_ptr<DirectEvents> events_;

    /// The last is open, if `listens_at_` says so; an address that changes is rare, and an earlier one costs little.
    std::vector<std::unique_ptr<DirectDoor>> doors_;
    std::string listens_at_;
    std::unique_ptr<Path> path_;
    direct::OutgoingWay<Sent> out_;
    // Of the client that opened a path last: kept when the path and the lease are over, for what it then sends again.
    std::string client_;
    direct::IncomingWay<Came> in_;
    direct::Unacknowledged unacknowledged_;
    std::shared_ptr<bool> alive_ = std::make_shared<bool>(true);  // for the timer
    DueTimer silence_;
    TimePoint warn_from_{};
};

}  // namespace axon::entity_manager
