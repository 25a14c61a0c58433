// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <algorithm>
#include <memory>
#include <string>

#include "common/clock.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/connection_limits.hpp"
#include "transport/ice/timer_thread.hpp"
#include "transport/sessions/door_settings.hpp"
#include "transport/sessions/lane_session.hpp"

namespace axon::transport {

/// One more way into a server: an adapter with a gate for each lane, behind which others decide who may log
/// in. Browsers come in here, over WebSocket. A session that does not attach a signal lane has one lane,
/// which carries everything.
///
/// `Kind` as in ServerRim. Life: construct, activate(); before it is destroyed, destroy the communicators,
/// then end(). Failure: std::runtime_error where it cannot listen.
template <class Kind>
class SessionDoor {
  public:
    /// The adapters are called `name` and, for signals, `name`Signal. What is referred to outlives it.
    SessionDoor(typename Kind::Core& core, const std::string& name, const DoorSettings& settings,
                const Clock& clock)
        : data_lane_{core, Lane::Data, {}, {}, OpenSessions<typename Kind::Session>(clock)},
          signal_lane_{
              core, Lane::Signal, OutboxLimits::ofSignals(), {}, OpenSessions<typename Kind::Session>(clock)},
          data_adapter_(listen(*settings.data.communicator, name, settings.data.endpoint, 0, Idle::Watched)),
          signal_adapter_(listen(*settings.signal.communicator, name + "Signal", settings.signal.endpoint, 0,
                                 Idle::Watched)),
          limits_(*settings.limits),
          timer_("axon-door-timer", Lane::Data, kLook, clock,
                 [this] { return std::min(data_lane_.sessions.expire(), signal_lane_.sessions.expire()); }) {
        data_lane_.logins = data_lane_.door = signal_lane_.door = settings.data.logins;
        signal_lane_.logins = settings.signal.logins;
        data_lane_.tell_signal_endpoint = [tell = settings.signal_endpoint](const PeerConnection& peer) {
            const auto* direct = dynamic_cast<const DirectConnection*>(&peer);
            return direct == nullptr ? std::string()
                                     : tell(peer.localAddress(), DirectConnection::originOf(*direct->get()));
        };
        addGate(*data_adapter_, std::make_shared<typename Kind::Gate>(data_lane_), Kind::kGate,
                data_lane_.ofStrangers(nullptr));
        addGate(*signal_adapter_, std::make_shared<typename Kind::Gate>(signal_lane_), Kind::kGate,
                signal_lane_.ofStrangers(nullptr));
    }

    void activate() {
        data_watch_ = watch(limits_, *data_adapter_, data_lane_, nullptr);
        signal_watch_ = watch(limits_, *signal_adapter_, signal_lane_, nullptr);
        signal_adapter_->activate();
        data_adapter_->activate();
    }
    void end() {
        timer_.end();
        data_watch_.reset();
        signal_watch_.reset();
    }
    /// Those that were taken where 0 was asked for.
    DoorPorts ports() const {
        return {listenedEndpoints(*data_adapter_).at(0).port, listenedEndpoints(*signal_adapter_).at(0).port};
    }

  private:
    static constexpr std::chrono::milliseconds kLook{100};

    SessionLane<typename Kind::Core, typename Kind::Session> data_lane_, signal_lane_;
    const std::shared_ptr<Ice::ObjectAdapter> data_adapter_, signal_adapter_;
    ConnectionLimits& limits_;
    std::shared_ptr<void> data_watch_, signal_watch_;
    TimerThread timer_;  // last: it uses the others
};

}  // namespace axon::transport
