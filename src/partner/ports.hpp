// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/profile.pb.h>

#include <cstdint>
#include <string>
#include <string_view>

#include "client/base/server_link.hpp"
#include "common/routed.hpp"

namespace axon::partner {

// What PartnerCore needs of the two laboratories. *Home* is the laboratory in which the entities are shown,
// *there* is the partner's, to which they belong. Called on the core's strand; nothing waits, and nothing
// calls back into the core before it returns.

/// An entity in both laboratories. At home it has another UUID, because only its own Entity Manager can
/// register that of the partner's (ADR 0024).
struct ShownEntity {
    std::string there;  ///< UUID in the partner's laboratory
    std::string home;   ///< UUID at home
    std::string name;   ///< at home: "b/PeopleBot"
};

/// The entity sessions at home, one for each entity that is shown.
class HomePort {
  public:
    virtual ~HomePort() = default;
    /// The UUID at home; the same for the same UUID there, at every start.
    virtual std::string uuidAtHome(std::string_view there) = 0;
    /// For whoever holds an entity there and is no client of this laboratory: an id of no client here.
    virtual std::string strangerAtHome(std::string_view id) = 0;
    /// From now on there is to be a session: PartnerCore::onHomeUp and onHomeDown report.
    virtual void join(const ShownEntity& entity) = 0;
    /// The session ends, and clients at home are told that the entity has left.
    virtual void leave(const std::string& home) = 0;
    /// The session is ended and opened again: the server was silent.
    virtual void renew(const std::string& home) = 0;
    /// While the session is up. A profile without a name: the entity is not ready.
    virtual void show(const Registration& registration, const proto::BasicProfile& profile) = 0;
    virtual void tellStatus(const EntityStatus& status) = 0;
    /// `head.entity`: UUID at home, `head.sender`: the recipient; `bytes`: an axon.proto.ToClient.
    virtual void toClient(Lane lane, const Header& head, const std::string& bytes) = 0;
    /// The same, for what may be dropped on the way, the oldest first.
    virtual void toClientDataSeq(const Header& head, const std::string& bytes) = 0;
};

/// Which session there. Each is opened once and has a number of its own; what is said of one that has ended
/// does nothing.
using SessionNumber = std::uint64_t;

/// The client sessions there: one that watches, one for stops of clients that have none, and one for each
/// client of home that uses an entity.
class TherePort {
  public:
    virtual ~TherePort() = default;
    enum class Use : std::uint8_t {
        Watch,  ///< it is told of entities and their statuses
        Stops,  ///< of clients without a session of their own; it is told of receipts only
        Visit   ///< of one client at home; it is told what is for that one
    };
    /// Answered by PartnerCore::onOpened or onRefused, on another turn of the strand.
    virtual void open(SessionNumber session, const std::string& display_name, Use use) = 0;
    /// Stops of clients without a session of their own go there, until it has ended. `shared`: only while
    /// there is none that is not; all that is shown depends on this session, so only so many pass that it
    /// does not end for them.
    virtual void stopsBy(SessionNumber session, bool shared) = 0;
    /// Signals of this client at home go there, until it has ended.
    virtual void visits(SessionNumber session, const Sender& client) = 0;
    /// False: too much waits for a server that does not read.
    virtual bool send(SessionNumber session, client::Operation operation, const Header& head,
                      std::string bytes) = 0;
    virtual void keepAlive(SessionNumber session, std::int64_t sequence) = 0;
    /// The orderly end: what is held is released.
    virtual void leave(SessionNumber session) = 0;
    /// Without a word: the client is lost, and its robots stop.
    virtual void drop(SessionNumber session) = 0;
};

}  // namespace axon::partner
