// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <deque>

#include "robots/ssc32/client_session.hpp"
#include "robots/ssc32/protocol.hpp"

namespace axon::ssc32 {
namespace {

using std::chrono::milliseconds;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

TEST(Ssc32Protocol, AGroupIsOneLineWithItsTimeInMilliseconds) {
    const std::array moves{ServoMove{0, 1500}, ServoMove{7, 600}};
    EXPECT_EQ(encodeMove(moves, milliseconds{50}), "#0P1500#7P600T50\r");
    EXPECT_EQ(encodeMove(moves), "#0P1500#7P600\r");
    EXPECT_EQ(encodePulseQuery(12), "QP12\r");
}

TEST(Ssc32Protocol, NoPulseAndNoTimeThatTheBoardCannotTake) {
    const std::array moves{ServoMove{1, 90}, ServoMove{2, 9000}};
    EXPECT_EQ(encodeMove(moves, Duration::zero()), "#1P500#2P2500T1\r");
    EXPECT_EQ(encodeMove(moves, std::chrono::hours{1}), "#1P500#2P2500T65535\r");
}

/// Plays the board from a script: what it expects, what it answers.
class ScriptedBoard : public ::testing::Test, public ClientSession::Port {
  protected:
    void send(const std::string& bytes) override { sent_.push_back(bytes); }
    void onOnline(const std::vector<int>& pulses) override { online_.push_back(pulses); }
    void onPulses(const std::vector<int>& pulses) override { pulses_.push_back(pulses); }
    void onStatus(bool moving) override { statuses_.push_back(moving); }
    void onLost(const std::string& reason) override { lost_.push_back(reason); }

    std::string next() {
        if (sent_.empty()) return {};
        auto bytes = sent_.front();
        sent_.pop_front();
        return bytes;
    }
    void answer(std::initializer_list<int> bytes) {
        std::vector<std::uint8_t> out(bytes.begin(), bytes.end());
        session_.receive(out, clock_.now());
    }
    void pass(Duration time) {
        clock_.advance(time);
        session_.tick(clock_.now());
    }
    void connect() {
        session_.begin(clock_.now());
        answer({'.'});
        answer({150});
        answer({60});
        sent_.clear();
    }

    ManualClock clock_;
    ClientSession session_{*this, {0, 7}};
    std::deque<std::string> sent_;
    std::vector<std::vector<int>> online_, pulses_;
    std::vector<bool> statuses_;
    std::vector<std::string> lost_;
};

TEST_F(ScriptedBoard, IsOnlineWhenItHasToldAllPulses) {
    session_.begin(clock_.now());
    EXPECT_EQ(next(), "\r");
    EXPECT_EQ(next(), "Q\r");
    answer({'.'});
    EXPECT_EQ(next(), "QP0\r");
    answer({151});
    EXPECT_EQ(next(), "QP7\r");
    EXPECT_TRUE(online_.empty());
    answer({0});
    ASSERT_EQ(online_.size(), 1U);
    EXPECT_THAT(online_[0], ElementsAre(1510, 0));
    EXPECT_EQ(next(), "") << "connecting moves nothing";
}

TEST_F(ScriptedBoard, WaitsForTheEndOfAMoveThatSomebodyLeft) {
    session_.begin(clock_.now());
    for (int i = 0; i < 60; ++i) {
        answer({'+'});
        sent_.clear();
        pass(milliseconds{100});
        ASSERT_EQ(next(), "Q\r");
    }
    EXPECT_TRUE(lost_.empty());
    answer({'.'});
    EXPECT_EQ(next(), "QP0\r");
}

TEST_F(ScriptedBoard, WhatItSaysUnaskedChangesNothing) {
    session_.begin(clock_.now());
    answer({'S', 'S', 'C', '3', '2', '\r', '.', 150, 60, '+', '.'});
    ASSERT_EQ(online_.size(), 1U);
    EXPECT_THAT(online_[0], ElementsAre(1500, 600));
    EXPECT_EQ(session_.unexpectedBytes(), 8U);
    EXPECT_TRUE(statuses_.empty());
}

TEST_F(ScriptedBoard, AnswersMayComeInPiecesOrAllAtOnce) {
    connect();
    for (int i = 0; i < 3; ++i) {
        pass(milliseconds{100});
        EXPECT_EQ(next(), "Q\r");
        pass(milliseconds{50});
        EXPECT_EQ(next(), "") << "one query at a time";
        answer({i == 1 ? '+' : '.'});
    }
    EXPECT_THAT(statuses_, ElementsAre(false, true, false));
}

TEST_F(ScriptedBoard, PulsesAreReadAgainWhenAsked) {
    connect();
    session_.askPulses();
    pass(milliseconds{20});
    EXPECT_EQ(next(), "QP0\r");
    answer({100});
    EXPECT_EQ(next(), "QP7\r");
    answer({46});  // '.', which is a pulse here
    ASSERT_EQ(pulses_.size(), 1U);
    EXPECT_THAT(pulses_[0], ElementsAre(1000, 460));
}

TEST_F(ScriptedBoard, SilenceIsLossAndTheNextConnectionStartsAnew) {
    connect();
    for (int i = 0; i < 30 && lost_.empty(); ++i) pass(milliseconds{50});
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_THAT(lost_[0], HasSubstr("has not answered for"));
    EXPECT_EQ(session_.state(), ClientSession::State::Closed);
    connect();
    EXPECT_EQ(online_.size(), 2U);
}

TEST_F(ScriptedBoard, SomethingElseThanAnSsc32IsRefusedWithTheMend) {
    session_.begin(clock_.now());
    answer({'l', 'o', 'g', 'i', 'n', ':'});
    for (int i = 0; i < 50 && lost_.empty(); ++i) pass(milliseconds{50});
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_THAT(lost_[0], HasSubstr("is the speed of the line right?"));
    EXPECT_TRUE(online_.empty());
}

}  // namespace
}  // namespace axon::ssc32
