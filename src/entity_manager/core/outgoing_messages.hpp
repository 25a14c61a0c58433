// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <cstdint>
#include <string>
#include <utility>

#include "common/refusal.hpp"
#include "common/routed.hpp"
#include "entity_manager/core/turn/turn.hpp"
#include "entity_manager/ports/ports.hpp"

namespace axon::entity_manager {

/// All that the Entity Manager sends to clients and to other entities, through the server or the direct path
/// (ServerPort).
///
/// It owns the sequence of these messages: the header of each has the next number, the present lease, the
/// newest stop generation that the strand knows, and the time. Nothing is sent and no number is used without
/// a session, nor for a client without an id, since that would go to everybody. Nothing waits here: a message
/// has been given to the ServerPort when a call returns, and what becomes of it there is told to nobody.
/// Threads: the core's strand.
class OutgoingMessages {
  public:
    /// `entity`: its UUID.
    OutgoingMessages(Turn& turn, ServerPort& server, std::string entity)
        : turn_(turn), server_(server), entity_(std::move(entity)) {}

    void tell(const Sender& to, const char* type, const proto::ToClient& message, Lane lane);
    /// May be dropped on the way, the oldest first. To a client with an id, and only while there is a
    /// session: the caller has looked.
    void tellDroppable(const Sender& to, const char* type, const proto::ToClient& message);
    /// To another entity, by its UUID. `self`: this one, as the sender.
    void tellPeer(Lane lane, const Sender& self, const std::string& peer, const char* type,
                  const proto::ToEntity& message);
    /// A Reply, with the refusal unless that is OK.
    void reply(const Sender& to, const std::string& request_id, const Refusal& refusal, Lane lane);

  private:
    Header headFor(const Sender& to, const char* type);

    Turn& turn_;
    ServerPort& server_;
    const std::string entity_;
    std::int64_t sequence_ = 0;
};

}  // namespace axon::entity_manager
