// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/ssc32/protocol.hpp"

#include <algorithm>

namespace axon::ssc32 {

std::string encodeMove(std::span<const ServoMove> moves) {
    std::string line;
    for (const auto& move : moves)
        line +=
            '#' + std::to_string(move.channel) + 'P' + std::to_string(std::clamp(move.pulse_us, 500, 2500));
    return line + '\r';
}

std::string encodeMove(std::span<const ServoMove> moves, Duration time) {
    auto line = encodeMove(moves);
    line.pop_back();
    const auto ms = std::chrono::duration_cast<std::chrono::milliseconds>(time).count();
    return line + 'T' + std::to_string(std::clamp<long long>(ms, 1, 65535)) + '\r';
}

std::string encodeQuery() {
    return "Q\r";
}

std::string encodePulseQuery(std::size_t channel) {
    return "QP" + std::to_string(channel) + '\r';
}

}  // namespace axon::ssc32
