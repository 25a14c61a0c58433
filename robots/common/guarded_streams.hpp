// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>

#include "entity_interfacer/axon/device_guard.hpp"
#include "robots/common/byte_stream.hpp"

/// What the robot applications have in common.
namespace axon::robots {

/// Opens the same links, each of them watched by one DeviceGuard: should this process freeze or die, the
/// guard writes `options.stop` to the robot. The guard is started here, so call this early.
///
/// A stream's read() is the sign of life: whoever attends to the stream calls it at least five times within
/// `options.silence`, whether there is something to read or not. Once the guard has stopped the robot, or is
/// gone itself, read() stops the robot too and says that the link is gone, and write() takes nothing any
/// more; the next link is guarded again. A serial line may change its speed; the guard writes at that of the
/// moment, and for 0.3 s after this process was killed nobody else can open the line. Without a guard no link
/// is opened. One link at a time. Throws as DeviceGuard does.
StreamOpener guardedStreams(StreamOpener open, DeviceGuard::Options options);

}  // namespace axon::robots
