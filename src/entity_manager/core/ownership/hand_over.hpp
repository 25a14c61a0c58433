// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <string>

#include "common/clock.hpp"
#include "common/result.hpp"
#include "entity_manager/core/turn/lease_book.hpp"

namespace axon::entity_manager {

/// The one question that may be open to the holder: whether it hands the entity over to who asks for it.
///
/// Where in the flow: a check-out that asks opens it and the core sends it to the holder; an answer, the end
/// of the holder's time or of its lease closes it. States: none, open. Threads: the core's strand. Bounded:
/// one question; a second asker is refused with the name of the first. Failure: refusals.
class HandOver {
  public:
    struct Question {
        Claim claim;
        bool waits = false;  ///< refused, it joins the wait list
        std::string reason;  ///< for people
        TimePoint until;
        bool yield = false;  ///< what silence means
    };

    const std::optional<Question>& open() const { return open_; }
    bool isOpenFor(const Sender& client, const std::string& request_id) const;
    /// Whether its question was the last one to be closed: a copy of the request that comes late asks nobody
    /// again.
    bool wasClosedFor(const Sender& client, const std::string& request_id) const;
    /// RESERVED, with the name of who asks already.
    Refusal mayAsk(const std::string& holder) const;
    /// After mayAsk(), under the holder's policy.
    const Question& ask(Claim claim, bool waits, std::string reason, const HandOverPolicy& policy,
                        TimePoint now);
    /// Closes it.
    std::optional<Question> take();
    /// Closes it where the holder's time is over.
    std::optional<Question> expire(TimePoint now);

  private:
    std::optional<Question> open_;
    std::string closed_client_, closed_request_;
};

}  // namespace axon::entity_manager
