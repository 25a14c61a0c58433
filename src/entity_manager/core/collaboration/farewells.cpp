// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/collaboration/farewells.hpp"

#include <algorithm>

#include "collaboration/collaboration.hpp"

namespace axon::entity_manager {

void Farewells::sent(const std::string& entity, const proto::FromMaster& end, Duration every, TimePoint now) {
    if (open_.size() == kMax) return;
    Farewell farewell{.entity = entity};
    farewell.every = every;
    farewell.again = now + every;
    // Who does not hear a stop misses the beats.
    farewell.until = now + (end.end().stop() ? 2 * watchdog_ : collaboration::Pace{}.answer_within);
    farewell.message.set_run_id(end.run_id());
    if (end.end().stop())
        farewell.message = end;
    else
        farewell.message.mutable_beat();
    open_.push_back(std::move(farewell));
}

void Farewells::answered(const std::string& entity, const std::string& run_id) {
    std::erase_if(open_, [&](const Farewell& farewell) {
        return farewell.entity == entity && farewell.message.run_id() == run_id;
    });
}

void Farewells::unreachable(const std::string& entity) {
    std::erase_if(open_, [&](const Farewell& farewell) { return farewell.entity == entity; });
}

std::vector<std::pair<std::string, proto::FromMaster>> Farewells::takeDue(TimePoint now) {
    std::erase_if(open_, [&](const Farewell& farewell) { return now >= farewell.until; });
    std::vector<std::pair<std::string, proto::FromMaster>> due;
    for (auto& farewell : open_) {
        if (now < farewell.again) continue;
        farewell.again = now + farewell.every;
        due.emplace_back(farewell.entity, farewell.message);
    }
    return due;
}

TimePoint Farewells::nextDeadline() const {
    auto next = TimePoint::max();
    for (const auto& farewell : open_) next = std::min(next, farewell.again);
    return next;
}

}  // namespace axon::entity_manager
