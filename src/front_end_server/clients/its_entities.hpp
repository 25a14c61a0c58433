// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <mutex>
#include <optional>
#include <string>
#include <unordered_map>
#include <unordered_set>
#include <utility>

namespace axon::front_end_server {

/// Which entities know of one client because it asked them, and which it holds.
///
/// An entity that was asked for a check-out or a watch remembers the client, and is told when that one is
/// gone: take() says which these are, once, and nothing is noted afterwards. An entity that the server does
/// not know may be joining, so it is noted, too; at most kUnknown of them. What the client
/// holds is here as the core's Holdings have it, for messages that do not take the core's mutex.
///
/// Threads: any; a mutex of its own, which messages of this client and to it take for a word of a few bytes,
/// and which may be taken while the core's is held. Bound: the entities that were here while the client was,
/// and kUnknown. One that has left is kept, since it may come back and remember the client. Failure: none.
class ItsEntities {
  public:
    /// Entity → whether it was asked for a check-out.
    using Asked = std::unordered_map<std::string, bool>;
    static constexpr std::size_t kUnknown = 256;

    /// `known`: to the server. `sequence`: of the message. False after take().
    bool ask(const std::string& entity, bool check_out, bool known, std::int64_t sequence = 0) {
        const std::lock_guard lock(mutex_);
        if (taken_) return false;
        if (known) {
            unknown_.erase(entity);
        } else if (!asked_.contains(entity)) {
            if (unknown_.size() >= kUnknown) return true;
            unknown_.insert(entity);
        }
        auto& before = asked_[entity];
        before = before || check_out;
        if (check_out) wanted_[entity] = sequence;
        return true;
    }
    /// Whether a check-out was passed on since it last held the entity: what belongs to that is under way.
    bool wants(const std::string& entity) const {
        const std::lock_guard lock(mutex_);
        return wanted_.contains(entity);
    }
    /// The same, which it wants no longer: the last message of it.
    std::optional<std::int64_t> giveUp(const std::string& entity) {
        const std::lock_guard lock(mutex_);
        const auto found = wanted_.find(entity);
        if (found == wanted_.end()) return std::nullopt;
        const auto sequence = found->second;
        wanted_.erase(found);
        return sequence;
    }
    /// Whether it was asked, for a check-out or a watch.
    bool asked(const std::string& entity) const {
        const std::lock_guard lock(mutex_);
        return asked_.contains(entity);
    }
    bool askedForCheckOut(const std::string& entity) const {
        const std::lock_guard lock(mutex_);
        const auto found = asked_.find(entity);
        return found != asked_.end() && found->second;
    }
    /// All that it has asked, so far.
    Asked all() const {
        const std::lock_guard lock(mutex_);
        return asked_;
    }
    Asked take() {
        const std::lock_guard lock(mutex_);
        taken_ = true;
        unknown_.clear();
        wanted_.clear();
        return std::exchange(asked_, {});
    }
    /// Whether that is new.
    bool setHeld(const std::string& entity, bool held) {
        const std::lock_guard lock(mutex_);
        if (held) return held_.insert(entity).second;
        if (held_.erase(entity) == 0) return false;
        wanted_.erase(entity);
        return true;
    }
    std::size_t held() const {
        const std::lock_guard lock(mutex_);
        return held_.size();
    }
    bool holds(const std::string& entity) const {
        const std::lock_guard lock(mutex_);
        return held_.contains(entity);
    }

  private:
    mutable std::mutex mutex_;
    // Guarded by mutex_:
    Asked asked_;
    std::unordered_set<std::string> unknown_;               // of asked_, those that the server did not know
    std::unordered_map<std::string, std::int64_t> wanted_;  // of asked_, with the last message for it
    bool taken_ = false;
    std::unordered_set<std::string> held_;
};

}  // namespace axon::front_end_server
