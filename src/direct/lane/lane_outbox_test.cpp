// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/lane/lane_outbox.hpp"

#include <gtest/gtest.h>

#include <vector>

#include "common/frame.hpp"

namespace axon::direct::lane {
namespace {

using Outcome = LaneOutbox::Outcome;

/// Takes as many bytes as it is told to.
struct Pipe final : Wire {
    std::optional<std::size_t> write(std::span<const std::string_view> pieces) override {
        ++writes;
        if (broken) return std::nullopt;
        std::size_t taken = 0;
        for (const auto piece : pieces) {
            const auto part = piece.substr(0, room);
            taken += part.size();
            room -= part.size();
            came += part;
        }
        return taken;
    }
    std::vector<std::int64_t> sequences() const {
        std::vector<std::int64_t> all;
        FrameReader reader(kMessageFrameMax);
        reader.feed(came);
        while (const auto frame = reader.nextView()) all.push_back(messageIn(*frame).value().sequence);
        return all;
    }
    std::size_t room = 1'000'000'000;
    bool broken = false;
    int writes = 0;
    std::string came;
};

class LaneOutboxTest : public ::testing::Test {
  protected:
    Outcome post(std::int64_t sequence, std::size_t bytes = 100, Keeping keeping = Keeping::Kept) {
        Header head;
        head.sequence = sequence;
        return outbox.post(keeping, head, std::make_shared<const std::string>(bytes, 'x'));
    }
    static transport::OutboxLimits limits() {
        transport::OutboxLimits its;
        its.window_bytes = 1000;
        its.data_bytes = 3000;
        its.control_bytes = 3000;
        return its;
    }
    Pipe pipe;
    std::size_t kept_waiting = 0;
    LaneOutbox outbox{limits(), pipe, [this](std::size_t) {
                          ++kept_waiting;
                          return std::shared_ptr<void>(nullptr, [this](void*) { --kept_waiting; });
                      }};
};

TEST_F(LaneOutboxTest, WhereNothingIsInTheWayAMessageIsWrittenAtOnceByOneCall) {
    EXPECT_EQ(post(1), Outcome::Taken);
    EXPECT_EQ(post(2), Outcome::Taken);
    EXPECT_EQ(pipe.writes, 2);
    EXPECT_EQ(pipe.sequences(), (std::vector<std::int64_t>{1, 2}));
    EXPECT_FALSE(outbox.waiting());
}

TEST_F(LaneOutboxTest, WhatWaitsGoesInOrderAndManyMessagesByOneCall) {
    pipe.room = 50;
    std::vector<std::int64_t> sent;
    for (std::int64_t i = 1; i <= 20; ++i) {
        ASSERT_EQ(post(i), Outcome::Taken);
        sent.push_back(i);
    }
    EXPECT_TRUE(outbox.waiting());
    EXPECT_GT(kept_waiting, 0U);
    pipe.room = 1'000'000;
    pipe.writes = 0;
    EXPECT_EQ(outbox.flush(), Outcome::Taken);
    EXPECT_LE(pipe.writes, 4) << "a window at a time";
    EXPECT_EQ(pipe.sequences(), sent);
    EXPECT_FALSE(outbox.waiting());
    EXPECT_EQ(kept_waiting, 0U);
    EXPECT_EQ(outbox.counts().unsent_bytes, 0U);
}

TEST_F(LaneOutboxTest, EveryPartialWriteGivesTheSameBytes) {
    for (const std::size_t step : {1U, 3U, 7U, 32U, 131U, 500U}) {
        Pipe slow;
        LaneOutbox its{{}, slow};
        slow.room = 0;
        std::vector<std::int64_t> sent;
        for (std::int64_t i = 1; i <= 30; ++i) {
            Header head;
            head.sequence = i;
            head.msg_type = kMsgText;
            its.post(Keeping::Kept, head,
                     std::make_shared<const std::string>(static_cast<std::size_t>(i % 7), 'x'));
            sent.push_back(i);
        }
        while (its.waiting()) {
            slow.room = step;
            ASSERT_EQ(its.flush(), Outcome::Taken);
        }
        ASSERT_EQ(slow.sequences(), sent) << "by " << step;
    }
}

TEST_F(LaneOutboxTest, OfDataTheOldestIsDroppedAndOfTheRestNothing) {
    pipe.room = 0;
    std::vector<std::int64_t> kept;
    for (std::int64_t i = 1; i <= 100; ++i) {
        const bool keeps = i % 10 == 0;
        ASSERT_EQ(post(i, 200, keeps ? Keeping::Kept : Keeping::Droppable), Outcome::Taken);
        if (keeps) kept.push_back(i);
    }
    EXPECT_GT(outbox.counts().dropped, 0U);
    pipe.room = 1'000'000;
    outbox.flush();
    const auto came = pipe.sequences();
    EXPECT_TRUE(std::is_sorted(came.begin(), came.end()));
    for (const auto one : kept) EXPECT_EQ(std::count(came.begin(), came.end(), one), 1) << one;
    EXPECT_EQ(came.back(), 100);
    EXPECT_LT(came.size(), 100U);
}

TEST_F(LaneOutboxTest, TooMuchThatMayNotBeDroppedIsTheEnd) {
    pipe.room = 0;
    Outcome last = Outcome::Taken;
    int sent = 0;
    while (last == Outcome::Taken && sent < 1000) last = post(++sent, 200);
    EXPECT_EQ(last, Outcome::Overflow);
    EXPECT_GT(sent, 15) << "window and bound";
    EXPECT_EQ(kept_waiting, 0U);
    EXPECT_EQ(post(2000), Outcome::Over);
    EXPECT_EQ(outbox.flush(), Outcome::Over);
}

TEST_F(LaneOutboxTest, AMessageLargerThanTheLaneTakesIsNotBegun) {
    EXPECT_EQ(post(1, kMessageMax + 1), Outcome::TooLarge);
    EXPECT_EQ(pipe.writes, 0);
    EXPECT_EQ(post(2, kMessageMax), Outcome::Taken);
}

TEST_F(LaneOutboxTest, NothingIsWrittenAfterABreakOrAnEnd) {
    pipe.room = 10;
    post(1);
    pipe.broken = true;
    EXPECT_EQ(outbox.flush(), Outcome::Over);
    const auto writes = pipe.writes;
    EXPECT_EQ(post(2), Outcome::Over);
    EXPECT_EQ(pipe.writes, writes);
    EXPECT_FALSE(outbox.waiting());

    Pipe other;
    LaneOutbox closed{{}, other};
    closed.close();
    EXPECT_EQ(closed.post(Keeping::Kept, {}, std::make_shared<const std::string>("x")), Outcome::Over);
    EXPECT_EQ(other.writes, 0);
}

TEST_F(LaneOutboxTest, AWireThatTakesMoreJustAfterItWasFullIsAskedOnceMore) {
    struct Late final : Wire {
        std::optional<std::size_t> write(std::span<const std::string_view> pieces) override {
            if (writes++ == 0) return 0;
            std::size_t all = 0;
            for (const auto piece : pieces) all += piece.size();
            return all;
        }
        int writes = 0;
    } late;
    LaneOutbox its{{}, late};
    its.post(Keeping::Kept, {}, std::make_shared<const std::string>("x"));
    EXPECT_FALSE(its.waiting()) << "who was told that nothing waits does not come";
}

}  // namespace
}  // namespace axon::direct::lane
