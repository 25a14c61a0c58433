// SPDX-License-Identifier: GPL-2.0-or-later
#include "figures.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <nlohmann/json.hpp>

#include "board.hpp"

namespace axon::faults {
namespace {

Series upTo(int n) {
    Series series;
    for (int i = n; i >= 1; --i) series.add(i);
    return series;
}

TEST(Figures, PercentilesAreShownOnlyWhereSoManySupportThem) {
    EXPECT_FALSE(upTo(1).percentile(0.5));
    EXPECT_FALSE(upTo(99).percentile(0.99));
    EXPECT_EQ(upTo(100).percentile(0.99), 99);
    EXPECT_FALSE(upTo(999).percentile(0.999));
    EXPECT_EQ(upTo(1000).percentile(0.999), 999);
    EXPECT_EQ(upTo(1000).percentile(0.5), 500);
}

TEST(Figures, WhatNeverArrivedIsInfinitelyLate) {
    auto series = upTo(98);
    series.addNever();
    series.addNever();
    EXPECT_EQ(series.percentile(0.5), 50);
    EXPECT_TRUE(std::isinf(*series.percentile(0.99)));
    EXPECT_TRUE(std::isinf(*series.maximum()));
    EXPECT_EQ(series.minimum(), 1);
}

Report kept() {
    Report report;
    report.kind = "kill-client";
    report.promise = {350, 20, "every stop within 350 ms"};
    report.trials = report.trials_wanted = 100;
    report.latency = upTo(10);
    return report;
}

TEST(Figures, AKeptPromiseHasNothingToSay) {
    EXPECT_TRUE(kept().broken().empty());
}

TEST(Figures, EachWayToBreakThePromiseIsNamed) {
    auto never = kept();
    never.latency.addNever();
    EXPECT_EQ(never.broken().size(), 1U);
    auto late = kept();
    late.late = 2;
    late.late_beside_stall = 1;
    EXPECT_EQ(late.broken().size(), 1U);
    late.late_beside_stall = 2;
    EXPECT_TRUE(late.broken().empty()) << "the host stood still, not the product";
    auto slow = kept();
    slow.latency = upTo(200);
    EXPECT_EQ(slow.broken().size(), 1U) << "p99 is 198 ms";
    slow.busy = true;
    EXPECT_TRUE(slow.broken().empty()) << "the percentile is promised for a host with time to spare";
    auto tail = kept();
    tail.promise.p99_ms = 0;
    tail.promise.p999_ms = 500;
    tail.latency = upTo(999);
    tail.promise.bound_ms = 2000;
    EXPECT_TRUE(tail.broken().empty()) << "999 stops do not support a p99.9";
    tail.latency = upTo(1000);
    EXPECT_EQ(tail.broken().size(), 1U) << "p99.9 is 999 ms";
    auto moved = kept();
    moved.moved_after_stop = 1;
    EXPECT_EQ(moved.broken().size(), 1U);
    auto gone = kept();
    gone.not_recovered = 1;
    EXPECT_EQ(gone.broken().size(), 1U);
    auto wrong = kept();
    wrong.violation("two hold it");
    EXPECT_EQ(wrong.broken().size(), 1U);
    auto nothing = kept();
    nothing.trials = 0;
    EXPECT_EQ(nothing.broken().size(), 1U);
}

TEST(Figures, ViolationsAreCountedBeyondThoseShown) {
    auto report = kept();
    for (int i = 0; i < 1000; ++i) report.violation("again");
    EXPECT_EQ(report.violations.size(), 100U);
    EXPECT_EQ(report.violations_count, 1000U);
}

TEST(Figures, JsonSaysNeverAndLeavesOutWhatIsNotSupported) {
    auto report = kept();
    report.latency.addNever();
    const auto json = nlohmann::json::parse(toJson(report));
    EXPECT_EQ(json["latency_ms"]["max"], "never");
    EXPECT_TRUE(json["latency_ms"]["p99"].is_null());
    EXPECT_EQ(json["kept"], false);
    EXPECT_NE(toText(report).find("BROKEN"), std::string::npos);
}

TEST(Board, TheFirstStopAfterTheFaultIsFoundAmongEarlierAndLaterOnes) {
    Slot slot;
    slot.stopped(1);
    const auto before = slot.stops.load();
    EXPECT_EQ(slot.firstStop(before, 0), nullptr);
    const auto fault = nowNs();
    slot.stopped(2);
    slot.stopped(3);
    ASSERT_NE(slot.firstStop(before, fault), nullptr);
    EXPECT_EQ(slot.firstStop(before, fault)->cause, 2U);
    EXPECT_EQ(slot.firstStop(before, nowNs() + 1), nullptr) << "what was before the fault does not count";
    for (std::uint32_t i = 0; i < 2 * Slot::kMarks; ++i) slot.stopped(7);
    EXPECT_EQ(slot.firstStop(before, fault)->cause, 7U) << "the oldest are overwritten";
}

}  // namespace
}  // namespace axon::faults
