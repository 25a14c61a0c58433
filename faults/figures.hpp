// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

namespace axon::faults {

/// Latencies in milliseconds. What never arrived is infinitely late: it belongs to the tail, not to nowhere.
class Series {
  public:
    void add(double ms) { ms_.push_back(ms); }
    void addNever() { ++never_; }
    std::size_t arrived() const { return ms_.size(); }
    std::size_t never() const { return never_; }
    std::size_t size() const { return ms_.size() + never_; }
    const std::vector<double>& all() const { return ms_; }

    /// The part q of all is not above it (nearest rank); nothing where so few do not tell: p50 needs 2, p90
    /// 10, p99 100, p99.9 1,000. Infinity when that rank never arrived.
    std::optional<double> percentile(double q) const;
    std::optional<double> minimum() const;
    std::optional<double> maximum() const;

  private:
    std::vector<double> ms_;
    std::size_t never_ = 0;
};

/// What a kind of fault promises. Zero = nothing is promised.
struct Promise {
    double bound_ms = 0;  ///< of every stop
    double p99_ms =
        0;  ///< of the distribution, on a host with time to spare (without --busy), from 100 stops on
    std::string text;
    double p999_ms = 0;  ///< likewise, from 1,000 stops on
};

/// What a run found. Everything in `broken` is a broken promise.
struct Report {
    std::string kind;
    Promise promise;
    std::size_t trials_wanted = 0, trials = 0;
    std::string measured = "stops";  ///< what `latency` is of
    Series latency;
    std::size_t late = 0;               ///< beyond the bound, whatever the reason
    std::size_t late_beside_stall = 0;  ///< of these: within the bound when the host's stall is taken off
    std::size_t trials_beside_stall = 0;
    std::size_t moved_after_stop = 0;           ///< robots that moved again before anybody wanted it
    std::size_t stopped_before = 0;             ///< robots that stopped while waiting for the fault
    std::size_t not_recovered = 0;              ///< trials after which things did not come back by themselves
    std::map<std::string, std::size_t> causes;  ///< as the stop callback was told
    std::map<std::string, std::size_t> counts;  ///< what else was counted; for people
    std::vector<std::string> violations;        ///< the first hundred, each a sentence
    std::size_t violations_count = 0;
    std::size_t host_stalls = 0;
    double longest_stall_ms = 0;
    bool busy = false, partial = false;
    double seconds = 0;

    void violation(std::string sentence);
    /// Why the promise is broken; empty = it was kept.
    std::vector<std::string> broken() const;
};

/// For people; several lines.
std::string toText(const Report& report);
/// For programs; one JSON object.
std::string toJson(const Report& report);
/// The machine of a run, as JSON.
std::string machineJson();

}  // namespace axon::faults
