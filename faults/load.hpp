// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <string>

namespace axon::faults {

/// What a client of the load sends at a time: a batch of chapter 5 of the thesis.
inline constexpr std::size_t kBatchBytes = 35137;

/// As many clients as robots, each made of the client library, each the holder of one robot. While Desk::load
/// says so each sends batches to its robot by the servers as fast as they arrive there, and rearms it when it
/// is latched. What happens to it is noted in the robot's slot. Runs until its parent dies or kills it.
int runLoad(const std::string& board_file, std::size_t entities, const std::string& server);

}  // namespace axon::faults
