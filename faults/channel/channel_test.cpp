// SPDX-License-Identifier: GPL-2.0-or-later
#include "channel/channel.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <utility>
#include <vector>

namespace axon::faults {
namespace {

using namespace std::chrono_literals;

constexpr TimePoint kBegin{std::chrono::seconds{1000}};

/// A packet each millisecond.
std::vector<std::optional<TimePoint>> send(const ChannelSettings& settings, int packets,
                                           std::uint64_t seed = 1, std::size_t bytes = 100) {
    Outages outages(settings, seed + 1, kBegin);
    Channel channel(settings, seed, outages);
    std::vector<std::optional<TimePoint>> fates;
    for (int i = 0; i < packets; ++i) fates.push_back(channel.pass(kBegin + i * 1ms, bytes));
    return fates;
}

double share(const std::vector<std::optional<TimePoint>>& fates) {
    return static_cast<double>(std::count(fates.begin(), fates.end(), std::nullopt)) /
           static_cast<double>(fates.size());
}

TEST(Channel, WithoutSettingsPassesEverythingAtOnce) {
    const auto fates = send({}, 1000);
    for (int i = 0; i < 1000; ++i) EXPECT_EQ(fates[static_cast<std::size_t>(i)], kBegin + i * 1ms);
}

TEST(Channel, LosesTheShareThatItIsTold) {
    ChannelSettings settings;
    settings.loss = 0.022;
    EXPECT_NEAR(share(send(settings, 100'000)), 0.022, 0.003);
}

TEST(Channel, TheSameSeedGivesTheSameFates) {
    ChannelSettings settings;
    settings.loss = 0.3;
    settings.jitter = 5ms;
    EXPECT_EQ(send(settings, 1000, 7), send(settings, 1000, 7));
    EXPECT_NE(send(settings, 1000, 7), send(settings, 1000, 8));
}

TEST(Channel, DelaysAndJittersWithoutReordering) {
    ChannelSettings settings;
    settings.delay = 2ms;
    settings.jitter = 10ms;
    const auto fates = send(settings, 1000);
    EXPECT_TRUE(std::is_sorted(fates.begin(), fates.end()));
    Duration longest{};
    for (int i = 0; i < 1000; ++i) {
        const auto taken = *fates[static_cast<std::size_t>(i)] - (kBegin + i * 1ms);
        EXPECT_GE(taken, 2ms);
        EXPECT_LE(taken, 12ms);
        longest = std::max<Duration>(longest, taken);
    }
    EXPECT_GT(longest, 11ms);
}

TEST(Channel, ALimitedRateDelaysAndAFullQueueDrops) {
    ChannelSettings settings;
    settings.bytes_per_s = 50'000;  // half of what is sent
    settings.queue = 1000;
    const auto fates = send(settings, 1000);
    EXPECT_EQ(*fates[0], kBegin + 2ms) << "100 bytes take 2 ms";
    EXPECT_NEAR(share(fates), 0.5, 0.02);
    for (int i = 0; i < 1000; ++i)
        if (const auto& at = fates[static_cast<std::size_t>(i)])
            EXPECT_LE(*at - (kBegin + i * 1ms), 20ms) << "1000 bytes";
}

TEST(Channel, AnOutageTakesEverythingForItsTime) {
    ChannelSettings settings;
    settings.outage = 60ms;
    settings.outage_every = 1s;
    const auto fates = send(settings, 200'000);
    EXPECT_NEAR(share(fates), 0.06 / 1.06, 0.01);
    int run = 0;
    std::vector<int> runs;
    for (const auto& fate : fates) {
        if (!fate) {
            ++run;
        } else if (run > 0) {
            runs.push_back(std::exchange(run, 0));
        }
    }
    EXPECT_GT(runs.size(), 150U);
    // 60 packets each; two outages that touch count as one.
    EXPECT_GE(*std::min_element(runs.begin(), runs.end()), 59);
}

TEST(Channel, OutagesAreThoseOfBothDirections) {
    ChannelSettings settings;
    settings.outage = 60ms;
    settings.outage_every = 200ms;
    Outages outages(settings, 3, kBegin);
    Channel there(settings, 1, outages), back(settings, 2, outages);
    for (int i = 0; i < 10'000; ++i) {
        const auto now = kBegin + i * 1ms;
        EXPECT_EQ(there.pass(now, 100).has_value(), back.pass(now, 100).has_value());
    }
    EXPECT_GT(outages.count(), 20U);
}

TEST(Channel, BurstsAreLongerThanChanceMakesThem) {
    ChannelSettings settings;
    settings.to_bad = 0.01;
    settings.to_good = 0.2;  // a twentieth of the packets find the bad state, five in a row on average
    const auto fates = send(settings, 100'000);
    EXPECT_NEAR(share(fates), 0.01 / 0.21, 0.006);
    int pairs = 0, losses = 0;
    for (std::size_t i = 1; i < fates.size(); ++i) {
        losses += !fates[i - 1];
        pairs += !fates[i - 1] && !fates[i];
    }
    EXPECT_GT(pairs, losses * 7 / 10);
}

}  // namespace
}  // namespace axon::faults
