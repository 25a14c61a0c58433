// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>

#include "robots/lms2xx/telegram.hpp"

namespace axon::lms2xx {

/// How wide the laser looks and how finely: Command::Variant. Angles are in the plane of the scan; the first
/// value is on the laser's right, and straight ahead is in the middle.
struct Variant {
    int angle_deg = 180;              ///< 100 or 180
    int resolution_hundredths = 100;  ///< of a degree: 25 (100 degrees only), 50 or 100

    int values() const { return angle_deg * 100 / resolution_hundredths + 1; }
    bool operator==(const Variant&) const = default;
};

/// The variant whose scans have so many values: 101, 181, 201, 361 or 401. Nothing for other numbers.
std::optional<Variant> variantOf(std::size_t values);

Telegram request(Command command);
Telegram request(Mode mode);
Telegram request(const Variant& variant);

/// What Command::Mode's answer says: done. Nothing for other telegrams.
std::optional<bool> parseModeAnswer(const Telegram& answer);

struct VariantAnswer {
    bool done = false;
    Variant variant;  ///< which the laser has now

    bool operator==(const VariantAnswer&) const = default;
};
/// Nothing for other telegrams, and for angles and resolutions that no laser has.
std::optional<VariantAnswer> parseVariantAnswer(const Telegram& answer);

/// The part of the laser's configuration that says what a measured value means.
struct Measuring {
    bool millimetres = false;  ///< else centimetres. Each scan says it as well
    int mode = 0;              ///< as the listing numbers them: 0 to 6, 15

    /// How many of a value's 16 bits are the distance; the others say which fields it lies in, or how much of
    /// the light came back. Nothing for modes whose values are no distances.
    std::optional<int> distanceBits() const;
    bool operator==(const Measuring&) const = default;
};
/// Of the answer to Command::ReadConfiguration. Nothing for other telegrams.
std::optional<Measuring> parseMeasuring(const Telegram& answer);

/// One scan as the laser sends it.
struct MeasuredValues {
    bool millimetres = false;
    std::vector<std::uint16_t> values;  ///< raw, with the bits beside the distance
    std::uint8_t status = 0;

    bool operator==(const MeasuredValues&) const = default;
};
/// Nothing for other telegrams, for parts of scans, and for telegrams that are shorter or longer than their
/// number of values says.
std::optional<MeasuredValues> parseMeasuredValues(const Telegram& answer);

inline constexpr std::uint16_t kNothing_mm = 32767;  ///< nothing was measured in this direction

/// The distance in a raw value; kNothing_mm where the laser says that it has measured none (nothing came
/// back, it was dazzled, too little light came back, or what came back was beyond its range), and from that
/// distance on.
std::uint16_t distance_mm(std::uint16_t raw, bool millimetres, int distance_bits);

// The laser's half, for one that is simulated.
inline constexpr std::uint8_t kGood = 0x10;  ///< a status: no trouble
Telegram modeAnswer(bool done);
Telegram toAnswer(const VariantAnswer& answer);
Telegram toAnswer(const Measuring& measuring);
/// More than 0x3FF values is a bug of the caller (assertion).
Telegram toAnswer(const MeasuredValues& scan);

}  // namespace axon::lms2xx
