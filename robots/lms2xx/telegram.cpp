// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/lms2xx/telegram.hpp"

#include <cassert>

namespace axon::lms2xx {
namespace {

constexpr std::uint8_t kStx = 0x02;
constexpr std::size_t kHeader = 4;
constexpr std::size_t kCrc = 2;

std::uint16_t wordAt(const Bytes& bytes, std::size_t at) {
    return static_cast<std::uint16_t>(bytes[at] | bytes[at + 1] << 8U);
}

}  // namespace

std::uint16_t crc16(std::span<const std::uint8_t> bytes) {
    constexpr unsigned kPolynomial = 0x8005;
    unsigned crc = 0;
    unsigned before = 0;
    for (const auto byte : bytes) {
        const bool carry = (crc & 0x8000U) != 0;
        crc = crc << 1U & 0xFFFFU;
        if (carry) crc ^= kPolynomial;
        crc ^= before << 8U | byte;
        before = byte;
    }
    return static_cast<std::uint16_t>(crc);
}

Bytes encode(const Telegram& telegram) {
    assert(telegram.data.size() < Telegram::kMaximumLength);
    const std::size_t length = telegram.data.size() + 1;
    Bytes bytes{kStx, telegram.address, static_cast<std::uint8_t>(length & 0xFFU),
                static_cast<std::uint8_t>(length >> 8U), telegram.command};
    bytes.insert(bytes.end(), telegram.data.begin(), telegram.data.end());
    const auto crc = crc16(bytes);
    bytes.push_back(static_cast<std::uint8_t>(crc & 0xFFU));
    bytes.push_back(static_cast<std::uint8_t>(crc >> 8U));
    return bytes;
}

std::vector<TelegramReader::Item> TelegramReader::feed(std::span<const std::uint8_t> bytes, TimePoint now) {
    std::vector<Item> found;
    if (bytes.empty()) return found;
    if (!buffer_.empty() && now - last_feed_ >= kPartialTimeout) {
        // What was taken for a telegram's beginning was none; something good may stand behind it.
        while (!buffer_.empty()) {
            ++noise_bytes_;
            buffer_.erase(buffer_.begin());
            find(found);
        }
    }
    last_feed_ = now;
    buffer_.insert(buffer_.end(), bytes.begin(), bytes.end());
    find(found);
    return found;
}

/// Takes from the buffer whatever is complete, until it is empty or begins with what may become a telegram.
void TelegramReader::find(std::vector<Item>& found) {
    std::size_t at = 0;
    const auto skip = [&] {
        ++at;
        ++noise_bytes_;
    };
    while (at < buffer_.size()) {
        const std::size_t rest = buffer_.size() - at;
        const auto first = buffer_[at];
        if (from_ == From::Laser && (first == kAck || first == kNak)) {
            found.push_back({first == kAck ? Item::Kind::Ack : Item::Kind::Nak, {}});
            ++at;
            continue;
        }
        if (first != kStx) {
            skip();
            continue;
        }
        if (rest < 2) break;
        const bool of_laser = (buffer_[at + 1] & Telegram::kFromLaser) != 0;
        if (of_laser != (from_ == From::Laser)) {
            skip();
            continue;
        }
        if (rest < kHeader) break;
        const std::size_t length = wordAt(buffer_, at + 2);
        if (length == 0 || length > Telegram::kMaximumLength) {
            skip();
            continue;
        }
        const std::size_t whole = kHeader + length + kCrc;
        if (rest < whole) break;
        if (crc16(std::span(buffer_).subspan(at, whole - kCrc)) != wordAt(buffer_, at + whole - kCrc)) {
            ++bad_crcs_;
            skip();
            continue;
        }
        const auto begin = buffer_.begin() + static_cast<std::ptrdiff_t>(at + kHeader);
        found.push_back(
            {Item::Kind::Telegram,
             {buffer_[at + 1], *begin, Bytes(begin + 1, begin + static_cast<std::ptrdiff_t>(length))},
             rest - whole});
        at += whole;
    }
    buffer_.erase(buffer_.begin(), buffer_.begin() + static_cast<std::ptrdiff_t>(at));
}

}  // namespace axon::lms2xx
