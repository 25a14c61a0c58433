// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <deque>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <unordered_map>

#include "common/clock.hpp"
#include "common/pace.hpp"
#include "common/routed.hpp"
#include "entity_server/ports/ports.hpp"
#include "entity_server/publishing/record.hpp"

namespace axon::entity_server {

/// Tells the front-end servers of entities, and the other servers of this one: by levels, what holds now
/// compared with what was told last.
///
/// set() and left() note what holds; publishPending() tells all that differs. One thread publishes at a time,
/// so that others hear of one entity in order though no lock is held while they are told; a thread that finds
/// another one publishing goes, and that one tells its news, too. An entity that changes faster than all
/// clients are told is left out until its pause is over, and what is told then is what holds by then. The
/// list of all entities, and this server's word of itself, come when everything about entities has been said:
/// its count tells a front-end server whether it has heard everything before it.
///
/// Threads: any; a mutex of its own, under which nothing is called. Calls of set() and left() about one
/// entity come one after the other. Bound: each entity waits once. Failure: none.
class Publisher {
  public:
    using Note = std::function<void(const std::string& line)>;

    /// `self` outlives it; without a name it is the only server. `wake` is called when endPauses() is due
    /// earlier than nextPause() said.
    Publisher(const ServerAnnouncement& self, const Clock& clock, FrontEndTopic& topic, Note note,
              std::function<void()> wake);

    /// The entity of its registration is here.
    void set(RecordRef now);
    void left(const std::string& entity);
    /// Everything again, and, as one of several servers, a list of it all.
    void again();
    /// This server's word of itself.
    void announce();
    /// Entities whose pause is over wait to be published from now on. Returns whether there may be any.
    bool endPauses();
    TimePoint nextPause() const;

    void publishPending();

  private:
    struct Level {
        RecordRef now;   // null: it has left
        RecordRef told;  // null: nobody has heard of it
        std::optional<Pace> pace;
        bool waits = false;
        bool again = false;  // tell it though nothing has changed
    };

    void queue(const std::string& entity, Level& level, bool again);
    bool isPaced(const std::string& entity, Level& level);
    void publishFront(std::unique_lock<std::mutex>& lock);
    void publishSummary(std::unique_lock<std::mutex>& lock);
    void publish(const std::string& entity, const RecordRef& before, const RecordRef& now, bool again);

    const ServerAnnouncement& self_;
    const Clock& clock_;
    FrontEndTopic& topic_;
    const Note note_;
    const std::function<void()> wake_;

    // Confined to whoever publishes:
    std::int64_t publications_ = 0;

    mutable std::mutex mutex_;
    // Guarded by mutex_:
    std::unordered_map<std::string, Level> levels_;
    std::deque<std::string> queue_;
    std::unordered_map<std::string, TimePoint> paused_;  // to be published later
    TimePoint next_pause_ = TimePoint::max();
    bool list_due_ = false;
    bool announcement_due_ = false;
    bool publishing_ = false;
};

}  // namespace axon::entity_server
