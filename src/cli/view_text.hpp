// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>

#include "cli/session.hpp"
#include "cli/table.hpp"

// What the views have in common: from the members of an event to text that a terminal may show. Pure
// functions.
namespace axon::cli {

/// A member of an event as harmless text; empty where there is none.
std::string textOf(const Json& json, const char* member, bool lines = false);
std::string valueText(const Json& value);
std::string valuesText(const Json& values);
std::string lowerCase(std::string text);
/// " 42 %": as many places for the number, so that a line that is redrawn stands still. Nothing is below 0 %.
std::string percent(double part, int width = 3);
/// Of a state of an entity.
Tint stateTint(const std::string& state);
/// A time of a receipt or a drill, "-" for null. `precision_ms`: what is shorter cannot be told apart from
/// nothing.
std::string stageText(const Json& milliseconds, double precision_ms = 0);

}  // namespace axon::cli
