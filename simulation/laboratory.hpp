// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>

namespace axon::simulation {

/// The services that every simulated entity offers: two that exclude each other, of which one can be paused,
/// and one that runs beside others.
extern const char* const kServicesProfile;
std::string basicProfile(const std::string& name);

}  // namespace axon::simulation
