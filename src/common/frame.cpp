// SPDX-License-Identifier: MIT
#include "common/frame.hpp"

#include <algorithm>
#include <cstdint>
#include <cstring>

namespace axon {
namespace {
constexpr std::size_t kLength = 4;
constexpr std::size_t kKeep = 2 * FrameReader::kReadMax;  // a buffer that one large frame has grown is given
                                                          // back
}  // namespace

void appendNumber(std::string& out, std::uint32_t number) {
    for (const unsigned shift : {24U, 16U, 8U, 0U})
        out.push_back(static_cast<char>((number >> shift) & 0xFFU));
}

bool appendFrame(std::string& out, std::string_view payload) {
    if (payload.empty() || payload.size() > kFrameMax) return false;
    appendNumber(out, static_cast<std::uint32_t>(payload.size()));
    out.append(payload);
    return true;
}

/// Of the frame that begins at begin_, whose length has come.
std::size_t FrameReader::announced() const {
    std::size_t length = 0;
    for (std::size_t i = 0; i < kLength; ++i)
        length = length << 8U | static_cast<unsigned char>(buffer_[begin_ + i]);
    return length;
}

void FrameReader::makeRoom(std::size_t count) {
    if (capacity_ - end_ >= count) return;
    const auto left = held();
    if (capacity_ - left >= count) {
        // Here, not for each frame, which keeps a burst of small frames linear.
        if (left > 0) std::memmove(buffer_.get(), buffer_.get() + begin_, left);
    } else {
        const auto grown = std::max(left + count, std::min(2 * capacity_, capacity_ + kReadMax));
        auto larger = std::make_unique_for_overwrite<char[]>(grown);
        if (left > 0) std::memcpy(larger.get(), buffer_.get() + begin_, left);
        buffer_ = std::move(larger);
        capacity_ = grown;
    }
    begin_ = 0;
    end_ = left;
}

void FrameReader::drop() {
    buffer_ = nullptr;
    capacity_ = begin_ = end_ = 0;
}

void FrameReader::feed(std::string_view bytes) {
    if (failed_ || bytes.empty()) return;
    makeRoom(bytes.size());
    std::memcpy(buffer_.get() + end_, bytes.data(), bytes.size());
    end_ += bytes.size();
}

std::span<char> FrameReader::room() {
    auto wanted = read_;
    if (held() >= kLength) {
        const auto length = announced();
        if (length <= limit_ && kLength + length > held())
            wanted = std::max(wanted, kLength + length - held());
    }
    makeRoom(wanted);
    return {buffer_.get() + end_, capacity_ - end_};
}

void FrameReader::filled(std::size_t count) {
    if (count == capacity_ - end_) read_ = std::min(2 * read_, kReadMax);
    end_ += count;
    if (failed_) drop();
}

std::optional<std::string_view> FrameReader::nextView() {
    if (begin_ == end_) {
        begin_ = end_ = 0;
        if (capacity_ > kKeep) drop();
    }
    if (failed_ || held() < kLength) return std::nullopt;
    const auto length = announced();
    if (length == 0 || length > limit_) {
        failed_ = true;
        error_ =
            "a frame announces " + std::to_string(length) + " bytes: expected 1 to " + std::to_string(limit_);
        drop();
        return std::nullopt;
    }
    if (held() < kLength + length) return std::nullopt;
    const std::string_view payload(buffer_.get() + begin_ + kLength, length);
    begin_ += kLength + length;
    return payload;
}

bool FrameReader::next(std::string& payload) {
    const auto view = nextView();
    if (!view) return false;
    payload.assign(*view);
    return true;
}

}  // namespace axon
