// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/robot_program.hpp"
#include "robots/peoplebot/application.hpp"

namespace {

constexpr auto kExamples =
    R"(With the virtual laboratory, each line in a terminal of its own:
  axon-lab
  axon-peoplebot --at 2400,2000,180
With a real robot, whose controller and laser are each on a serial line (docs/how-to/real-peoplebot.md):
  axon-peoplebot --robot /dev/ttyS0 --laser /dev/ttyUSB0 --camera ''
A wander.rules or navigation.rules in the folder of --profiles replaces the program's own rules.)";

}  // namespace

int main(int argc, char** argv) {
    axon::peoplebot::Settings settings;
    std::string at;
    axon::robots::RobotProgram program(
        settings, "A PeopleBot as an entity of Axon: drives the robot over ARCOS and offers its services.",
        kExamples);
    program.option("--robot", settings.robot,
                   "The robot: host:port, or a serial line such as /dev/ttyS0 or /dev/ttyUSB0:38400");
    program.option("--laser", settings.laser,
                   "The line of a SICK LMS-200 that is wired to this computer, such as /dev/ttyUSB0; without "
                   "it the scans come from the robot, over ARCOS");
    program.option("--camera", settings.camera, "The robot's camera, host:port; '' if there is none");
    program.option("--at", at, "Where the robot stands: X,Y,HEADING in mm, mm, degrees");
    return program.run(argc, argv, [&] {
        settings.at_given = !at.empty();
        if (settings.at_given) settings.at = axon::peoplebot::parsePose(at);
        axon::peoplebot::Application(settings).run();
    });
}
