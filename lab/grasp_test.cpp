// SPDX-License-Identifier: GPL-2.0-or-later
// What the transport rests on: a PeopleBot takes an object off one table and puts it on another one.
#include <gtest/gtest.h>

#include <cmath>
#include <utility>

#include "common/ids.hpp"
#include "lab/laboratory.hpp"
#include "robots/arcos/client_session.hpp"
#include "robots/arcos/gripper.hpp"

namespace axon::lab {
namespace {

using arcos::Command;
using arcos::GripperOrder;

constexpr double kTable_m = 0.66;
constexpr double kEdge_m = 3.0;  // of the table: x of its front

class GraspTest : public ::testing::Test, public arcos::ClientSession::Port {
  protected:
    /// A robot in front of a table, an object so far from the table's edge and so far to the left of the
    /// robot's axis.
    void start(double from_edge_m, double left_m, double turned_deg, Object object = {}) {
        WorldDescription world;
        world.tables = {{.name = "west", .x = kEdge_m + 0.4, .y = 3, .dx = 0.8, .dy = 2, .height = kTable_m}};
        object.x = kEdge_m + from_edge_m;
        object.y = 3 + left_m;
        object.theta = turned_deg;
        world.objects = {object};
        world.robots = {{.x = 2.2, .y = 3}};
        lab_ = std::make_unique<Laboratory>(
            world,
            [this](std::size_t, const arcos::Bytes& bytes) {
                inbox_.insert(inbox_.end(), bytes.begin(), bytes.end());
            },
            Laboratory::Options{.seed = 1, .noise = 1});
        inbox_.clear();
        lab_->robot(0).clientConnected();
        session_.begin(lab_->now());
        run(1.0);
        ASSERT_EQ(session_.state(), arcos::ClientSession::State::Online);
        order(Command::Enable, 1);
    }
    void TearDown() override { session_.end("over"); }

    void send(const arcos::Bytes& bytes) override { lab_->robot(0).receive(bytes); }
    void onOnline(const arcos::RobotIdentity& /*identity*/) override {}
    void onState(const arcos::RobotState& /*state*/) override {}
    void onLost(const std::string& /*reason*/) override {}

    void order(Command command, int argument) {
        lab_->robot(0).receive(arcos::encodeCommand(command, argument));
    }
    void grip(GripperOrder what) { order(Command::Gripper, static_cast<int>(what)); }
    void tick() {
        for (const auto& packet : wire_.feed(inbox_, lab_->now())) {
            if (const auto sip = arcos::parseServerInformation(packet)) sip_ = *sip;
        }
        session_.receive(std::exchange(inbox_, {}), lab_->now());
        lab_->step();
        session_.tick(lab_->now());
    }
    void run(double seconds) {
        const auto end =
            lab_->age() + std::chrono::duration_cast<Duration>(std::chrono::duration<double>(seconds));
        while (lab_->age() < end) tick();
    }
    template <class Condition>
    bool runUntil(Condition&& done, double seconds) {
        const auto end =
            lab_->age() + std::chrono::duration_cast<Duration>(std::chrono::duration<double>(seconds));
        while (lab_->age() < end && !done()) tick();
        return done();
    }
    arcos::GripperSwitches switches() const { return arcos::parseGripperSwitches(sip_.general_io); }
    arcos::GripState state() const { return arcos::parseGripState(sip_.grip_state); }
    bool tableSeen() const { return (sip_.digital_in & 3U) != 3U; }
    ObjectTruth object() const { return lab_->physics().truthOfObjects().at(0); }

    /// From a metre before the table to the object held 5 cm above it.
    void approachAndGrasp() {
        // All the way up, and down again to 2 cm above the table: there is no other measure of the lift.
        grip(GripperOrder::LiftUp);
        grip(GripperOrder::Open);
        ASSERT_TRUE(runUntil([&] { return state().lift_up && switches().paddles_open; }, 15));
        EXPECT_NEAR(lab_->truth(0).lift_mm, GripperControl::kLift_mm, 5);
        EXPECT_NEAR(lab_->truth(0).opening_mm, 2 * GripperControl::kOpening_mm, 5);
        grip(GripperOrder::LiftCarry);
        order(Command::GripperValue, -225);  // 4.5 s at 20 mm/s: 90 mm
        run(5);
        ASSERT_FALSE(switches().lift_moving);
        order(Command::Vel, 150);
        ASSERT_TRUE(runUntil([&] { return tableSeen(); }, 8)) << "the table sensors saw nothing";
        EXPECT_NEAR(kEdge_m - lab_->truth(0).x_m, 0.333, 0.03);
        order(Command::Vel, 60);
        ASSERT_TRUE(runUntil([&] { return switches().inner_beam_broken; }, 8))
            << "nothing between the paddles";
        order(Command::Vel, 0);
        run(0.5);
        grip(GripperOrder::Close);
        ASSERT_TRUE(
            runUntil([&] { return switches().left_paddle_pressed && switches().right_paddle_pressed; }, 8))
            << "object at " << object().x_m << " " << object().y_m << " tilt " << object().tilt_deg;
        run(0.5);
        EXPECT_FALSE(switches().paddles_moving);
        grip(GripperOrder::LiftCarry);
        order(Command::GripperValue, 125);
        run(3.0);
        EXPECT_GT(object().z_m, kTable_m + 0.04);
    }

    std::unique_ptr<Laboratory> lab_;
    arcos::Bytes inbox_;
    arcos::PacketReader wire_;
    arcos::ServerInformation sip_;
    arcos::ClientSession session_{*this};
};

TEST_F(GraspTest, TakesTheObjectFromTheTableCarriesItAwayAndPutsItDownAtTenOffsets) {
    SeededRandom random(6);
    const auto uniform = [&random](double least, double most) {
        std::uint32_t word = 0;
        random.fill(reinterpret_cast<std::uint8_t*>(&word), sizeof word);
        return least + (most - least) * word / 4294967295.0;
    };
    for (int i = 0; i < 10; ++i) {
        const double from_edge = uniform(0.035, 0.08);
        const double left = uniform(-0.05, 0.05);
        const double turned = uniform(-20, 20);
        SCOPED_TRACE("offset " + std::to_string(i) + ": " + std::to_string(from_edge) + " m from the edge, " +
                     std::to_string(left) + " m to the left, turned by " + std::to_string(turned));
        start(from_edge, left, turned);
        approachAndGrasp();
        if (HasFatalFailure()) return;
        order(Command::Vel, -200);
        run(3.5);
        order(Command::Vel, 0);
        run(1);
        order(Command::RVel, 40);
        run(3);
        order(Command::RVel, -40);
        run(4);  // it spins up and down: about where it was
        order(Command::RVel, 0);
        run(1.5);
        EXPECT_GT(object().z_m, kTable_m + 0.04) << "it slips";
        EXPECT_LT(lab_->truth(0).x_m, 2.6);
        EXPECT_LT(object().tilt_deg, 15);
        EXPECT_TRUE(switches().left_paddle_pressed && switches().right_paddle_pressed);
        session_.end("next");
    }
}

TEST_F(GraspTest, PutsTheObjectDownWhereItStaysStanding) {
    start(0.05, 0.01, 5);
    approachAndGrasp();
    if (HasFatalFailure()) return;
    order(Command::Move, -400);
    run(4);
    EXPECT_GT(object().z_m, kTable_m + 0.03);
    order(Command::Move, 400);
    run(4);
    grip(GripperOrder::LiftCarry);
    order(Command::GripperValue, -125);
    run(4);
    grip(GripperOrder::Open);
    ASSERT_TRUE(runUntil([&] { return switches().paddles_open; }, 8));
    order(Command::Move, -500);
    run(5);
    const auto end = object();
    EXPECT_NEAR(end.z_m, kTable_m, 0.003);
    EXPECT_LT(end.tilt_deg, 1);
    EXPECT_LT(end.speed_m_s, 0.01);
    EXPECT_EQ(end.on, std::vector<std::string>{"west"});
    EXPECT_TRUE(lab_->truth(0).touched.empty()) << lab_->truth(0).touched.front();
}

TEST_F(GraspTest, CylindersAreHeldUprightToo) {
    // Between flat paddles a cylinder touches in two lines; found as one point each, it turned over in the
    // grip.
    for (const double left : {-0.03, -0.01, 0.0, 0.02}) {
        for (const bool thick : {false, true}) {
            SCOPED_TRACE("a cylinder " + std::to_string(left) + " m to the left, " +
                         (thick ? "40 mm" : "28 mm") + " thick");
            start(0.05, left, 0,
                  {.colour = "blue",
                   .shape = Object::Shape::Cylinder,
                   .dx = thick ? 0.04 : 0.028,
                   .dz = thick ? 0.1 : 0.08,
                   .mass = 0.08});
            approachAndGrasp();
            if (HasFatalFailure()) return;
            order(Command::Vel, -200);
            run(4);
            EXPECT_GT(object().z_m, kTable_m + 0.03);
            EXPECT_LT(object().tilt_deg, 15);
            session_.end("next");
        }
    }
}

TEST_F(GraspTest, PaddlesThatMeetNothingPressEachOther) {
    start(0.05, 0.6, 0);
    grip(GripperOrder::Close);
    ASSERT_TRUE(runUntil([&] { return state().paddles_closed; }, 8));
    EXPECT_FALSE(switches().inner_beam_broken);
    EXPECT_FALSE(switches().outer_beam_broken);
    grip(GripperOrder::Open);
    EXPECT_TRUE(runUntil([&] { return switches().paddles_open; }, 8));
}

TEST_F(GraspTest, ALiftThatComesDownOnTheTableStopsAndSaysSo) {
    start(0.3, 0.0, 0);
    grip(GripperOrder::LiftUp);
    ASSERT_TRUE(runUntil([&] { return state().lift_up; }, 15));
    order(Command::Move, 640);
    run(6);
    grip(GripperOrder::LiftDown);
    ASSERT_TRUE(runUntil([&] { return state().lift_error; }, 15));
    EXPECT_FALSE(state().lift_down);
    EXPECT_FALSE(state().lift_moving);
    EXPECT_NEAR(lab_->truth(0).x_m, 2.84, 0.05);
    grip(GripperOrder::LiftUp);
    run(0.5);
    EXPECT_FALSE(state().lift_error);
}

TEST_F(GraspTest, AStuckGripperStaysWhereItIs) {
    start(0.05, 0.0, 0);
    lab_->physics().setFault(0, {Fault::Kind::StuckGripper}, true);
    grip(GripperOrder::Close);
    run(6);
    EXPECT_FALSE(state().paddles_closed);
    lab_->physics().setFault(0, {Fault::Kind::StuckGripper}, false);
    EXPECT_TRUE(runUntil([&] { return state().paddles_closed; }, 8));
}

}  // namespace
}  // namespace axon::lab
