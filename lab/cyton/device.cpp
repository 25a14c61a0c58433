// SPDX-License-Identifier: GPL-2.0-or-later
// The Cyton as a device of the laboratory: its body, moved by an SSC-32.
#include "lab/device.hpp"

#include <numbers>
#include <stdexcept>

#include "lab/cyton/body.hpp"
#include "lab/cyton/ssc32_server.hpp"

namespace axon::lab {
namespace {

class Cyton final : public Device {
  public:
    explicit Cyton(const DeviceParts& parts) : body_(parts) {}

    void reset() override {
        board_ = Ssc32Server();
        body_.place(CytonBody::home());
    }
    void step(Duration period) override {
        board_.step(period);
        body_.setTargets(board_.targets());
    }
    void clientConnected() override { board_.clientConnected(); }
    std::vector<std::uint8_t> receive(std::span<const std::uint8_t> bytes) override {
        return board_.receive(bytes);
    }
    void setFault(std::string_view kind, std::size_t which, bool broken) override {
        if (kind != "stuck-servo" && kind != "stuck-gripper")
            throw std::invalid_argument("\"kind\" of an arm: expected stuck-servo or stuck-gripper");
        const std::size_t servo = kind == "stuck-gripper" ? cyton::kJoints : which;
        if (servo >= cyton::kServos.size())
            throw std::invalid_argument("\"which\": expected a servo from 0 to 7");
        board_.setStuck(servo, broken);
    }
    std::vector<Measure> truth() const override {
        constexpr double kDegree = std::numbers::pi / 180;
        const auto at = body_.positions();
        std::vector<double> joints;
        for (std::size_t i = 0; i < cyton::kJoints; ++i) joints.push_back(at[i] / kDegree);
        return {{.name = "joints_deg", .value = joints, .least_move = 0.002 / kDegree},
                {.name = "claw_mm", .value = at[cyton::kJoints] * 1000, .least_move = 2}};
    }

  private:
    CytonBody body_;
    Ssc32Server board_;
};

}  // namespace

DeviceKind cytonKind() {
    return {.word = "cyton",
            .label = "Cyton",
            .noun = "arm",
            .protocol = "SSC-32",
            .first_port = 8201,
            .radius_m = 0.1,
            .model = &cytonModel,
            .make = [](const DeviceParts& parts) -> std::unique_ptr<Device> {
                return std::make_unique<Cyton>(parts);
            }};
}

}  // namespace axon::lab
