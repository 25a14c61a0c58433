// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <optional>

#include "common/clock.hpp"
#include "common/ids.hpp"

namespace axon::faults {

/// What a radio link does to packets. The defaults do nothing.
struct ChannelSettings {
    double loss =
        0;  ///< share of packets lost, each by itself; in Gilbert's good state where there is a bad one
    /// Gilbert and Elliott's model of bursts: in the bad state `bad_loss` of the packets are lost. A packet
    /// finds the state changed with these probabilities; to_bad = 0 switches it off.
    double to_bad = 0, to_good = 0, bad_loss = 1;
    Duration outage{};        ///< nothing passes, in either direction, for so long …
    Duration outage_every{};  ///< … and this is the mean time from the end of one to the next; 0 = never
    Duration delay{};
    Duration jitter{};           ///< up to so much more, evenly distributed; the order is kept
    double bytes_per_s = 0;      ///< 0 = as fast as they come
    std::size_t queue = 65'536;  ///< bytes that wait for their turn; what finds it full is lost
};

/// When the air is dead, for both directions alike. Asked in the order of time.
class Outages {
  public:
    Outages(const ChannelSettings& settings, std::uint64_t seed, TimePoint begin);
    bool at(TimePoint time);
    std::uint64_t count() const { return count_; }

  private:
    void draw(TimePoint after);
    const Duration length_, mean_;
    SeededRandom random_;
    TimePoint from_ = TimePoint::max(), until_ = TimePoint::max();
    std::uint64_t count_ = 0;
};

/// One direction of the link. Pure: the same seed and the same arrivals give the same fates.
class Channel {
  public:
    struct Counters {
        std::uint64_t passed = 0, lost = 0, in_outage = 0, queue_full = 0;
    };
    Channel(const ChannelSettings& settings, std::uint64_t seed, Outages& outages)
        : settings_(settings), random_(seed), outages_(outages) {}

    /// When a packet of this size that comes now comes out; nothing = never. Calls in the order of time.
    std::optional<TimePoint> pass(TimePoint now, std::size_t bytes);
    const Counters& counters() const { return counters_; }

  private:
    const ChannelSettings settings_;
    SeededRandom random_;
    Outages& outages_;
    bool bad_ = false;
    TimePoint free_{};  ///< when the last packet has been put on the air
    TimePoint last_{};  ///< when the last packet comes out
    Counters counters_;
};

}  // namespace axon::faults
