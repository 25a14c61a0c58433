// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <memory>
#include <string>

#include "common/clock.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/connection_limits.hpp"
#include "transport/ice/timer_thread.hpp"
#include "transport/sessions/lane_session.hpp"

namespace axon::transport {

/// One more way into a server: an adapter with a gate of its own, behind which others decide who may log in.
/// Its sessions have one lane, which carries everything. Browsers come in here, over WebSocket.
///
/// `Kind` as in ServerRim. Life: construct, activate(); before it is destroyed, destroy the communicator,
/// then end(). Failure: std::runtime_error where it cannot listen.
template <class Kind>
class SessionDoor {
  public:
    /// `endpoint` in Ice's form, "ws -h 127.0.0.1 -p 0". What is referred to outlives it.
    SessionDoor(typename Kind::Core& core, const std::string& name, const std::string& endpoint,
                Ice::Communicator& communicator, Logins& logins, ConnectionLimits& limits, const Clock& clock)
        : lane_{core, Lane::Data, {}, {}, OpenSessions<typename Kind::Session>(clock)},
          adapter_(listen(communicator, name, endpoint, 0, Idle::Watched)),
          limits_(limits),
          timer_("axon-door-timer", Lane::Data, kLook, clock, [this] { return lane_.sessions.expire(); }) {
        lane_.logins = &logins;
        adapter_->add(std::make_shared<typename Kind::Gate>(lane_), Ice::stringToIdentity(Kind::kGate));
    }

    void activate() {
        watch_ = watch(limits_, *adapter_, lane_, nullptr);
        adapter_->activate();
    }
    void end() {
        timer_.end();
        watch_.reset();
    }
    /// That was taken where 0 was asked for.
    std::uint16_t port() const { return listenedEndpoints(*adapter_).at(0).port; }

  private:
    static constexpr std::chrono::milliseconds kLook{100};

    SessionLane<typename Kind::Core, typename Kind::Session> lane_;
    const std::shared_ptr<Ice::ObjectAdapter> adapter_;
    ConnectionLimits& limits_;
    std::shared_ptr<void> watch_;
    TimerThread timer_;  // last: it uses the others
};

}  // namespace axon::transport
