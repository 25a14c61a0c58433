// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>

#include "cli/session.hpp"

// What the verbs of `axon global` have in common.
namespace axon::cli {

/// The service that a person means by `name`; UNKNOWN_SERVICE names near ones, and files that offer nothing.
Result<GlobalService> findGlobal(Session& session, const std::string& name);

/// Emits the refusal with the fix of `axon global`.
int refuseGlobal(Session& session, const Refusal& refusal);

/// "roles" of "global_service" and "binding" events.
Json toJson(const client::Proposal& proposal);

}  // namespace axon::cli
