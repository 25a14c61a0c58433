// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <mutex>
#include <string>
#include <vector>

#include "audit/note.hpp"

namespace axon::test {

/// Keeps what is noted, as "KIND|NAME|CLIENT|ENTITY|WHAT|OUTCOME", after "USER@PEER|" where one of these is
/// there. Threads: any.
class RecordedAudit final : public audit::AuditTrail {
  public:
    void note(const audit::Note& note) override {
        std::string line;
        if (!note.user.empty() || !note.peer.empty())
            line = std::string(note.user) + '@' + std::string(note.peer) + '|';
        line += audit::toString(note.kind);
        for (const auto text : {note.name, note.client, note.entity, note.what, note.outcome})
            line += '|' + std::string(text);
        const std::lock_guard lock(mutex_);
        notes_.push_back(std::move(line));
    }
    std::vector<std::string> notes() const {
        const std::lock_guard lock(mutex_);
        return notes_;
    }
    std::string last() const {
        const std::lock_guard lock(mutex_);
        return notes_.empty() ? std::string() : notes_.back();
    }
    /// Whether one of them has this in it.
    bool has(const std::string& part) const {
        const std::lock_guard lock(mutex_);
        for (const auto& note : notes_)
            if (note.find(part) != std::string::npos) return true;
        return false;
    }

  private:
    mutable std::mutex mutex_;
    std::vector<std::string> notes_;
};

}  // namespace axon::test
