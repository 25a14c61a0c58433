// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <set>
#include <string>
#include <string_view>
#include <unordered_map>
#include <vector>

#include "axon/types.hpp"
#include "client/core/core_context.hpp"
#include "client/core/name_index.hpp"
#include "client/core/requests.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"

namespace axon::proto {
class EntityStatus;
class Position;
}  // namespace axon::proto

namespace axon::client {

/// The entities that the server has reported: what every client may see of each, what people call them, and
/// which of those that this client holds are moving. Part of SessionCore.
///
/// An entity is *there* for the program once its profile and its status have come, whichever was first. All
/// are forgotten when the connection is lost, until the server tells of them again.
class Entities {
  public:
    explicit Entities(const CoreParts& parts) : parts_(parts) {}

    // Events.
    /// `promised`: how many entities there are, which the server will report.
    void onConnected(int promised);
    void onDisconnected();
    /// Presence::Joined and Changed.
    void onProfile(const Registration& registration, std::string_view profile);
    void onLeft(const std::string& id);
    /// Whether it is there now and was not before; then the observer has been told.
    bool onStatus(const EntityStatus& status);
    /// What the entity itself says.
    void onOwnStatus(const std::string& id, const proto::EntityStatus& status);
    /// The answer to fetchDetails().
    void onDetails(Id128 request, const proto::EntityStatus& status);
    void onGranted(const std::string& id, std::int32_t stop_generation, bool latched);
    /// This session asks for a check-out of it.
    void onAskedFor(const std::string& id);
    /// After each change of its state or its lease.
    void countMoving(const std::string& id);
    /// To the observer, where it knows the entity.
    void tellChanged(const std::string& id);

    // What is known.
    std::vector<Entity> list(Listed listed = Listed::Ready) const;
    Result<Entity> find(std::string_view name) const;
    Result<Entity> entity(const std::string& id) const;
    /// Null when nothing is known of it; it need not be there.
    const Entity* facts(const std::string& id) const;
    bool isThere(const std::string& id) const;
    Result<std::string> resolve(std::string_view name) const { return names_.resolve(name); }
    /// The shortest name that means only this entity.
    std::string label(const std::string& id) const { return names_.label(id); }
    /// Those that are there, in order of name.
    std::vector<const Entity*> all() const;
    /// Those whose profile has come, in no order.
    std::vector<const Entity*> announced() const;
    /// Every entity that was promised has been told of.
    bool complete() const { return present_ >= promised_; }
    /// Held by this client as far as is known here or as its entity says, and BUSY or driven otherwise.
    bool moving(const std::string& id) const { return moving_.contains(id); }
    bool anyMoving() const { return !moving_.empty(); }
    /// Of those the BUSY ones that the server takes for this client's.
    bool anyBusyForServer() const { return !busy_.empty(); }

    /// Asks the entity itself; no lease needed.
    void fetchDetails(const std::string& id, DetailsDone done);
    void fetchServices(const std::string& id, std::function<void(Result<std::vector<Service>>)> done);

  private:
    struct Known {
        Entity facts;
        bool announced = false;
        bool heard = false;                    // its status
        EntityState told = EntityState::UNAV;  // by the server; `facts` may be newer, by the entity itself
        bool there() const { return announced && heard; }
    };
    void join(const Known& known);
    void tellChanged(const Known& known);

    const CoreParts& parts_;
    NameIndex names_;  // of those that are there
    std::unordered_map<std::string, Known> entities_;
    int promised_ = 0;
    int present_ = 0;
    std::set<std::string> asked_;   // for a check-out, in this session
    std::set<std::string> moving_;  // held (countMoving), and BUSY or driven otherwise
    std::set<std::string> busy_;    // of those the BUSY ones that the server takes for this client's
};

}  // namespace axon::client
