// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <string_view>

#include "common/clock.hpp"

namespace axon::simulation {

/// The services that every simulated entity offers: two that exclude each other, of which one can be paused,
/// one that runs beside others, and two that may go on when their client is lost: Lift is held, Dock
/// finishes.
extern const char* const kServicesProfile;
/// How long a task of the service may go on moving after the loss of its client is known: for Lift until it
/// has paused, for Dock what its profile allows.
Duration aloneFor(std::string_view service);
std::string basicProfile(const std::string& name);

}  // namespace axon::simulation
