// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "common/routed.hpp"
#include "direct/incoming_way.hpp"

// The frames of the data lane of a direct path (docs/reference/direct.md, "Frames of the data lane"): a
// length of 4 bytes, a byte for the kind, and the rest. Numbers are in network order. Pure; any thread.
namespace axon::direct::lane {

enum class Kind : std::uint8_t {
    // the opening (opening.hpp)
    Nonce = 1,
    Claim = 2,
    Proof = 3,
    Refusal = 4,
    // afterwards, either way
    Kept = 5,
    Droppable = 6
};

/// What a frame may hold after its length: that of a stranger, those which answer it, and those after the
/// opening. An axon.proto message may be as large as on a lane of Ice.
inline constexpr std::size_t kClaimMax = 256;
inline constexpr std::size_t kOpeningMax = 4096;
inline constexpr std::size_t kMessageMax = 4096 * 1024;
inline constexpr std::size_t kTypeMax = 255;  ///< of a msgType
inline constexpr std::size_t kFixedHead = 1 + 4 + 4 + 4 + 8 + 8 + 1;
inline constexpr std::size_t kMessageFrameMax = kFixedHead + kTypeMax + kMessageMax;

/// What goes before the content of a message: length, kind and head.
class HeadBytes {
  public:
    std::string_view view() const { return {bytes_.data(), size_}; }
    std::size_t size() const { return size_; }

  private:
    friend std::optional<HeadBytes> headOf(Keeping keeping, const Header& head, std::size_t content);
    void put(std::uint64_t value, unsigned bytes) {
        while (bytes-- > 0) bytes_[size_++] = static_cast<char>(value >> 8 * bytes & 0xFFU);
    }
    std::array<char, 4 + kFixedHead + kTypeMax> bytes_;
    std::size_t size_ = 0;
};

/// Nothing where the content or the msgType is too large. Sender and entity are the ends of the connection
/// and are not sent.
std::optional<HeadBytes> headOf(Keeping keeping, const Header& head, std::size_t content);

/// A message in a frame, whose bytes it refers to.
struct MessageView {
    Keeping keeping = Keeping::Kept;
    LeaseNumber held;
    std::int32_t stop_generation = 0;
    std::int64_t sequence = 0;
    std::int64_t sent_at_us = 0;
    std::string_view msg_type;
    std::string_view content;

    /// All but sender and entity.
    void into(Header& head) const {
        head.msg_type = msg_type;
        head.held = held;
        head.stop_generation = stop_generation;
        head.sequence = sequence;
        head.sent_at_us = sent_at_us;
    }
};

/// Nothing where the frame is no message, or not a proper one.
std::optional<MessageView> messageIn(std::string_view frame);

/// A frame of the opening; its content is at most kOpeningMax.
std::string frameOf(Kind kind, std::string_view content);

/// Reads numbers and bytes from the front; what is not there fails for good, and reads as nothing.
class Fields {
  public:
    explicit Fields(std::string_view bytes) : left_(bytes) {}

    std::uint64_t number(std::size_t bytes) {
        std::uint64_t value = 0;
        for (const char byte : take(bytes)) value = value << 8U | static_cast<unsigned char>(byte);
        return value;
    }
    std::string_view take(std::size_t bytes) {
        if (bytes > left_.size()) {
            good_ = false;
            left_ = {};
        }
        const auto taken = good_ ? left_.substr(0, bytes) : std::string_view();
        left_.remove_prefix(taken.size());
        return taken;
    }
    std::string_view rest() const { return left_; }
    bool good() const { return good_; }
    /// All was there, and nothing is left.
    bool done() const { return good_ && left_.empty(); }

  private:
    std::string_view left_;
    bool good_ = true;
};

}  // namespace axon::direct::lane
