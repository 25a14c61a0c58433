// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/vcc4.hpp"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <cstdio>

namespace axon::arcos::vcc4 {
namespace {

constexpr char kHeader = '\xFF';
constexpr char kResponse = '\xFE';
constexpr char kFooter = '\xEF';
constexpr int kZero = 0x8000;  // of angles
constexpr std::size_t kLongestRequest = 32;

std::string request(Code code, std::string_view parameters) {
    std::string text{kHeader, '0', '0', '\0', static_cast<char>(code)};
    text += parameters;
    return text + kFooter;
}

std::string hex(int value, int digits) {
    std::array<char, 16> text{};
    std::snprintf(text.data(), text.size(), "%0*X", digits, static_cast<unsigned>(value));
    return text.data();
}

std::string angle(double degrees) {
    return hex(kZero + static_cast<int>(std::lround(degrees / kUnit_deg)), 4);
}

std::string onWire(const PanTilt& to) {
    return angle(-std::clamp(to.pan_left_deg, -kMaximumPan_deg, kMaximumPan_deg)) +
           angle(std::clamp(to.tilt_up_deg, kMinimumTilt_deg, kMaximumTilt_deg));
}

std::string rate(Code code, double deg_s, double maximum) {
    return request(code, hex(static_cast<int>(std::lround(std::clamp(deg_s, 1.0, maximum) / kUnit_deg)), 3));
}

}  // namespace

std::string power(bool on) {
    return request(Code::Power, on ? "1" : "0");
}
std::string control() {
    return request(Code::Control, "0");
}
std::string initialise() {
    return request(Code::Initialise, "0");
}
std::string panTilt(const PanTilt& to) {
    return request(Code::PanTilt, onWire(to));
}
std::string panRate(double deg_s) {
    return rate(Code::PanRate, deg_s, kMaximumPanRate_deg_s);
}
std::string tiltRate(double deg_s) {
    return rate(Code::TiltRate, deg_s, kMaximumTiltRate_deg_s);
}
std::string fullTiltRange() {
    return request(Code::SetRange, "1" + angle(kMinimumTilt_deg) + angle(kMaximumTilt_deg));
}
std::string zoom(int position) {
    return request(Code::Zoom, hex(std::clamp(position, 0, kMaximumZoom), 4));
}
std::string stop() {
    return request(Code::Stop, "0");
}
std::string requestPanTilt() {
    return request(Code::PanTiltRequest, "");
}

std::optional<int> parseNumber(std::string_view text) {
    int value = 0;
    if (text.empty() || text.size() > 4) return std::nullopt;
    const auto parsed = std::from_chars(text.data(), text.data() + text.size(), value, 16);
    if (parsed.ec != std::errc{} || parsed.ptr != text.data() + text.size() || value < 0) return std::nullopt;
    return value;
}

std::optional<PanTilt> parsePanTilt(std::string_view text) {
    if (text.size() != 8) return std::nullopt;
    const auto pan = parseNumber(text.substr(0, 4));
    const auto tilt = parseNumber(text.substr(4));
    if (!pan || !tilt) return std::nullopt;
    const PanTilt to{-(*pan - kZero) * kUnit_deg, (*tilt - kZero) * kUnit_deg};
    constexpr double kSlack = kUnit_deg;  // limits are no multiples of the unit
    if (std::abs(to.pan_left_deg) > kMaximumPan_deg + kSlack || to.tilt_up_deg < kMinimumTilt_deg - kSlack ||
        to.tilt_up_deg > kMaximumTilt_deg + kSlack) {
        return std::nullopt;
    }
    return to;
}

std::string answer(Error error) {
    return {kResponse, '0', '0', static_cast<char>(error), '0', kFooter};
}

std::string answerPanTilt(const PanTilt& at) {
    return std::string{kResponse, '0', '0', '0', '0'} + onWire(at) + kFooter;
}

std::string answerZoom(int position) {
    return std::string{kResponse, '0', '0', '0', '0'} + hex(position, 4) + kFooter;
}

std::optional<PanTilt> parsePanTiltAnswer(std::string_view text) {
    if (text.size() != 14 || text.front() != kResponse || text.back() != kFooter || text[3] != '0')
        return std::nullopt;
    return parsePanTilt(text.substr(5, 8));
}

std::vector<Request> RequestReader::feed(std::string_view bytes) {
    std::vector<Request> requests;
    for (const char byte : bytes) {
        if (byte == kHeader) {
            buffer_ = byte;
            continue;
        }
        if (buffer_.empty()) continue;
        buffer_ += byte;
        if (byte == kFooter) {
            if (buffer_.size() >= 6 && buffer_.compare(1, 2, "00") == 0) {
                requests.push_back({static_cast<Code>(static_cast<std::uint8_t>(buffer_[4])),
                                    buffer_.substr(5, buffer_.size() - 6)});
            }
            buffer_.clear();
        } else if (buffer_.size() >= kLongestRequest) {
            buffer_.clear();
        }
    }
    return requests;
}

double viewAt(int zoom) {
    const double part = std::clamp(zoom, 0, kMaximumZoom) / static_cast<double>(kMaximumZoom);
    return kWideView_deg * std::pow(kTeleView_deg / kWideView_deg, part);
}

}  // namespace axon::arcos::vcc4
