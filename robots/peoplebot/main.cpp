// SPDX-License-Identifier: GPL-2.0-or-later
#include <fmt/format.h>

#include <CLI/CLI.hpp>

#include "robots/peoplebot/application.hpp"

namespace {

constexpr auto kFooter = R"(
With the virtual laboratory, each line in a terminal of its own:
  axon-lab
  axon-peoplebot --at 2400,2000,180
With a real robot, whose controller and laser are each on a serial line (docs/how-to/real-peoplebot.md):
  axon-peoplebot --robot /dev/ttyS0 --laser /dev/ttyUSB0 --camera ''
An Entity Manager that is configured with the same --application links to it. The robot may come and go: its services are
inactive while it cannot be reached. Ends on Ctrl-C, after stopping the robot.
Exit status: 0 ended when told to, 2 something is wrong with the options or the profiles.)";

}  // namespace

int main(int argc, char** argv) {
    using namespace axon::peoplebot;
    CLI::App app{
        "A PeopleBot as an entity of Axon: drives the robot over ARCOS, offers the services of its profile.",
        "axon-peoplebot"};
    app.footer(kFooter);
    Settings settings;
    std::string at;
    auto guard_ms = settings.guard_silence.count();
    app.add_option("--robot", settings.robot,
                   "The robot: host:port, or a serial line such as /dev/ttyS0 or /dev/ttyUSB0:38400")
        ->capture_default_str();
    app.add_option("--laser", settings.laser,
                   "The line of a SICK LMS-200 that is wired to this computer, such as /dev/ttyUSB0; without "
                   "it the laser is asked for by the robot");
    app.add_option("--camera", settings.camera, "The robot's camera, host:port; an empty text: there is none")
        ->capture_default_str();
    app.add_option("--application", settings.application, "Name that the Entity Manager is configured with")
        ->capture_default_str();
    app.add_option("--instance", settings.instance, "Tells equal applications on one host apart");
    app.add_option("--name", settings.name, "Name of the entity, instead of the basic profile's");
    app.add_option("--ports", settings.ports, "A ports.cfg, or the range to listen in, such as 5500-5600");
    app.add_option("--at", at, "Where the robot stands: X,Y,HEADING in mm, mm, degrees");
    app.add_option("--guard", guard_ms,
                   "Milliseconds without a sign of life of this program after which its guard, a process of "
                   "its own, stops the robot; 0: no guard")
        ->capture_default_str()
        ->check(CLI::Range(0, 10000));
    app.add_option("--profiles", settings.profiles,
                   "Folder with basic_profile.xml and services_profile.xml, and wander.rules and "
                   "navigation.rules if others are wanted");
    app.add_option(
        "--resources", settings.resources,
        "Folders in which the absolute urls of resources in the services profile may lead; none by default");
    try {
        app.parse(argc, argv);
    } catch (const CLI::ParseError& error) {
        return app.exit(error) == 0 ? 0 : 2;
    }
    try {
        settings.guard_silence = std::chrono::milliseconds{guard_ms};
        settings.at_given = !at.empty();
        if (settings.at_given) settings.at = parsePose(at);
        Application(settings).run();
    } catch (const std::exception& error) {
        fmt::print(stderr, "axon-peoplebot: {}\n", error.what());
        return 2;
    }
    return 0;
}
