// SPDX-License-Identifier: MIT
#include "common/neighbours.hpp"

#include <algorithm>
#include <iterator>
#include <utility>

namespace axon {
namespace {

constexpr std::size_t kInstanceMax = 64;
constexpr std::size_t kSignalsMax = 1024;
constexpr std::size_t kReplacedKept = 8;

bool contains(const std::vector<std::string>& list, std::string_view one) {
    return std::find(list.begin(), list.end(), one) != list.end();
}

}  // namespace

Neighbours::Neighbour* Neighbours::findOrAdd(std::string_view server, TimePoint now) {
    if (const auto found = all_.find(server); found != all_.end()) return &found->second;
    if (all_.size() >= kMost) return nullptr;
    auto& its = all_[std::string(server)];
    its.liveness.setTimeouts(timeouts_.met, timeouts_.met, now);
    return &its;
}

bool Neighbours::heard(Lane lane, const ServerAnnouncement& announcement, TimePoint now) {
    if (!isServerName(announcement.name) || announcement.instance.empty() ||
        announcement.instance.size() > kInstanceMax || announcement.signals.size() > kSignalsMax ||
        announcement.messages.size() > kSignalsMax)
        return false;
    const std::lock_guard lock(mutex_);
    auto* its = findOrAdd(announcement.name, now);
    if (its == nullptr || contains(its->replaced, announcement.instance)) return false;
    bool news = false;
    auto& known = its->announcement;
    if (known.instance != announcement.instance) {
        if (!known.instance.empty()) {
            its->replaced.push_back(known.instance);
            if (its->replaced.size() > kReplacedKept) its->replaced.erase(its->replaced.begin());
            its->restarted = its->restarted || its->alive;  // else it is lost already
        }
        its->straight = its->refuses = false;
        its->alive = true;
        its->liveness.setTimeouts(timeouts_.met, timeouts_.met, now);
        its->arrived = news = true;
    }
    if (known.signals != announcement.signals || known.messages != announcement.messages || !its->reached)
        reach_changed_ = news = true;
    its->reached = true;
    its->reachable_until = now + kReach;
    known = announcement;
    if (lane == Lane::Signal && !its->straight) {
        its->straight = true;
        its->liveness.setTimeouts(timeouts_.busy, timeouts_.idle, now);
        news = true;  // its time-out is shorter than was said
    }
    if (lane == Lane::Signal || !its->straight) {
        its->liveness.heard(now);
        its->refuses = false;
        if (!its->alive) its->alive = its->arrived = news = true;
    }
    return news;
}

bool Neighbours::refused(std::string_view server, std::string_view signals) {
    const std::lock_guard lock(mutex_);
    const auto found = all_.find(server);
    if (found == all_.end()) return false;
    auto& its = found->second;
    if (!its.alive || !its.straight || its.announcement.signals != signals) return false;
    return !std::exchange(its.refuses, true);
}

void Neighbours::await(std::string_view server, TimePoint now) {
    const std::lock_guard lock(mutex_);
    findOrAdd(server, now);
}

void Neighbours::setBusy(std::string_view server, bool busy, TimePoint now) {
    const std::lock_guard lock(mutex_);
    if (auto* its = findOrAdd(server, now)) its->liveness.setBusy(busy, now);
}

Neighbours::News Neighbours::news(TimePoint now) {
    News news;
    news.next = now + std::chrono::seconds{1};
    const std::lock_guard lock(mutex_);
    for (auto entry = all_.begin(); entry != all_.end();) {
        auto& [name, its] = *entry;
        const bool lost = its.alive && now >= its.deadline();
        if (lost) its.alive = its.arrived = its.refuses = false;
        if (lost || its.restarted) news.lost.push_back(name);
        if (its.arrived) news.arrived.push_back(name);
        its.arrived = its.restarted = false;
        if (its.alive) news.next = std::min(news.next, its.deadline());
        if (its.reached && now >= its.reachable_until) {
            its.reached = false;
            reach_changed_ = true;
        }
        const bool forgotten = !its.alive && !its.liveness.busy() && now >= its.reachable_until + kForget;
        entry = forgotten ? all_.erase(entry) : std::next(entry);
    }
    if (reach_changed_) {
        reach_changed_ = false;
        news.reachable.emplace();
        for (const auto& [name, its] : all_) {
            if (its.reached && !its.announcement.signals.empty()) news.reachable->push_back(its.announcement);
        }
    }
    return news;
}

bool Neighbours::serves(std::string_view client_id) const {
    const auto origin = originOf(client_id);
    if (origin.server.empty()) return true;
    const std::lock_guard lock(mutex_);
    const auto found = all_.find(origin.server);
    if (found == all_.end()) return true;
    const auto& its = found->second;
    if (contains(its.replaced, origin.instance)) return false;
    const auto& present = its.announcement.instance;
    return its.alive || !(present.empty() || present == origin.instance);
}

bool Neighbours::lost(std::string_view server) const {
    const std::lock_guard lock(mutex_);
    const auto found = all_.find(server);
    return found != all_.end() && !found->second.alive;
}

bool Neighbours::hears(std::string_view server, Duration within, TimePoint now) const {
    const std::lock_guard lock(mutex_);
    const auto found = all_.find(server);
    if (found == all_.end() || !found->second.alive || !found->second.straight) return false;
    return found->second.liveness.silentSince() + within >= now;
}

std::size_t Neighbours::size() const {
    const std::lock_guard lock(mutex_);
    return all_.size();
}

}  // namespace axon
