// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/robot_program.hpp"

#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>

namespace axon::robots {
namespace {

constexpr auto kEnd = R"(
An Entity Manager that is configured with the same --application links to it. While the robot cannot be reached, its
services are inactive. On Ctrl-C the program stops the robot and ends.
Exit status: 0 ended by a signal; 2 the options or the profiles are wrong.)";

}  // namespace

RobotProgram::RobotProgram(RobotSettings& settings, const std::string& summary, const std::string& examples)
    : settings_(settings), app_(std::make_unique<CLI::App>(summary, "axon-" + settings.kind)) {
    app_->footer("\n" + examples + kEnd);
}
RobotProgram::~RobotProgram() = default;

void RobotProgram::option(const std::string& name, std::string& value, const std::string& meaning) {
    auto* option = app_->add_option(name, value, meaning);
    if (!value.empty()) option->capture_default_str();
}

int RobotProgram::run(int argc, const char* const* argv, const std::function<void()>& start) {
    auto guard_ms = settings_.guard_silence.count();
    app_->add_option("--application", settings_.application,
                     "Name that the Entity Manager is configured with")
        ->capture_default_str();
    app_->add_option("--instance", settings_.instance,
                     "Distinguishes several of these applications on one host");
    app_->add_option("--name", settings_.name, "Name of the entity, instead of the basic profile's");
    app_->add_option("--ports", settings_.ports, "A ports.cfg, or the range to listen in, such as 5500-5600");
    app_->add_option(
            "--guard", guard_ms,
            "Milliseconds without a sign of life of this program after which its guard, a process of "
            "its own, stops the robot; 0: no guard")
        ->capture_default_str()
        ->check(CLI::Range(0, 10000));
    app_->add_option("--profiles", settings_.profiles,
                     "Folder with basic_profile.xml and services_profile.xml");
    app_->add_option("--resources", settings_.resources,
                     "Folders below which resources with an absolute url may be; none by default");
    try {
        app_->parse(argc, argv);
    } catch (const CLI::ParseError& error) {
        return app_->exit(error) == 0 ? 0 : 2;
    }
    try {
        settings_.guard_silence = std::chrono::milliseconds{guard_ms};
        start();
    } catch (const std::exception& error) {
        fmt::print(stderr, "axon-{}: {}\n", settings_.kind, error.what());
        return 2;
    }
    return 0;
}

}  // namespace axon::robots
