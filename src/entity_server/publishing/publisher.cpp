// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/publishing/publisher.hpp"

#include <algorithm>
#include <utility>
#include <vector>

namespace axon::entity_server {
namespace {

// What every client is told of one entity: each status, and each begun 16 KiB of a profile, counts once.
constexpr std::uint32_t kPublishedPerSecond = 200;
constexpr std::size_t kProfileStep = 16 * 1024U;

/// Whether front-end servers are told the profile, and not its status alone.
bool tellsProfile(const RecordRef& before, const RecordRef& now, bool again) {
    return again || !before || before->session != now->session || now->registration != before->registration ||
           (now->profile != before->profile && *now->profile != *before->profile);
}

}  // namespace

Publisher::Publisher(const ServerAnnouncement& self, const Clock& clock, FrontEndTopic& topic, Note note,
                     std::function<void()> wake)
    : self_(self), clock_(clock), topic_(topic), note_(std::move(note)), wake_(std::move(wake)) {}

void Publisher::set(RecordRef now) {
    const std::lock_guard lock(mutex_);
    const auto& entity = now->registration.entity;
    auto& level = levels_[entity];
    if (!level.now || level.now->session != now->session) level.pace.emplace(kPublishedPerSecond);
    queue(entity, level, false);
    level.now = std::move(now);
}

void Publisher::left(const std::string& entity) {
    const std::lock_guard lock(mutex_);
    const auto level = levels_.find(entity);
    if (level == levels_.end()) return;
    level->second.now = nullptr;
    queue(entity, level->second, false);
}

void Publisher::again() {
    const std::lock_guard lock(mutex_);
    for (auto& [entity, level] : levels_)
        if (level.now) queue(entity, level, true);
    list_due_ = !self_.name.empty();
}

void Publisher::announce() {
    const std::lock_guard lock(mutex_);
    announcement_due_ = true;
}

/// Under the mutex.
void Publisher::queue(const std::string& entity, Level& level, bool again) {
    level.again = level.again || again;
    if (!std::exchange(level.waits, true)) queue_.push_back(entity);
}

bool Publisher::endPauses() {
    const std::lock_guard lock(mutex_);
    const auto now = clock_.now();
    if (next_pause_ > now) return false;
    next_pause_ = TimePoint::max();
    for (auto its = paused_.begin(); its != paused_.end();) {
        if (its->second > now) {
            next_pause_ = std::min(next_pause_, its->second);
            ++its;
            continue;
        }
        if (const auto level = levels_.find(its->first); level != levels_.end())
            queue(its->first, level->second, false);
        its = paused_.erase(its);
    }
    return true;
}

TimePoint Publisher::nextPause() const {
    const std::lock_guard lock(mutex_);
    return next_pause_;
}

/// Under the mutex: whether this entity changes faster than all clients are told.
bool Publisher::isPaced(const std::string& entity, Level& level) {
    const auto now = clock_.now();
    const auto at = level.pace->next(now);
    if (at > now) {
        paused_[entity] = at;
        next_pause_ = std::min(next_pause_, at);
        return true;
    }
    const auto profile =
        tellsProfile(level.told, level.now, level.again) ? level.now->profile->size() / kProfileStep : 0;
    level.pace->take(now, 1 + static_cast<std::uint32_t>(profile));
    return false;
}

void Publisher::publishPending() {
    std::unique_lock lock(mutex_);
    if (publishing_) return;
    publishing_ = true;
    while (!queue_.empty() || list_due_ || announcement_due_) {
        if (!queue_.empty())
            publishFront(lock);
        else
            publishSummary(lock);
    }
    publishing_ = false;
}

/// Under the mutex, which it releases while it tells.
void Publisher::publishFront(std::unique_lock<std::mutex>& lock) {
    const auto entity = std::move(queue_.front());
    queue_.pop_front();
    auto& level = levels_.find(entity)->second;
    level.waits = false;
    const auto timer = next_pause_;
    if (level.now && isPaced(entity, level)) {
        if (next_pause_ >= timer) return;
        lock.unlock();
        wake_();
        return lock.lock();
    }
    const auto now = level.now;
    const auto before = std::exchange(level.told, now);
    const auto again = std::exchange(level.again, false);
    if (!now) levels_.erase(entity);
    lock.unlock();
    publish(entity, before, now, again);
    lock.lock();
}

/// Under the mutex, which it releases while it tells: the list of entities, or else this server's word of
/// itself.
void Publisher::publishSummary(std::unique_lock<std::mutex>& lock) {
    const bool list = std::exchange(list_due_, false);
    if (!list) announcement_due_ = false;
    std::vector<std::string> entities;
    for (const auto& [entity, level] : levels_)
        if (list ? level.told : level.now) entities.push_back(entity);
    lock.unlock();
    if (list) {
        topic_.entityServerEntities(self_.name, entities);
    } else {
        auto self = self_;
        self.published = publications_;
        topic_.entityServerUpdate(Lane::Data, self);
        topic_.peersUpdate(Lane::Data, self, entities);
    }
    lock.lock();
}

void Publisher::publish(const std::string& entity, const RecordRef& before, const RecordRef& now,
                        bool again) {
    const bool same_session = before && now && before->session == now->session;
    const auto presence = [&](Presence what, const Registration& registration, std::string_view profile) {
        ++publications_;
        topic_.entityBasicPrflUpdate(what, registration, profile);
    };
    if (before && !same_session) presence(Presence::Left, before->registration, {});
    if (!now) return;
    if (!same_session) {
        presence(Presence::Joined, now->registration, *now->profile);
    } else if (tellsProfile(before, now, again)) {
        presence(Presence::Changed, now->registration, *now->profile);
    }
    const bool was_ready = same_session && !before->profile->empty();
    if (!now->profile->empty() && !was_ready)
        note_(now->registration.name + " joined (" + entity + ")");
    else if (!same_session)
        note_(now->registration.name + " is connected and not ready (" + entity +
              "); axon ls --all shows why");
    if (now->heard && (again || !same_session || !before->heard || now->status != before->status)) {
        topic_.entityUpdate(now->status, ++publications_);
    }
}

}  // namespace axon::entity_server
