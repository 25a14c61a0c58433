// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/cyton/ssc32_server.hpp"

#include <algorithm>
#include <cmath>
#include <optional>

namespace axon::lab {
namespace {

constexpr std::uint8_t kEscape = 27;
constexpr int kLeastPulse_us = 500;
constexpr int kMostPulse_us = 2500;
constexpr int kLargestNumber = 65535;

}  // namespace

/// A line without blanks, in capitals, read from the left.
struct Ssc32Server::Line {
    std::string_view rest;

    bool take(std::string_view word) {
        if (!rest.starts_with(word)) return false;
        rest.remove_prefix(word.size());
        return true;
    }
    std::optional<int> number() {
        int value = 0;
        std::size_t digits = 0;
        for (; digits < rest.size() && rest[digits] >= '0' && rest[digits] <= '9'; ++digits) {
            value = value * 10 + (rest[digits] - '0');
            if (value > kLargestNumber) return std::nullopt;
        }
        if (digits == 0) return std::nullopt;
        rest.remove_prefix(digits);
        return value;
    }
    std::optional<std::size_t> channel() {
        const auto value = number();
        if (!value || *value >= static_cast<int>(kChannels)) return std::nullopt;
        return static_cast<std::size_t>(*value);
    }
};

Ssc32Server::Ssc32Server() {
    for (std::size_t i = 0; i < cyton::kServos.size(); ++i) {
        auto& channel = channels_[i];
        channel.pulse_us = channel.servo_us = channel.from_us = channel.to_us = cyton::kServos[i].home_us;
    }
}

std::vector<std::uint8_t> Ssc32Server::receive(std::span<const std::uint8_t> bytes) {
    std::vector<std::uint8_t> answers;
    for (const auto byte : bytes) {
        if (byte == kEscape) {
            cancel();
        } else if (byte == '\r') {
            if (too_long_)
                ++counters_.refused_lines;
            else if (!line_.empty())
                onLine(line_, answers);
            line_.clear();
            too_long_ = false;
        } else if (byte == ' ' || byte == '\t' || byte == '\n') {
            continue;
        } else if (line_.size() >= kLongestLine) {
            too_long_ = true;
        } else {
            line_ += static_cast<char>(byte >= 'a' && byte <= 'z' ? byte - 'a' + 'A' : byte);
        }
    }
    return answers;
}

void Ssc32Server::clientConnected() {
    line_.clear();
    too_long_ = false;
}

void Ssc32Server::onLine(std::string_view text, std::vector<std::uint8_t>& answers) {
    Line line{text};
    if (text.starts_with('#')) {
        if (move(line)) {
            ++counters_.moves;
            return;
        }
    } else if (text.starts_with("STOP")) {
        if (stopChannel(line)) return;
    } else if (query(line, answers)) {
        ++counters_.queries;
        return;
    }
    ++counters_.refused_lines;
}

bool Ssc32Server::move(Line& line) {
    struct Wish {
        std::size_t channel;
        double pulse_us;
        double speed = 0;  // none
    };
    std::vector<Wish> wishes;
    double lasts_s = 0;
    std::uint64_t clamped = 0;
    while (line.take("#")) {
        const auto channel = line.channel();
        if (!channel || !line.take("P")) return false;
        const auto asked = line.number();
        if (!asked) return false;
        const bool fitted = *channel < cyton::kServos.size();
        const int pulse = std::clamp(*asked, fitted ? cyton::kServos[*channel].least_us : kLeastPulse_us,
                                     fitted ? cyton::kServos[*channel].most_us : kMostPulse_us);
        clamped += pulse != *asked ? 1 : 0;
        Wish wish{*channel, static_cast<double>(pulse)};
        if (line.take("S")) {
            const auto speed = line.number();
            if (!speed || *speed == 0) return false;
            wish.speed = *speed;
        }
        wishes.push_back(wish);
    }
    if (line.take("T")) {
        const auto time_ms = line.number();
        if (!time_ms) return false;
        lasts_s = *time_ms / 1000.0;
    }
    if (!line.rest.empty()) return false;
    for (const auto& wish : wishes) {
        if (wish.speed == 0) continue;
        lasts_s = std::max(lasts_s, std::abs(wish.pulse_us - channels_[wish.channel].pulse_us) / wish.speed);
    }
    counters_.clamped_pulses += clamped;
    for (const auto& wish : wishes) {
        auto& channel = channels_[wish.channel];
        channel.from_us = channel.pulse_us;
        channel.to_us = wish.pulse_us;
        channel.gone = Duration::zero();
        channel.lasts = Duration(std::llround(lasts_s * 1e9));
        if (channel.lasts == Duration::zero()) channel.pulse_us = channel.to_us;
    }
    return true;
}

bool Ssc32Server::query(Line& line, std::vector<std::uint8_t>& answers) {
    if (line.rest == "VER") {
        for (const char c : std::string_view("SSC32-V2.01XE\r"))
            answers.push_back(static_cast<std::uint8_t>(c));
        return true;
    }
    if (line.rest == "Q") {
        answers.push_back(moving() ? '+' : '.');
        return true;
    }
    std::vector<std::uint8_t> pulses;
    while (line.take("QP")) {
        const auto channel = line.channel();
        if (!channel) return false;
        pulses.push_back(static_cast<std::uint8_t>(std::floor(channels_[*channel].pulse_us / 10)));
    }
    if (pulses.empty() || !line.rest.empty()) return false;
    answers.insert(answers.end(), pulses.begin(), pulses.end());
    return true;
}

bool Ssc32Server::stopChannel(Line& line) {
    line.take("STOP");
    const auto channel = line.channel();
    if (!channel || !line.rest.empty()) return false;
    channels_[*channel].lasts = Duration::zero();
    return true;
}

void Ssc32Server::cancel() {
    line_.clear();
    too_long_ = false;
    for (auto& channel : channels_) channel.lasts = Duration::zero();
}

void Ssc32Server::step(Duration period) {
    for (std::size_t i = 0; i < channels_.size(); ++i) {
        auto& channel = channels_[i];
        if (channel.lasts > Duration::zero()) {
            channel.gone += period;
            if (channel.gone >= channel.lasts) {
                channel.pulse_us = channel.to_us;
                channel.lasts = Duration::zero();
            } else {
                channel.pulse_us = channel.from_us + (channel.to_us - channel.from_us) *
                                                         static_cast<double>(channel.gone.count()) /
                                                         static_cast<double>(channel.lasts.count());
            }
        }
        if (i >= cyton::kServos.size() || channel.stuck) continue;
        const double reach =
            cyton::kServos[i].fastest_us_per_s * std::chrono::duration<double>(period).count();
        channel.servo_us += std::clamp(channel.pulse_us - channel.servo_us, -reach, reach);
    }
}

std::array<double, cyton::kChannels> Ssc32Server::targets() const {
    std::array<double, cyton::kChannels> targets{};
    for (std::size_t i = 0; i < targets.size(); ++i)
        targets[i] = cyton::kServos[i].value(channels_[i].servo_us);
    return targets;
}

bool Ssc32Server::moving() const {
    return std::any_of(channels_.begin(), channels_.end(),
                       [](const Channel& channel) { return channel.lasts > Duration::zero(); });
}

}  // namespace axon::lab
