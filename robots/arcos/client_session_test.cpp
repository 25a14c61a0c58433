// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/client_session.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <utility>

namespace axon::arcos {
namespace {

using std::chrono::milliseconds;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

constexpr int kEStop = static_cast<int>(Command::EStop);
constexpr int kClose = static_cast<int>(Command::Close);

/// Plays the robot by hand: notes what the session sends, and answers when told to.
class ClientSessionTest : public ::testing::Test, public ClientSession::Port {
  protected:
    void send(const Bytes& bytes) override {
        for (auto& packet : wire_.feed(bytes, clock_.now())) sent_.push_back(packet);
    }
    void onOnline(const RobotIdentity& identity) override { online_ = identity; }
    void onState(const RobotState& state) override { robot_ = state; }
    void onLost(const std::string& reason) override { lost_.push_back(reason); }
    bool setSpeed(int baud) override {
        if (!line_can_change_) return false;
        line_speed_ = baud;
        speeds_.push_back(baud);
        return true;
    }

    void answer(const Packet& packet) { session_.receive(encode(packet), clock_.now()); }
    void tell(ServerInformation sip) { answer(toPacket(sip)); }
    void pass(milliseconds time) {
        for (; time.count() > 0; time -= milliseconds{25}) {
            clock_.advance(milliseconds{25});
            session_.tick(clock_.now());
        }
    }
    void shakeHands(const robots::LineSpeed& line = {}) {
        line_speed_ = line.baud;
        session_.begin(clock_.now(), line);
        echoSyncs();
    }
    void echoSyncs() {
        answer({0, {}});
        answer({1, {}});
        answer({2, FieldWriter{}.text("Ann").text("Pioneer").text("peoplebot-sh").take()});
    }
    /// The ids of what was sent since the last call.
    std::vector<int> takeSent() {
        std::vector<int> ids;
        for (const auto& packet : std::exchange(sent_, {})) ids.push_back(packet.id);
        return ids;
    }
    int countSent(Command command) const {
        int count = 0;
        for (const auto& packet : sent_) count += packet.id == static_cast<std::uint8_t>(command) ? 1 : 0;
        return count;
    }

    ManualClock clock_;
    PacketReader wire_;
    std::vector<Packet> sent_;
    std::optional<RobotIdentity> online_;
    RobotState robot_;
    std::vector<std::string> lost_;
    bool line_can_change_ = true;
    int line_speed_ = 0;
    std::vector<int> speeds_;  // that the line was set to, one after the other
    ClientSession session_{*this};
};

TEST_F(ClientSessionTest, IsOnlineWithTheFirstServerInformation) {
    shakeHands();
    EXPECT_EQ(session_.state(), ClientSession::State::Opening);
    EXPECT_FALSE(online_);
    tell({});
    EXPECT_EQ(session_.state(), ClientSession::State::Online);
    EXPECT_EQ(online_, (RobotIdentity{"Ann", "Pioneer", "peoplebot-sh"}));
    EXPECT_TRUE(robot_.online);
}

TEST_F(ClientSessionTest, RepeatsSync0AndFinallyGivesUp) {
    session_.begin(clock_.now());
    pass(milliseconds{600});
    EXPECT_EQ(sent_.size(), 2U);
    pass(milliseconds{10000});
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_NE(lost_[0].find("SYNC"), std::string::npos);
    EXPECT_EQ(session_.state(), ClientSession::State::Closed);
}

TEST_F(ClientSessionTest, StartsAgainFromSync0WhenAnEchoIsLost) {
    session_.begin(clock_.now());
    answer({0, {}});
    sent_.clear();
    pass(milliseconds{500});
    ASSERT_EQ(sent_.size(), 1U);
    EXPECT_EQ(sent_[0].id, 0);
}

TEST_F(ClientSessionTest, IgnoresServerInformationOfAnEarlierSessionWhileShakingHands) {
    session_.begin(clock_.now());
    tell({});
    EXPECT_EQ(session_.state(), ClientSession::State::Synchronising);
    EXPECT_FALSE(online_);
}

TEST_F(ClientSessionTest, SendsAPulseOnlyWhenNothingElseWasSent) {
    shakeHands();
    answer(toPacket(GripperPacket{}));
    sent_.clear();
    for (int i = 0; i < 20; ++i) {
        tell({});
        pass(milliseconds{100});
    }
    EXPECT_EQ(countSent(Command::Pulse), 4);
    sent_.clear();
    for (int i = 0; i < 20; ++i) {
        tell({});
        session_.commandSent(clock_.now());
        pass(milliseconds{100});
    }
    EXPECT_EQ(countSent(Command::Pulse), 0);
}

TEST_F(ClientSessionTest, AShorterWatchdogIsFedMoreOften) {
    shakeHands();
    answer(toPacket(GripperPacket{}));
    answer(toPacket(RobotConfig{.name = "Ann", .watchdog_ms = 400}));
    sent_.clear();
    for (int i = 0; i < 10; ++i) {
        tell({});
        pass(milliseconds{100});
    }
    EXPECT_EQ(countSent(Command::Pulse), 10);
}

TEST_F(ClientSessionTest, TheRobotIsLostAfterExactly500MillisecondsOfSilence) {
    shakeHands();
    tell({});
    clock_.advance(milliseconds{499});
    session_.tick(clock_.now());
    EXPECT_TRUE(lost_.empty());
    clock_.advance(milliseconds{1});
    session_.tick(clock_.now());
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_FALSE(session_.robot().online);
    session_.end("again");
    EXPECT_EQ(lost_.size(), 1U);
}

TEST_F(ClientSessionTest, PositionAccumulatesOverTheWrapOfFifteenBits) {
    shakeHands();
    int x = 0;
    for (; x < 100000; x += 3000) {
        ServerInformation sip;
        sip.x = static_cast<std::uint16_t>(x & 0x7FFF);
        sip.y = static_cast<std::uint16_t>(-x & 0x7FFF);
        tell(sip);
        EXPECT_DOUBLE_EQ(robot_.x_mm, x);
        EXPECT_DOUBLE_EQ(robot_.y_mm, -x);
    }
}

TEST_F(ClientSessionTest, HeadingAccumulatesOverFullTurns) {
    shakeHands();
    for (int step = 0; step <= 48; ++step) {
        int units = step * 256 % 4096;
        if (units > 2047) units -= 4096;
        ServerInformation sip;
        sip.theta = static_cast<std::int16_t>(units);
        tell(sip);
    }
    EXPECT_NEAR(robot_.heading_deg, 3 * 360, 0.2);
}

TEST_F(ClientSessionTest, TableSensorsAreActiveLowAndTheFourthInputByteOverrules) {
    shakeHands();
    ServerInformation sip;
    sip.digital_in = 0xFD;
    tell(sip);
    EXPECT_TRUE(robot_.table_left);
    EXPECT_FALSE(robot_.table_right);
    answer(toPacket(InputsOutputs{{0xFF, 0xFF, 0xFF, 0xFE}, {}, {}}));
    tell(sip);
    EXPECT_FALSE(robot_.table_left);
    EXPECT_TRUE(robot_.table_right);
}

TEST_F(ClientSessionTest, RemembersWhenEachSonarWasHeard) {
    shakeHands();
    ServerInformation sip;
    sip.sonars = {{3, 412}, {200, 1}};
    tell(sip);
    EXPECT_EQ(robot_.sonars[3].range_mm, 412);
    EXPECT_EQ(robot_.sonars[3].heard, clock_.now());
    EXPECT_EQ(robot_.sonars[4].heard, TimePoint{});
}

TEST_F(ClientSessionTest, AsksForTheLaserAndAssemblesWholeScansOfBothKinds) {
    shakeHands();
    EXPECT_EQ(countSent(Command::LaserOn), 1);
    ServerInformation sip;
    sip.x = 32760;
    sip.theta = 1000;
    tell(sip);
    EXPECT_FALSE(robot_.laser);
    for (const bool extended : {false, true}) {
        for (std::uint16_t first = 0; first < 181; first += 32) {
            LaserPacket packet{.extended = extended, .x = 4, .theta = 88, .total = 181, .first = first};
            for (int i = first; i < std::min(first + 32, 181); ++i)
                packet.readings.push_back({static_cast<std::uint16_t>(1000 + i)});
            answer(toPacket(packet));
        }
        tell(sip);
        ASSERT_TRUE(robot_.laser);
        EXPECT_EQ(robot_.laser->sequence, extended ? 2U : 1U);
        ASSERT_EQ(robot_.laser->ranges_mm.size(), 181U);
        EXPECT_EQ(robot_.laser->ranges_mm[180], 1180);
        EXPECT_DOUBLE_EQ(robot_.laser->start_deg, -90);
        EXPECT_DOUBLE_EQ(robot_.laser->step_deg, 1);
        // Twelve millimetres further, over the wrap of the wire; extended packets have no pose of their own.
        EXPECT_DOUBLE_EQ(robot_.laser->x_mm, robot_.x_mm + (extended ? 0 : 12));
        EXPECT_DOUBLE_EQ(robot_.laser->heading_deg, robot_.heading_deg);
    }
}

TEST_F(ClientSessionTest, ATurnSinceTheServerInformationIsInTheScansHeading) {
    shakeHands();
    tell({});
    answer(toPacket(LaserPacket{.theta = -6, .total = 1, .readings = {{1000, 0}}}));
    tell({});
    ASSERT_TRUE(robot_.laser);
    EXPECT_DOUBLE_EQ(robot_.laser->heading_deg, -6);
}

TEST_F(ClientSessionTest, AsksForTheGripperUntilItIsAnswered) {
    shakeHands();
    const auto pass_with_robot = [this](int packets) {
        for (; packets > 0; --packets) {
            tell({});
            pass(milliseconds{100});
        }
    };
    pass_with_robot(25);
    EXPECT_EQ(countSent(Command::GripperRequest), 3);
    EXPECT_FALSE(robot_.gripper.fitted);
    answer(toPacket(GripperPacket{GripperPacket::kGeneralIo, {}, 10}));
    pass_with_robot(25);
    EXPECT_EQ(countSent(Command::GripperRequest), 3);
    EXPECT_TRUE(robot_.gripper.fitted);
}

TEST_F(ClientSessionTest, MobileSimIsAskedInItsOwnNumbersAndNeverForAGripper) {
    session_.begin(clock_.now());
    answer({0, {}});
    answer({1, {}});
    answer({2, FieldWriter{}.text("MobileSim").text("Pioneer").text("peoplebot-sh").take()});
    for (int i = 0; i < 30; ++i) {
        tell({});
        pass(milliseconds{100});
    }
    EXPECT_EQ(countSent(Command::OldLaserOn), 1);
    EXPECT_EQ(countSent(Command::LaserOn), 0);
    EXPECT_EQ(countSent(Command::GripperRequest), 0);
}

TEST_F(ClientSessionTest, TheGripperIsReadFromBothItsBytes) {
    shakeHands();
    ServerInformation sip;
    sip.grip_state = toByte(GripState{.lift_up = true});
    sip.general_io = toByte(GripperSwitches{.lift_at_limit = true,
                                            .inner_beam_broken = true,
                                            .left_paddle_pressed = true,
                                            .right_paddle_pressed = true});
    tell(sip);
    EXPECT_EQ(robot_.gripper, GripperState{}) << "nothing is known of it before the robot says what it has";
    answer(toPacket(GripperPacket{GripperPacket::kGeneralIo, {}, 10}));
    tell(sip);
    EXPECT_EQ(robot_.gripper, (GripperState{.known = true,
                                            .fitted = true,
                                            .closed = true,
                                            .lift_up = true,
                                            .lift_at_limit = true,
                                            .inner_beam = true,
                                            .left_pressed = true,
                                            .right_pressed = true}));
    sip.general_io = toByte(GripperSwitches{.paddles_moving = true});
    tell(sip);
    EXPECT_FALSE(robot_.gripper.closed);
    EXPECT_TRUE(robot_.gripper.paddles_moving);
}

TEST_F(ClientSessionTest, TheColumnsBeamsAndTheConfigurationAreRead) {
    shakeHands();
    answer(toPacket(RobotConfig{.name = "Ann", .watchdog_ms = 2000}));
    answer(toPacket(InputsOutputs{{0xFF, 0xFF, 0xFF, 0xFB}, {}, {}}));
    tell({});
    EXPECT_TRUE(robot_.column_right);
    EXPECT_FALSE(robot_.column_left);
    ASSERT_TRUE(robot_.config);
    EXPECT_EQ(robot_.config->watchdog_ms, 2000);
}

TEST_F(ClientSessionTest, ARobotOnASerialLineIsStoppedBeforeEachSync0) {
    // Whoever drove it may have been killed, and it hears nothing of that; to it SYNC0 is a PULSE.
    session_.begin(clock_.now(), {.baud = 9600, .asked = 9600});
    EXPECT_THAT(takeSent(), ElementsAre(kEStop, kClose, 0));
    pass(milliseconds{500});
    EXPECT_THAT(takeSent(), ElementsAre(kEStop, kClose, 0)) << "at the other speed";
    pass(milliseconds{500});
    EXPECT_THAT(takeSent(), ElementsAre(kEStop, 0)) << "a robot that is deaf after a CLOSE hears this one";
    answer({0, {}});
    EXPECT_THAT(takeSent(), ElementsAre(1));
}

TEST_F(ClientSessionTest, ARobotThatIsHeardInAnOldSessionIsStoppedOverAnyLink) {
    session_.begin(clock_.now());
    EXPECT_THAT(takeSent(), ElementsAre(0));
    tell({.moving = true});
    EXPECT_THAT(takeSent(), ElementsAre(kEStop, kClose, 0));
    tell({.moving = true});
    EXPECT_THAT(takeSent(), IsEmpty());
    echoSyncs();
    EXPECT_EQ(session_.state(), ClientSession::State::Opening);
}

TEST_F(ClientSessionTest, ARobotThatIsNoLongerHeardIsToldToStop) {
    shakeHands();
    tell({});
    takeSent();
    pass(milliseconds{500});
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_EQ(takeSent().back(), kEStop);
}

TEST_F(ClientSessionTest, ASerialLineIsRaisedAndThenEverythingIsAskedFor) {
    shakeHands({.baud = 9600});
    ASSERT_EQ(countSent(Command::HostBaud), 1);
    EXPECT_EQ(parseArgument(sent_.back()).value, 2) << "38400";
    EXPECT_THAT(speeds_, IsEmpty()) << "HOSTBAUD has not left the computer yet";
    tell({});
    EXPECT_FALSE(online_) << "the robot has not changed its speed yet";
    pass(milliseconds{50});
    EXPECT_EQ(line_speed_, 38400);
    EXPECT_EQ(countSent(Command::Config), 0);
    tell({});
    EXPECT_TRUE(online_);
    EXPECT_EQ(countSent(Command::Config), 1);
    EXPECT_EQ(robot_.baud, 38400);
    pass(milliseconds{400});
    EXPECT_EQ(line_speed_, 38400);
}

TEST_F(ClientSessionTest, ARobotThatDoesNotFollowIsSpokenToAsBefore) {
    shakeHands({.baud = 9600});
    pass(milliseconds{50});
    EXPECT_EQ(line_speed_, 38400);
    pass(milliseconds{875});
    EXPECT_EQ(line_speed_, 38400);
    pass(milliseconds{25});
    EXPECT_EQ(line_speed_, 9600);
    EXPECT_EQ(countSent(Command::Config), 1);
    tell({});
    EXPECT_TRUE(online_);
    EXPECT_EQ(robot_.baud, 9600);
    EXPECT_THAT(lost_, IsEmpty());
}

TEST_F(ClientSessionTest, ARobotThatAKilledProgramHasRaisedIsFoundThere) {
    line_speed_ = 9600;
    session_.begin(clock_.now(), {.baud = 9600});
    pass(milliseconds{500});
    EXPECT_EQ(line_speed_, 38400);
    echoSyncs();
    EXPECT_EQ(countSent(Command::HostBaud), 0);
    tell({});
    EXPECT_EQ(robot_.baud, 38400);
}

TEST_F(ClientSessionTest, TheSpeedThatTheAddressAsksForIsUsed) {
    shakeHands({.baud = 57600, .asked = 57600});
    EXPECT_EQ(countSent(Command::HostBaud), 0);
    // And a robot at another speed is brought there.
    session_.begin(clock_.now(), {.baud = 57600, .asked = 57600});
    pass(milliseconds{500});
    EXPECT_EQ(line_speed_, 9600);
    sent_.clear();
    echoSyncs();
    ASSERT_EQ(countSent(Command::HostBaud), 1);
    EXPECT_EQ(parseArgument(sent_.back()).value, 3) << "57600";
    pass(milliseconds{50});
    EXPECT_EQ(line_speed_, 57600);
}

TEST_F(ClientSessionTest, WhereThereIsNoSpeedNoneIsChanged) {
    shakeHands();
    tell({});
    EXPECT_EQ(countSent(Command::HostBaud), 0);
    EXPECT_EQ(robot_.baud, 0);
    EXPECT_THAT(speeds_, IsEmpty());
}

TEST_F(ClientSessionTest, ALineThatCannotChangeItsSpeedIsSaid) {
    line_can_change_ = false;
    shakeHands({.baud = 9600});
    pass(milliseconds{50});
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_NE(lost_[0].find("fix: "), std::string::npos);
}

TEST_F(ClientSessionTest, ASweepOfALaserOfOursStandsWhereTheRobotWasThen) {
    shakeHands();
    ServerInformation sip;
    tell(sip);
    const auto first = clock_.now();
    clock_.advance(milliseconds{100});
    sip.x = 40;
    sip.theta = 100;
    tell(sip);
    session_.newScan(
        {.taken = first + milliseconds{25}, .start_deg = -90, .step_deg = 1, .ranges_mm = {500, 600}});
    EXPECT_FALSE(robot_.laser);
    tell(sip);
    ASSERT_TRUE(robot_.laser);
    EXPECT_EQ(robot_.laser->sequence, 1U);
    EXPECT_NEAR(robot_.laser->x_mm, 10, 1e-9);
    EXPECT_NEAR(robot_.laser->heading_deg, robot_.heading_deg / 4, 1e-9);
    EXPECT_THAT(robot_.laser->ranges_mm, ElementsAre(500, 600));
    // What the robot's own laser says is another one from then on.
    answer(toPacket(LaserPacket{.total = 1, .readings = {{1000, 0}}}));
    tell(sip);
    EXPECT_THAT(robot_.laser->ranges_mm, ElementsAre(500, 600));
    EXPECT_EQ(robot_.laser->sequence, 1U);
}

TEST_F(ClientSessionTest, ASweepBeforeTheRobotIsOnlineIsDropped) {
    session_.newScan({.taken = clock_.now(), .ranges_mm = {500}});
    shakeHands();
    session_.newScan({.taken = clock_.now(), .ranges_mm = {500}});
    tell({});
    tell({});
    EXPECT_FALSE(robot_.laser);
}

TEST(PoseHistoryTest, LiesBetweenWhatWasAddedAndForgets) {
    const TimePoint start{std::chrono::seconds{5}};
    PoseHistory poses;
    EXPECT_FALSE(poses.at(start));
    poses.add(start, {0, 0, 350});
    poses.add(start + milliseconds{100}, {10, -20, 370});
    poses.add(start + milliseconds{50}, {1000, 0, 0});  // goes back: ignored
    const auto middle = poses.at(start + milliseconds{75});
    ASSERT_TRUE(middle);
    EXPECT_DOUBLE_EQ(middle->x_mm, 7.5);
    EXPECT_DOUBLE_EQ(middle->y_mm, -15);
    EXPECT_DOUBLE_EQ(middle->heading_deg, 365);
    EXPECT_DOUBLE_EQ(poses.at(start - milliseconds{1})->heading_deg, 350);
    EXPECT_DOUBLE_EQ(poses.at(start + milliseconds{900})->heading_deg, 370);
    poses.add(start + milliseconds{2150}, {0, 0, 0});
    EXPECT_DOUBLE_EQ(poses.at(start)->heading_deg, 0) << "older than its memory";
}

}  // namespace
}  // namespace axon::arcos
