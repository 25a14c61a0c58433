// SPDX-License-Identifier: MIT
#include "common/ids.hpp"

#include <sys/random.h>

#include <cerrno>
#include <cstring>
#include <system_error>

namespace axon {

void SystemRandom::fill(void* bytes, std::size_t count) {
    auto* at = static_cast<char*>(bytes);
    while (count > 0) {
        const auto got = ::getrandom(at, count, 0);
        if (got < 0) {
            if (errno == EINTR) continue;
            throw std::system_error(errno, std::generic_category(), "getrandom");
        }
        at += got;
        count -= static_cast<std::size_t>(got);
    }
}

std::uint64_t SeededRandom::next() {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15U);
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9U;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebU;
    return z ^ (z >> 31);
}

void SeededRandom::fill(void* bytes, std::size_t count) {
    auto* at = static_cast<char*>(bytes);
    while (count > 0) {
        const std::uint64_t word = next();
        const std::size_t part = count < sizeof word ? count : sizeof word;
        std::memcpy(at, &word, part);
        at += part;
        count -= part;
    }
}

Id128 Id128::random(RandomSource& source) {
    Id128 id;
    source.fill(id.value_.data(), id.value_.size());
    return id;
}

Id128 Id128::uuid(RandomSource& source) {
    Id128 id = random(source);
    id.value_[6] = static_cast<std::uint8_t>((id.value_[6] & 0x0fU) | 0x40U);
    id.value_[8] = static_cast<std::uint8_t>((id.value_[8] & 0x3fU) | 0x80U);
    return id;
}

std::optional<Id128> Id128::fromBytes(std::string_view bytes) {
    Id128 id;
    if (bytes.size() != id.value_.size()) return std::nullopt;
    std::memcpy(id.value_.data(), bytes.data(), bytes.size());
    return id;
}

namespace {
int hexDigit(char c) {
    if (c >= '0' && c <= '9') return c - '0';
    if (c >= 'a' && c <= 'f') return c - 'a' + 10;
    if (c >= 'A' && c <= 'F') return c - 'A' + 10;
    return -1;
}
bool dashBefore(std::size_t byte) {
    return byte == 4 || byte == 6 || byte == 8 || byte == 10;
}
}  // namespace

std::optional<Id128> Id128::parse(std::string_view text) {
    if (text.size() != 36) return std::nullopt;
    Id128 id;
    std::size_t at = 0;
    for (std::size_t byte = 0; byte < id.value_.size(); ++byte) {
        if (dashBefore(byte) && text[at++] != '-') return std::nullopt;
        const int high = hexDigit(text[at++]);
        const int low = hexDigit(text[at++]);
        if (high < 0 || low < 0) return std::nullopt;
        id.value_[byte] = static_cast<std::uint8_t>(high * 16 + low);
    }
    return id;
}

std::string Id128::toString() const {
    static constexpr char kDigits[] = "0123456789abcdef";
    std::string text;
    text.reserve(36);
    for (std::size_t byte = 0; byte < value_.size(); ++byte) {
        if (dashBefore(byte)) text += '-';
        text += kDigits[value_[byte] >> 4U];
        text += kDigits[value_[byte] & 0x0fU];
    }
    return text;
}

}  // namespace axon
