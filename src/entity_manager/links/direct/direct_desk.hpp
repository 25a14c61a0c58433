// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <list>
#include <memory>
#include <string>
#include <utility>

#include "common/clock.hpp"
#include "direct/incoming_way.hpp"
#include "direct/outgoing_way.hpp"
#include "entity_manager/core/turn/lease_book.hpp"
#include "entity_manager/ports/direct_lane.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// Which way messages go between the core and the holder of the lease: by the servers, or by the direct path
/// that the holder has opened (ADR 0021).
///
/// Where in the flow: between EntityManagerCore and EntityCommunicator, as the core's ServerPort; what comes
/// by either way goes through relayed() and arrived() before the core hears of it. The core knows nothing of
/// it. States, for each lease: relayed ─ two openings with the right proof ► direct ─ silence, a closed
/// connection, too much unacknowledged ► relayed. The end of the lease ends the path; so do the loss of the
/// holder, who then has no session, and that of the server: what was not acknowledged is lost then, as what
/// is under way between the servers is. Threads: the strand's alone. Time: call onTimer() at nextDeadline().
/// Failure: what cannot be opened is refused, logged once a minute at most, and everything goes by the
/// servers as ever.
class DirectDesk final : public ServerPort {
  public:
    /// A line for the operator's log.
    using Log = std::function<void(bool warning, const std::string& line)>;
    DirectDesk(const Clock& clock, RelayedWay& server, Log log);
    ~DirectDesk() override;
    /// Before anything else: the UUID, which only the core knows that is made after this.
    void setEntity(std::string uuid) { entity_ = std::move(uuid); }

    /// Who holds the entity now; a path of somebody else ends. Cheap when nothing has changed.
    void hold(const LeaseBook::Held* held);
    void serverDown();
    /// The Entity Manager ends, and the path with it.
    void close();

    /// `held`: null when nobody is to be let in.
    void onOpening(const DirectOpening& opening, const LeaseBook::Held* held);
    void onClosed(const Id128& path, const std::string& why);

    /// When the client will have been silent for too long, or a mark or an answer has not come in time. Beats
    /// move it, and where they come faster from now on (DirectEvents::directPace), to an earlier time.
    TimePoint nextDeadline() const;
    void onTimer();

    using Deliver = std::function<void(const Header& head, const std::string& bytes)>;
    /// A message of a client or a peer that came by the servers: whether the core is to hear of it. A mark
    /// makes `deliver` be called for what was held back.
    bool relayed(direct::Keeping keeping, const Header& head, const std::string& bytes,
                 const Deliver& deliver);
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
    struct Came {
        Header head;
        std::string bytes;
    };
    struct Path {
        Id128 number;
        LeaseNumber lease;
        Sender holder;
        direct::IncomingWay<Came>* in = nullptr;  // of rows_
        std::shared_ptr<DirectSigns> signs;
        std::shared_ptr<DirectLane> data, signal;
        TimePoint mark_due = TimePoint::max();                // while something is held back
        TimePoint asked_at{}, answer_due = TimePoint::max();  // while something is not acknowledged
    };
    struct Sent {
        Header head;
        std::shared_ptr<const std::string> message;
    };
    enum class Rest : std::uint8_t { SendAgain, Forget };
    void begin();
    void end(const std::string& why, Rest rest);
    void ask();
    void acknowledge();

    const Clock& clock_;
    RelayedWay& server_;
    const Log log_;
    std::string entity_;

    std::unique_ptr<Path> path_;
    direct::OutgoingWay<Sent> out_;
    /// Of a client that has opened a path: kept when the path and the lease are over, for what it then sends
    /// again, which may come when the next holder has its own.
    struct Row {
        std::string client;
        direct::IncomingWay<Came> in;
    };
    Row& rowOf(const std::string& client);
    std::list<Row> rows_;  // whoever opened one last is the last; kRows at most
    direct::Unacknowledged unacknowledged_;
    TimePoint warn_from_{};
};

}  // namespace axon::entity_manager
