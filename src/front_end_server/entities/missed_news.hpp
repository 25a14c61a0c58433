// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <unordered_map>

#include "common/clock.hpp"
#include "common/neighbours.hpp"

namespace axon::front_end_server {

/// Whether everything that an entity server publishes by the topic has come: it says by each announcement how
/// many registrations and statuses it has published, and here they are counted. Where fewer came, it has to
/// be asked for everything (STATUS); and again with each announcement, until the answer has come whole, since
/// the question, too, may be lost. Not thread-safe. Bound: Neighbours::kMost servers.
class MissedNews {
  public:
    /// A registration or a status of this server has come by the topic.
    void heard(const std::string& server) {
        if (const auto found = heard_.find(server); found != heard_.end()) ++found->second;
    }
    /// The server has published so many. Returns whether to ask it now; the answer is awaited then.
    bool announced(const std::string& server, std::int64_t published, TimePoint now) {
        if (heard_.size() >= Neighbours::kMost && !heard_.contains(server)) return false;
        const auto [heard, is_new] = heard_.try_emplace(server, published);
        const auto asked = asked_.find(server);
        const bool unanswered = asked != asked_.end() && now - asked->second >= kAskAgain;
        if (!is_new && !unanswered && heard->second == published) return false;
        heard->second = published;
        asked_[server] = now;
        return true;
    }
    /// It is being asked, if it has announced itself before.
    void asked(const std::string& server, TimePoint now) {
        if (heard_.contains(server)) asked_[server] = now;
    }
    void askedAll(TimePoint now) {
        for (const auto& [server, published] : heard_) asked_[server] = now;
    }
    /// Its answer has come whole.
    void answered(const std::string& server) { asked_.erase(server); }

  private:
    // A little less than the second in which a server announces itself by the topic.
    static constexpr std::chrono::milliseconds kAskAgain{900};

    std::unordered_map<std::string, std::int64_t> heard_;  // server → registrations and statuses
    std::unordered_map<std::string, TimePoint> asked_;     // server → when, while its answer has not come
};

}  // namespace axon::front_end_server
