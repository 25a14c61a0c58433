// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/distribution.hpp"

#include <gmock/gmock.h>

#include <cmath>

using namespace axon::cli;

namespace {

Distribution of(int count) {
    Distribution times;
    for (int i = count; i > 0; --i) times.add(Seconds(i / 1000.0));
    return times;
}

}  // namespace

TEST(DistributionTest, APercentileNeedsEnoughTries) {
    EXPECT_FALSE(of(0).quantile(1));
    EXPECT_FALSE(of(1).quantile(0.5));
    EXPECT_DOUBLE_EQ(*of(2).quantile(0.5), 1);
    EXPECT_FALSE(of(9).quantile(0.9));
    EXPECT_DOUBLE_EQ(*of(10).quantile(0.9), 9);
    EXPECT_FALSE(of(99).quantile(0.99));
    EXPECT_DOUBLE_EQ(*of(100).quantile(0.99), 99);
    EXPECT_FALSE(of(999).quantile(0.999));
    EXPECT_DOUBLE_EQ(*of(1000).quantile(0.999), 999);
    EXPECT_DOUBLE_EQ(*of(7).quantile(1), 7);
}

TEST(DistributionTest, WhatNeverArrivedIsInfinitelyLate) {
    auto times = of(9);
    times.add(std::nullopt);
    EXPECT_DOUBLE_EQ(*times.quantile(0.9), 9);
    EXPECT_TRUE(std::isinf(*times.quantile(1)));
    const auto json = times.toJson();
    EXPECT_EQ(json.at("n"), 10);
    EXPECT_EQ(json.at("never_arrived"), 1);
    EXPECT_EQ(json.at("max_ms"), "never");
    EXPECT_EQ(json.at("p99_ms"), nullptr);
    EXPECT_EQ(json.at("samples_ms").at(9), nullptr);
}

TEST(DistributionTest, AnyNumberOfTriesFitsIntoALineOfTheAgent) {
    Distribution times;
    for (int i = 0; i < 50'000; ++i) times.add(Seconds(0.001 / 3 + i * 1e-9 / 7));
    const auto json = times.toJson();
    EXPECT_EQ(json.at("n"), 50'000);
    EXPECT_EQ(json.at("samples_ms").size(), Distribution::kSamples);
    EXPECT_LT(2 * json.dump().size(), std::size_t{1} << 20U) << "an event has two of them";
}

TEST(DistributionTest, TheHistogramGoesFromTheFirstToTheLast) {
    Distribution times;
    for (const double ms : {0.3, 0.4, 3.0, 20000.0}) times.add(Seconds(ms / 1000));
    const auto bins = times.histogram();
    EXPECT_DOUBLE_EQ(bins.front().up_to_ms, 0.5);
    EXPECT_EQ(bins.front().count, 2U);
    EXPECT_EQ(bins.back().count, 1U) << "later than the last edge counts there";
    std::size_t sum = 0;
    for (const auto& bin : bins) sum += bin.count;
    EXPECT_EQ(sum, 4U);
    EXPECT_TRUE(of(0).histogram().empty());
}
