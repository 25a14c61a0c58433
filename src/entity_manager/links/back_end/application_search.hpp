// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstdint>
#include <map>
#include <optional>
#include <string>

#include "common/backoff.hpp"
#include "common/clock.hpp"
#include "host/port_range.hpp"

namespace axon::entity_manager {

/// What an Entity Manager looks for, and where.
struct Wanted {
    std::string application;
    std::string instance;  ///< empty = any
    LinkPorts where;
    std::string ports_from;  ///< which file or option gives the ports, for people; empty = the defaults
};

/// What people are told while the robot application is not found.
struct SearchReport {
    std::string finding;  ///< what was looked for, where, and what is there instead
    std::string fix;      ///< empty where the finding says it already
};

/// Notes what the search for a robot application meets, and says when a person should hear of it: after
/// `first` without the application, then at intervals that double up to ten minutes.
///
/// Pure: the caller brings the time. Confined to the strand of its owner. At most 64 applications are noted.
class ApplicationSearch {
  public:
    static constexpr Duration kFirst = std::chrono::seconds{3};

    explicit ApplicationSearch(Wanted wanted, Duration first = kFirst);

    /// Looking begins, at the start or after the link was lost. Forgets what was noted.
    void begin(TimePoint now);
    /// There is a link, or nobody looks any more.
    void end() { next_.reset(); }

    /// A robot application answers at `port`, and it is not the one that is wanted, or it declines: then
    /// `declined` is its reason.
    void met(std::uint16_t port, const std::string& application, const std::string& instance,
             const std::string& declined, TimePoint now);

    /// The report, once it is due. Names what was met within the last few seconds.
    std::optional<SearchReport> report(TimePoint now);

  private:
    struct Met {
        std::string application, instance, declined;
        TimePoint at;
    };
    const Wanted wanted_;
    Backoff pause_;
    std::optional<TimePoint> next_;
    std::map<std::uint16_t, Met> met_;  // by port
};

}  // namespace axon::entity_manager
