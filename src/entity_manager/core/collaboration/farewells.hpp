// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <cstddef>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"

namespace axon::entity_manager {

/// The ends of a run that its master has sent, and of which it is not known whether they have arrived. An end
/// waits with the data before it, and that of a stop may find no room; so until it is answered, or too old to
/// matter, each participant hears a beat, or the stop once more, on the signal lane: one that has finished
/// must not miss its master. Threads: the core's strand. Bounded: above kMax ends nothing is repeated.
class Farewells {
  public:
    static constexpr std::size_t kMax = 1024;

    /// `watchdog`: for so long a participant believes in a master that it does not hear.
    explicit Farewells(Duration watchdog) : watchdog_(watchdog) {}

    /// `end` has been sent to this entity, which expects to hear from its master `every` so often.
    void sent(const std::string& entity, const proto::FromMaster& end, Duration every, TimePoint now);
    /// It takes no part in the run any more, by its own word.
    void answered(const std::string& entity, const std::string& run_id);
    /// What is sent to it does not arrive.
    void unreachable(const std::string& entity);

    /// What is to be sent now, and to which entity.
    std::vector<std::pair<std::string, proto::FromMaster>> takeDue(TimePoint now);
    TimePoint nextDeadline() const;

  private:
    struct Farewell {
        std::string entity;
        proto::FromMaster message;  ///< a beat, or a stop once more
        Duration every{};
        TimePoint again{}, until{};
    };
    Duration watchdog_;
    std::vector<Farewell> open_;
};

}  // namespace axon::entity_manager
