// SPDX-License-Identifier: GPL-2.0-or-later
#include "radio.hpp"

#include "channel/two_sides.hpp"

namespace axon::bench {

namespace {

using namespace std::chrono_literals;

// The bad radio of docs/reference/datagrams.md: losses by themselves, no limit of the rate, which would only
// measure itself.
constexpr double kLoss = 0.022;
constexpr auto kDelay = 2ms;
constexpr std::uint64_t kSeed = 1;

faults::ChannelSettings channel() {
    faults::ChannelSettings its;
    its.loss = kLoss;
    its.delay = kDelay;
    return its;
}

}  // namespace

Radio::Radio() {
    try {
        sides_ = std::make_unique<faults::TwoSides>(channel(), kSeed);
        sides_->enter(faults::Side::Right);
    } catch (const faults::NotPermitted& refused) {
        throw std::runtime_error(std::string("this machine does not permit a radio link: ") + refused.what());
    }
}
Radio::~Radio() = default;

std::function<void()> Radio::enterWireless() const {
    return [this] { sides_->enter(faults::Side::Left); };
}

const char* Radio::address() {
    return faults::TwoSides::kRight;
}

nlohmann::json Radio::settings() {
    return {{"loss", kLoss}, {"delay_ms", kDelay.count()}, {"seed", kSeed}};
}

}  // namespace axon::bench
