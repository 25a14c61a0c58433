// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <string>

#include "common/result.hpp"
#include "common/routed.hpp"

namespace axon::entity_server {

/// Whether an entity may register like this: its name, which nobody may take for another entity's, its
/// texts, its heartbeat periods, and the size of its profile. Its UUID has been read. Refused otherwise, with
/// what to fix.
Result<void> checkRegistration(const Registration& registration, std::size_t profile_bytes,
                               std::size_t profile_bytes_max);

/// A text of a status, corrected: cut to what a registration's may have, and made valid UTF-8.
void makeValid(std::string& text);

}  // namespace axon::entity_server
