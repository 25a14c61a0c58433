// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <string>

namespace axon::transport {

/// Who is told of each connection to this process whose TLS handshake has failed: its address and port, and
/// why. Ice tells these to its log alone, and each process has one. Called on Ice's threads.
using RefusedHandshake = std::function<void(const std::string& peer, const std::string& why)>;

/// `told` is told as long as what is returned lives, whose end waits for a call that is under way. Threads:
/// any.
[[nodiscard]] std::shared_ptr<void> watchRefusedHandshakes(RefusedHandshake told);

}  // namespace axon::transport
