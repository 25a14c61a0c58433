// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/laboratory.hpp"

#include <optional>

namespace axon::lab {

struct Laboratory::Controller final : ArcosServer::Port {
    struct RobotLine final : ClientLine {
        explicit RobotLine(Controller& of) : robot(of) {}
        void clientConnected() override { robot.arcos.clientConnected(robot.now); }
        void clientLost() override { robot.arcos.clientLost(); }
        std::vector<std::uint8_t> receive(std::span<const std::uint8_t> bytes) override {
            robot.arcos.receive(bytes, robot.now);
            return {};
        }
        int baud() const override { return robot.arcos.baud(); }

        Controller& robot;
    };
    struct LaserLine final : ClientLine {
        explicit LaserLine(Controller& of) : robot(of) {}
        std::vector<std::uint8_t> receive(std::span<const std::uint8_t> bytes) override {
            return robot.laser.value().receive(bytes, robot.now);
        }
        int baud() const override { return robot.laser.value().baud(); }

        Controller& robot;
    };

    Controller(std::size_t number, const std::string& name, const TimePoint& time, Send to,
               const LaserLines& lasers)
        : index(number),
          now(time),
          out(std::move(to)),
          laser_out(lasers.send),
          arcos({.name = name}, *this, !lasers.send) {
        if (lasers.send) laser.emplace(lasers.serial);
    }
    void send(const arcos::Bytes& bytes) override { out(index, bytes); }

    std::size_t index;
    const TimePoint& now;
    Send out;
    Send laser_out;
    ArcosServer arcos;
    std::optional<LmsServer> laser;
    RobotLine robot_line{*this};
    LaserLine laser_line{*this};
};

Laboratory::Laboratory(const WorldDescription& world, Send send, const Options& options,
                       const LaserLines& lasers)
    : physics_((validate(world), world), options) {
    for (std::size_t i = 0; i < world.robots.size(); ++i) {
        controllers_.push_back(std::make_unique<Controller>(i, world.robots[i].name, now_, send, lasers));
    }
}
Laboratory::~Laboratory() = default;

void Laboratory::step() {
    now_ += Physics::kPeriod;
    for (const auto& controller : controllers_) {
        const auto robot = controller->index;
        auto& arcos = controller->arcos;
        const auto& readings = physics_.sense(robot);
        if (auto& laser = controller->laser) {
            if (const auto bytes = laser->step(Physics::kPeriod, readings); !bytes.empty())
                controller->laser_out(robot, bytes);
        }
        physics_.setWheels(robot, arcos.step(Physics::kPeriod, readings, now_));
        physics_.setGripper(robot, arcos.gripper());
        physics_.setCamera(robot, arcos.camera());
        physics_.setLaser(robot, controller->laser ? controller->laser->scanning() : arcos.laser());
    }
    physics_.step();
}

void Laboratory::reset() {
    physics_.reset();
    for (const auto& controller : controllers_) controller->arcos.encodersJumped();
}

ClientLine& Laboratory::robot(std::size_t index) {
    return controllers_.at(index)->robot_line;
}
ClientLine& Laboratory::laser(std::size_t robot) {
    return controllers_.at(robot)->laser_line;
}
const ArcosServer& Laboratory::controller(std::size_t robot) const {
    return controllers_[robot]->arcos;
}

}  // namespace axon::lab
