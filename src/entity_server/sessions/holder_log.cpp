// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/sessions/holder_log.hpp"

#include <utility>

namespace axon::entity_server {

bool isTaken(const EntityStatus& before, const EntityStatus& now) {
    if (before.holder.id.empty() || before.holder.id == now.holder.id) return false;
    if (!now.holder.id.empty()) return now.held != before.held;
    return now.state == EntityState::IDLE && !now.reason.empty();
}

std::string HolderLog::line(const std::string& name, const EntityStatus& before, const EntityStatus& now,
                            TimePoint at) {
    if (before.holder.id == now.holder.id) return {};
    if (!lines_.admit(at)) {
        ++left_out_;
        return {};
    }
    std::string line;
    if (isTaken(before, now)) {
        line = "audit: " + name + " is taken from " + before.holder.name +
               (now.holder.id.empty() ? ": " + now.reason : " by " + now.holder.name);
    } else if (!before.holder.id.empty() && !now.holder.id.empty()) {
        line = now.holder.name + " goes on with its lease of " + name;
    } else if (!now.holder.id.empty()) {
        line = name + " is checked out by " + now.holder.name;
    } else {
        line = name + " is free, released by " + before.holder.name;
    }
    if (const auto left_out = std::exchange(left_out_, 0); left_out > 0)
        line +=
            " (" + std::to_string(left_out) + " changes of its holder before this one are not in the log)";
    return line;
}

}  // namespace axon::entity_server
