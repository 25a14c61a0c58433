// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <map>
#include <string>
#include <vector>

#include "axon/types.hpp"

namespace axon::testing {

/// A task as a scripted entity was asked for it: all its parameters by name, those of the profile included.
struct Request {
    std::string service;
    std::map<std::string, std::vector<client::Value>> parameters;

    bool has(const std::string& parameter) const { return parameters.contains(parameter); }
    /// The first value of a parameter that has this type. An integer is read as a number, too. Throws Failure
    /// if there is none.
    double number(const std::string& parameter) const;
    std::string text(const std::string& parameter) const;
};

/// What a scripted entity does with a task, in the order of the calls:
///
///     Script().after(1s).progress(0.5).feedback("half way").after(1s).result("Moved", {1000.0})
///
/// It grants the task, reports half of the way after a second of the laboratory's time, and ends well after
/// two. A script without an end succeeds when everything in it has happened. What comes after an end is
/// ignored. A value: copy it as you like.
class Script {
  public:
    /// What follows happens this much later. Time that is zero or less is no time.
    Script& after(client::Seconds time);
    Script& progress(double part);  ///< 0 to 1
    Script& feedback(std::string text);
    /// An OUTPUT or FEEDBACK parameter, told at this time.
    Script& result(std::string name, std::vector<client::Value> values);
    /// A sample of a stream: one number, or several.
    Script& sample(std::string stream, std::vector<double> numbers, std::string units = {});

    Script& succeed();
    Script& fail(std::string reason);
    /// Fails with ROBOT_LOST.
    Script& robotLost(std::string reason);
    /// Runs until it is stopped or cancelled.
    Script& never();

    /// The robot application refuses the task.
    static Script denied(std::string reason);

  private:
    friend class Actor;
    struct Step {
        enum class Kind : std::uint8_t {
            Progress,
            Feedback,
            Result,
            Sample,
            Succeed,
            Fail,
            RobotLost,
            Never
        };
        Kind kind;
        client::Seconds after{0};  ///< since the step before
        std::string text, units;
        std::vector<client::Value> values;
        std::vector<double> numbers;
    };
    Script& add(Step step);
    bool denied_ = false;
    std::string reason_;
    std::vector<Step> steps_;
    client::Seconds pause_{0};  // before the next step
};

}  // namespace axon::testing
