// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/unreadable_calls.hpp"

#include <spdlog/spdlog.h>

#include <utility>

namespace axon::transport {

UnreadableCalls::UnreadableCalls(std::shared_ptr<Ice::Object> servant, std::string peer)
    : servant_(std::move(servant)), peer_(std::move(peer)) {}

UnreadableCalls::~UnreadableCalls() {
    if (count_ > 1) spdlog::warn("{}: {} calls could not be read", peer_, count_.load());
}

bool UnreadableCalls::dispatch(Ice::Request& request) {
    try {
        return servant_->ice_dispatch(request);
    } catch (const Ice::MarshalException& error) {
        note(request.getCurrent().operation, error.ice_id());
        throw;
    } catch (const Ice::OperationNotExistException&) {
        note(request.getCurrent().operation, "no such operation");
        throw;
    }
}

void UnreadableCalls::note(const std::string& operation, const std::string& why) {
    if (count_++ == 0)
        spdlog::warn(
            "{}: a call of '{}' cannot be read ({}); its program may have been built from other contracts",
            peer_, operation.substr(0, 64), why);
}

}  // namespace axon::transport
