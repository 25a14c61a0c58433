// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>
#include <axon/profile.pb.h>

#include <functional>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/refusal.hpp"
#include "entity_manager/core/presence/readiness.hpp"
#include "entity_manager/core/services/service_profiler.hpp"
#include "entity_manager/core/turn/incident.hpp"
#include "entity_manager/core/turn/turn.hpp"
#include "entity_manager/ports/later.hpp"
#include "entity_manager/ports/ports.hpp"
#include "messages/profile_reader.hpp"

namespace axon::entity_manager {

/// The profiles that the robot application uploads, until they are good and the ServiceProfiler has them:
/// which have come, what is wrong or missing, where the files of their resources lie, and which services the
/// application has switched off. What is uploaded while somebody holds the entity is kept for its release,
/// since the services that a holder was granted do not change under its hands. Threads: the core's strand.
/// Bounded: one kept profile of each kind, 1024 services whose activity is remembered by name.
class Profiles final : public Owner {
  public:
    struct Settings {
        std::string entity;       ///< its UUID
        std::string application;  ///< for people
        Duration within;          ///< after the link is up; then what has not been uploaded is missing
    };
    /// What it asks of other owners.
    class Others {
      public:
        virtual ~Others() = default;
        /// The services of a profile have been loaded: whatever else goes by it is told, and ProfilesGood
        /// fired.
        virtual void profilesAreGood(const proto::BasicProfile& basic) = 0;
        /// Tells the server how the entity is, where that has changed.
        virtual void tellStatus() = 0;
        /// For the operator's log: what is as it should be.
        virtual void tellNews(std::string text) = 0;
    };
    Profiles(Turn& turn, Others& others, Readiness& readiness, ResourceStore& store,
             ServiceProfiler& profiler, Settings settings);

    // Actions of the state table.

    /// A link begins without profiles.
    void await();
    /// Fires ProfilesBad, or, now or when the store has answered, ProfilesGood.
    void consider();
    /// What is wrong, to the application.
    void report();

    // The application.

    void linkUp() { active_told_.clear(); }
    void linkDown();
    void uploaded(proto::ProfileUpload& upload);
    void activeIs(const proto::ServiceActive& told);
    /// What was kept, where the state admits it.
    void takeKept();

    // The store.

    /// Files that the robot's owner puts in their places come without a word.
    void lookAgain();
    void onStored();

    void onTimer() override;
    TimePoint nextDeadline() const override;

  private:
    /// For the application's log; OK where nothing is wrong.
    void answer(const Refusal& refusal);
    void read(const proto::ProfileUpload& upload);
    void keep(proto::ProfileUpload& upload);
    void takeGood();
    void takeLook();
    void amiss(std::string why);

    Turn& turn_;
    Others& others_;
    Readiness& readiness_;
    ResourceStore& store_;
    ServiceProfiler& profiler_;
    const Settings settings_;

    std::optional<Reading<proto::BasicProfile>> basic_;
    std::optional<Reading<proto::ServicesProfile>> services_;
    ResourceRoots roots_;  ///< that came with it
    std::string amiss_;    ///< what was wrong last
    /// Where the files of its resources lie: asked before it is used, and again while it is.
    std::optional<Later<std::vector<ResourcePlace>>> located_, located_again_;
    std::optional<TimePoint> due_;  ///< in INIT: what has not been uploaded by then is missing
    /// Uploaded while the entity was held: by whether it is the services profile.
    std::map<bool, proto::ProfileUpload> kept_;
    /// By the application since its link is up: on or off, and why.
    std::map<std::string, std::pair<bool, std::string>, std::less<>> active_told_;
};

}  // namespace axon::entity_manager
