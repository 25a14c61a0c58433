// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/lms2xx/scan.hpp"

#include <algorithm>
#include <array>
#include <cassert>

namespace axon::lms2xx {
namespace {

constexpr std::array<Variant, 5> kVariants{{{180, 100}, {180, 50}, {100, 100}, {100, 50}, {100, 25}}};

// The first word of measured values.
constexpr unsigned kCount = 0x03FF;
constexpr unsigned kPartial = 0x2000 | 0x1800;  // a part of a scan; one of the rasters of a finer one
constexpr unsigned kUnit = 0xC000;
constexpr unsigned kMillimetres = 0x4000;

// Of the configuration: two words and a byte come before the two of interest. Older lasers have two bytes
// fewer at its end.
constexpr std::size_t kModeAt = 5;
constexpr std::size_t kUnitAt = 6;
constexpr std::size_t kShortConfiguration = 32;
constexpr std::size_t kLongConfiguration = 34;

// The nine highest values that the distance's bits can hold are no distances but say why there is none.
constexpr unsigned kSpecialValues = 9;

unsigned wordAt(const Bytes& bytes, std::size_t at) {
    return bytes[at] | static_cast<unsigned>(bytes[at + 1]) << 8U;
}

void putWord(Bytes& bytes, unsigned word) {
    bytes.push_back(static_cast<std::uint8_t>(word & 0xFFU));
    bytes.push_back(static_cast<std::uint8_t>(word >> 8U));
}

Bytes variantBytes(const Variant& variant) {
    Bytes bytes;
    putWord(bytes, static_cast<unsigned>(variant.angle_deg));
    putWord(bytes, static_cast<unsigned>(variant.resolution_hundredths));
    return bytes;
}

}  // namespace

std::optional<Variant> variantOf(std::size_t values) {
    for (const auto& variant : kVariants)
        if (static_cast<std::size_t>(variant.values()) == values) return variant;
    return std::nullopt;
}

Telegram request(Command command) {
    return {Telegram::kAnyLaser, static_cast<std::uint8_t>(command), {}};
}
Telegram request(Mode mode) {
    return {Telegram::kAnyLaser, static_cast<std::uint8_t>(Command::Mode), {static_cast<std::uint8_t>(mode)}};
}
Telegram request(const Variant& variant) {
    return {Telegram::kAnyLaser, static_cast<std::uint8_t>(Command::Variant), variantBytes(variant)};
}

std::optional<bool> parseModeAnswer(const Telegram& answer) {
    if (answer.command != kModeAnswer || answer.data.size() != 2) return std::nullopt;
    return answer.data[0] == 0;
}

std::optional<VariantAnswer> parseVariantAnswer(const Telegram& answer) {
    if (answer.command != kVariantAnswer || answer.data.size() != 6) return std::nullopt;
    const Variant variant{static_cast<int>(wordAt(answer.data, 1)), static_cast<int>(wordAt(answer.data, 3))};
    if (std::find(kVariants.begin(), kVariants.end(), variant) == kVariants.end()) return std::nullopt;
    return VariantAnswer{answer.data[0] == 1, variant};
}

std::optional<int> Measuring::distanceBits() const {
    switch (mode) {
        case 0:  // fields A and B, dazzled
        case 1:  // eight steps of reflected light
        case 2:  // fields A, B and C
            return 13;
        case 3:  // four steps
        case 4:  // fields A and B
            return 14;
        case 5:   // two steps
        case 6:   // field A
        case 15:  // as it was measured
            return 15;
        default:
            return std::nullopt;
    }
}

std::optional<Measuring> parseMeasuring(const Telegram& answer) {
    if (answer.command != kConfigurationAnswer ||
        (answer.data.size() != kShortConfiguration + 1 && answer.data.size() != kLongConfiguration + 1))
        return std::nullopt;
    return Measuring{answer.data[kUnitAt] == 1, answer.data[kModeAt]};
}

std::optional<MeasuredValues> parseMeasuredValues(const Telegram& answer) {
    if (answer.command != kMeasuredValues || answer.data.size() < 3) return std::nullopt;
    const unsigned header = wordAt(answer.data, 0);
    const std::size_t count = header & kCount;
    const std::size_t bare = 2 + 2 * count + 1;
    // With the number of the scan and of the telegram, where the laser is configured to send them.
    const bool fits = answer.data.size() == bare || answer.data.size() == bare + 2;
    if (count == 0 || !fits || (header & kPartial) != 0 || (header & kUnit) > kMillimetres)
        return std::nullopt;
    MeasuredValues scan{(header & kUnit) == kMillimetres, {}, answer.data.back()};
    scan.values.reserve(count);
    for (std::size_t i = 0; i < count; ++i)
        scan.values.push_back(static_cast<std::uint16_t>(wordAt(answer.data, 2 + 2 * i)));
    return scan;
}

std::uint16_t distance_mm(std::uint16_t raw, bool millimetres, int distance_bits) {
    const unsigned limit = 1U << static_cast<unsigned>(distance_bits);
    const unsigned value = raw & (limit - 1);
    if (value >= limit - kSpecialValues) return kNothing_mm;
    return static_cast<std::uint16_t>(std::min<unsigned>(millimetres ? value : value * 10, kNothing_mm));
}

Telegram modeAnswer(bool done) {
    return {Telegram::kFromLaser, kModeAnswer, {static_cast<std::uint8_t>(done ? 0 : 1), kGood}};
}

Telegram toAnswer(const VariantAnswer& answer) {
    Bytes data{static_cast<std::uint8_t>(answer.done ? 1 : 0)};
    const auto variant = variantBytes(answer.variant);
    data.insert(data.end(), variant.begin(), variant.end());
    data.push_back(kGood);
    return {Telegram::kFromLaser, kVariantAnswer, std::move(data)};
}

Telegram toAnswer(const Measuring& measuring) {
    Bytes data(kLongConfiguration + 1, 0);
    data[kModeAt] = static_cast<std::uint8_t>(measuring.mode);
    data[kUnitAt] = measuring.millimetres ? 1 : 0;
    data.back() = kGood;
    return {Telegram::kFromLaser, kConfigurationAnswer, std::move(data)};
}

Telegram toAnswer(const MeasuredValues& scan) {
    assert(scan.values.size() <= kCount);
    Bytes data;
    putWord(data, static_cast<unsigned>(scan.values.size()) | (scan.millimetres ? kMillimetres : 0));
    for (const auto value : scan.values) putWord(data, value);
    data.push_back(scan.status);
    return {Telegram::kFromLaser, kMeasuredValues, std::move(data)};
}

}  // namespace axon::lms2xx
