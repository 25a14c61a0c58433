// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/lms2xx/client_session.hpp"

#include <algorithm>
#include <array>
#include <utility>

namespace axon::lms2xx {
namespace {

struct Speed {
    int baud;
    Mode mode;
};
// RS-422's 500000 is left out: no line of a computer has it.
constexpr std::array<Speed, 3> kSpeeds{
    {{38400, Mode::Baud38400}, {9600, Mode::Baud9600}, {19200, Mode::Baud19200}}};

}  // namespace

void ClientSession::begin(TimePoint now, const robots::LineSpeed& line) {
    state_ = State::Finding;
    reader_.reset();
    setting_ = {};
    line_ = line;
    if (line_.asked == 0) line_.asked = kRaisedSpeed;
    speeds_.clear();
    if (line_.baud != 0) {
        speeds_ = {line_.baud};
        for (const auto& speed : kSpeeds)
            if (speed.baud != line_.baud) speeds_.push_back(speed.baud);
    }
    searches_ = 0;
    just_raised_ = false;
    take(Step::EndOutput, now);
}

void ClientSession::end(const std::string& reason) {
    if (state_ == State::Closed) return;
    // A laser that goes on talking to nobody would have to be interrupted next time.
    if (state_ == State::Scanning) port_.send(encode(request(Mode::OutputOnRequest)));
    state_ = State::Closed;
    port_.onLost(reason);
}

void ClientSession::take(Step step, TimePoint now) {
    step_ = step;
    tries_ = 0;
    ask(now);
}

void ClientSession::ask(TimePoint now) {
    ++tries_;
    asked_ = now;
    switch (step_) {
        case Step::EndOutput:
            port_.send(encode(request(Mode::OutputOnRequest)));
            break;
        case Step::RaiseSpeed: {
            const auto* const speed =
                std::find_if(kSpeeds.begin(), kSpeeds.end(),
                             [this](const Speed& known) { return known.baud == line_.asked; });
            port_.send(encode(request(speed->mode)));
            break;
        }
        case Step::ReadConfiguration:
            port_.send(encode(request(Command::ReadConfiguration)));
            break;
        case Step::SetVariant:
            port_.send(encode(request(Variant())));
            break;
        case Step::StartOutput:
            port_.send(encode(request(Mode::ContinuousOutput)));
            break;
    }
}

void ClientSession::receive(std::span<const std::uint8_t> bytes, TimePoint now) {
    for (const auto& item : reader_.feed(bytes, now)) {
        if (state_ == State::Closed) return;
        // ACK and NAK say no more than that a request arrived: its answer, or none in time, is what counts.
        if (item.kind == TelegramReader::Item::Kind::Telegram) onTelegram(item, now);
    }
}

void ClientSession::onTelegram(const TelegramReader::Item& item, TimePoint now) {
    const auto& telegram = item.telegram;
    if (telegram.command == kMeasuredValues) {
        // Scans that waited in a buffer together arrived one after the other.
        if (state_ == State::Scanning) onScanTelegram(telegram, now, now - onTheWire(item.followed_by));
        return;
    }
    if (telegram.command == kPowerOn) {
        if (state_ == State::Finding)
            ask(now);  // now it listens
        else
            end("the laser was switched on again");
        return;
    }
    if (state_ == State::Scanning) return;
    if (telegram.command == kRefused) {
        if (step_ == Step::SetVariant)
            take(Step::StartOutput, now);
        else if (step_ == Step::RaiseSpeed)
            take(Step::ReadConfiguration, now);
        else
            end("the laser refuses to be set up; fix: switch it off and on, and wait a minute");
        return;
    }
    switch (step_) {
        case Step::EndOutput:
            if (parseModeAnswer(telegram) != true) return;
            state_ = State::Configuring;
            take(line_.baud == 0 || line_.baud == line_.asked || raise_failed_ ||
                         std::none_of(kSpeeds.begin(), kSpeeds.end(),
                                      [this](const Speed& known) { return known.baud == line_.asked; })
                     ? Step::ReadConfiguration
                     : Step::RaiseSpeed,
                 now);
            return;
        case Step::RaiseSpeed:
            if (const auto done = parseModeAnswer(telegram)) onSpeedAnswer(*done, now);
            return;
        case Step::ReadConfiguration:
            if (const auto measuring = parseMeasuring(telegram)) {
                just_raised_ = false;
                if (!measuring->distanceBits()) {
                    end("the laser is set to measuring mode " + std::to_string(measuring->mode) +
                        ", whose values are no distances; fix: set another one with the vendor's program");
                    return;
                }
                setting_.measuring = *measuring;
                take(Step::SetVariant, now);
            }
            return;
        case Step::SetVariant:
            if (const auto answer = parseVariantAnswer(telegram)) {
                setting_.variant = answer->variant;
                take(Step::StartOutput, now);
            }
            return;
        case Step::StartOutput:
            if (const auto done = parseModeAnswer(telegram)) {
                if (!*done) {
                    end("the laser refuses to send scans; fix: switch it off and on, and wait a minute");
                    return;
                }
                state_ = State::Scanning;
                last_scan_ = now;
                setting_.baud = line_.baud;
                port_.onOnline(setting_);
            }
            return;
    }
}

void ClientSession::onSpeedAnswer(bool done, TimePoint now) {
    if (done) {
        if (!port_.setSpeed(line_.asked)) {
            end("the serial line does not have " + std::to_string(line_.asked) +
                " baud; fix: put the speed that it has behind the name of the line, such as :9600");
            return;
        }
        line_.baud = line_.asked;
        just_raised_ = true;
        reader_.reset();
    }
    take(Step::ReadConfiguration, now);
}

void ClientSession::onScanTelegram(const Telegram& telegram, TimePoint now, TimePoint arrived) {
    const auto measured = parseMeasuredValues(telegram);
    const auto variant = measured ? variantOf(measured->values.size()) : std::nullopt;
    if (!variant) {
        ++dropped_scans_;
        return;
    }
    const Status status(measured->status);
    if (status.faulty()) {
        end("the laser reports a fault, severity " + std::to_string(status.severity) +
            " of 4; fix: switch it off and on; if it stays, the vendor's program tells more");
        return;
    }
    last_scan_ = now;
    Scan scan;
    scan.taken = arrived - onTheWire(telegram.data.size() + 1 + Telegram::kFraming) - kHalfASweep;
    scan.start_deg = -variant->angle_deg / 2.0;
    scan.step_deg = variant->resolution_hundredths / 100.0;
    scan.polluted = status.polluted;
    scan.ranges_mm.reserve(measured->values.size());
    for (const auto raw : measured->values)
        scan.ranges_mm.push_back(distance_mm(raw, measured->millimetres, *setting_.measuring.distanceBits()));
    port_.onScan(scan);
}

Duration ClientSession::onTheWire(std::size_t bytes) const {
    if (line_.baud == 0) return Duration::zero();
    // Start bit, eight bits, stop bit.
    return Duration(std::chrono::seconds{1}) * static_cast<int>(bytes) * 10 / line_.baud;
}

void ClientSession::tick(TimePoint now) {
    switch (state_) {
        case State::Closed:
            return;
        case State::Finding:
            if (now - asked_ >= kFindTimeout) findElsewhere(now);
            return;
        case State::Configuring:
            if (now - asked_ >= kAnswerTimeout) onNoAnswer(now);
            return;
        case State::Scanning:
            if (now - last_scan_ >= silence_limit_)
                end("no scan of the laser for " +
                    std::to_string(
                        std::chrono::duration_cast<std::chrono::milliseconds>(silence_limit_).count()) +
                    " ms");
            return;
    }
}

void ClientSession::findElsewhere(TimePoint now) {
    const auto choices = std::max<std::size_t>(1, speeds_.size());
    if (++searches_ >= kRounds * static_cast<int>(choices)) {
        end(speeds_.empty()
                ? "the laser does not answer: is it switched on? It needs up to a minute then"
                : "the laser does not answer at 9600, 19200 or 38400 baud: is it switched on (it needs up "
                  "to a minute then), and is this its line?");
        return;
    }
    if (choices > 1) {
        const int baud = speeds_[static_cast<std::size_t>(searches_) % choices];
        if (port_.setSpeed(baud)) line_.baud = baud;
        reader_.reset();
    }
    ask(now);
}

void ClientSession::onNoAnswer(TimePoint now) {
    if (tries_ < kTries) {
        ask(now);
    } else if (step_ == Step::SetVariant) {
        take(Step::StartOutput, now);
    } else if (std::exchange(just_raised_, false)) {
        raise_failed_ = true;
        end("the laser does not answer at " + std::to_string(line_.asked) +
            " baud; from now on it keeps its own speed");
    } else {
        end("the laser stopped answering while it was set up");
    }
}

}  // namespace axon::lms2xx
