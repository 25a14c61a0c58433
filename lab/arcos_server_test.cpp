// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/arcos_server.hpp"

#include <gtest/gtest.h>

namespace axon::lab {
namespace {

using arcos::Command;
using arcos::encodeCommand;
using std::chrono::milliseconds;

constexpr milliseconds kPeriod{4};

/// A body whose wheels do at once what they are told.
class ArcosServerTest : public ::testing::Test, public ArcosServer::Port {
  protected:
    void send(const arcos::Bytes& bytes) override {
        for (auto& packet : wire_.feed(bytes, clock_.now())) {
            if (auto sip = arcos::parseServerInformation(packet)) {
                sip_ = *sip;
                ++sips_;
            } else {
                answers_.push_back(packet);
            }
        }
    }

    void give(const arcos::Bytes& bytes) { server_.receive(bytes, clock_.now()); }
    void order(Command command) { give(encodeCommand(command)); }
    void order(Command command, int argument) { give(encodeCommand(command, argument)); }
    void sync(int number) { give(encodeCommand(static_cast<Command>(number))); }

    void open() {
        server_.clientConnected(clock_.now());
        for (const int i : {0, 1, 2}) sync(i);
        order(Command::Open);
        order(Command::Enable, 1);
        answers_.clear();
    }

    void pass(milliseconds time) {
        for (; time.count() > 0; time -= kPeriod) {
            clock_.advance(kPeriod);
            wheels_ = server_.step(kPeriod, body_, clock_.now());
            body_.left_mm_s = wheels_.left_mm_s;
            body_.right_mm_s = wheels_.right_mm_s;
            body_.left_wheel_mm += wheels_.left_mm_s * 0.004;
            body_.right_wheel_mm += wheels_.right_mm_s * 0.004;
        }
    }
    void passPulsing(milliseconds time) {
        for (; time.count() > 0; time -= milliseconds{100}) {
            order(Command::Pulse);
            pass(milliseconds{100});
        }
    }

    ManualClock clock_;
    arcos::PacketReader wire_;
    std::vector<arcos::Packet> answers_;
    arcos::ServerInformation sip_;
    int sips_ = 0;
    BodyReadings body_;
    ArcosServer::WheelSpeeds wheels_;
    ArcosServer server_{{.name = "Left"}, *this};
};

TEST_F(ArcosServerTest, HandshakeEchoesAndTellsNameClassAndSubclass) {
    server_.clientConnected(clock_.now());
    for (const int i : {0, 1, 2}) sync(i);
    ASSERT_EQ(answers_.size(), 3U);
    EXPECT_EQ(answers_[0], (arcos::Packet{0, {}}));
    EXPECT_EQ(answers_[1], (arcos::Packet{1, {}}));
    arcos::FieldReader fields(answers_[2].data);
    EXPECT_EQ(fields.text(), "Left");
    EXPECT_EQ(fields.text(), "Pioneer");
    EXPECT_EQ(fields.text(), "peoplebot-sh");
    EXPECT_TRUE(fields.atEnd());
    EXPECT_EQ(server_.state(), ArcosServer::State::Synchronised);
    order(Command::Open);
    EXPECT_EQ(server_.state(), ArcosServer::State::Open);
}

TEST_F(ArcosServerTest, OutOfOrderSyncStartsAgainAtZero) {
    server_.clientConnected(clock_.now());
    sync(0);
    sync(2);
    EXPECT_EQ(answers_.size(), 1U);
    sync(1);
    EXPECT_EQ(answers_.size(), 1U);
    EXPECT_EQ(server_.counters().out_of_order_syncs, 2U);
    for (const int i : {0, 1, 2}) sync(i);
    EXPECT_EQ(server_.state(), ArcosServer::State::Synchronised);
}

TEST_F(ArcosServerTest, Sync0InTheMiddleOfAHandshakeIsAnswered) {
    server_.clientConnected(clock_.now());
    sync(0);
    sync(1);
    sync(0);
    ASSERT_EQ(answers_.size(), 3U);
    EXPECT_EQ(answers_[2].id, 0);
    sync(1);
    sync(2);
    sync(2);  // the client missed the answer and asks once more
    EXPECT_EQ(answers_.back().id, 2);
    EXPECT_EQ(server_.state(), ArcosServer::State::Synchronised);
}

TEST_F(ArcosServerTest, NothingMovesAndNothingIsToldBeforeOpen) {
    server_.clientConnected(clock_.now());
    order(Command::Enable, 1);
    order(Command::Vel, 200);
    pass(milliseconds{500});
    EXPECT_EQ(wheels_.left_mm_s, 0);
    EXPECT_EQ(sips_, 0);
}

TEST_F(ArcosServerTest, ServerInformationComesEvery100Milliseconds) {
    open();
    passPulsing(milliseconds{2000});
    EXPECT_EQ(sips_, 20);
    EXPECT_EQ(sip_.flags & 1U, 1U);
}

TEST_F(ArcosServerTest, MotorsMustBeEnabled) {
    open();
    order(Command::Enable, 0);
    order(Command::Vel, 200);
    passPulsing(milliseconds{500});
    EXPECT_EQ(wheels_.left_mm_s, 0);
    order(Command::Enable, 1);
    order(Command::Vel, 200);
    passPulsing(milliseconds{1000});
    EXPECT_NEAR(wheels_.left_mm_s, 200, 1);
    EXPECT_TRUE(sip_.moving);
    EXPECT_EQ(sip_.left_mm_s, 200);
}

TEST_F(ArcosServerTest, WatchdogStopsAtExactlyTwoSeconds) {
    open();
    order(Command::Vel, 200);
    pass(milliseconds{1996});
    EXPECT_EQ(server_.counters().watchdog_trips, 0U);
    EXPECT_NEAR(wheels_.left_mm_s, 200, 1);
    pass(milliseconds{4});
    EXPECT_EQ(server_.counters().watchdog_trips, 1U);
    pass(milliseconds{500});
    EXPECT_EQ(wheels_.left_mm_s, 0);
}

TEST_F(ArcosServerTest, APulseAfterTheWatchdogDoesNotStartTheOldMotion) {
    open();
    order(Command::Vel, 200);
    pass(milliseconds{2600});
    passPulsing(milliseconds{1000});
    EXPECT_EQ(wheels_.left_mm_s, 0);
    order(Command::Vel, 100);
    passPulsing(milliseconds{1000});
    EXPECT_NEAR(wheels_.left_mm_s, 100, 1);
}

TEST_F(ArcosServerTest, DamagedPacketsDoNotFeedTheWatchdog) {
    open();
    order(Command::Vel, 200);
    auto damaged = encodeCommand(Command::Pulse);
    damaged.back() ^= 1U;
    for (int i = 0; i < 25; ++i) {
        give(damaged);
        pass(milliseconds{100});
    }
    EXPECT_EQ(server_.badChecksums(), 25U);
    EXPECT_EQ(server_.counters().watchdog_trips, 1U);
}

TEST_F(ArcosServerTest, LosingTheClientStopsTheRobotAndSwitchesTheMotorsOff) {
    open();
    order(Command::Vel, 300);
    passPulsing(milliseconds{1000});
    server_.clientLost();
    pass(milliseconds{600});
    EXPECT_EQ(wheels_.left_mm_s, 0);
    EXPECT_FALSE(server_.motorsOn());
    const int before = sips_;
    pass(milliseconds{500});
    EXPECT_EQ(sips_, before);
    open();
    EXPECT_EQ(server_.state(), ArcosServer::State::Open);
}

TEST_F(ArcosServerTest, CloseEndsTheSessionAndANewOneCanFollowOnTheSameLink) {
    open();
    order(Command::Vel, 300);
    passPulsing(milliseconds{1000});
    order(Command::Close);
    pass(milliseconds{600});
    EXPECT_EQ(wheels_.left_mm_s, 0);
    for (const int i : {0, 1, 2}) sync(i);
    order(Command::Open);
    EXPECT_EQ(server_.state(), ArcosServer::State::Open);
}

TEST_F(ArcosServerTest, AFrontBumperStallsForwardMotionOnlyWhenAskedTo) {
    open();
    order(Command::Vel, 200);
    passPulsing(milliseconds{1000});
    body_.front_bumpers = 0b00100;
    passPulsing(milliseconds{200});
    EXPECT_NEAR(wheels_.left_mm_s, 200, 1);
    EXPECT_EQ(sip_.front_bumpers, 0b00100);
    order(Command::BumpStall, 1);
    pass(milliseconds{4});
    EXPECT_EQ(wheels_.left_mm_s, 0);
    passPulsing(milliseconds{100});
    EXPECT_TRUE(sip_.left_stall);
    EXPECT_TRUE(sip_.right_stall);
}

TEST_F(ArcosServerTest, AfterABumpTheRobotMayBackOffButNotPushAgain) {
    open();
    order(Command::BumpStall, 3);
    order(Command::Vel, 200);
    passPulsing(milliseconds{1000});
    body_.front_bumpers = 1;
    order(Command::Vel, 200);
    pass(milliseconds{100});
    order(Command::Vel, -200);  // still within the pause: dropped
    passPulsing(milliseconds{600});
    EXPECT_EQ(wheels_.left_mm_s, 0);
    order(Command::Vel, 200);
    passPulsing(milliseconds{600});
    EXPECT_LT(body_.left_mm_s, 5);
    EXPECT_EQ(server_.counters().stalls, 2U);
    order(Command::Vel, -200);
    passPulsing(milliseconds{1000});
    EXPECT_NEAR(wheels_.left_mm_s, -200, 1);
}

TEST_F(ArcosServerTest, ABlockedMotorStallsOnItsSide) {
    open();
    order(Command::Vel, 200);
    passPulsing(milliseconds{1000});
    body_.left_blocked = true;
    pass(milliseconds{4});
    body_.left_blocked = false;
    EXPECT_EQ(wheels_.left_mm_s, 0);
    passPulsing(milliseconds{100});
    EXPECT_TRUE(sip_.left_stall);
    EXPECT_FALSE(sip_.right_stall);
    passPulsing(milliseconds{600});
    EXPECT_FALSE(sip_.left_stall);
}

TEST_F(ArcosServerTest, MoveHeadAndVel2DriveAsTheirNamesSay) {
    open();
    order(Command::Move, 500);
    passPulsing(milliseconds{5000});
    EXPECT_NEAR(sip_.x, 500, 6);
    order(Command::DHead, -90);
    passPulsing(milliseconds{4000});
    EXPECT_NEAR(sip_.theta * arcos::kRadiansPerAngleUnit, -1.571, 0.03);
    give(encodeCommand(Command::Vel2, 0x0A05));  // left 10 x 20, right 5 x 20 mm/s
    passPulsing(milliseconds{2000});
    EXPECT_NEAR(wheels_.left_mm_s, 200, 2);
    EXPECT_NEAR(wheels_.right_mm_s, 100, 2);
}

TEST_F(ArcosServerTest, SetOMakesHereTheOrigin) {
    open();
    order(Command::Move, 500);
    passPulsing(milliseconds{5000});
    order(Command::SetO);
    passPulsing(milliseconds{100});
    EXPECT_EQ(sip_.x, 0);
}

TEST_F(ArcosServerTest, EachSonarReadingIsToldOnceAndSwitchedOffArraysAreSilent) {
    open();
    body_.sonars_fired = 1U << 0U | 1U << 9U | 1U << 17U;
    body_.sonar_mm[0] = 700;
    body_.sonar_mm[17] = 900;
    pass(milliseconds{4});
    body_.sonars_fired = 0;
    pass(milliseconds{96});
    ASSERT_EQ(sip_.sonars.size(), 3U);
    EXPECT_EQ(sip_.sonars[0], (arcos::ServerInformation::Sonar{0, 700}));
    EXPECT_EQ(sip_.sonars[2], (arcos::ServerInformation::Sonar{17, 900}));
    pass(milliseconds{100});
    EXPECT_TRUE(sip_.sonars.empty());
    order(Command::Sonar, 0);
    body_.sonars_fired = 0xFFFFFF;
    pass(milliseconds{100});
    EXPECT_TRUE(sip_.sonars.empty());
    order(Command::Sonar, 1 | (3 << 1));
    pass(milliseconds{100});
    EXPECT_EQ(sip_.sonars.size(), 8U);
}

TEST_F(ArcosServerTest, ConfigAndInputsAreAnswered) {
    open();
    body_.table_left = true;
    pass(milliseconds{4});
    order(Command::SetA, -450);
    order(Command::Config, 1);
    order(Command::IoRequest, 1);
    ASSERT_EQ(answers_.size(), 2U);
    const auto config = arcos::parseRobotConfig(answers_[0]);
    ASSERT_TRUE(config);
    EXPECT_EQ(config->subtype, "peoplebot-sh");
    EXPECT_EQ(config->deceleration, 450);
    EXPECT_EQ(config->watchdog_ms, 2000);
    const auto io = arcos::parseInputsOutputs(answers_[1]);
    ASSERT_TRUE(io);
    EXPECT_EQ(io->digital_in.at(3), 0xFD);
    passPulsing(milliseconds{200});
    EXPECT_EQ(answers_.size(), 2U);
    order(Command::IoRequest, 2);
    passPulsing(milliseconds{200});
    EXPECT_EQ(answers_.size(), 4U);
}

TEST_F(ArcosServerTest, UnknownAndMalformedCommandsAreCountedAndHarmless) {
    open();
    give(arcos::encode({200, {1, 2, 3}}));
    give(arcos::encode({11, {0x3B}}));
    give(arcos::encode({11, {}}));
    give(encodeCommand(Command::SetA, "fast"));
    EXPECT_EQ(server_.counters().unknown_commands, 1U);
    EXPECT_EQ(server_.counters().malformed_commands, 3U);
    pass(milliseconds{100});
    EXPECT_EQ(wheels_.left_mm_s, 0);
}

TEST_F(ArcosServerTest, ZeroDecelerationCannotMakeTheRobotUnstoppable) {
    open();
    order(Command::SetA, -1);
    order(Command::SetA, 0);
    order(Command::Vel, 10);
    passPulsing(milliseconds{11000});
    order(Command::EStop);
    passPulsing(milliseconds{4000});
    EXPECT_EQ(wheels_.left_mm_s, 0);
}

}  // namespace
}  // namespace axon::lab
