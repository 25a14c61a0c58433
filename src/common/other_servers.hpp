// SPDX-License-Identifier: MIT
#pragma once
#include <atomic>
#include <deque>
#include <functional>
#include <map>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/neighbours.hpp"
#include "common/routed.hpp"

namespace axon {

/// One of several servers among the others: when it says that it lives, and whom it hears of each other kind.
///
/// Where in the flow: a server's core hands every announcement that comes in to the Group of its kind, and
/// calls onTimer() from its own timer. It says that it lives straight to each server that is reached, every
/// 50 ms and at once when somebody is new, whose watchdog is short only from then on; and by the topic, every
/// second and when announceSoon() or a Kind asks for it.
///
/// Threads: what Neighbours has, any. onTimer() one, announceSoon() any. Failure: none.
class OtherServers {
  public:
    /// What differs between the kinds. onTimer() calls these; a null one is left out.
    struct Kind {
        std::string name;  ///< for people: "entity server"
        Neighbours::Timeouts timeouts;
        /// Whom signals are sent to directly from now on.
        std::function<void(const std::vector<ServerAnnouncement>&)> reach = {};
        /// They fell silent, refuse connections, or started anew. Called before anything is said to anybody:
        /// for what stops robots.
        std::function<void(const std::vector<std::string>&)> lost = {};
        /// The same news, when everything has been said: for what may take a while.
        std::function<void(const std::vector<std::string>&)> left = {};
        /// It is there, or there again. Called when everything has been said, after `left`.
        std::function<void(const std::string&)> arrived = {};
        /// Who has arrived needs the announcement by the topic at once.
        bool waits_for_announcement = false;
    };
    /// The servers of one kind, and how many of our tasks hang on each.
    class Group : public Neighbours {
      public:
        explicit Group(Kind kind) : Neighbours(kind.timeouts), kind_(std::move(kind)) {}
        /// A task that hung on server `was` hangs on server `is` now; empty: on none. Calls come one at a
        /// time.
        void moveTask(const std::string& was, const std::string& is, TimePoint now);

      private:
        friend class OtherServers;
        const Kind kind_;
        std::map<std::string, int> tasks_;  // by server
    };
    using Note = std::function<void(const std::string& line)>;

    /// `name`: of this server; empty where it is the only one, and then nothing happens here. `say` says that
    /// it lives: straight on the signal lane, by the topic on the data lane.
    OtherServers(std::string name, RandomSource& random, Note note, std::function<void(Lane)> say);
    /// Before anything else is called. What it returns stays where it is.
    Group& add(Kind kind);

    /// This server, as it announces itself; the instance is new at every start.
    const ServerAnnouncement& self() const { return self_; }
    /// By the topic, together with the next sign of life.
    void announceSoon() { announce_soon_ = true; }
    /// Returns when it wants to be called again.
    TimePoint onTimer(TimePoint now);

  private:
    const ServerAnnouncement self_;
    const Note note_;
    const std::function<void(Lane)> say_;
    std::deque<Group> groups_;
    std::atomic<bool> announce_soon_{false};
    // Confined to the timer's thread:
    TimePoint next_beat_;
    TimePoint next_announcement_;
};

}  // namespace axon
