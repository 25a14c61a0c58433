// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <deque>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/result.hpp"
#include "entity_manager/core/turn/lease_book.hpp"

namespace axon::entity_manager {

/// Who waits for the entity, in the order of arrival. It lives here and not in a server, so that any number
/// of front-end servers agree.
///
/// Where in the flow: a check-out of what is held joins it; the core grants to the first as soon as the
/// entity is free and stands. States of a place: kept for kRefreshWithin after each time that its request is
/// sent, then given up. Threads: the core's strand. Bounded: kMax places, one for each client. Failure:
/// refusals.
class WaitList {
  public:
    static constexpr std::size_t kMax = 64;
    static constexpr Duration kRefreshWithin = std::chrono::seconds{15};

    /// OVERLOADED (full), DUPLICATE (the client waits already, with another request).
    Refusal mayJoin(const Sender& client, const std::string& request_id) const;
    /// After mayJoin(): the place, 1 = next. Of who waits already it is refreshed. The caller tells the
    /// place.
    std::size_t join(Claim claim, TimePoint now);
    /// 0 = this request does not wait.
    std::size_t placeOf(const Sender& client, const std::string& request_id) const;

    bool empty() const { return waiting_.empty(); }
    std::size_t size() const { return waiting_.size(); }
    const Claim& first() const { return waiting_.front().claim; }
    Claim pop();

    std::optional<Claim> leave(const Sender& client, const std::string& request_id);
    /// All that this client waits for.
    std::vector<Claim> forget(const std::string& client_id);
    std::vector<Claim> clear();
    /// Those that were not asked for in time.
    std::vector<Claim> expire(TimePoint now);
    std::optional<TimePoint> nextExpiry() const;

    /// Who has another place than was told last; taken for told from now on.
    std::vector<std::pair<Claim, std::size_t>> takeChanges();

  private:
    struct Place {
        Claim claim;
        TimePoint until;
        std::size_t told;
    };
    template <class Leaves>
    std::vector<Claim> remove(Leaves leaves);

    std::deque<Place> waiting_;
};

}  // namespace axon::entity_manager
