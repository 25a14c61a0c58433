// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>

#include "simulation/direct_liars.hpp"
#include "simulation/observer.hpp"
#include "simulation/server_station.hpp"
#include "simulation/timeline.hpp"

namespace axon::simulation {

/// A client that holds nothing and an entity, both logged in, that say whatever their sessions let them:
/// orders under leases of others, holders and states that are not, receipts, grants and ends of leases that
/// nobody gave, runs that nobody leads. They read what honest peers are told (ids, leases, generations) and
/// use it. What they must not cause is for the Observer to see. They give no stops and ask for no check-outs,
/// which are anybody's right.
///
/// They have no process and no network of their own: their messages are at the server's cores at once.
class Liars {
  public:
    /// Logs in at `from`, leaves at `until`.
    Liars(Timeline& timeline, Process& outside, ServerStation& server, Observer& observer,
          DirectLiars& direct, std::uint64_t seed, TimePoint from, TimePoint until);
    ~Liars();
    Liars(const Liars&) = delete;
    Liars& operator=(const Liars&) = delete;

  private:
    struct Ears;
    void logIn();
    void lie();
    void beat();
    void leave();
    void lieAsClient();
    void lieAsEntity();
    EntityStatus anyStatus();
    Header headTo(const EntityStatus& target, const char* msg_type);

    Timeline& timeline_;
    Process& outside_;
    ServerStation& server_;
    Observer& observer_;
    DirectLiars& direct_;
    Dice dice_;
    SeededRandom random_;
    const TimePoint until_;
    std::shared_ptr<Ears> ears_;
    front_end_server::FrontEndCore::ClientRef client_;
    entity_server::EntityServerCore::SessionRef entity_;
    std::string uuid_;
    std::int64_t sequence_ = 0;
};

}  // namespace axon::simulation
