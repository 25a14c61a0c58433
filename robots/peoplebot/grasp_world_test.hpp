// SPDX-License-Identifier: GPL-2.0-or-later
// A world for the tests of what grasps: a robot without inertia, a table with an object on it, a camera that
// sees the object as a rectangle, and a gripper whose parts move at their speeds. No physics.
#pragma once
#include <algorithm>
#include <cmath>
#include <numbers>
#include <optional>

#include "robots/peoplebot/table_approach.hpp"
#include "robots/peoplebot/tracking.hpp"

namespace axon::peoplebot::test {

class GraspWorld {
  public:
    static constexpr double kDegree = std::numbers::pi / 180;

    GraspWorld() {
        robot.online = true;
        robot.gripper = {
            .known = true, .fitted = true, .closed = true, .lift_down = true, .lift_at_limit = true};
    }

    // Where the robot really is; its odometry starts at zero.
    double x = 0, y = 0, heading_deg = 0;
    double table_x = 1200;  ///< its edge is the line x = table_x, turned about (table_x, 0)
    double table_turn_deg = 0;
    double table_height = 660;
    bool table = true;
    std::optional<double> object_x = 1260, object_y = 0;
    double lift = 0, opening = 0;  ///< mm of the lift; of each paddle from the middle
    bool holding = false;
    bool camera_works = true;
    bool slippery = false;  ///< the object gets lost while it is lifted
    bool stuck_paddles = false;
    bool visible = true;
    std::optional<double> wall_ahead;  ///< the sonars ahead read this

    arcos::RobotState robot;
    GraspGeometry geometry;
    ManualClock clock;
    CameraView view;
    int pictures = 0;
    double forward = 0, left = 0;
    int paddles = 0, lift_way = 0;
    double lift_rest = 1e9;
    arcos::vcc4::PanTilt looks{};
    double travelled = 0;

    double edgeDistance(double px, double py) const {  // in front of the table is negative
        const double a = table_turn_deg * kDegree;
        return std::cos(a) * (px - table_x) + std::sin(a) * py;
    }
    std::pair<double, double> toWorld(double rx, double ry) const {
        const double a = heading_deg * kDegree;
        return {x + std::cos(a) * rx - std::sin(a) * ry, y + std::sin(a) * rx + std::cos(a) * ry};
    }
    std::pair<double, double> toRobot(double wx, double wy) const {
        const double a = heading_deg * kDegree;
        const double dx = wx - x, dy = wy - y;
        return {std::cos(a) * dx + std::sin(a) * dy, -std::sin(a) * dx + std::cos(a) * dy};
    }

    void apply(double forward_mm_s, double left_deg_s, const std::vector<GripperCommand>& commands,
               const std::optional<arcos::vcc4::PanTilt>& look) {
        forward = forward_mm_s;
        left = left_deg_s;
        for (const auto& command : commands) {
            using arcos::GripperOrder;
            switch (command.order) {
                case GripperOrder::Open:
                    paddles = 1;
                    break;
                case GripperOrder::Press:
                case GripperOrder::Close:
                    paddles = -1;
                    break;
                case GripperOrder::Stop:
                    paddles = 0;
                    break;
                case GripperOrder::LiftUp:
                    lift_way = 1;
                    lift_rest = 1e9;
                    break;
                case GripperOrder::LiftDown:
                    lift_way = -1;
                    lift_rest = 1e9;
                    break;
                case GripperOrder::LiftStop:
                    lift_way = 0;
                    break;
                case GripperOrder::Halt:
                    paddles = lift_way = 0;
                    break;
                case GripperOrder::LiftCarry:
                    lift_way = *command.value > 0 ? 1 : -1;
                    lift_rest = std::abs(*command.value) * 0.02 * geometry.lift_mm_s;
                    break;
                default:
                    break;
            }
        }
        if (look) looks = *look;
    }

    /// A tenth of a second: what the robot does, then what it tells.
    void pass() {
        constexpr double kDt = 0.1;
        clock.advance(std::chrono::milliseconds{100});
        const double a = heading_deg * kDegree;
        x += std::cos(a) * forward * kDt;
        y += std::sin(a) * forward * kDt;
        travelled += std::abs(forward) * kDt;
        heading_deg += left * kDt;
        moveGripper(kDt);
        robot.x_mm = x;
        robot.y_mm = y;
        robot.heading_deg = heading_deg;
        robot.left_mm_s = robot.right_mm_s = forward;
        robot.rotation_deg_s = left;
        robot.moving = forward != 0 || left != 0;
        robot.taken = clock.now();
        ++robot.sequence;
        const auto seen = [&](double side) {
            const auto [px, py] = toWorld(333, side * 233);
            return table && edgeDistance(px, py) > 0;
        };
        robot.table_left = seen(1);
        robot.table_right = seen(-1);
        for (int i = 0; i < 24; ++i) {
            const double ahead = std::abs(std::remainder(*sonarDirection_deg(i), 360.0));
            robot.sonars[static_cast<std::size_t>(i)] = {
                wall_ahead && ahead < 20 ? static_cast<int>(*wall_ahead) : 5000, clock.now()};
        }
        if (camera_works) takePicture();
    }

  private:
    void moveGripper(double dt) {
        auto& g = robot.gripper;
        if (stuck_paddles) paddles = 0;
        double inner = 0;
        bool between = false;
        g.outer_beam = g.inner_beam = false;
        if (object_x) {
            const auto [ox, oy] = toRobot(*object_x, *object_y);
            const bool level = holding || std::abs(geometry.lift_top_mm - geometry.lift_travel_mm + lift -
                                                   (table_height + 40)) < 60;
            between = level && ox > geometry.paddles_mm - 80 && ox < geometry.paddles_mm + 30 &&
                      std::abs(oy) < opening - 10;
            if (holding || (level && std::abs(oy) < 95 && std::abs(ox - geometry.paddles_mm - 13) < 14))
                g.outer_beam = true;
            if (!holding && level && std::abs(oy) < 95 && std::abs(ox - geometry.paddles_mm + 13) < 14)
                g.inner_beam = true;
            if (between || holding) inner = 14;
            if (holding) {
                const auto [wx, wy] = toWorld(geometry.paddles_mm, 0);
                object_x = wx;
                object_y = wy;
            }
        }
        opening = std::clamp(opening + paddles * 20 * dt, inner, 107.5);
        g.left_pressed = g.right_pressed = opening <= inner + 0.01 && paddles <= 0;
        if ((paddles > 0 && opening >= 107.5) || (paddles < 0 && opening <= inner)) paddles = 0;
        if (between && g.left_pressed) holding = true;
        if (opening > 20) holding = false;
        const double step = lift_way * std::min(geometry.lift_mm_s * dt, lift_rest);
        // What it holds comes to rest on the table.
        const double floor = holding && lift_way < 0 && robot.table_left ? table_height + 40 - 600 : 0;
        lift = std::clamp(lift + step, floor, geometry.lift_travel_mm);
        lift_rest -= std::abs(step);
        if (lift_rest <= 1e-6 || lift >= geometry.lift_travel_mm || lift <= floor) {
            if (lift_way != 0 && (lift_rest <= 1e-6 || (lift_way > 0 && lift >= geometry.lift_travel_mm) ||
                                  (lift_way < 0 && lift <= floor)))
                lift_way = 0;
        }
        if (slippery && holding && lift > 150) {
            holding = false;
            object_x.reset();
        }
        g.open = opening >= 107;
        g.paddles_moving = paddles != 0;
        g.closed = !g.open && paddles == 0;
        g.lift_up = lift >= geometry.lift_travel_mm - 1;
        g.lift_down = lift <= 1;
        g.lift_at_limit = g.lift_up || g.lift_down;
        g.lift_moving = lift_way != 0;
    }

    void takePicture() {
        ++pictures;
        view = {static_cast<std::uint64_t>(pictures), clock.now(), 320, 240, {}};
        if (!object_x || !visible) return;
        const auto [ox, oy] = toRobot(*object_x, *object_y);
        const double focal = 160 / std::tan(geometry.view_deg / 2 * kDegree);
        double u[2], v[2];
        int i = 0;
        for (const double z : {table_height, table_height + 80}) {
            const double dx = ox - geometry.camera_x_mm;
            const double p = looks.pan_left_deg * kDegree, t = looks.tilt_up_deg * kDegree;
            const double f = std::cos(p) * dx + std::sin(p) * oy;
            const double l = -std::sin(p) * dx + std::cos(p) * oy;
            const double h = z - geometry.camera_height_mm;
            const double depth = std::cos(t) * f + std::sin(t) * h - geometry.camera_lens_mm;
            const double up = -std::sin(t) * f + std::cos(t) * h;
            if (depth < 50) return;
            u[i] = 160 - focal * l / depth;
            v[i] = 120 - focal * up / depth;
            ++i;
        }
        const double half = focal * 14 / std::hypot(ox - geometry.camera_x_mm, oy);
        Blob blob;
        blob.left = static_cast<int>(std::clamp(u[0] - half, 0.0, 319.0));
        blob.right = static_cast<int>(std::clamp(u[0] + half, 0.0, 319.0));
        blob.top = static_cast<int>(std::clamp(v[1], 0.0, 239.0));
        blob.bottom = static_cast<int>(std::clamp(v[0], 0.0, 239.0));
        blob.x = (blob.left + blob.right) / 2.0;
        blob.y = (blob.top + blob.bottom) / 2.0;
        blob.area = (blob.right - blob.left) * (blob.bottom - blob.top);
        if (blob.area >= kSignificantArea) view.blobs.push_back(blob);
    }
};

}  // namespace axon::peoplebot::test
