// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <optional>
#include <vector>

#include "cli/session.hpp"

namespace axon::cli {

/// What was measured, some of which may never have arrived; these count as infinitely late. Pure.
class Distribution {
  public:
    static constexpr std::size_t kSamples = 10'000;

    void add(std::optional<Seconds> time);

    std::size_t count() const { return times_.size() + never_; }
    std::size_t never() const { return never_; }
    /// The nearest rank, in milliseconds (infinity = it never arrived); nothing where there are too few to
    /// say: 1 / (1 - part) of them at least.
    std::optional<double> quantile(double part) const;

    struct Bin {
        double up_to_ms;
        std::size_t count;
    };
    /// From the first bin that has any to the last; each ends where the next begins (1, 2, 5, 10 … ms).
    std::vector<Bin> histogram() const;

    /// "n", "never_arrived", "p50_ms" … (a number, "never", or null where n is too small), "histogram",
    /// "samples_ms" (null = never), of which there are the first kSamples: an event is one line of the agent,
    /// and that has a bound.
    Json toJson() const;

  private:
    std::vector<double> times_;                   // ms
    std::vector<std::optional<double>> samples_;  // the first, as they came
    std::size_t never_ = 0;
};

}  // namespace axon::cli
