// SPDX-License-Identifier: MIT
// [tour]
#pragma once
#include <axon/client.hpp>
#include <string>
#include <vector>

/// Drives the legs of a tour one after the other. A leg that fails is tried once more. Returns what the
/// operator is told.
inline std::string tour(axon::client::Client& lab, const std::vector<double>& legs_mm) {
    const auto rover = lab.checkOut("Rover");
    if (!rover) return "no rover: " + rover.refusal().message;
    double driven_mm = 0;
    for (const auto leg_mm : legs_mm) {
        auto end = rover->run("Drive", {{"Distance", {leg_mm}}}).wait();
        if (end.state == axon::client::TaskState::Failed)
            end = rover->run("Drive", {{"Distance", {leg_mm}}}).wait();
        if (end.state != axon::client::TaskState::Succeeded)
            return "ended after " + std::to_string(int(driven_mm)) + " mm: " + toString(end.state);
        driven_mm += leg_mm;
    }
    (void)rover->release();
    return "drove " + std::to_string(int(driven_mm)) + " mm";
}
// [end]
