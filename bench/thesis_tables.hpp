// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <optional>
#include <span>
#include <string_view>

namespace axon::bench {

/// A row of tables 5.1 to 5.4 of the thesis, as printed: average latency in ms.
struct ThesisRow {
    std::size_t count;  ///< entities (5.1, 5.2) or clients (5.3, 5.4)
    double lan_ms, wlan_ms;
};

// The server ran on a quad core of 2.66 GHz with 4 GB of RAM, the Entity Managers on four other machines,
// half of them wired and half wireless in each run; time-outs were two seconds (thesis 5, 5.1). Quantiles,
// counts and spread are not in the thesis.

/// Single client, multiple entities: data, a batch of 35,137 bytes each 500 ms.
inline constexpr ThesisRow kTable51[] = {{1, 1.8, 141.5},     {2, 1.7, 57.7},       {4, 2.7, 57.7},
                                         {8, 4.4, 57.5},      {16, 7.9, 57.1},      {32, 16.1, 56.4},
                                         {64, 30.9, 54.2},    {128, 61.1, 58.4},    {256, 157.6, 108.4},
                                         {512, 249.7, 246.7}, {1024, 402.6, 698.9}, {2048, 823.7, 901.8}};
/// Single client, multiple entities: stop.
inline constexpr ThesisRow kTable52[] = {{1, 0.2, 0.3},     {2, 0.3, 0.3},      {4, 0.6, 0.5},
                                         {8, 0.9, 2.3},     {16, 1.7, 1.6},     {32, 2.6, 2.4},
                                         {64, 4.8, 5.1},    {128, 10.6, 8.9},   {256, 18.2, 17.8},
                                         {512, 35.3, 39.5}, {1024, 72.3, 83.6}, {2048, 160.7, 402.8}};
/// Multiple clients, 256 entities: data.
inline constexpr ThesisRow kTable53[] = {{1, 14.0, 25.8},    {2, 43.0, 106.3},    {4, 70.9, 78.8},
                                         {8, 89.6, 54.4},    {16, 344.8, 445.0},  {32, 671.5, 1374.2},
                                         {64, 643.6, 665.1}, {128, 860.8, 711.6}, {256, 1365.2, 2215.8}};
/// Multiple clients, 256 entities: stop.
inline constexpr ThesisRow kTable54[] = {{1, 0.3, 0.9},  {2, 0.3, 0.6},     {4, 0.3, 0.8},
                                         {8, 0.3, 1.0},  {16, 2.0, 3.2},    {32, 3.5, 5.7},
                                         {64, 3.9, 4.8}, {128, 10.6, 10.7}, {256, 8.3, 9.5}};

struct ThesisTable {
    std::string_view number, title;
    bool stop, many_clients;
    std::span<const ThesisRow> rows;

    std::optional<ThesisRow> row(std::size_t count) const {
        for (const auto& one : rows)
            if (one.count == count) return one;
        return std::nullopt;
    }
};
inline const std::array<ThesisTable, 4> kThesisTables{{
    {"5.1", "Single client, multiple entities: data", false, false, kTable51},
    {"5.2", "Single client, multiple entities: stop", true, false, kTable52},
    {"5.3", "Multiple clients, 256 entities: data", false, true, kTable53},
    {"5.4", "Multiple clients, 256 entities: stop", true, true, kTable54},
}};

/// Of the 256 entities of tables 5.3 and 5.4 those that are measured; the others take the standard clients'
/// load.
inline constexpr std::size_t kTestingEntities = 10, kStandardEntities = 246;

}  // namespace axon::bench
