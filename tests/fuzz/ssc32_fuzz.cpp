// SPDX-License-Identifier: GPL-2.0-or-later
// What comes over an arm's serial line, at either end: however the bytes are cut, the virtual controller
// answers the same and its servos stay where servos can be; the client's session takes anything as an answer.
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "lab/cyton/ssc32_server.hpp"
#include "robots/ssc32/client_session.hpp"

namespace {

using namespace axon;
using std::chrono::milliseconds;

void require(bool holds) {
    if (!holds) std::abort();
}

struct Ignored final : ssc32::ClientSession::Port {
    void send(const std::string& /*bytes*/) override {}
    void onOnline(const std::vector<int>& pulses_us) override { require(pulses_us.size() == 8); }
    void onPulses(const std::vector<int>& pulses_us) override { require(pulses_us.size() == 8); }
    void onStatus(bool /*moving*/) override {}
    void onLost(const std::string& /*reason*/) override {}
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* bytes, std::size_t size) {
    if (size == 0) return 0;
    const std::span<const std::uint8_t> stream(bytes + 1, size - 1);
    const std::size_t piece = 1 + bytes[0];

    lab::Ssc32Server whole, cut;
    whole.clientConnected();
    cut.clientConnected();
    const auto answers = whole.receive(stream);
    std::vector<std::uint8_t> pieces;
    Ignored ignored;
    ssc32::ClientSession client(ignored, {0, 1, 2, 3, 4, 5, 6, 7});
    TimePoint now{};
    client.begin(now);
    for (std::size_t at = 0; at < stream.size(); at += piece) {
        const auto part = stream.subspan(at, std::min(piece, stream.size() - at));
        const auto some = cut.receive(part);
        pieces.insert(pieces.end(), some.begin(), some.end());
        client.receive(part, now);
        client.tick(now);
        now += milliseconds{20};
    }
    require(answers == pieces);
    require(whole.counters().moves == cut.counters().moves &&
            whole.counters().refused_lines == cut.counters().refused_lines);
    for (int i = 0; i < 20; ++i) {
        whole.step(milliseconds{100});
        for (std::size_t channel = 0; channel < lab::Ssc32Server::kChannels; ++channel)
            require(whole.pulse_us(channel) >= 500 && whole.pulse_us(channel) <= 2500);
        for (const double target : whole.targets()) require(std::isfinite(target));
    }
    return 0;
}
