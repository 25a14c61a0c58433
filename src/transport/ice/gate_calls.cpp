// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/gate_calls.hpp"

#include <utility>

namespace axon::transport {

GateCalls::GateCalls(std::shared_ptr<Ice::Object> gate, Told told)
    : gate_(std::move(gate)), told_(std::move(told)) {}

bool GateCalls::dispatch(Ice::Request& request) {
    const auto tell = [&](const char* why) {
        // None where this process has called itself.
        if (const auto& connection = request.getCurrent().con) told_(*connection, why);
    };
    try {
        if (gate_) return gate_->ice_dispatch(request);
    } catch (const Ice::MarshalException&) {
        tell("it cannot be read; the program may have been built from other contracts");
        throw;
    } catch (const Ice::OperationNotExistException&) {
        tell("the gate has no such operation");
        throw;
    }
    tell("no such object, or one of a session that has ended");
    const auto& current = request.getCurrent();
    throw Ice::ObjectNotExistException(__FILE__, __LINE__, current.id, current.facet, current.operation);
}

void addGate(Ice::ObjectAdapter& adapter, const std::shared_ptr<Ice::Object>& gate, const std::string& name,
             const GateCalls::Told& told) {
    adapter.add(std::make_shared<GateCalls>(gate, told), Ice::stringToIdentity(name));
    adapter.addDefaultServant(std::make_shared<GateCalls>(nullptr, told), "");
}

}  // namespace axon::transport
