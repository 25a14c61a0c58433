// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <memory>
#include <optional>
#include <queue>

#include "common/clock.hpp"
#include "entity_server/sessions/session.hpp"

namespace axon::entity_server {

/// When the timer is to look at which session next. Each has one time, the one that was given last; one that
/// is gone has none. Not thread-safe: the core's mutex guards it. Failure: none.
class DueSessions {
  public:
    void schedule(const SessionRef& session, TimePoint at) { due_.push({at, ++session->revision, session}); }
    /// One whose time has come, the earliest first, which has none then; null where there is none.
    SessionRef take(TimePoint now) {
        while (!due_.empty() && due_.top().at <= now) {
            const auto due = due_.top();
            due_.pop();
            auto session = due.session.lock();
            if (session && !session->gone && session->revision == due.revision) return session;
        }
        return nullptr;
    }
    /// Not later than the next time at which take() may return a session; none where nothing is scheduled.
    std::optional<TimePoint> next() const {
        return due_.empty() ? std::nullopt : std::optional(due_.top().at);
    }

  private:
    struct Due {
        TimePoint at;
        std::uint64_t revision;
        std::weak_ptr<Session> session;
        bool operator<(const Due& other) const { return at > other.at; }  // earliest on top
    };
    std::priority_queue<Due> due_;
};

}  // namespace axon::entity_server
