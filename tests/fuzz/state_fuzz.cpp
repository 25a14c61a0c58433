// SPDX-License-Identifier: GPL-2.0-or-later
// A value of the state folder that is damaged in any way: the Entity Manager says so and does not start, or
// the robot, which was held and stopped when the last life ended, comes up latched. The first byte chooses
// the value, the rest is its content.
#include <cstdint>
#include <iterator>
#include <stdexcept>
#include <string>

#include "claim.hpp"
#include "tests/support/core_rig.hpp"

namespace {}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    using axon::test::CoreRig;
    static const auto values = [] {
        CoreRig rig;
        rig.makeIdle();
        rig.take("client1", "r1");
        rig.task("client1", "t1", "Turning");
        rig.stop("client2");
        return rig.storage.values;
    }();
    if (size == 0) return 0;
    CoreRig rig;
    rig.storage.values = values;
    std::next(rig.storage.values.begin(), static_cast<std::ptrdiff_t>(bytes[0] % values.size()))
        ->second.assign(reinterpret_cast<const char*>(bytes + 1), size - 1);
    try {
        rig.restart();
        require(rig.core().latched(), "a robot that was stopped comes up latched");
    } catch (const std::runtime_error& error) {
        require(std::string(error.what()).find("damaged") != std::string::npos, "what is wrong is said");
    }
    return 0;
}
