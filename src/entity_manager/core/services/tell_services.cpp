// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/services/tell_services.hpp"

#include <axon/messages.pb.h>

#include <set>

namespace axon::entity_manager {

void tellServices(Turn& turn, const ServiceProfiler& profiler, const std::vector<int>& services) {
    if (turn.holder() == nullptr || !turn.connected()) return;
    std::set<int> changed(services.begin(), services.end());
    for (const auto service : services) {
        const auto& composites = profiler.compositesWith(service);
        changed.insert(composites.begin(), composites.end());
    }
    for (const auto service : changed) {
        proto::ToClient message;
        *message.mutable_service() = profiler.record(service);
        turn.tell(*turn.holder(), kMsgService, message);
    }
}

}  // namespace axon::entity_manager
