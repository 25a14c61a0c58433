// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string_view>

#include "common/routed.hpp"

namespace axon::direct {

/// Servers see who holds what and keep a record of who rearmed, so check-outs, with their answers, and REARM
/// go by them always. They have no place in the order of the rest: a check-out is before it, and who rearms
/// waits for the answer.
inline bool alwaysRelayed(std::string_view msg_type) {
    return msg_type == kMsgCheckOut || msg_type == kMsgRearm;
}

}  // namespace axon::direct
