// SPDX-License-Identifier: MIT
#include "common/utf8.hpp"

#include <cstdint>
#include <cstring>

namespace axon {
namespace {

constexpr std::string_view kReplacement = "\xEF\xBF\xBD";

unsigned at(std::string_view text, std::size_t i) {
    return i < text.size() ? static_cast<unsigned char>(text[i]) : 0U;
}

bool continues(unsigned byte) {
    return (byte & 0xC0U) == 0x80U;
}

struct Sequence {
    std::size_t length;  // of what is whole, or of what is to be replaced as one
    bool valid;
};

/// Of the character that begins at `i`; neither overlong forms nor surrogates nor beyond U+10FFFF.
Sequence sequenceAt(std::string_view text, std::size_t i) {
    const auto first = at(text, i);
    if (first < 0x80U) return {1, true};
    if (first < 0xC2U || first > 0xF4U) return {1, false};
    const std::size_t whole = first < 0xE0U ? 2 : first < 0xF0U ? 3 : 4;
    const auto second = at(text, i + 1);
    const unsigned low = first == 0xE0U ? 0xA0U : first == 0xF0U ? 0x90U : 0x80U;
    const unsigned high = first == 0xEDU ? 0x9FU : first == 0xF4U ? 0x8FU : 0xBFU;
    if (second < low || second > high) return {1, false};
    std::size_t length = 2;
    while (length < whole && continues(at(text, i + length))) ++length;
    return {length, length == whole};
}

/// Where the first byte at or behind `i` is that is not ASCII, or up to seven bytes before it.
std::size_t skipAscii(std::string_view text, std::size_t i) {
    constexpr std::uint64_t kHighBits = 0x8080808080808080U;
    for (std::uint64_t word = 0; i + sizeof(word) <= text.size(); i += sizeof(word)) {
        std::memcpy(&word, text.data() + i, sizeof(word));
        if ((word & kHighBits) != 0) break;
    }
    return i;
}

/// Where the first sequence at or behind `i` is that is not UTF-8; the size of the text when there is none.
std::size_t firstBroken(std::string_view text, std::size_t i) {
    for (i = skipAscii(text, i); i < text.size(); i = skipAscii(text, i)) {
        const auto sequence = sequenceAt(text, i);
        if (!sequence.valid) break;
        i += sequence.length;
    }
    return i;
}

}  // namespace

bool isUtf8(std::string_view text) {
    return firstBroken(text, 0) == text.size();
}

std::size_t utf8Length(std::string_view text) {
    if (text.empty()) return 0;
    const auto sequence = sequenceAt(text, 0);
    return sequence.valid ? sequence.length : 0;
}

std::string validUtf8(std::string_view text) {
    std::string valid;
    valid.reserve(text.size());
    for (std::size_t i = 0; i < text.size();) {
        const auto broken = firstBroken(text, i);
        valid.append(text.substr(i, broken - i));
        if (broken == text.size()) break;
        valid.append(kReplacement);
        i = broken + sequenceAt(text, broken).length;
    }
    return valid;
}

std::string_view cutUtf8(std::string_view text, std::size_t max) {
    if (text.size() <= max) return text;
    while (max > 0 && continues(at(text, max))) --max;
    return text.substr(0, max);
}

}  // namespace axon
