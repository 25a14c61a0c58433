// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/distribution.hpp"

#include <algorithm>
#include <cmath>
#include <limits>

namespace axon::cli {
namespace {

constexpr double kEdges_ms[] = {0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 10000};

Json number(const std::optional<double>& value) {
    if (!value) return nullptr;
    return std::isinf(*value) ? Json("never") : Json(*value);
}

}  // namespace

void Distribution::add(std::optional<Seconds> time) {
    if (time)
        times_.push_back(time->count() * 1000);
    else
        ++never_;
    if (samples_.size() < kSamples) samples_.push_back(time ? std::optional(times_.back()) : std::nullopt);
}

std::optional<double> Distribution::quantile(double part) const {
    const auto n = static_cast<double>(count());
    // Rounded, for 1 - 0.9 is not quite 0.1.
    if (count() == 0 || (part < 1 && std::round(n * (1 - part) * 1e6) < 1e6)) return std::nullopt;
    const auto rank = static_cast<std::size_t>(std::ceil(std::round(part * n * 1e6) / 1e6));
    if (rank > times_.size()) return std::numeric_limits<double>::infinity();
    auto sorted = times_;
    const auto at = sorted.begin() + static_cast<std::ptrdiff_t>(std::max<std::size_t>(rank, 1) - 1);
    std::nth_element(sorted.begin(), at, sorted.end());
    return *at;
}

std::vector<Distribution::Bin> Distribution::histogram() const {
    std::vector<Bin> bins;
    for (const auto edge : kEdges_ms) bins.push_back({edge, 0});
    for (const auto time : times_) {
        const auto bin =
            std::find_if(bins.begin(), bins.end() - 1, [&](const Bin& b) { return time <= b.up_to_ms; });
        ++bin->count;
    }
    const auto any = [](const Bin& bin) { return bin.count > 0; };
    const auto first = std::find_if(bins.begin(), bins.end(), any);
    const auto last = std::find_if(bins.rbegin(), bins.rend(), any).base();
    if (first == bins.end()) return {};
    return {first, last};
}

Json Distribution::toJson() const {
    auto bins = Json::array();
    for (const auto& bin : histogram()) bins.push_back({{"up_to_ms", bin.up_to_ms}, {"count", bin.count}});
    auto samples = Json::array();
    for (const auto& sample : samples_) samples.push_back(sample ? Json(*sample) : Json(nullptr));
    return {{"n", count()},
            {"never_arrived", never_},
            {"p50_ms", number(quantile(0.5))},
            {"p90_ms", number(quantile(0.9))},
            {"p99_ms", number(quantile(0.99))},
            {"p999_ms", number(quantile(0.999))},
            {"max_ms", number(quantile(1))},
            {"histogram", std::move(bins)},
            {"samples_ms", std::move(samples)}};
}

}  // namespace axon::cli
