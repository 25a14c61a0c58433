// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/sessions/send_limits.hpp"

#include <string>

#include "common/rights.hpp"

namespace axon::entity_server {

bool SendLimits::tooMuchSignal(std::string_view message, const Clock& clock) {
    return message.size() > kSignalBytes ||
           !signal_bytes_.admit(clock.now(), static_cast<std::uint32_t>(message.size() + kSignalOverhead));
}

Refusal SendLimits::tooMuchOnSignalLane() {
    return {RefusalCode::Overloaded,
            "the signal lane takes no raw data, messages of at most " + std::to_string(kSignalBytes / 1024) +
                " KiB, and " + std::to_string(kSignalBytesPerSecond / 1024) + " KiB in a second",
            {}};
}

Result<void> SendLimits::toClient(Lane lane, std::string_view message, const Clock& clock) {
    if (lane == Lane::Signal && tooMuchSignal(message, clock)) return tooMuchOnSignalLane();
    return {};
}

Result<void> SendLimits::toPeer(Lane lane, const Header& head, std::string_view message, const Clock& clock) {
    if (!entitiesMaySend(head.msg_type)) {
        return Refusal{RefusalCode::PermissionDenied,
                       "an entity sends other entities COLLABORATION and RAW only, found '" +
                           head.msg_type.substr(0, 64) + '\'',
                       {}};
    }
    const bool raw = head.msg_type == kMsgRaw;
    if (lane == Lane::Signal && (raw || tooMuchSignal(message, clock))) return tooMuchOnSignalLane();
    if (message.size() > kPeerBytes) {
        return Refusal{RefusalCode::TooLarge,
                       "an entity sends other entities at most " + std::to_string(kPeerBytes / 1024) +
                           " KiB in a message",
                       {}};
    }
    if (lane == Lane::Data && !raw &&
        !peer_bytes_.admit(clock.now(), static_cast<std::uint32_t>(message.size()))) {
        return Refusal{RefusalCode::Overloaded,
                       "an entity sends other entities at most " +
                           std::to_string(kPeerBytesPerSecond / 1024) +
                           " KiB of messages of runs in a second",
                       {}};
    }
    return {};
}

}  // namespace axon::entity_server
