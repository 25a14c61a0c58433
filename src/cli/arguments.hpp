// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <string_view>
#include <vector>

#include "cli/station.hpp"

// From what a person writes to what the library takes. Pure functions.
namespace axon::cli {

/// Whether two names are the same to a person at a keyboard: no difference of case, and ' ', '_' and '-' are
/// one.
bool sameToAPerson(std::string_view a, std::string_view b);

/// By exact name or global id, else the only one that is the same to a person. UNKNOWN_SERVICE names the near
/// ones.
Result<const Service*> findService(const std::vector<Service>& services, std::string_view name);
Result<const client::GlobalService*> findGlobalService(const std::vector<client::GlobalService>& services,
                                                       std::string_view name);
Result<const Parameter*> findParameter(const Service& service, std::string_view name);
Result<const client::Resource*> findResource(const Service& service, std::string_view name);

/// A number and the letters after it: "1500mm", "1.5 m", "-90°". Nothing where the text is a plain number
/// ("1e3") or no number at all.
struct Measure {
    std::string number, units;
};
std::optional<Measure> splitMeasure(std::string_view text);

/// `key=value` words as arguments: keys are resolved among the service's parameters; a key that comes again
/// adds a value. A unit after the number is taken off where the parameter is a number that has units; whether
/// it is the right one, and all else about the value, the library checks. A word without '=' is MALFORMED.
Result<std::vector<Argument>> readArguments(const Service& service, const std::vector<std::string>& words);

}  // namespace axon::cli
