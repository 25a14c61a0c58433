// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include "common/clock.hpp"
#include "entity_manager/core/turn/incident.hpp"
#include "entity_manager/core/turn/turn.hpp"

namespace axon::entity_manager {

/// Texts and raw data between the holder and the robot application, in both directions. The Entity Manager
/// does not read them; what the application sends while nobody holds the robot is counted as undelivered.
/// Threads: the core's strand. Refused raw data is answered five times a second at most.
class HolderChannel {
  public:
    explicit HolderChannel(Turn& turn) : turn_(turn) {}

    // Actions of the state table: from the holder. What it said is left in some valid state.

    void passText(const Incident& incident);
    void passRaw(const Incident& incident);
    /// A stream of raw data is not answered with a stream of refusals.
    void refuseRaw(const Sender& to, const Refusal& refusal);

    // From the robot application; left in some valid state.

    void textCame(proto::LinkText& text);
    void rawCame(proto::LinkRaw& raw);

  private:
    Turn& turn_;
    TimePoint raw_refused_{};
    proto::EmToEi raw_to_link_;  ///< kept for its memory
    proto::ToClient raw_to_client_;
};

}  // namespace axon::entity_manager
