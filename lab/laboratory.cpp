// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/laboratory.hpp"

namespace axon::lab {

struct Laboratory::Controller final : ArcosServer::Port {
    Controller(std::size_t number, const std::string& name, Send to)
        : index(number), out(std::move(to)), arcos({.name = name}, *this) {}
    void send(const arcos::Bytes& bytes) override { out(index, bytes); }

    std::size_t index;
    Send out;
    ArcosServer arcos;
};

Laboratory::Laboratory(const WorldDescription& world, Send send, const Options& options)
    : physics_((validate(world), world), options) {
    for (std::size_t i = 0; i < world.robots.size(); ++i) {
        controllers_.push_back(std::make_unique<Controller>(i, world.robots[i].name, send));
    }
    for (std::size_t i = 0; i < world.arms.size(); ++i) arms_.push_back(std::make_unique<Ssc32Server>());
}
Laboratory::~Laboratory() = default;

void Laboratory::step() {
    now_ += Physics::kPeriod;
    for (const auto& controller : controllers_) {
        const auto robot = controller->index;
        auto& arcos = controller->arcos;
        physics_.setWheels(robot, arcos.step(Physics::kPeriod, physics_.sense(robot), now_));
        physics_.setGripper(robot, arcos.gripper());
        physics_.setCamera(robot, arcos.camera());
        physics_.setLaser(robot, arcos.laser());
    }
    for (std::size_t i = 0; i < arms_.size(); ++i) {
        arms_[i]->step(Physics::kPeriod);
        physics_.setArm(i, arms_[i]->targets());
    }
    physics_.step();
}

void Laboratory::reset() {
    physics_.reset();
    for (const auto& controller : controllers_) controller->arcos.encodersJumped();
    for (auto& arm : arms_) *arm = Ssc32Server();
}

void Laboratory::armClientConnected(std::size_t arm) {
    arms_.at(arm)->clientConnected();
}
std::vector<std::uint8_t> Laboratory::receiveArm(std::size_t arm, std::span<const std::uint8_t> bytes) {
    return arms_.at(arm)->receive(bytes);
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
const ArcosServer& Laboratory::controller(std::size_t robot) const {
    return controllers_[robot]->arcos;
}

}  // namespace axon::lab
