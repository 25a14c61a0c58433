// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <string>

#include "robots/common/robot_settings.hpp"

namespace CLI {
class App;
}

namespace axon::robots {

/// The main function of a robot application: its command line, its help and its exit status. The program is
/// called axon-KIND.
///
///     axon::blimp::Settings settings;
///     axon::robots::RobotProgram program(settings, "A blimp as an entity of Axon.", kExamples);
///     program.option("--blimp", settings.blimp, "The blimp's radio: host:port");
///     return program.run(argc, argv, [&] { axon::blimp::Application(settings).run(); });
class RobotProgram {
  public:
    /// `settings` must outlive this; `summary` is one sentence, `examples` the end of the help: how to start
    /// the program, one line each.
    RobotProgram(RobotSettings& settings, const std::string& summary, const std::string& examples);
    ~RobotProgram();
    RobotProgram(const RobotProgram&) = delete;
    RobotProgram& operator=(const RobotProgram&) = delete;

    /// An option that only this kind of robot has; `value` is its default, and must outlive this.
    void option(const std::string& name, std::string& value, const std::string& meaning);

    /// Once. Reads the command line, then calls `start`, which returns when the application ends. Gives the
    /// exit status: 0 for an end that was asked for and for --help, 2 for a wrong option and for whatever
    /// `start` throws, which is printed.
    int run(int argc, const char* const* argv, const std::function<void()>& start);

  private:
    RobotSettings& settings_;
    std::unique_ptr<CLI::App> app_;
};

}  // namespace axon::robots
