// SPDX-License-Identifier: GPL-2.0-or-later
#include <gtest/gtest.h>

#include <sched.h>
#include <sys/socket.h>
#include <unistd.h>

#include <filesystem>
#include <future>
#include <limits>
#include <thread>

#include "board.hpp"
#include "child.hpp"
#include "common/descriptor.hpp"
#include "contender.hpp"
#include "ddsperf.hpp"
#include "nats_peer.hpp"
#include "placement.hpp"
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

/// How many cores a process may use.
int coresOfProcess(pid_t process) {
    cpu_set_t set;
    return ::sched_getaffinity(process, sizeof(set), &set) == 0 ? CPU_COUNT(&set) : 0;
}
bool share(pid_t one, pid_t other) {
    cpu_set_t its{}, others{}, both{};
    ::sched_getaffinity(one, sizeof(its), &its);
    ::sched_getaffinity(other, sizeof(others), &others);
    CPU_AND(&both, &its, &others);
    return CPU_COUNT(&both) > 0;
}

TEST(BenchPlacement, MovesEveryThreadOfThisProcessAndItsChildrenAndPutsThemBack) {
    const auto before = coresOfProcess(0);
    const WorkFolder work;
    const Child child({"sleep", "60"}, work.sub("child") / "log");
    std::promise<void> end;
    std::promise<pid_t> begun;
    std::thread thread([&] {
        begun.set_value(::gettid());
        end.get_future().wait();
    });
    const auto other = begun.get_future().get();
    {
        Placement placement;
        placement.apply(Cores::One);
        for (const auto process : {0, other, child.pid()}) EXPECT_EQ(coresOfProcess(process), 1);
        EXPECT_TRUE(share(0, child.pid()));
        if (placement.permits(Cores::Two)) {
            placement.apply(Cores::Two);
            for (const auto process : {0, other, child.pid()}) EXPECT_EQ(coresOfProcess(process), 1);
            EXPECT_TRUE(share(0, other));
            EXPECT_FALSE(share(0, child.pid()));
            const Child sender({"sleep", "60"}, work.sub("sender") / "log", {}, placement.asSender());
            const Child receiver({"sleep", "60"}, work.sub("receiver") / "log", {}, placement.asReceiver());
            sender.waitUntil([&] { return !share(sender.pid(), receiver.pid()); }, "they share a core",
                             std::chrono::seconds{10});
            EXPECT_TRUE(share(0, sender.pid()));
        }
    }
    for (const auto process : {0, other, child.pid()}) EXPECT_EQ(coresOfProcess(process), before);
    end.set_value();
    thread.join();
}

TEST(BenchPlacement, ItsNamesAreThoseOfTheOption) {
    for (const auto cores : {Cores::Any, Cores::One, Cores::Two}) EXPECT_EQ(coresOf(nameOf(cores)), cores);
    EXPECT_THROW(coresOf("three"), std::invalid_argument);
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

TEST(BenchRatios, APeerThatLosesMostBatchesHasNoMeanOverN) {
    constexpr double kNever = std::numeric_limits<double>::infinity();
    MeanOverN mean;
    mean.add(1, spread(ratios({1, 2, 3}, {2, 4, 6})));
    mean.add(64, spread(ratios({8, 8, kNever}, {4, 4, 4})));
    EXPECT_DOUBLE_EQ(mean.mean(), 1);
    const auto lost_by_it = spread(ratios({1, 1, 1}, {2, kNever, kNever}));
    EXPECT_EQ(figure(lost_by_it, "median", 0), "0.000");
    const auto lost_by_us = spread(ratios({1, kNever, kNever}, {2, 2, 2}));
    EXPECT_EQ(figure(lost_by_us, "median", 0), "never");
    const auto lost_by_both = spread(ratios({kNever}, {kNever}));
    EXPECT_EQ(figure(lost_by_both, "median", 0), "-");
    for (const auto& one : {lost_by_it, lost_by_us, lost_by_both}) {
        auto its = mean;
        its.add(256, one);
        EXPECT_TRUE(its.mean().is_null());
        EXPECT_EQ(its.n(), (std::vector<std::size_t>{1, 64}));
    }
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

/// Two receivers; `arrive` says what the sending does to them. Stops are counted.
class FakeSubject final : public Subject {
  public:
    using Arrive = std::function<void(Board&, Kind, std::int64_t called)>;
    explicit FakeSubject(Arrive arrive) : arrive_(std::move(arrive)), board_(file(), 2, true) {
        std::filesystem::remove(file());
    }
    Board& board() override { return board_; }
    bool numbered(Kind kind) const override { return kind == Kind::Data; }
    void send(Message message, const std::string&, std::vector<std::int64_t>& called) override {
        std::fill(called.begin(), called.end(), nowNs());
        if (arrive_) arrive_(board_, kindOf(message), called.front());
    }
    std::size_t relayed() const override { return ++asked_ == 2 ? 1 : 0; }

  private:
    static std::string file() { return testing::TempDir() + "axon_bench_test." + std::to_string(::getpid()); }
    Arrive arrive_;
    Board board_;
    mutable int asked_ = 0;
};

void bothNote(Board& board, Kind kind, std::uint32_t number, std::int64_t when) {
    for (std::size_t i = 0; i < board.size(); ++i) board[i].of(kind).note(number, when);
}

TEST(BenchContender, AStopLaterThanTwoSecondsIsLost) {
    Contender one("fake", std::make_unique<FakeSubject>(nullptr));
    auto bytes = content(kSmallBytes);
    const auto batch = one.send(Message::Stop, bytes, nowNs());
    EXPECT_EQ(one.firstMissing(batch), 0U);
    one.board()[0].stops.note(0, batch.begin + kPatience_ns);
    one.board()[1].stops.note(0, batch.begin + kPatience_ns + 1);
    EXPECT_EQ(one.firstMissing(batch), 2U) << "it has arrived, if too late";
    one.collect(batch, one.series);
    EXPECT_EQ(one.series.sent(), 2U);
    EXPECT_EQ(one.series.lost(), 1U);
}

TEST(BenchContender, AStopLostForGoodShiftsNothingAfterAPause) {
    Contender one("fake", std::make_unique<FakeSubject>(nullptr));
    auto bytes = content(kSmallBytes);
    const auto begin = nowNs();
    one.send(Message::Stop, bytes, begin);
    const auto soon = one.send(Message::Stop, bytes, begin + 50'000'000);
    bothNote(one.board(), Kind::Stop, 0, nowNs());
    EXPECT_EQ(one.firstMissing(soon), 0U) << "it may be the first one that has arrived";
    const auto later = one.send(Message::Stop, bytes, nowNs() + 2 * kPatience_ns);
    bothNote(one.board(), Kind::Stop, 1, later.begin);
    EXPECT_EQ(one.firstMissing(later), 2U);
}

TEST(BenchContender, WhatIsLateFromDueStaysOnTimeFromCall) {
    Contender one("fake", std::make_unique<FakeSubject>([](Board& board, Kind kind, std::int64_t called) {
                      bothNote(board, kind, 0, called + 1'000'000);
                  }));
    auto bytes = content(kSmallBytes);
    const auto batch = one.send(Message::Data, bytes, nowNs() - 100'000'000);
    Series from_begin, from_call;
    one.collect(batch, 0, 2, from_begin, &from_call, nullptr);
    EXPECT_GE(from_begin.json()["p50"], 101);
    EXPECT_DOUBLE_EQ(from_call.json()["max"], 1);
}

TEST(BenchContender, OverlappingStopsKeepTheirRowsAndThoseThatWarmUpDoNotCount) {
    constexpr int kWarm = 2, kCounted = 3;
    std::uint32_t sent = 0;
    std::int64_t arrived = 0;
    // All of them arrive when the last one is sent.
    Contender one("fake", std::make_unique<FakeSubject>([&](Board& board, Kind kind, std::int64_t) {
                      if (++sent < kWarm + kCounted) return;
                      arrived = nowNs();
                      for (std::uint32_t number = 0; number < sent; ++number)
                          bothNote(board, kind, number, arrived);
                  }));
    auto bytes = content(kSmallBytes);
    std::vector<Figures> figures{{0, 2, {}, {}, {}}};
    measurePaced(one, Message::Stop, bytes, {1'000'000, kCounted, kWarm}, figures);
    EXPECT_LT(nowNs(), arrived + kPatience_ns) << "what is there is not waited for";
    auto& from_batch = figures.front().from_batch;
    EXPECT_EQ(from_batch.json()["n"], 2 * kCounted);
    EXPECT_EQ(from_batch.lost(), 0U);
    ASSERT_EQ(from_batch.lasts().size(), std::size_t{kCounted});
    for (int i = 0; i + 1 < kCounted; ++i)
        EXPECT_NEAR(from_batch.lasts()[i] - from_batch.lasts()[i + 1], 1, 1e-6) << "a period of 1 ms";
    EXPECT_EQ(one.relayed, 1U) << "for a while one path was not there";
}

TEST(BenchChild, InheritsNothingOfOurs) {
    int pipe[2];
    ASSERT_EQ(::pipe(pipe), 0);
    const Descriptor ours(pipe[0]), other(pipe[1]);
    const WorkFolder folder;
    const Child child(
        {"sh", "-c",
         "test -e /proc/$$/fd/" + std::to_string(pipe[0]) + " && echo open || echo closed; exec sleep 60"},
        folder.sub("child") / "log");
    EXPECT_NO_THROW(child.waitForLine("closed"));
}

TEST(BenchWorkFolder, StaysWhereALogOfItWasNamed) {
    std::filesystem::path path;
    {
        const WorkFolder folder;
        path = folder.sub("server");
    }
    EXPECT_FALSE(std::filesystem::exists(path));
    {
        const WorkFolder folder;
        EXPECT_EQ(see(folder.sub("server") / "log"), "; see " + (path / "log").string());
    }
    EXPECT_TRUE(std::filesystem::exists(path));
    std::filesystem::remove_all(path.parent_path());
}

TEST(BenchInbox, TakesMessagesThatComeInPiecesAndAreLongerThanTheBuffer) {
    std::uint16_t port = 0;
    const tcp::Connection listener(tcp::listen(port));
    const tcp::Connection to(port), from(Descriptor(::accept(listener.fd(), nullptr, nullptr)));
    tcp::Inbox inbox;
    std::vector<char> shared(8);
    std::vector<std::string> lines;
    const auto take = [&](std::size_t count) {
        while (lines.size() < count) {
            std::fill(shared.begin(), shared.end(), '\n');  // what another connection has left there
            inbox.take(from, shared, [&](std::string_view received) {
                std::size_t used = 0;
                for (auto end = received.find('\n'); end != std::string_view::npos;
                     end = received.find('\n', used)) {
                    lines.emplace_back(received.substr(used, end - used));
                    used = end + 1;
                }
                return used;
            });
        }
    };
    to.write({"one\ntw"});
    take(1);
    to.write({"o\nas long as three buffers\nfo"});
    take(3);
    to.write({"ur\n"});
    take(4);
    EXPECT_EQ(lines, (std::vector<std::string>{"one", "two", "as long as three buffers", "four"}));
}

TEST(BenchNats, TakesWholeMessagesAndLeavesTheRest) {
    std::uint16_t port = 0;
    const auto listening = tcp::listen(port);
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
    const auto second = readDdsperf(
        "[4711] 2.001  host:4710 size 60 mean 38.123us min 20.000us 50% 36.500us 90% 45.000us 99% 80.250us "
        "max 310.000us cnt 12345");
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
