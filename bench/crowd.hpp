// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <string>

namespace axon::bench {

/// N Entity Managers (the library the daemon is made of, with real sessions over real sockets) in one process, each
/// with a robot application in memory that notes the arrival of stops and data on the board. Named bench-0 … bench-N-1.
/// Runs until its parent dies or kills it.
int runCrowd(const std::string& board_file, std::size_t entities, const std::string& entity_server);

}  // namespace axon::bench
