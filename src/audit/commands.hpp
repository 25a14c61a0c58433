// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <array>
#include <string_view>

#include "common/routed.hpp"

namespace axon::audit {

/// Whether a message of this kind orders something; servers record these on their way to an entity.
inline bool isCommand(std::string_view msg_type) {
    constexpr std::array<std::string_view, 6> kCommands{kMsgCheckOut, kMsgRelease,     kMsgHandOver,
                                                        kMsgTask,     kMsgTaskControl, kMsgRun};
    return std::find(kCommands.begin(), kCommands.end(), msg_type) != kCommands.end();
}

}  // namespace axon::audit
