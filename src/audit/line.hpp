// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace axon::audit {

/// A record as it is in a file: one JSON object on one line.
struct Record {
    std::uint64_t number = 0;  ///< 1, 2, … of its trail, in all files together
    std::string at;            ///< UTC, "2026-11-28T14:35:06.123456Z": texts sort as times do
    std::string kind;          ///< one of kKinds, or one of a later release
    std::string user, name, client, peer, entity, what, outcome;
    std::string before;  ///< hashOf() the line before it, whatever that is; kNoHash for the first

    bool operator==(const Record&) const = default;
};

inline constexpr std::size_t kLineMax = 16'384;           ///< bytes; a longer line is no record
inline constexpr std::uint64_t kNumberMax = 1ULL << 53U;  ///< what every reader of JSON has exactly
inline const std::string kNoHash(64, '0');

/// SHA-256 of the line without its line end, in 64 hexadecimal digits: what sha256sum prints. Pure.
std::string hashOf(std::string_view line);

/// Without the line end. What is no UTF-8 becomes U+FFFD. Pure.
std::string lineOf(const Record& record);

/// Nothing where the text is no record. Members that it does not know do not count. Pure.
std::optional<Record> readLine(std::string_view line);

/// `us`: microseconds since 1970. Pure.
std::string utcTime(std::int64_t us);

}  // namespace axon::audit
