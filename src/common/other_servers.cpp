// SPDX-License-Identifier: MIT
#include "common/other_servers.hpp"

#include <algorithm>

namespace axon {
namespace {

constexpr std::chrono::seconds kAnnounce{1};

}  // namespace

void OtherServers::Group::moveTask(const std::string& was, const std::string& is, TimePoint now) {
    if (was == is) return;
    if (!is.empty() && tasks_[is]++ == 0) setBusy(is, true, now);
    if (const auto found = tasks_.find(was); found != tasks_.end() && --found->second == 0) {
        tasks_.erase(found);
        setBusy(was, false, now);
    }
}

OtherServers::OtherServers(std::string name, RandomSource& random, Note note, std::function<void(Lane)> say)
    : self_{std::move(name), Id128::random(random).toString().substr(0, 8), {}, 0},
      note_(std::move(note)),
      say_(std::move(say)) {}

OtherServers::Group& OtherServers::add(Kind kind) {
    return groups_.emplace_back(std::move(kind));
}

TimePoint OtherServers::onTimer(TimePoint now) {
    if (self_.name.empty()) return TimePoint::max();
    auto next = TimePoint::max();
    bool somebody_new = false;
    bool announce = false;
    std::vector<std::pair<const Kind*, std::vector<std::string>>> left;
    std::vector<std::pair<const Kind*, std::string>> arrived;
    for (auto& group : groups_) {
        const auto& kind = group.kind_;
        const auto news = group.news(now);
        if (!news.lost.empty() && kind.lost) kind.lost(news.lost);
        if (news.reachable) {
            somebody_new = true;
            if (kind.reach) kind.reach(*news.reachable);
        }
        if (!news.lost.empty() && kind.left) left.emplace_back(&kind, news.lost);
        for (const auto& name : news.arrived) arrived.emplace_back(&kind, name);
        announce = announce || (kind.waits_for_announcement && !news.arrived.empty());
        next = std::min(next, news.next);
    }
    if (now >= next_beat_ || somebody_new) {
        next_beat_ = now + Neighbours::kBeat;
        say_(Lane::Signal);
        announce = announce_soon_.exchange(false) || announce;
    }
    if (now >= next_announcement_ || announce) {
        next_announcement_ = now + kAnnounce;
        say_(Lane::Data);
    }
    for (const auto& [kind, names] : left) kind->left(names);
    for (const auto& [kind, name] : arrived) {
        note_(kind->name + " " + name + " is there");
        if (kind->arrived) kind->arrived(name);
    }
    return std::min({next, next_beat_, next_announcement_});
}

}  // namespace axon
