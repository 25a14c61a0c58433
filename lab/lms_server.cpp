// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/lms_server.hpp"

#include <utility>

#include "robots/arcos/laser.hpp"

namespace axon::lab {
namespace {

using lms2xx::Bytes;
using lms2xx::Command;
using lms2xx::Mode;
using lms2xx::Telegram;

void append(Bytes& to, const Bytes& bytes) {
    to.insert(to.end(), bytes.begin(), bytes.end());
}

}  // namespace

Bytes LmsServer::receive(std::span<const std::uint8_t> bytes, TimePoint now) {
    Bytes answers;
    const auto damaged = reader_.badCrcs();
    for (const auto& item : reader_.feed(bytes, now)) {
        ++counters_.requests;
        answers.push_back(lms2xx::kAck);
        if (const auto said = answer(item.telegram)) append(answers, lms2xx::encode(*said));
    }
    if (reader_.badCrcs() != damaged) answers.push_back(lms2xx::kNak);
    return answers;
}

std::optional<Telegram> LmsServer::answer(const Telegram& request) {
    switch (static_cast<Command>(request.command)) {
        case Command::Mode:
            if (request.data.size() != 1) break;
            return lms2xx::modeAnswer(changeMode(request.data[0]));
        case Command::Variant:
            for (const std::size_t values : {181, 361, 101, 201, 401}) {
                const auto variant = *lms2xx::variantOf(values);
                if (request != lms2xx::request(variant)) continue;
                variant_ = variant;
                return lms2xx::toAnswer(lms2xx::VariantAnswer{true, variant_});
            }
            return lms2xx::toAnswer(lms2xx::VariantAnswer{false, variant_});
        case Command::ReadConfiguration:
            if (!request.data.empty()) break;
            return lms2xx::toAnswer(measuring_);
        case Command::Measure:
            if (request.data != Bytes{1}) break;
            one_wanted_ = true;
            return std::nullopt;  // the scan is the answer
        case Command::Status:
            break;
    }
    ++counters_.refused;
    return Telegram{Telegram::kFromLaser, lms2xx::kRefused, {lms2xx::kGood}};
}

bool LmsServer::changeMode(std::uint8_t mode) {
    switch (static_cast<Mode>(mode)) {
        case Mode::ContinuousOutput:
            continuous_ = true;
            return true;
        case Mode::OutputOnRequest:
            continuous_ = false;
            travelling_.clear();
            return true;
        case Mode::Baud38400:
            baud_ = 38400;
            return true;
        case Mode::Baud19200:
            baud_ = 19200;
            return true;
        case Mode::Baud9600:
            baud_ = 9600;
            return true;
        case Mode::Baud500000:
            break;  // this line has no RS-422
    }
    return false;
}

LaserSettings LmsServer::scanning() const {
    return {.on = continuous_ || one_wanted_,
            .start_deg = -variant_.angle_deg / 2.0,
            .end_deg = variant_.angle_deg / 2.0,
            .resolution_deg = variant_.resolution_hundredths / 100.0};
}

Bytes LmsServer::step(Duration period, const BodyReadings& readings) {
    Bytes arrived;
    if (!travelling_.empty()) {
        arrives_in_ -= period;
        if (arrives_in_ <= Duration::zero()) arrived = std::exchange(travelling_, {});
    }
    const bool wanted = continuous_ || one_wanted_;
    // As it was asked for: after a change of variant the next scan may still be an old one.
    const bool fits = readings.laser_mm.size() == static_cast<std::size_t>(variant_.values());
    if (!wanted || !readings.laser_scanned || !fits || !travelling_.empty()) return arrived;
    one_wanted_ = false;
    ++counters_.scans;
    auto bytes = lms2xx::encode(scanOf(readings));
    if (!serial_line_) {
        append(arrived, bytes);
        return arrived;
    }
    // Start bit, eight bits, stop bit.
    arrives_in_ = Duration(std::chrono::seconds{1}) * static_cast<int>(bytes.size()) * 10 / baud_;
    travelling_ = std::move(bytes);
    return arrived;
}

Telegram LmsServer::scanOf(const BodyReadings& readings) const {
    const unsigned most = (1U << static_cast<unsigned>(measuring_.distanceBits().value_or(13))) - 1;
    lms2xx::MeasuredValues scan{.millimetres = measuring_.millimetres, .values = {}, .status = lms2xx::kGood};
    scan.values.reserve(readings.laser_mm.size());
    for (const auto range_mm : readings.laser_mm) {
        const unsigned value = measuring_.millimetres ? range_mm : (range_mm + 5U) / 10;
        const bool none = range_mm >= arcos::LaserPacket::kNothing_mm || value > most;
        scan.values.push_back(static_cast<std::uint16_t>(none ? most : value));
    }
    return lms2xx::toAnswer(scan);
}

}  // namespace axon::lab
