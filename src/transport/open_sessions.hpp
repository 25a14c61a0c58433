// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <deque>
#include <memory>
#include <mutex>
#include <set>
#include <string>

#include "common/clock.hpp"
#include "common/result.hpp"

namespace axon::transport {

/// The sessions that have been opened: one for each connection (PeerConnection::key()), and each must be
/// taken into use (`ready()`) within ten seconds or is disconnected. Threads: any.
template <class Servant>
class OpenSessions {
  public:
    static constexpr std::chrono::seconds kSetUpTime{10};

    explicit OpenSessions(const Clock& clock) : clock_(clock) {}

    Result<void> add(const void* connection, const std::shared_ptr<Servant>& servant) {
        const std::lock_guard lock(mutex_);
        if (!connections_.insert(connection).second) {
            return Refusal{RefusalCode::Duplicate,
                           "this connection has a session already; open another connection for another one",
                           {}};
        }
        opening_.push_back({clock_.now() + kSetUpTime, servant});
        return {};
    }

    void remove(const void* connection) {
        const std::lock_guard lock(mutex_);
        connections_.erase(connection);
    }

    /// Disconnects those that are late; returns when the next one will be, at most a second ahead.
    TimePoint expire() {
        const auto now = clock_.now();
        auto next = now + std::chrono::seconds{1};
        while (true) {
            std::shared_ptr<Servant> late;
            {
                const std::lock_guard lock(mutex_);
                if (opening_.empty() || opening_.front().deadline > now) {
                    if (!opening_.empty()) next = std::min<TimePoint>(next, opening_.front().deadline);
                    return next;
                }
                late = opening_.front().servant.lock();
                opening_.pop_front();
            }
            if (late && !late->ready()) late->disconnect("it opened a session and did not use it");
        }
    }

  private:
    struct Opening {
        TimePoint deadline;
        std::weak_ptr<Servant> servant;
    };
    const Clock& clock_;
    std::mutex mutex_;
    std::set<const void*> connections_;             // guarded by mutex_
    std::deque<Opening> opening_;                   // guarded by mutex_, earliest first
};

}  // namespace axon::transport
