// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <spdlog/spdlog.h>

#include <string>

#include "audit/note.hpp"
#include "common/clock.hpp"
#include "common/rate_limit.hpp"
#include "common/refusal.hpp"

namespace axon::entity_manager {

/// What they ask for there, for logs and records.
inline constexpr const char* kDataLane = "a data lane";
inline constexpr const char* kSignalLane = "a signal lane";

/// Tells of whoever is turned away at the ports of direct paths: the log, with at most ten lines in a second,
/// and the audit trail, which bounds what each address may fill (audit::Shares).
///
/// Threads: any; does not wait. One for all Entity Managers of a process.
class DirectRefusals {
  public:
    /// `trail` outlives this object; null: nothing is recorded.
    explicit DirectRefusals(audit::AuditTrail* trail) : trail_(audit::orNone(trail)) {}

    /// `entity`: the UUID of the one whose port it is; empty where several share it. `peer`:
    /// "10.0.0.9:50122". `what`: that was refused, such as "a data lane".
    void refused(const std::string& entity, const std::string& peer, const std::string& what,
                 const Refusal& refusal) {
        if (lines_.admit(clock_.now()))
            spdlog::warn("audit: direct path: {} from {} was refused: {}", what, peer, refusal.message);
        record(entity, peer, what, refusal);
    }
    /// Where the log has it already.
    void record(const std::string& entity, const std::string& peer, const std::string& what,
                const Refusal& refusal) {
        const auto text = "direct path: " + what + ": " + refusal.message;
        trail_.note({.kind = audit::Kind::Refusal,
                     .peer = peer,
                     .entity = entity,
                     .what = text,
                     .outcome = refusalName(refusal.code)});
    }
    /// The bounds of connections without a path have closed some; the line says how many, and whose.
    void closed(const std::string& entity, const std::string& line) {
        spdlog::warn("direct path: {}", line);
        const auto text = "direct path: " + line;
        trail_.note({.kind = audit::Kind::Refusal,
                     .entity = entity,
                     .what = text,
                     .outcome = refusalName(RefusalCode::Overloaded)});
    }

  private:
    audit::AuditTrail& trail_;
    const SteadyClock clock_{};  // of what strangers cost, also where the laboratory's time stands
    RateLimit lines_{10};
};

}  // namespace axon::entity_manager
