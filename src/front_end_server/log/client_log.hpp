// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "audit/note.hpp"
#include "common/clock.hpp"
#include "common/rate_limit.hpp"
#include "common/refusal.hpp"
#include "common/routed.hpp"

namespace axon::front_end_server {

/// What the log says of what clients do, and of what entities do to them.
///
/// Stops, resets, clears and rearms are audited, each in one line: who did what to which entities. The audit
/// trail gets these too, and what the log leaves out: commands, refusals, who comes and goes. What
/// exceeds a limit or is not believed gets a line, so that an operator can find out why the server is slow,
/// but at most 8 of a kind in a second. Threads: any; no lock. Failure: none.
class ClientLog {
  public:
    using Note = std::function<void(const std::string& line)>;

    ClientLog(const Clock& clock, Note note, audit::AuditTrail* trail = nullptr);

    /// `entities`: UUIDs, the first of which are named; one that is empty stands for all `known` entities. A
    /// forced take-over is inside a payload: the Entity Manager says it.
    void audit(const char* what, const Sender& who, const std::vector<std::string>& entities,
               std::size_t known) const;
    // For the audit trail only.
    /// `user`: as it has logged in.
    void joined(const Sender& who, const std::string& user) const;
    void left(const Sender& who, std::string_view how, const std::string& why) const;
    /// A message on its way to an entity; of those that order something.
    void command(const Header& head) const;
    void refused(const Header& head, const Refusal& refusal) const;
    /// The entity's status names this holder from now on.
    void holder(const EntityStatus& status) const;

    /// The client is refused for exceeding a limit; other refusals get no line.
    void excess(const Sender& client, const Refusal& refusal);
    /// The entity sends the client more than its share.
    void slowClient(const Sender& client, const std::string& entity);
    /// The entity names a holder that has not asked for it.
    void unaskedHolder(const std::string& entity, const std::string& holder);

  private:
    const Clock& clock_;
    const Note note_;
    audit::AuditTrail& trail_;
    RateLimit doubts_;    // about entities
    RateLimit excesses_;  // about clients
};

}  // namespace axon::front_end_server
