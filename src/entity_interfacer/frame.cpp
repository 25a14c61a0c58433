// SPDX-License-Identifier: MIT
#include "entity_interfacer/frame.hpp"

#include <cstdint>

namespace axon {
namespace {
constexpr std::size_t kLength = 4;
constexpr std::size_t kKeep = 64 * 1024;  // buffers that one large frame has grown are given back
}  // namespace

bool appendFrame(std::string& out, std::string_view payload) {
    if (payload.empty() || payload.size() > kFrameMax) return false;
    const auto length = static_cast<std::uint32_t>(payload.size());
    for (const unsigned shift : {24U, 16U, 8U, 0U})
        out.push_back(static_cast<char>((length >> shift) & 0xFFU));
    out.append(payload);
    return true;
}

void FrameReader::feed(std::string_view bytes) {
    if (!failed_) buffer_.append(bytes);
}

bool FrameReader::next(std::string& payload) {
    if (failed_ || buffer_.size() - begin_ < kLength) return false;
    std::size_t length = 0;
    for (std::size_t i = 0; i < kLength; ++i)
        length = length << 8U | static_cast<unsigned char>(buffer_[begin_ + i]);
    if (length == 0 || length > limit_) {
        failed_ = true;
        error_ =
            "a frame announces " + std::to_string(length) + " bytes: expected 1 to " + std::to_string(limit_);
        buffer_ = {};
        begin_ = 0;
        return false;
    }
    if (buffer_.size() - begin_ < kLength + length) {
        // Moving the rest to the front here, not per frame, keeps a burst of small frames linear.
        buffer_.erase(0, begin_);
        begin_ = 0;
        return false;
    }
    payload.assign(buffer_, begin_ + kLength, length);
    begin_ += kLength + length;
    if (begin_ == buffer_.size()) {
        begin_ = 0;
        if (buffer_.capacity() > kKeep)
            buffer_ = {};
        else
            buffer_.clear();
    }
    return true;
}

}  // namespace axon
