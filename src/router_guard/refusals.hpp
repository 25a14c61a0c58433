// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <mutex>
#include <set>
#include <string>

#include "audit/note.hpp"
#include "common/clock.hpp"
#include "common/rate_limit.hpp"

namespace axon::router_guard {

/// Whom a program of Ice's turns away: reads Ice's traces, says each refusal in the log, at most ten in a
/// second, and records it in the trail. Uses no Ice. Threads: any; onTrace() comes on Ice's.
class Refusals {
  public:
    using Say = std::function<void(const std::string& line)>;

    /// `trail`: null to say it only. `clock` outlives this.
    Refusals(std::unique_ptr<audit::AuditTrail> trail, const Clock& clock, Say say);

    /// One message of the traces of category "Network". It has to see those from the beginning on, as they
    /// say which ports are the program's.
    void onTrace(const std::string& trace);

    /// Ends the trail, which writes what waits. Later refusals are said only.
    void end();

  private:
    const Clock& clock_;
    const Say say_;
    RateLimit lines_{10};
    std::mutex mutex_;
    std::unique_ptr<audit::AuditTrail> trail_;       // guarded by mutex_
    std::set<std::string, std::less<>> listens_on_;  // ports; guarded by mutex_
};

}  // namespace axon::router_guard
