// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <optional>
#include <string>
#include <string_view>

#include "common/rights.hpp"
#include "common/routed.hpp"
#include "entity_manager/core/journal/journal_writer.hpp"
#include "entity_manager/core/turn/state_table.hpp"
#include "entity_manager/core/turn/turn.hpp"

namespace axon::entity_manager {

/// Reads what clients and other entities send, and says which request it is. What cannot be read, what this
/// edition does not know, and what is not the kind of message that its header says, it refuses itself.
/// Threads: the core's strand.
class RequestReader {
  public:
    struct Request {
        const Right* right;     ///< who may send it
        Event event;            ///< Event::Quit, which nobody can ask for: it is none of the requests
        proto::ToEntity* body;  ///< until the next is read
    };

    RequestReader(Turn& turn, JournalWriter& journal) : turn_(turn), journal_(journal) {}

    /// `bytes` is an axon.proto.ToEntity. `partner`: its sender takes part in the same run. Nothing: it has
    /// been refused.
    std::optional<Request> read(const Header& head, std::string_view bytes, bool partner);
    /// It is none of the requests, nor has a run taken it.
    void refuseOther(const Header& head, const Request& other);

  private:
    void refuse(const Header& head, const std::string& request_id, const Refusal& refusal);
    bool isTooLargeFor(const Header& head, std::string_view bytes, bool partner);

    Turn& turn_;
    JournalWriter& journal_;
    proto::ToEntity message_;  ///< kept for its memory
};

}  // namespace axon::entity_manager
