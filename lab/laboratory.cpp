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

Laboratory::Laboratory(const WorldDescription& world, Send send) : physics_((validate(world), world)) {
    for (std::size_t i = 0; i < world.robots.size(); ++i) {
        controllers_.push_back(std::make_unique<Controller>(i, world.robots[i].name, send));
    }
}
Laboratory::~Laboratory() = default;

void Laboratory::step() {
    now_ += Physics::kPeriod;
    for (const auto& controller : controllers_) {
        const auto& readings = physics_.sense(controller->index);
        physics_.setWheels(controller->index, controller->arcos.step(Physics::kPeriod, readings, now_));
    }
    physics_.step();
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
