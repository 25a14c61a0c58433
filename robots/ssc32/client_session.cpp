// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/ssc32/client_session.hpp"

#include <utility>

#include "robots/ssc32/protocol.hpp"

namespace axon::ssc32 {

ClientSession::ClientSession(Port& port, std::vector<std::size_t> channels, Duration silence_limit)
    : port_(port), channels_(std::move(channels)), silence_limit_(silence_limit) {}

void ClientSession::begin(TimePoint now) {
    state_ = State::Probing;
    began_ = heard_ = now;
    pulses_us_.clear();
    pulses_wanted_ = false;
    // Ends what somebody before us, or noise, may have left unfinished: it must not become one line with
    // ours.
    port_.send("\r");
    ask(Query::Status, now);
}

void ClientSession::ask(Query query, TimePoint now) {
    under_way_ = query;
    asked_ = now;
    port_.send(query == Query::Status ? encodeQuery() : encodePulseQuery(channels_[pulses_us_.size()]));
}

void ClientSession::receive(std::span<const std::uint8_t> bytes, TimePoint now) {
    for (const auto byte : bytes) {
        if (state_ == State::Closed) return;
        if (under_way_ == Query::Pulse) {
            onPulse(byte, now);
        } else if (under_way_ == Query::Status && (byte == '.' || byte == '+')) {
            under_way_.reset();
            heard_ = now;
            if (state_ == State::Online)
                port_.onStatus(byte == '+');
            else if (byte == '.')
                ask(Query::Pulse, now);
            else
                began_ = now;  // somebody's last move: pulses are not known before it is over
        } else {
            ++unexpected_bytes_;
        }
    }
}

void ClientSession::onPulse(std::uint8_t byte, TimePoint now) {
    under_way_.reset();
    heard_ = now;
    pulses_us_.push_back(byte * kPulseStep_us);
    if (pulses_us_.size() < channels_.size()) {
        ask(Query::Pulse, now);
        return;
    }
    const auto pulses = std::exchange(pulses_us_, {});
    if (state_ == State::Probing) {
        state_ = State::Online;
        port_.onOnline(pulses);
    } else {
        port_.onPulses(pulses);
    }
}

void ClientSession::tick(TimePoint now) {
    if (state_ == State::Closed) return;
    if (state_ == State::Probing && now - began_ >= kProbeLimit) {
        end("nobody answers there as an SSC-32 does: is the controller switched on, is the speed of the line "
            "right?");
        return;
    }
    if (state_ == State::Online && now - heard_ >= silence_limit_) {
        end("the controller has not answered for " +
            std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(now - heard_).count()) +
            " ms");
        return;
    }
    if (under_way_) return;
    if (state_ == State::Online && pulses_wanted_) {
        pulses_wanted_ = false;
        ask(Query::Pulse, now);
    } else if (now - asked_ >= kQueryPeriod) {
        ask(Query::Status, now);
    }
}

void ClientSession::end(const std::string& reason) {
    if (state_ == State::Closed) return;
    state_ = State::Closed;
    under_way_.reset();
    port_.onLost(reason);
}

}  // namespace axon::ssc32
