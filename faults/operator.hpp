// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <string>

namespace axon::faults {

/// The person at the console: a client process, made of the client library, that holds every robot. At each
/// order of the desk (Desk::prepare) it sees that every robot moves: connected, checked out, rearmed,
/// driving. Between orders it does nothing at all, so whatever moves after a stop moves by a fault. Runs
/// until its parent dies or kills it.
int runOperator(const std::string& board_file, std::size_t entities, const std::string& server);

}  // namespace axon::faults
