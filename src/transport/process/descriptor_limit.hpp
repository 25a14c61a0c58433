// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once

namespace axon::transport {

/// Raises the number of descriptors that this process may have to the most that its user is allowed: the soft
/// limit is 1,024 in most shells, and a thousand silent connections would leave none for who comes to stop a
/// robot. For the mains of daemons. Nothing happens where it cannot be raised.
void raiseDescriptorLimit();

}  // namespace axon::transport
