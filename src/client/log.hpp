// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <spdlog/fwd.h>

namespace axon::client {

/// Where the library's log goes: to the program's logger "axon" when it has registered one before its first
/// Client, else to standard error, warnings and worse only. Never to standard output, which is the program's.
/// Any thread.
spdlog::logger& log();

}  // namespace axon::client
