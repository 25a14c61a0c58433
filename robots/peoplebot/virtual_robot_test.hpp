// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <deque>
#include <functional>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "lab/laboratory.hpp"
#include "robots/peoplebot/body.hpp"
#include "robots/peoplebot/motion.hpp"

/// For tests: motions on the virtual robot, with real slip, real sensors and the real protocol, in the
/// laboratory's own time and as fast as it can; judged by ground truth.
namespace axon::peoplebot {

using arcos::Command;

class VirtualRobotTest : public ::testing::Test, public arcos::ClientSession::Port {
  protected:
    /// Again: another robot in another world, whose time begins anew.
    void start(const lab::WorldDescription& world, const lab::Physics::Options& options = {}) {
        session_.end("another robot is started");
        inbox_.clear();
        fresh_ = false;
        nearest_mm_ = 1e9;
        bumps_ = 0;
        seen_at_.reset();
        failed_at_.reset();
        world_ = world;
        lab_ = std::make_unique<lab::Laboratory>(
            world,
            [this](std::size_t robot, const arcos::Bytes& bytes) {
                if (robot == 0) inbox_.push_back({lab_->now() + late_, bytes});
            },
            options);
        lab_->robot(0).clientConnected();
        session_.begin(lab_->now());
        run(1.3);
        order(Command::Enable, 1);
    }
    void send(const arcos::Bytes& bytes) override { lab_->robot(0).receive(bytes); }
    void onOnline(const arcos::RobotIdentity& /*identity*/) override {
        order(Command::SetA, 300);
        order(Command::SetA, -600);
    }
    void onState(const arcos::RobotState& /*state*/) override { fresh_ = true; }
    void onLost(const std::string& /*reason*/) override {}

    void order(Command command, int argument) {
        lab_->robot(0).receive(arcos::encodeCommand(command, argument));
    }
    void run(double seconds) {
        const auto end =
            lab_->age() + std::chrono::duration_cast<Duration>(std::chrono::duration<double>(seconds));
        while (lab_->age() < end) tick();
    }
    void tick() {
        for (; !inbox_.empty() && inbox_.front().at <= lab_->now(); inbox_.pop_front())
            session_.receive(inbox_.front().bytes, lab_->now());
        session_.tick(lab_->now());
        lab_->step();
        if (!seen_at_ && !failed_at_ && must_end_ && must_end_(lab_->truth(0))) seen_at_ = lab_->age();
    }
    /// What the application would know.
    arcos::RobotState robot() const {
        auto state = session_.robot();
        if (!has_laser_) state.laser.reset();
        return state;
    }
    template <class Motion>
    MotionStep perform(Motion& motion, std::chrono::seconds patience = std::chrono::seconds{60}) {
        MotionStep step;
        const auto deadline = lab_->age() + patience;
        while (step.outcome == MotionStep::Outcome::Running && lab_->age() < deadline) {
            tick();
            if (!std::exchange(fresh_, false)) continue;
            step = motion.step(robot(), lab_->now());
            nearest_mm_ = std::min(nearest_mm_, clearance_mm());
            bumps_ += session_.robot().front_bumpers != 0 || session_.robot().rear_bumpers != 0 ? 1 : 0;
            if (step.outcome == MotionStep::Outcome::Failed) failed_at_ = lab_->age();
            if (step.halt) {
                lab_->robot(0).receive(arcos::encodeCommand(Command::EStop));
                continue;
            }
            order(Command::Vel, static_cast<int>(std::lround(step.forward_mm_s)));
            order(Command::RVel, static_cast<int>(std::lround(step.left_deg_s)));
        }
        lab_->robot(0).receive(arcos::encodeCommand(Command::EStop));
        run(1);
        EXPECT_NEAR(lab_->truth(0).speed_m_s, 0, 0.01);
        return step;
    }

    struct Rectangle {
        double x, y, dx, dy, theta_deg;
    };
    /// What stands on the floor or above it, as seen from above.
    std::vector<Rectangle> obstacles() const {
        std::vector<Rectangle> all{{world_.room_x / 2, -0.5, world_.room_x + 2, 1, 0},
                                   {world_.room_x / 2, world_.room_y + 0.5, world_.room_x + 2, 1, 0},
                                   {-0.5, world_.room_y / 2, 1, world_.room_y + 2, 0},
                                   {world_.room_x + 0.5, world_.room_y / 2, 1, world_.room_y + 2, 0}};
        for (const auto& b : world_.boxes) all.push_back({b.x, b.y, b.dx, b.dy, b.theta});
        for (const auto& t : world_.tables) all.push_back({t.x, t.y, t.dx, t.dy, t.theta});
        return all;
    }
    /// What the robot's body touched, by ground truth.
    std::string touched() const {
        std::string all;
        for (const auto& thing : lab_->truth(0).touched) all += thing + " ";
        return all;
    }
    /// From the robot's hull to the nearest obstacle, by ground truth; less than nothing when it is under a
    /// table.
    double clearance_mm() const {
        const auto truth = lab_->truth(0);
        const double a = truth.theta_deg * std::numbers::pi / 180;
        double nearest = 1e9;
        for (const auto& o : obstacles()) {
            for (int i = 0; i <= 4; ++i) {
                const double behind = body::kRear_mm / 1000 * i / 4;
                nearest = std::min(nearest, distance_m(o, truth.x_m + std::cos(a) * behind,
                                                       truth.y_m + std::sin(a) * behind));
            }
        }
        return nearest * 1000 - 212;  // the hull's radius in front and behind, rubber included
    }

    std::unique_ptr<lab::Laboratory> lab_;
    lab::WorldDescription world_;
    struct Answer {
        TimePoint at;
        arcos::Bytes bytes;
    };
    std::deque<Answer> inbox_;
    Duration late_{};  ///< the robot's answers, as over a radio link
    bool fresh_ = false;
    bool has_laser_ = true;
    double nearest_mm_ = 1e9;
    int bumps_ = 0;
    /// By ground truth: from when on the motion must end; and the laboratory's age when that came, and when
    /// it did.
    std::function<bool(const lab::Truth&)> must_end_;
    std::optional<Duration> seen_at_, failed_at_;
    arcos::ClientSession session_{*this};

  private:
    static double distance_m(const Rectangle& o, double x, double y) {
        const double a = o.theta_deg * std::numbers::pi / 180;
        const double u = std::cos(a) * (x - o.x) + std::sin(a) * (y - o.y);
        const double v = std::cos(a) * (y - o.y) - std::sin(a) * (x - o.x);
        return std::hypot(std::max(0.0, std::abs(u) - o.dx / 2), std::max(0.0, std::abs(v) - o.dy / 2));
    }
};

}  // namespace axon::peoplebot
