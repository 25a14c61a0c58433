// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once

namespace axon::transport {

/// Keeps what the process has touched, now and later, in memory, so that no stop waits for a disk. Only where
/// the process may lock without a limit: with one, allocating would fail when it is reached. Where not, that
/// is logged, once, with the mend. What is freed, up to 64 MiB, is kept in any case. For the mains of
/// daemons, after logging has begun and before there are threads.
void lockMemory();

}  // namespace axon::transport
