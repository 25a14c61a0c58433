// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/endings/settlement.hpp"

#include <vector>

#include "common/planted_bug.hpp"

namespace axon::front_end_server {
namespace {

StopCause causeOf(Ending ending) {
    switch (ending) {
        case Ending::Ended:
            return StopCause::Released;
        case Ending::Lost:
            return StopCause::ClientLost;
        case Ending::Improper:
            return StopCause::Improper;
    }
    return StopCause::ClientLost;
}

}  // namespace

void Settlement::stop(const Sender& client, Ending ending, const Holdings::Held& held) {
    if (AXON_PLANTED(LostClientForgotten) && ending == Ending::Lost) return;
    Header head;
    head.sender = client;
    head.sequence = kServerSequences + ++stops_;
    head.sent_at_us = toMicroseconds(clock_.now());
    std::vector<std::string> stopped;
    for (const auto& [entity, busy] : held) {
        if (ending != Ending::Ended || busy) stopped.push_back(entity);
    }
    if (stopped.size() == 1) {
        head.entity = stopped.front();
        topic_.stopSignal(head, causeOf(ending));
    } else if (!stopped.empty()) {
        topic_.stopSignals(head, stopped, causeOf(ending));
    }
}

void Settlement::tellGone(const Sender& client, Ending ending, const Holdings::Held& held) {
    if (AXON_PLANTED(LostClientForgotten) && ending == Ending::Lost) return;
    for (const auto& [entity, busy] : held) tellGone(client, entity, ending);
}

void Settlement::tellGone(const Sender& client, const std::string& entity, Ending ending) {
    Header head;
    head.sender = client;
    head.entity = entity;
    head.sent_at_us = toMicroseconds(clock_.now());
    topic_.clientUpdate(head, ending == Ending::Ended ? ClientChange::Ended : ClientChange::Lost);
}

}  // namespace axon::front_end_server
