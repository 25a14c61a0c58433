// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/unreadable_calls.hpp"

#include <spdlog/spdlog.h>

#include <utility>

#include "transport/ice/peer_connection.hpp"

namespace axon::transport {

UnreadableCalls::UnreadableCalls(std::shared_ptr<Ice::Object> servant, std::string peer, const void* over,
                                 Foreign foreign)
    : servant_(std::move(servant)), peer_(std::move(peer)), over_(over), foreign_(std::move(foreign)) {}

UnreadableCalls::~UnreadableCalls() {
    if (count_ > 1) spdlog::warn("{}: {} calls could not be read", peer_, count_.load());
}

bool UnreadableCalls::dispatch(Ice::Request& request) {
    const auto& current = request.getCurrent();
    try {
        return servant_->ice_dispatch(request);
    } catch (const Ice::MarshalException& error) {
        if (!isForeign(current)) note(current.operation, error.ice_id());
        throw;
    } catch (const Ice::OperationNotExistException&) {
        if (!isForeign(current)) note(current.operation, "no such operation");
        throw;
    } catch (const Ice::ObjectNotExistException&) {
        isForeign(current);
        throw;
    }
}

bool UnreadableCalls::isForeign(const Ice::Current& current) const {
    if (!foreign_ || !current.con || current.con.get() == over_) return false;
    foreign_(DirectConnection::peerOf(*current.con));
    return true;
}

void UnreadableCalls::note(const std::string& operation, const std::string& why) {
    if (count_++ == 0)
        spdlog::warn(
            "{}: a call of '{}' cannot be read ({}); its program may have been built from other contracts",
            peer_, operation.substr(0, 64), why);
}

}  // namespace axon::transport
