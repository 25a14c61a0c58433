// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <string>
#include <utility>

#include "common/routed.hpp"

namespace axon::entity_manager {

/// The resets and clears that were taken last. Between servers each goes two ways, and the second copy, late,
/// would end the next task. Bounded: 32; what has no sequence number is always new.
class PassedSignals {
  public:
    /// Whether it has come before; from now on it has.
    bool seen(const Header& head) {
        if (head.sequence <= 0) return false;
        const std::pair key{head.sender.id, head.sequence};
        if (std::find(recent_.begin(), recent_.end(), key) != recent_.end()) return true;
        recent_[next_++ % recent_.size()] = key;
        return false;
    }

  private:
    std::array<std::pair<std::string, std::int64_t>, 32> recent_;
    std::size_t next_ = 0;
};

}  // namespace axon::entity_manager
