// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once

namespace axon::transport {

/// Keeps all memory that the process touches, now and later, in RAM, so that no stop waits for a disk. Works
/// only if the process may lock memory without a limit, because allocating would fail at a limit. Otherwise
/// this is logged once, with how to fix it. Up to 64 MiB of freed memory is kept in both cases. Call it in
/// main() of a daemon, after logging has begun and before there are threads.
void lockMemory();

}  // namespace axon::transport
