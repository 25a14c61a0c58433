// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/robot_program.hpp"
#include "robots/cyton/application.hpp"

namespace {

constexpr auto kExamples =
    R"(With the virtual laboratory, each line in a terminal of its own:
  axon-lab
  axon-cyton --arm 127.0.0.1:8201
On the real arm's serial line: axon-cyton --arm /dev/ttyUSB0:115200
Connecting moves nothing; at the end of the program the arm stays where it is.)";

}  // namespace

int main(int argc, char** argv) {
    axon::cyton::Settings settings;
    std::string at;
    axon::robots::RobotProgram program(
        settings,
        "A Cyton Alpha as an entity of Axon: an arm with an SSC-32 controller. "
        "It offers Reach Demo, Control, and Grab and Place.",
        kExamples);
    program.option("--arm", settings.arm, "The arm's SSC-32: host:port, or a serial device with its speed");
    program.option("--at", at, "Where the arm's base stands: X,Y,Z in mm");
    return program.run(argc, argv, [&] {
        if (!at.empty()) settings.at_mm = axon::cyton::parsePlace(at);
        axon::cyton::Application(settings).run();
    });
}
