// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/laboratory.hpp"

#include <optional>

namespace axon::lab {

struct Laboratory::Controller final : ArcosServer::Port {
    Controller(std::size_t number, const std::string& name, Send to, const LaserLines& lasers)
        : index(number),
          out(std::move(to)),
          laser_out(lasers.send),
          arcos({.name = name}, *this, !lasers.send) {
        if (lasers.send) laser.emplace(lasers.serial);
    }
    void send(const arcos::Bytes& bytes) override { out(index, bytes); }

    std::size_t index;
    Send out;
    Send laser_out;
    ArcosServer arcos;
    std::optional<LmsServer> laser;
};

Laboratory::Laboratory(const WorldDescription& world, Send send, const Options& options,
                       const LaserLines& lasers)
    : physics_((validate(world), world), options) {
    for (std::size_t i = 0; i < world.robots.size(); ++i) {
        controllers_.push_back(std::make_unique<Controller>(i, world.robots[i].name, send, lasers));
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

void Laboratory::clientConnected(std::size_t robot) {
    controllers_[robot]->arcos.clientConnected(now_);
}
void Laboratory::clientLost(std::size_t robot) {
    controllers_[robot]->arcos.clientLost();
}
void Laboratory::receive(std::size_t robot, std::span<const std::uint8_t> bytes) {
    controllers_[robot]->arcos.receive(bytes, now_);
}
std::vector<std::uint8_t> Laboratory::receiveLaser(std::size_t robot, std::span<const std::uint8_t> bytes) {
    return controllers_.at(robot)->laser.value().receive(bytes, now_);
}
const LmsServer& Laboratory::laser(std::size_t robot) const {
    return controllers_.at(robot)->laser.value();
}
const ArcosServer& Laboratory::controller(std::size_t robot) const {
    return controllers_[robot]->arcos;
}

}  // namespace axon::lab
