// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/camera_control.hpp"

#include <algorithm>
#include <cmath>

namespace axon::lab {

using namespace arcos::vcc4;

namespace {

double approach(double from, double to, double step) {
    return from < to ? std::min(from + step, to) : std::max(from - step, to);
}

}  // namespace

std::string CameraControl::receive(std::string_view bytes) {
    std::string answers;
    for (const auto& request : reader_.feed(bytes)) answers += answerTo(request);
    return answers;
}

std::string CameraControl::answerTo(const Request& request) {
    if (request.code == Code::Power) {
        powered_ = request.parameters == "1";
        if (!powered_) controlled_ = false;
        return answer(Error::None);
    }
    if (!powered_) return answer(Error::Mode);
    if (request.code == Code::Control) {
        controlled_ = request.parameters == "0";
        return answer(Error::None);
    }
    if (!controlled_) return answer(Error::Mode);
    const auto rate = [&](double& of, double maximum) {
        const auto units = parseNumber(request.parameters);
        if (!units || *units * kUnit_deg > maximum + 1 || *units < 8) return answer(Error::Parameter);
        of = *units * kUnit_deg;
        return answer(Error::None);
    };
    switch (request.code) {
        case Code::Initialise:
            target_ = {};
            return answer(Error::None);
        case Code::SetRange:
            if (request.parameters.size() != 9) return answer(Error::Parameter);
            tilt_limit_deg_ = kMaximumTilt_deg;
            return answer(Error::None);
        case Code::PanTilt: {
            const auto to = parsePanTilt(request.parameters);
            if (!to || to->tilt_up_deg > tilt_limit_deg_ + kUnit_deg) return answer(Error::Parameter);
            target_ = *to;
            return answer(Error::None);
        }
        case Code::PanTiltRequest:
            return answerPanTilt(pose_.looks);
        case Code::Stop:
            target_ = pose_.looks;
            return answer(Error::None);
        case Code::PanRate:
            return rate(pan_rate_deg_s_, kMaximumPanRate_deg_s);
        case Code::TiltRate:
            return rate(tilt_rate_deg_s_, kMaximumTiltRate_deg_s);
        case Code::Zoom: {
            const auto to = parseNumber(request.parameters);
            if (!to || *to > kMaximumZoom) return answer(Error::Parameter);
            pose_.zoom = *to;
            return answer(Error::None);
        }
        case Code::ZoomRequest:
            return answerZoom(pose_.zoom);
        default:
            return answer(Error::Parameter);
    }
}

CameraPose CameraControl::step(Duration period) {
    const double seconds = std::chrono::duration<double>(period).count();
    auto& at = pose_.looks;
    at.pan_left_deg = approach(at.pan_left_deg, target_.pan_left_deg, pan_rate_deg_s_ * seconds);
    at.tilt_up_deg = approach(at.tilt_up_deg, target_.tilt_up_deg, tilt_rate_deg_s_ * seconds);
    return pose_;
}

}  // namespace axon::lab
