// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include "cli/session.hpp"

namespace axon::cli {

/// A Station on the client library. UNAVAILABLE and the like when there is no server within the time.
Result<std::shared_ptr<Station>> connectStation(const Settings& settings);

}  // namespace axon::cli
