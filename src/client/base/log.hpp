// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <spdlog/fwd.h>

namespace axon::client {

/// Where the library's log goes: to the program's logger "axon" when it has registered one before its first
/// Client, else to standard error, warnings and worse only. Never to standard output, which is the program's.
/// Nobody waits for standard error: lines go through a queue of 1024 to a thread of their own, and the oldest
/// are lost while it is full (a logger of the program's waits as the program made it to). Any thread.
spdlog::logger& log();

}  // namespace axon::client
