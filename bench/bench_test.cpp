// SPDX-License-Identifier: GPL-2.0-or-later
#include <gtest/gtest.h>

#include "board.hpp"
#include "ddsperf.hpp"
#include "nats_peer.hpp"
#include "report.hpp"

namespace axon::bench {
namespace {

TEST(BenchContent, EveryByteCounts) {
    auto bytes = content(kDataBytes);
    ASSERT_EQ(bytes.size(), 35000U);
    setNumber(bytes, 123'456'789);
    EXPECT_EQ(readContent(bytes.data(), bytes.size()), 123'456'789U);
    for (const std::size_t at : {std::size_t{0}, std::size_t{7}, std::size_t{17'000}, bytes.size() - 1}) {
        auto wrong = bytes;
        wrong[at] = static_cast<char>(wrong[at] ^ 1);
        EXPECT_FALSE(readContent(wrong.data(), wrong.size())) << at;
    }
    EXPECT_FALSE(readContent(bytes.data(), 3));
}

TEST(BenchContent, ShortContentIsTheBeginningOfTheLong) {
    const auto bytes = content(kSmallBytes);
    EXPECT_EQ(bytes, content(kDataBytes).substr(0, kSmallBytes));
    EXPECT_EQ(readContent(bytes.data(), bytes.size()), 0U);
}

TEST(BenchSlot, ALostMessageIsMisplacedAndACorruptOneHasNotArrived) {
    Slot slot;
    auto bytes = content(kSmallBytes);
    const auto arrive = [&](std::uint32_t number, std::int64_t when) {
        setNumber(bytes, number);
        slot.arrived(Kind::Data, when, bytes.data(), bytes.size());
    };
    arrive(0, 10);
    arrive(2, 20);
    EXPECT_EQ(slot.misplaced, 1U);
    EXPECT_EQ(slot.data.of(2), 20);
    arrive(3, 30);
    EXPECT_EQ(slot.misplaced, 1U);
    bytes[40] = 'Z';
    slot.arrived(Kind::Data, 40, bytes.data(), bytes.size());
    EXPECT_EQ(slot.corrupt, 1U);
    EXPECT_EQ(slot.data.next, 4U);
    EXPECT_EQ(slot.intact, 3U) << "not the last number";
}

TEST(BenchSlot, AStopThatANewerOneOvertookHasReachedTheApplicationWithIt) {
    Slot manager, robot;
    manager.stopped(1001, 10);
    manager.stopped(1002, 20);
    robot.reachedGeneration(1002, 30);
    robot.reachedGeneration(1002, 40);
    EXPECT_EQ(robot.reached(0, manager), 30);
    EXPECT_EQ(robot.reached(1, manager), 30);
    manager.stopped(1003, 50);
    EXPECT_LT(robot.reached(2, manager), 50) << "of a generation 64 before, or none";
}

TEST(BenchSeries, WhatNeverArrivedIsInfinitelyLate) {
    Series series;
    series.beginBatch();
    for (int i = 1; i <= 98; ++i) series.add(i);
    series.lose();
    series.lose();
    const auto json = series.json();
    EXPECT_EQ(json["n"], 100);
    EXPECT_EQ(json["lost"], 2);
    EXPECT_DOUBLE_EQ(json["p50"], 50.5);
    EXPECT_TRUE(json["p99"].is_null());
    EXPECT_TRUE(json["max"].is_null());
    EXPECT_TRUE(json["last"].is_null());
    EXPECT_DOUBLE_EQ(json["mean"], 49.5);
    EXPECT_FALSE(json.contains("p99.9")) << "too few for it";
}

TEST(BenchSeries, BatchesHaveTheirOwnMeanAndLast) {
    Series series;
    for (const double last : {4.0, 6.0, 8.0}) {
        series.beginBatch();
        series.add(2);
        series.add(last);
    }
    EXPECT_DOUBLE_EQ(series.json()["last"], 6);
    EXPECT_EQ(series.means(), (std::vector<double>{3, 4, 5}));
    EXPECT_EQ(series.lasts(), (std::vector<double>{4, 6, 8}));
    EXPECT_DOUBLE_EQ(spread({0.5, 2, 1})["median"], 1);
}

TEST(BenchSeries, QuantilesAreOfTheNearestRank) {
    std::vector<double> values;
    for (int i = 1; i <= 100; ++i) values.push_back(i);
    EXPECT_DOUBLE_EQ(quantile(values, 0.5), 50.5);
    EXPECT_DOUBLE_EQ(quantile(values, 0.07), 7);
    EXPECT_DOUBLE_EQ(quantile(values, 0.99), 99);
    EXPECT_DOUBLE_EQ(quantile(values, 0.999), 100);
    EXPECT_DOUBLE_EQ(quantile({1, 2, 3}, 0.5), 2);
    EXPECT_DOUBLE_EQ(quantile({1, 2, 3}, 0.99), 3);
    EXPECT_DOUBLE_EQ(quantile({1, 2, 3}, 0.1), 1);
    EXPECT_DOUBLE_EQ(quantile({1, 2}, 1), 2);
    EXPECT_DOUBLE_EQ(quantile({7}, 0), 7);
    EXPECT_DOUBLE_EQ(quantile({}, 0.5), 0);
}

TEST(BenchNats, TakesWholeMessagesAndLeavesTheRest) {
    std::uint16_t port = 0;
    tcp::listen(port);
    const tcp::Connection connection(port);
    Slot slot;
    int ready = 0;
    auto bytes = content(kSmallBytes);
    const auto consume = [&](const std::string& received) {
        return NatsReceiver().consume(connection, received, 7, slot, [&ready] { ++ready; });
    };
    const std::string greeting = "INFO {\"max_payload\":1048576}\r\nPONG\r\nPING\r\n";
    EXPECT_EQ(consume(greeting), greeting.size());
    EXPECT_EQ(ready, 1);
    const auto message = "MSG s.17 1 60\r\n" + bytes + "\r\n";
    EXPECT_EQ(consume(message + message.substr(0, 30)), message.size());
    EXPECT_EQ(slot.stops.next, 1U);
    EXPECT_EQ(slot.stops.of(0), 7);
    EXPECT_EQ(consume(message.substr(0, message.size() - 1)), 0U);
    EXPECT_THROW(consume("-ERR 'Slow Consumer'\r\n"), std::runtime_error);
    EXPECT_THROW(consume("MSG s.17 1 sixty\r\n"), std::runtime_error);
}

TEST(BenchDdsperf, ReadsASecondOfIt) {
    const auto second =
        readDdsperf("[4711] 2.001  host:4710 size 60 mean 38.123us min 20.000us 50% 36.500us 90% 45.000us 99% 80.250us max 310.000us cnt 12345");
    ASSERT_TRUE(second);
    EXPECT_DOUBLE_EQ(second->mean_us, 38.123);
    EXPECT_DOUBLE_EQ(second->p50_us, 36.5);
    EXPECT_DOUBLE_EQ(second->p99_us, 80.25);
    EXPECT_DOUBLE_EQ(second->max_us, 310);
    EXPECT_EQ(second->count, 12345);
    EXPECT_FALSE(readDdsperf("[4711] 2.001  rss:5.0MB vcsw:22000 ivcsw:4 recv:20%+5%"));
    EXPECT_FALSE(readDdsperf("[4711] participant host:4710: new"));
}

}  // namespace
}  // namespace axon::bench
