// SPDX-License-Identifier: GPL-2.0-or-later
#include "router_guard/router_guard.hpp"

#include <Ice/Ice.h>

#include <algorithm>

namespace axon::router_guard {

namespace {

/// What Glacier2 calls for a log-in; "SSL…" where it verifies certificates instead of passwords.
constexpr const char* kLogIn[] = {"Glacier2.PermissionsVerifier", "Glacier2.SSLPermissionsVerifier",
                                  "Glacier2.SessionManager", "Glacier2.SSLSessionManager"};
constexpr auto kPeriod = std::chrono::milliseconds{250};
constexpr int kAnswerMs = 1000;

/// That the object is not there is an answer, too.
bool answers(const Ice::ObjectPrx& server) {
    try {
        server->ice_ping();
        return true;
    } catch (const Ice::RequestFailedException&) {
        return true;
    } catch (const Ice::InvocationTimeoutException&) {
        return false;
    }
}

}  // namespace

RouterGuard::RouterGuard(Ice::CommunicatorPtr communicator) : communicator_(std::move(communicator)) {}

RouterGuard::~RouterGuard() {
    destroy();
}

void RouterGuard::initialize() {
    finder_ = std::jthread([this](const std::stop_token& ended) { findServers(ended); });
}

void RouterGuard::destroy() {
    finder_ = {};
    guards_.clear();
}

void RouterGuard::findServers(const std::stop_token& ended) {
    // Plug-ins that make endpoints, as that for TLS, may begin after this one.
    if (!pause(ended)) return;
    std::vector<Ice::EndpointPtr> known;
    for (const auto* property : kLogIn) {
        Ice::ObjectPrx proxy;
        try {
            proxy = communicator_->propertyToProxy(property);
        } catch (const Ice::Exception& error) {
            // Glacier2 itself does not start with it, and says so.
            communicator_->getLogger()->warning(std::string("router guard: ") + property + ": " +
                                                error.what());
        }
        if (!proxy) continue;
        for (const auto& endpoint : proxy->ice_getEndpoints()) {
            if (std::find(known.begin(), known.end(), endpoint) != known.end()) continue;
            known.push_back(endpoint);
            const auto server = proxy->ice_endpoints({endpoint})
                                    ->ice_connectionCached(true)
                                    ->ice_invocationTimeout(kAnswerMs);
            guards_.emplace_back([this, server](const std::stop_token& its_end) { guard(server, its_end); });
        }
    }
}

void RouterGuard::guard(const Ice::ObjectPrx& server, const std::stop_token& ended) {
    while (pause(ended)) {
        try {
            const auto connection = server->ice_getConnection();
            if (answers(server)) continue;
            connection->close(Ice::ConnectionCloseForcefully);
            communicator_->getLogger()->warning(
                "router guard: no answer in " + std::to_string(kAnswerMs) +
                " ms, so the connection is closed: " + connection->toString());
        } catch (const Ice::CommunicatorDestroyedException&) {
            return;
        } catch (const Ice::Exception&) {  // it is not there; Glacier2 says so to whom it concerns
        }
    }
}

bool RouterGuard::pause(const std::stop_token& ended) {
    std::unique_lock lock(mutex_);
    end_.wait_for(lock, ended, kPeriod, [] { return false; });
    return !ended.stop_requested();
}

}  // namespace axon::router_guard
