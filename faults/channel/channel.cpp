// SPDX-License-Identifier: GPL-2.0-or-later
#include "channel/channel.hpp"

#include <algorithm>
#include <cmath>

namespace axon::faults {
namespace {

/// From 0 to below 1.
double fraction(SeededRandom& random) {
    return static_cast<double>(random.next() >> 11U) * 0x1.0p-53;
}

Duration seconds(double value) {
    return std::chrono::duration_cast<Duration>(std::chrono::duration<double>(value));
}

}  // namespace

Outages::Outages(const ChannelSettings& settings, std::uint64_t seed, TimePoint begin)
    : length_(settings.outage), mean_(settings.outage_every), random_(seed) {
    if (length_ > Duration{} && mean_ > Duration{}) draw(begin);
}

/// Exponentially distributed, as of events that know nothing of each other.
void Outages::draw(TimePoint after) {
    const auto mean = std::chrono::duration<double>(mean_).count();
    from_ = after + seconds(-mean * std::log(1 - fraction(random_)));
    until_ = from_ + length_;
}

bool Outages::at(TimePoint time) {
    while (time >= until_) {
        ++count_;
        draw(until_);
    }
    return time >= from_;
}

std::optional<TimePoint> Channel::pass(TimePoint now, std::size_t bytes) {
    if (settings_.to_bad > 0 && fraction(random_) < (bad_ ? settings_.to_good : settings_.to_bad))
        bad_ = !bad_;
    const bool lost = fraction(random_) < (bad_ ? settings_.bad_loss : settings_.loss);
    const auto jitter = seconds(fraction(random_) * std::chrono::duration<double>(settings_.jitter).count());

    auto on_air = now;
    if (settings_.bytes_per_s > 0) {
        const auto waiting =
            std::chrono::duration<double>(std::max<Duration>(free_ - now, Duration{})).count() *
            settings_.bytes_per_s;
        if (waiting + static_cast<double>(bytes) > static_cast<double>(settings_.queue)) {
            ++counters_.queue_full;
            return std::nullopt;
        }
        free_ = std::max(free_, now) + seconds(static_cast<double>(bytes) / settings_.bytes_per_s);
        on_air = free_;
    }
    if (outages_.at(now)) {
        ++counters_.in_outage;
        return std::nullopt;
    }
    if (lost) {
        ++counters_.lost;
        return std::nullopt;
    }
    ++counters_.passed;
    last_ = std::max(last_, on_air + settings_.delay + jitter);
    return last_;
}

}  // namespace axon::faults
