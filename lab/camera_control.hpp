// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>

#include "common/clock.hpp"
#include "robots/arcos/vcc4.hpp"

namespace axon::lab {

/// Where the camera looks and how far it zooms.
struct CameraPose {
    arcos::vcc4::PanTilt looks;
    int zoom = 0;
};

/// The virtual VC-C4: takes the bytes of its serial port, answers them, and turns its head at the rates it
/// was given. Like the real one it does nothing before Power and Control, and refuses to tilt above 30
/// degrees before SetRange. I/O-free, not thread-safe.
class CameraControl {
  public:
    /// The answers to all commands that are complete with these bytes.
    std::string receive(std::string_view bytes);
    /// Where it looks at the end of the period.
    CameraPose step(Duration period);
    const CameraPose& pose() const { return pose_; }

  private:
    std::string answerTo(const arcos::vcc4::Request& request);

    static constexpr double kFirstTiltLimit_deg = 30;
    arcos::vcc4::RequestReader reader_;
    CameraPose pose_;
    arcos::vcc4::PanTilt target_;
    double pan_rate_deg_s_ = arcos::vcc4::kMaximumPanRate_deg_s;
    double tilt_rate_deg_s_ = arcos::vcc4::kMaximumTiltRate_deg_s;
    double tilt_limit_deg_ = kFirstTiltLimit_deg;
    bool powered_ = false;
    bool controlled_ = false;
};

}  // namespace axon::lab
