// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <string_view>

namespace axon::transport {

/// Sends the program's log lines to standard error without making anybody wait: a logging thread puts the
/// line into a queue of 4096, and a thread of its own writes it. Signal threads and timers log, too, and a
/// terminal that is stopped or a pipe that nobody reads must not hold up a stop. While the queue is full the
/// oldest lines are lost.
///
/// `level` is one that isLogLevel() accepts. Control characters in a line are written as \xNN, so that no
/// peer's name looks like a line of ours. Call it once, at the start of main(), after signals are blocked
/// (the thread inherits the mask) and before other threads exist. At exit it waits for the queue to be
/// written, half a second at most.
void logToStderr(const std::string& level);

/// The levels of `--log-level`, for help texts and messages.
inline constexpr std::string_view kLogLevels = "trace, debug, info, warning, error, critical or off";

/// Whether `level` is one of kLogLevels, or `warn`, which means warning.
bool isLogLevel(std::string_view level);

/// What happens at exit, for a program that ends by _exit.
void flushLog();

/// The line with its control characters written as \xNN.
std::string withoutControls(const std::string& line);

}  // namespace axon::transport
