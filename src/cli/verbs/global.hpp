// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <map>
#include <memory>
#include <string>
#include <vector>

#include "cli/session.hpp"

// What the verbs of `axon global` have in common.
namespace axon::cli {

/// The service that a person means by `name`; UNKNOWN_SERVICE names near ones, and files that offer nothing.
Result<GlobalService> findGlobal(Session& session, const std::string& name);

/// Emits the refusal with the fix of `axon global`.
int refuseGlobal(Session& session, const Refusal& refusal);

/// What the services of a run's steps take and give. One thread.
class ServicesOfSteps {
  public:
    /// Asks each entity once; of one that does not answer nothing is known.
    ServicesOfSteps(const std::shared_ptr<Station>& station, const std::vector<std::string>& entities);
    /// Adds "units" of the step's parameters and "live", the names of the FEEDBACK among its results.
    void describe(Json& step) const;

  private:
    std::map<std::string, std::vector<Service>> services_;
};

/// "roles" of "global_service" and "binding" events.
Json toJson(const client::Proposal& proposal);

}  // namespace axon::cli
