// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <string>

namespace axon::bench {

/// Global services over `entities`, each with one step in each of `levels` levels: the time from the end of a level's last
/// step to the entry of each handler of the next, beside the relayed one-way latency of a client's task in the same run.
/// 1 when a run did not succeed or was interrupted.
int runRuns(const std::filesystem::path& programs, std::size_t entities, int levels, int rounds, const std::string& json_file);

}  // namespace axon::bench
