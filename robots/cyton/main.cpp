// SPDX-License-Identifier: GPL-2.0-or-later
#include <fmt/format.h>

#include <CLI/CLI.hpp>

#include "robots/cyton/application.hpp"

namespace {

constexpr auto kFooter = R"(
With the virtual laboratory, each line in a terminal of its own:
  axon-lab
  axon-cyton --arm 127.0.0.1:8201
On the real arm's serial line: axon-cyton --arm /dev/ttyUSB0:115200
An Entity Manager that is configured with the same --application links to it. The arm may come and go: its services are
inactive while its controller cannot be reached. Connecting moves nothing. Ends on Ctrl-C; the arm stays where it is.
Exit status: 0 ended when told to, 2 something is wrong with the options or the profiles.)";

}  // namespace

int main(int argc, char** argv) {
    using namespace axon::cyton;
    CLI::App app{
        "A Cyton Alpha as an entity of Axon: an arm on an SSC-32; offers Reach Demo, Control, Grab and "
        "Place.",
        "axon-cyton"};
    app.footer(kFooter);
    Settings settings;
    std::string at;
    auto guard_ms = settings.guard_silence.count();
    app.add_option("--arm", settings.arm, "The arm's SSC-32: host:port, or a serial device with its speed")
        ->capture_default_str();
    app.add_option("--application", settings.application, "Name that the Entity Manager is configured with")
        ->capture_default_str();
    app.add_option("--instance", settings.instance, "Tells equal applications on one host apart");
    app.add_option("--name", settings.name, "Name of the entity, instead of the basic profile's");
    app.add_option("--ports", settings.ports, "A ports.cfg, or the range to listen in, such as 5500-5600");
    app.add_option("--at", at, "Where the arm's base stands: X,Y,Z in mm");
    app.add_option("--guard", guard_ms,
                   "Milliseconds without a sign of life of this program after which its guard, a process of "
                   "its own, stops the arm; 0: no guard")
        ->capture_default_str()
        ->check(CLI::Range(0, 10000));
    app.add_option("--profiles", settings.profiles, "Folder with basic_profile.xml and services_profile.xml");
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
        if (!at.empty()) settings.at_mm = parsePlace(at);
        Application(settings).run();
    } catch (const std::exception& error) {
        fmt::print(stderr, "axon-cyton: {}\n", error.what());
        return 2;
    }
    return 0;
}
