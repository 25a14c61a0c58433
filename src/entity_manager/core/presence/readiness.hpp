// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <utility>

#include "common/routed.hpp"
#include "messages/text.hpp"

namespace axon::entity_manager {

/// Why the entity is not ready, for whoever asks while it is in UNAV, INIT or ERR. Threads: the core's
/// strand.
class Readiness {
  public:
    /// `application`: the name of the robot application that it waits for.
    explicit Readiness(std::string application) : application_(std::move(application)) {}

    void notReady(std::string why) { why_ = std::move(why); }
    /// What the search for the robot application has found instead; empty = it is not looked for any more.
    void sought(std::string finding) { sought_ = std::move(finding); }
    /// The entity has come to another state.
    void stateIs(EntityState state) {
        if (state != EntityState::UNAV && state != EntityState::ERR) why_.clear();
    }

    /// Empty in the other states, and in INIT as long as all goes well.
    std::string whyNot(EntityState state) const {
        if (state == EntityState::UNAV) {
            if (why_.empty() && sought_.empty())
                return "waiting for the robot application " + inQuotes(application_);
            return why_ + (why_.empty() || sought_.empty() ? "" : "; ") + sought_;
        }
        return state == EntityState::INIT || state == EntityState::ERR ? why_ : std::string();
    }

  private:
    const std::string application_;
    std::string why_, sought_;
};

}  // namespace axon::entity_manager
