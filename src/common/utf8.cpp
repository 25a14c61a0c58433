// SPDX-License-Identifier: MIT
#include "common/utf8.hpp"

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

}  // namespace

std::string validUtf8(std::string_view text) {
    std::string valid;
    valid.reserve(text.size());
    for (std::size_t i = 0; i < text.size();) {
        const auto sequence = sequenceAt(text, i);
        valid.append(sequence.valid ? text.substr(i, sequence.length) : kReplacement);
        i += sequence.length;
    }
    return valid;
}

std::string_view cutUtf8(std::string_view text, std::size_t max) {
    if (text.size() <= max) return text;
    while (max > 0 && continues(at(text, max))) --max;
    return text.substr(0, max);
}

}  // namespace axon
