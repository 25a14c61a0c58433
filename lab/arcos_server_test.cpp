// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/arcos_server.hpp"

#include <gtest/gtest.h>

#include <array>

#include "common/ids.hpp"
#include "robots/arcos/gripper.hpp"
#include "robots/arcos/laser.hpp"
#include "robots/arcos/vcc4.hpp"

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

TEST_F(ArcosServerTest, Vel2AndDigOutTakeTheirTwoBytesAlsoFromNegativeArguments) {
    open();
    const auto two = [](int high, int low) {
        return static_cast<std::int16_t>(static_cast<std::uint16_t>((high & 0xFF) << 8 | (low & 0xFF)));
    };
    order(Command::Vel2, two(-10, 5));
    passPulsing(milliseconds{2000});
    EXPECT_NEAR(wheels_.left_mm_s, -200, 2);
    EXPECT_NEAR(wheels_.right_mm_s, 100, 2);
    order(Command::Vel2, two(-10, -5));
    passPulsing(milliseconds{2000});
    EXPECT_NEAR(wheels_.left_mm_s, -200, 2);
    EXPECT_NEAR(wheels_.right_mm_s, -100, 2);
    order(Command::DigOut, two(0x81, 0x80));
    passPulsing(milliseconds{100});
    EXPECT_EQ(sip_.digital_out, 0x80);
    order(Command::DigOut, two(0x80, 0));
    passPulsing(milliseconds{100});
    EXPECT_EQ(sip_.digital_out, 0);
}

TEST_F(ArcosServerTest, AStopBehindADamagedHeaderIsObeyedWithoutFurtherBytes) {
    open();
    order(Command::Vel, 300);
    passPulsing(milliseconds{2000});
    give({0xFA, 0xFB, 200});
    order(Command::EStop);
    pass(std::chrono::ceil<milliseconds>(arcos::PacketReader::kPartialTimeout) + milliseconds{500});
    EXPECT_NEAR(wheels_.left_mm_s, 0, 1);
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
    EXPECT_EQ(config->serial_number, "SIM") << "what the vendor's simulators say, and no robot does";
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

TEST_F(ArcosServerTest, MergedAndSplitPacketsAreOneStreamOfCommands) {
    server_.clientConnected(clock_.now());
    arcos::Bytes wire;
    for (const auto& bytes : {encodeCommand(static_cast<Command>(0)), encodeCommand(static_cast<Command>(1)),
                              encodeCommand(static_cast<Command>(2)), encodeCommand(Command::Open),
                              encodeCommand(Command::Enable, 1), encodeCommand(Command::Vel, 100)})
        wire.insert(wire.end(), bytes.begin(), bytes.end());
    for (const auto byte : wire) give({byte});
    EXPECT_EQ(server_.state(), ArcosServer::State::Open);
    passPulsing(milliseconds{1000});
    EXPECT_NEAR(wheels_.left_mm_s, 100, 1);
    auto merged = encodeCommand(Command::Vel, 50);
    const auto more = encodeCommand(Command::Config, 0);
    merged.insert(merged.end(), {0xFA, 0x00, 0xFB});  // garbage between packets
    merged.insert(merged.end(), more.begin(), more.end());
    answers_.clear();
    give(merged);
    EXPECT_EQ(answers_.size(), 1U);
    passPulsing(milliseconds{1000});
    EXPECT_NEAR(wheels_.left_mm_s, 50, 1);
}

TEST_F(ArcosServerTest, TheLongestPacketsAndTextsThatLieAboutTheirLengthAreHarmless) {
    open();
    give(arcos::encode({static_cast<std::uint8_t>(Command::Tty2), arcos::Bytes(arcos::kMaximumData, 0x2B)}));
    give(arcos::encode({static_cast<std::uint8_t>(Command::Tty2), {0x2B, 200, 'a'}}));
    give(arcos::encode({250, arcos::Bytes(arcos::kMaximumData, 0xFF)}));
    EXPECT_EQ(server_.counters().unknown_commands, 1U);
    EXPECT_EQ(server_.counters().malformed_commands, 1U);
    give({0xFA, 0xFB, 0x02, 0x00, 0x00});  // a count that holds no checksum
    passPulsing(milliseconds{300});
    EXPECT_GE(sips_, 3);
}

TEST_F(ArcosServerTest, PaddlesCloseUntilBothFeelSomethingAndThenPressForTheGraspTime) {
    open();
    body_.gripper = {.left_paddle_mm = 107, .right_paddle_mm = 107};
    order(Command::Gripper, 2);
    pass(milliseconds{500});
    EXPECT_EQ(server_.gripper().paddles_mm_s, -20);
    body_.gripper = {.left_paddle_mm = 14, .right_paddle_mm = 14, .left_pressed = true};
    pass(milliseconds{100});
    EXPECT_EQ(server_.gripper().paddles_mm_s, -20);
    body_.gripper.right_pressed = body_.gripper.inner_beam_broken = true;
    pass(milliseconds{196});
    EXPECT_EQ(server_.gripper().paddles_mm_s, -20);
    pass(milliseconds{104});
    EXPECT_EQ(server_.gripper().paddles_mm_s, 0);
    const auto switches = arcos::parseGripperSwitches(sip_.general_io);
    EXPECT_TRUE(switches.left_paddle_pressed && switches.right_paddle_pressed && switches.inner_beam_broken);
    EXPECT_FALSE(switches.outer_beam_broken || switches.paddles_moving || switches.paddles_open);
    EXPECT_TRUE(arcos::parseGripState(sip_.grip_state).paddles_closed);
}

TEST_F(ArcosServerTest, TheLiftStopsAtItsLimitsAfterItsTimeAndWhenItIsBlocked) {
    open();
    body_.gripper.lift_mm = 50;
    order(Command::Gripper, 4);
    pass(milliseconds{100});
    EXPECT_EQ(server_.gripper().lift_mm_s, 20);
    body_.gripper.lift_mm = 189.5;
    pass(milliseconds{100});
    EXPECT_EQ(server_.gripper().lift_mm_s, 0);
    EXPECT_TRUE(arcos::parseGripState(sip_.grip_state).lift_up);
    EXPECT_TRUE(arcos::parseGripperSwitches(sip_.general_io).lift_at_limit);
    order(Command::Gripper, 17);
    order(Command::GripperValue, -10);
    body_.gripper.lift_mm = 150;
    pass(milliseconds{196});
    EXPECT_EQ(server_.gripper().lift_mm_s, -20);
    pass(milliseconds{8});
    EXPECT_EQ(server_.gripper().lift_mm_s, 0);
    order(Command::Gripper, 5);
    body_.gripper.lift_blocked = true;
    pass(milliseconds{100});
    EXPECT_EQ(server_.gripper().lift_mm_s, 0);
    EXPECT_TRUE(arcos::parseGripState(sip_.grip_state).lift_error);
    order(Command::Gripper, 12);
    EXPECT_EQ(server_.counters().malformed_commands, 1U);
}

TEST_F(ArcosServerTest, TheGripperPacketTellsItsTypeOnceOrWithEveryServerInformation) {
    open();
    order(Command::GripperRequest, 1);
    ASSERT_EQ(answers_.size(), 1U);
    const auto gripper = arcos::parseGripperPacket(answers_[0]);
    ASSERT_TRUE(gripper);
    EXPECT_EQ(gripper->type, arcos::GripperPacket::kGeneralIo);
    EXPECT_EQ(gripper->grasp_time, 10);
    order(Command::GripperRequest, 2);
    passPulsing(milliseconds{300});
    EXPECT_EQ(answers_.size(), 4U);
    order(Command::GripperRequest, 0);
    passPulsing(milliseconds{300});
    EXPECT_EQ(answers_.size(), 4U);
}

TEST_F(ArcosServerTest, OldLaserCommandsAndGripperValuesShareTheirNumbersAndAreToldApart) {
    open();
    order(static_cast<Command>(36), -90);
    order(static_cast<Command>(37), 90);
    order(static_cast<Command>(38), 50);
    order(static_cast<Command>(35), 2);
    EXPECT_EQ(server_.laser(), (LaserSettings{true, -90, 90, 0.5}));
    EXPECT_EQ(server_.laser().readings(), 361);
    order(static_cast<Command>(33), 16);
    order(static_cast<Command>(36), 20);
    order(static_cast<Command>(37), 1);
    EXPECT_EQ(server_.laser().start_deg, -90);
    EXPECT_EQ(arcos::parseGripperPacket(answers_.at(0))->grasp_time, 20);
    order(static_cast<Command>(33), 16);
    order(static_cast<Command>(29));
    order(static_cast<Command>(36), 20);
    EXPECT_EQ(server_.laser().start_deg, 20);
    order(static_cast<Command>(38), 10);  // finer than the laser is
    EXPECT_EQ(server_.counters().malformed_commands, 1U);
    order(Command::LaserResolution, 1);
    order(Command::LaserStart, -45);
    order(Command::LaserEnd, 45);
    order(Command::LaserOn, 0);
    EXPECT_EQ(server_.laser(), (LaserSettings{false, -45, 45, 1}));
}

TEST_F(ArcosServerTest, AScanComesInPacketsOfThirtyTwo) {
    open();
    order(Command::LaserOn, 1);
    body_.laser_scanned = true;
    for (int i = 0; i < 181; ++i) body_.laser_mm.push_back(static_cast<std::uint16_t>(1000 + i));
    pass(milliseconds{4});
    body_.laser_scanned = false;
    pass(milliseconds{8});
    ASSERT_EQ(answers_.size(), 6U);
    arcos::LaserScanAssembler scan;
    std::optional<std::vector<arcos::LaserPacket::Reading>> whole;
    for (const auto& answer : answers_) whole = scan.add(arcos::parseLaserPacket(answer).value());
    ASSERT_TRUE(whole);
    EXPECT_EQ(whole->size(), 181U);
    EXPECT_EQ(whole->at(180).range_mm, 1180);
    EXPECT_EQ(answers_[0].id, arcos::kLaserPacket);
}

TEST_F(ArcosServerTest, TheCameraAnswersThroughTheSecondSerialPort) {
    open();
    const auto tell = [this](const std::string& bytes) { give(encodeCommand(Command::Tty2, bytes)); };
    order(Command::GetAux, 0);
    order(Command::GetAux, 6);
    EXPECT_TRUE(answers_.empty());
    tell(arcos::vcc4::panTilt({10, 0}));
    ASSERT_EQ(answers_.size(), 1U) << "bytes that were asked for follow when they are there";
    EXPECT_EQ(answers_[0].id, arcos::kAuxPacket);
    EXPECT_EQ(answers_[0].data.at(3), 0x39) << "not under control yet";
    tell(arcos::vcc4::power(true));
    tell(arcos::vcc4::control());
    tell(arcos::vcc4::panTilt({40, 20}));
    pass(milliseconds{200});
    EXPECT_NEAR(server_.camera().looks.pan_left_deg, 18, 0.5) << "90 degrees a second";
    EXPECT_NEAR(server_.camera().looks.tilt_up_deg, 14, 0.5) << "69 degrees a second";
    passPulsing(milliseconds{1000});
    EXPECT_NEAR(server_.camera().looks.pan_left_deg, 40, 0.1);
    order(Command::GetAux, 0);
    tell(arcos::vcc4::requestPanTilt());
    order(Command::GetAux, 14);
    const auto& bytes = answers_.back().data;
    const auto at = arcos::vcc4::parsePanTiltAnswer(std::string(bytes.begin(), bytes.end()));
    ASSERT_TRUE(at);
    EXPECT_NEAR(at->pan_left_deg, 40, 0.1);
    tell(arcos::vcc4::panTilt({0, 60}));
    tell(arcos::vcc4::fullTiltRange());
    tell(arcos::vcc4::panTilt({0, 60}));
    tell(arcos::vcc4::zoom(1000));
    passPulsing(milliseconds{1500});
    EXPECT_NEAR(server_.camera().looks.tilt_up_deg, 60, 0.1);
    EXPECT_EQ(server_.camera().zoom, 1000);
}

TEST_F(ArcosServerTest, AnyCommandWithAnyArgumentLeavesARobotThatCanBeStopped) {
    open();
    SeededRandom random(6);
    for (int i = 0; i < 5000; ++i) {
        const auto word = random.next();
        const auto id = static_cast<std::uint8_t>(word);
        if (id == static_cast<std::uint8_t>(Command::Close)) continue;
        arcos::Bytes data(word >> 8U & 15U);
        random.fill(data.data(), data.size());
        if (!data.empty() && (word >> 16U & 3U) != 0)
            data[0] = std::array<std::uint8_t, 3>{0x3B, 0x1B, 0x2B}[word >> 20U & 1U];
        give(arcos::encode({id, data}));
        if (i % 8 == 0) pass(milliseconds{4});
    }
    EXPECT_EQ(server_.state(), ArcosServer::State::Open);
    EXPECT_GE(server_.laser().readings(), 1);
    EXPECT_LE(server_.laser().readings(), LaserSettings::kMaximumReadings);
    order(Command::SetA, -600);
    order(Command::SetRa, -100);
    order(Command::EStop);
    passPulsing(milliseconds{5000});
    EXPECT_EQ(wheels_.left_mm_s, 0);
    EXPECT_EQ(wheels_.right_mm_s, 0);
}

}  // namespace
}  // namespace axon::lab
