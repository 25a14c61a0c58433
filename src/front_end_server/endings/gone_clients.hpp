// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <deque>
#include <string>
#include <unordered_map>
#include <utility>

#include "common/routed.hpp"

namespace axon::front_end_server {

/// How a session ended.
enum class Ending : std::uint8_t {
    Ended,    ///< the client said so
    Lost,     ///< its connection closed, or it fell silent
    Improper  ///< it was dropped for its behaviour
};

/// The last clients that are gone, and how they went: each might be granted an entity late, and that entity
/// is then told the same as those that the client held. Not thread-safe. Bound: `most`; the oldest is
/// forgotten first. Failure: none.
class GoneClients {
  public:
    struct Gone {
        Sender sender;
        Ending ending;
    };
    explicit GoneClients(std::size_t most) : most_(most) {}

    /// The first ending of a client counts.
    void remember(const Sender& client, Ending ending) {
        if (!gone_.emplace(client.id, Gone{client, ending}).second) return;
        order_.push_back(client.id);
        if (order_.size() <= most_) return;
        gone_.erase(order_.front());
        order_.pop_front();
    }
    /// The client that an entity names as its holder and that is not here: one that is not remembered counts
    /// as lost.
    Gone find(const Sender& holder) const {
        const auto found = gone_.find(holder.id);
        return found != gone_.end() ? found->second : Gone{holder, Ending::Lost};
    }

  private:
    const std::size_t most_;
    std::unordered_map<std::string, Gone> gone_;  // by client
    std::deque<std::string> order_;
};

}  // namespace axon::front_end_server
