// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <string>

#include "audit/note.hpp"
#include "common/routed.hpp"

namespace axon::entity_server {

/// What an entity server records of its entities in the audit trail. Threads: any. Failure: none.
class EntityAudit {
  public:
    /// `trail`: null where nothing is recorded.
    explicit EntityAudit(audit::AuditTrail* trail) : trail_(audit::orNone(trail)) {}

    void joined(const Registration& registration) const;
    void left(const std::string& entity, const std::string& name, const std::string& why) const;
    /// Records a change of the holder; nothing where it is the same.
    void holder(const std::string& name, const EntityStatus& before, const EntityStatus& now) const;
    /// It was stopped because nobody watches its holder any more.
    void stoppedForLostClient(const EntityStatus& status) const;
    /// A client's stop, reset or clear; to `entities` of them, where the head names none.
    void signal(const char* what, const Header& head, std::size_t entities) const;

    /// A message on its way to an entity; of those that order something.
    void command(const Header& head) const;

  private:
    audit::AuditTrail& trail_;
};

}  // namespace axon::entity_server
