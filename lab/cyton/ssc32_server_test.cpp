// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/cyton/ssc32_server.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace axon::lab {
namespace {

using std::chrono::milliseconds;

std::vector<std::uint8_t> bytes(std::string_view text) {
    return {text.begin(), text.end()};
}

class Ssc32 : public ::testing::Test {
  protected:
    std::string tell(std::string_view text) {
        const auto answers = board_.receive(bytes(text));
        return {answers.begin(), answers.end()};
    }
    void pass(milliseconds time) {
        for (milliseconds t{}; t < time; t += milliseconds{4}) board_.step(milliseconds{4});
    }
    Ssc32Server board_;
};

TEST_F(Ssc32, StartsAtTheVendorsHome) {
    EXPECT_EQ(tell("Q\r"), ".");
    EXPECT_EQ(tell("QP0 QP5 QP7\r"), std::string({char(110), char(79), char(105)}));
    EXPECT_NEAR(board_.targets()[0], 0.787, 0.001);
    EXPECT_NEAR(board_.targets()[5], -0.785, 0.001);
    EXPECT_NEAR(board_.targets()[7], 0.012, 0.0001);
}

TEST_F(Ssc32, AGroupStartsAndEndsTogether) {
    tell("#0P1500#1P1500#3P1500\r");
    EXPECT_EQ(tell("Q\r"), ".");
    pass(milliseconds{400});
    tell("#0 P2000 #1 P1000 #3 P1600 T1000\r");
    EXPECT_EQ(tell("Q\r"), "+");
    pass(milliseconds{500});
    EXPECT_NEAR(board_.pulse_us(0), 1750, 1);
    EXPECT_NEAR(board_.pulse_us(1), 1250, 1);
    EXPECT_NEAR(board_.pulse_us(3), 1550, 1);
    pass(milliseconds{496});
    EXPECT_EQ(tell("Q\r"), "+");
    pass(milliseconds{4});
    EXPECT_EQ(tell("Q\r"), ".");
    EXPECT_EQ(tell("QP0QP1QP3\r"), std::string({char(200), char(100), char(160)}));
}

TEST_F(Ssc32, TheSlowestOfAGroupSetsItsTime) {
    tell("#0P1500#1P1500\r");
    tell("#0P2000S250#1P1600T1000\r");  // 500 us at 250 us/s: two seconds
    pass(milliseconds{1000});
    EXPECT_NEAR(board_.pulse_us(0), 1750, 1);
    EXPECT_NEAR(board_.pulse_us(1), 1550, 1);
    tell("#1P1500\r");  // leaves the group, the other goes on
    EXPECT_DOUBLE_EQ(board_.pulse_us(1), 1500);
    pass(milliseconds{1000});
    EXPECT_NEAR(board_.pulse_us(0), 2000, 1);
    EXPECT_DOUBLE_EQ(board_.pulse_us(1), 1500);
}

TEST_F(Ssc32, PulsesAreClampedToTheServo) {
    tell("#5P2500\r#7P100\r#20P3000\r");
    EXPECT_DOUBLE_EQ(board_.pulse_us(5), 2250);
    EXPECT_DOUBLE_EQ(board_.pulse_us(7), 600);
    EXPECT_DOUBLE_EQ(board_.pulse_us(20), 2500);
    EXPECT_EQ(board_.counters().clamped_pulses, 3U);
}

TEST_F(Ssc32, TheServoFollowsNoFasterThanItCan) {
    tell("#1P500\r");
    pass(milliseconds{1000});
    tell("#1P2500\r");
    EXPECT_EQ(tell("Q QP1\r"), "");  // one command a line
    EXPECT_EQ(tell("QP1\r"), std::string(1, char(250)));
    const double from = board_.targets()[1];
    pass(milliseconds{500});
    EXPECT_NEAR(board_.targets()[1] - from, 1.94, 0.01);
    pass(milliseconds{500});
    EXPECT_NEAR(board_.targets()[1] - from, 3.88, 0.01);
}

TEST_F(Ssc32, EscapeEndsTheMoveAndForgetsTheLine) {
    tell("#0P1500\r#0P2000T1000\r");
    pass(milliseconds{500});
    tell("#0P500T1\x1bQ");
    EXPECT_EQ(tell("\r"), ".");
    pass(milliseconds{600});
    EXPECT_NEAR(board_.pulse_us(0), 1750, 1);
}

TEST_F(Ssc32, StopEndsTheMoveOfOneChannel) {
    tell("#0P1500#1P1500\r#0P2000#1P2000T1000\r");
    pass(milliseconds{500});
    tell("STOP 0\r");
    pass(milliseconds{500});
    EXPECT_NEAR(board_.pulse_us(0), 1750, 1);
    EXPECT_NEAR(board_.pulse_us(1), 2000, 1);
}

TEST_F(Ssc32, BytesMayComeSplitAndMerged) {
    const std::string all = "#0p1600\r#1 P1700\r\nver\r qp 0 qp 1 \rQ\r";
    for (std::size_t cut = 0; cut <= all.size(); ++cut) {
        Ssc32Server board;
        auto answers = board.receive(bytes(std::string_view(all).substr(0, cut)));
        const auto rest = board.receive(bytes(std::string_view(all).substr(cut)));
        answers.insert(answers.end(), rest.begin(), rest.end());
        EXPECT_EQ(std::string(answers.begin(), answers.end()),
                  std::string("SSC32-V2.01XE\r") + char(160) + char(170) + ".")
            << "cut at " << cut;
    }
}

TEST_F(Ssc32, WhatIsWrongChangesNothing) {
    const auto before = board_.targets();
    const std::vector<std::string> wrong{"#",
                                         "#0",
                                         "#0P",
                                         "#32P1500",
                                         "#-1P1500",
                                         "#0P1500X",
                                         "#0P1500T",
                                         "#0P1500S0",
                                         "#0P1500#1",
                                         "HELLO",
                                         "QP",
                                         "QP99",
                                         "STOP",
                                         "#0P99999999",
                                         "P1500",
                                         "Q1",
                                         "#0P1500T99999999",
                                         "#0T100P1500"};
    for (const auto& line : wrong) EXPECT_EQ(tell(line + "\r"), "") << line;
    EXPECT_EQ(board_.counters().refused_lines, wrong.size());
    EXPECT_EQ(board_.counters().moves, 0U);
    pass(milliseconds{1000});
    EXPECT_EQ(board_.targets(), before);
    EXPECT_EQ(tell("VER\r"), "SSC32-V2.01XE\r");
}

TEST_F(Ssc32, AnEndlessLineIsDroppedWholeAndTheNextIsHeard) {
    std::string endless = "#0P1500";
    while (endless.size() < 3 * Ssc32Server::kLongestLine) endless += "#1P1500";
    EXPECT_EQ(tell(endless + "\r"), "");
    EXPECT_EQ(board_.counters().refused_lines, 1U);
    EXPECT_EQ(board_.counters().moves, 0U);
    EXPECT_EQ(tell("Q\r"), ".");
}

TEST_F(Ssc32, GarbageDisturbsNothing) {
    std::mt19937 random(6);
    for (int i = 0; i < 200; ++i) {
        std::vector<std::uint8_t> noise(random() % 700);
        for (auto& byte : noise) byte = static_cast<std::uint8_t>(random());
        board_.receive(noise);
        board_.step(milliseconds{4});
    }
    board_.receive(bytes("\x1b"));
    EXPECT_EQ(tell("VER\r"), "SSC32-V2.01XE\r");
    for (const double target : board_.targets()) EXPECT_TRUE(std::isfinite(target));
}

TEST_F(Ssc32, ANewClientDoesNotInheritHalfALine) {
    tell("#0P15");
    board_.clientConnected();
    EXPECT_EQ(tell("Q\r"), ".");
    EXPECT_EQ(board_.counters().refused_lines, 0U);
}

TEST_F(Ssc32, AStuckServoStaysAndTheBoardDoesNotKnow) {
    const double before = board_.targets()[7];
    board_.setStuck(7, true);
    tell("#7P600\r");
    pass(milliseconds{1000});
    EXPECT_DOUBLE_EQ(board_.targets()[7], before);
    EXPECT_EQ(tell("QP7\r"), std::string(1, char(60)));
}

}  // namespace
}  // namespace axon::lab
