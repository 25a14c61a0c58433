// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <functional>
#include <mutex>
#include <string>
#include <unordered_map>
#include <vector>

#include "common/clock.hpp"
#include "common/neighbours.hpp"
#include "common/rate_limit.hpp"
#include "common/refusal.hpp"
#include "common/routed.hpp"
#include "entity_server/ports/ports.hpp"

namespace axon::entity_server {

/// OVERLOADED, of the entity that this message is for.
Refusal slowEntity(const Header& head);

/// Answers for messages that do not get to their entity, and what the log says of them.
///
/// What a client sends to an entity that is not here, or that takes no more of this client's messages, is
/// refused to it on the lane it came by. One of several servers says nothing of what came by the topic for an
/// entity that is not here: another one may have it. Data is not answered message by message: a client that
/// streams to an entity that left is told once a second. The log names those who send a slow entity too much,
/// in at most 20 lines a second.
///
/// Threads: any. unknownData() takes a mutex of its own, under which nothing is called; the others take none.
/// Bound: 4096 senders of data are remembered. Failure: none.
class Undelivered {
  public:
    using Note = std::function<void(const std::string& line)>;

    /// `alone`: it is the only entity server.
    Undelivered(bool alone, const Clock& clock, FrontEndTopic& topic, Note note);

    /// `head.entity` is not here.
    void unknown(Lane lane, const Header& head, Via via = Via::Topic);
    void unknownData(const Header& head, Via via);
    /// It takes no more of `head.sender`.
    void slow(Lane lane, const Header& head);
    /// Signals, each of these entities.
    void slow(const Header& head, const std::vector<std::string>& entities);
    /// The log alone: the sender is told otherwise.
    void noteSlow(const Header& head);

  private:
    bool toldLately(const std::string& sender);

    const bool alone_;
    const Clock& clock_;
    FrontEndTopic& topic_;
    const Note note_;
    RateLimit lines_;

    std::mutex mutex_;
    std::unordered_map<std::string, TimePoint> told_;  // guarded by mutex_: whose data, and when
};

}  // namespace axon::entity_server
