// SPDX-License-Identifier: MIT
#pragma once
#include <cstddef>
#include <cstdint>
#include <string>

#include "common/frame.hpp"

namespace axon {

/// appendFrame() of a message of protobuf, full or lite, which is written where it is sent from instead of
/// into a string of its own.
template <class Message>
bool appendFrameOf(std::string& out, const Message& message) {
    const std::size_t size = message.ByteSizeLong();
    if (size == 0 || size > kFrameMax) return false;
    appendNumber(out, static_cast<std::uint32_t>(size));
    const auto begin = out.size();
    out.resize(begin + size);
    message.SerializeWithCachedSizesToArray(reinterpret_cast<std::uint8_t*>(out.data() + begin));
    return true;
}

}  // namespace axon
