// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/profile.pb.h>

#include <optional>
#include <string>
#include <vector>

#include "common/liveness.hpp"
#include "common/routed.hpp"
#include "entity_manager/core/turn/turn.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::proto {
class EntityStatus;
class PositionNote;
}  // namespace axon::proto

namespace axon::entity_manager {

/// The entity as the server has it: the session and whether the server is heard, what the entity is
/// registered as, its position, and which status was told last.
///
/// It judges the server's silence (safety.md, "Watchdogs"); what a lost server means for the robot is a row
/// of the state table.
class Presence final : public Owner {
  public:
    struct Settings {
        std::string entity;       ///< its UUID
        std::string application;  ///< the name until the profiles have been good
        Duration watchdog_busy;
        Duration watchdog_idle;
    };
    Presence(Turn& turn, ServerPort& server, const Settings& settings);

    // The session.

    bool connected() const { return up_; }
    /// Wants a session; gives up one that has fallen silent, so that a new one can be made. Where there is
    /// one already, fires ServerUp or ServerReturned.
    void seek();
    /// Fires ServerUp, or ServerReturned where a lease has outlived the last session; before it ServerDown
    /// where another session still counted.
    void sessionBegan();
    /// There is no longer a session, or none that counts; why. Fires ServerDown.
    void sessionEnded(const std::string& reason);
    void up();
    void down() { up_ = false; }
    /// On any thread; takes no lock.
    void heard();
    /// What the server allows for depends on whether the status it knows is BUSY. Call after every event.
    void setBusy(bool busy);
    /// For people: how long the server has been silent, once that is too long.
    std::optional<std::string> whySilent();
    /// Ends the session of a silent server, and warns of one that is heard late; sends a position that had to
    /// wait.
    void onTimer() override;
    TimePoint nextDeadline() const override;
    /// The longest silence of late; nothing without a session.
    std::optional<HopMargin> margin() const;
    /// With those of `others`, its own before them.
    void describeWatchdogs(std::vector<HopMargin> others, proto::EntityStatus& status) const;

    // What the server knows.

    /// The name for people, of the profile; empty before there has been one.
    const std::string& name() const { return profile_.name(); }
    /// Whether profiles have been good.
    bool ready() const { return ready_; }
    /// Good profiles have come.
    void profileIs(proto::BasicProfile profile);
    /// Without a profile it is registered as one that is not ready (ADR 0023).
    void registerEntity();
    void positionIs(const proto::PositionNote& position);
    /// Tells it where it is not the one that was told last. Between two steps of a run an entity rests for a
    /// moment, which is told only if it lasts.
    void tell(EntityStatus status);

  private:
    Event upEvent() const;
    TimePoint warnAt() const;
    void sendPosition();

    Turn& turn_;
    ServerPort& server_;
    const std::string entity_;
    bool up_ = false;
    bool silent_ = false;
    Liveness liveness_;  ///< of the server
    TimePoint warn_again_{};

    Registration registration_;
    proto::BasicProfile profile_;
    bool ready_ = false;
    TimePoint position_sent_{};
    bool position_waits_ = false;
    std::optional<EntityStatus> told_;
    std::optional<TimePoint>
        rest_told_at_;  ///< when it is told that a step has ended, if no other has begun by then
};

}  // namespace axon::entity_manager
