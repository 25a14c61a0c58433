// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <algorithm>
#include <atomic>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/connection_limits.hpp"
#include "transport/ice/timer_thread.hpp"
#include "transport/sessions/lane_session.hpp"
#include "transport/sessions/router_servants.hpp"
#include "transport/topics/topic_adapters.hpp"

namespace axon::transport {

/// A server's core on Ice, the same for both kinds of server: an adapter for each lane with a gate, one for
/// routers where it has an endpoint, those for the other servers where there are several, the bounds of
/// strangers' connections, and the thread that gives the core time.
///
/// `Kind` says what differs:
///     Core, Topic            the core, and its way to the other servers
///     Session, SessionPrx    the servant of one lane's session, and the proxy to it
///     Gate                   the servant that opens sessions: Gate(SessionLane<Core, Session>&)
///     Listener               hears the other servers: Listener(Core&, Lane, Via)
///     make(lane, peer, who, display name)   a Session
///     kVerify, kVouched      of Logins: how this kind of peer logs in
///     kCertificate           the kind of the certificate of one of several
///     kServer, kGate, kTimer the names of the adapters ("EntityServer"), the gate, the timer's thread
///     kPeer                  who opens sessions: "an Entity Manager"
///
/// Life: construct, activate(); before it is destroyed, destroy the communicators, then end(). Threads:
/// wake() any, the rest one. Failure: std::runtime_error where it cannot listen (misconfiguration).
template <class Kind>
class ServerRim {
  public:
    using ItsLane = SessionLane<typename Kind::Core, typename Kind::Session>;

    /// `core` and `topic` outlive it. `settings` is that of the server.
    template <class Settings>
    ServerRim(typename Kind::Core& core, typename Kind::Topic& topic, const Settings& settings,
              const std::shared_ptr<Ice::Communicator>& data,
              const std::shared_ptr<Ice::Communicator>& signal, const Clock& clock)
        : data_lane_{core, Lane::Data, {}, {}, OpenSessions<typename Kind::Session>(clock)},
          signal_lane_{
              core, Lane::Signal, OutboxLimits::ofSignals(), {}, OpenSessions<typename Kind::Session>(clock)},
          data_adapter_(listen(*data, Kind::kServer, settings.data_endpoint, 0, Idle::Watched)),
          signal_adapter_(listen(*signal, kName + "Signal", settings.signal_endpoint, 0, Idle::Watched)),
          limits_(*settings.limits),
          links_(settings.links) {
        data_lane_.logins = data_lane_.door = signal_lane_.door = settings.logins;
        data_lane_.releases = &releases_;
        data_lane_.server = signal_lane_.server = settings.name;
        data_lane_.signal_endpoints = publishedEndpoints(*signal_adapter_);
        if (!settings.router_endpoint.empty())
            routers_ = std::make_unique<RouterConnections>(settings.logins, Kind::kCertificate);
        addGate(*data_adapter_, std::make_shared<typename Kind::Gate>(data_lane_), Kind::kGate,
                data_lane_.ofStrangers(routers_.get()));
        addGate(*signal_adapter_, std::make_shared<typename Kind::Gate>(signal_lane_), Kind::kGate,
                signal_lane_.ofStrangers(routers_.get()));
        if (routers_) {
            door_ = std::make_unique<RouterDoor>(
                makeDoor<Kind>(data_lane_, data_adapter_, signal_lane_, signal_adapter_, *routers_));
            door_->neighbours = neighboursOf(*data, settings.neighbours);
            door_->links = settings.links;
            router_adapter_ = listenForRouters(*data, kName + "Router", settings.router_endpoint, *door_);
            if (settings.links != nullptr)
                settings.links->admit(*router_adapter_, {certificates::Kind::Router,
                                                         certificates::Kind::Server, Kind::kCertificate});
        }
        if (settings.here == nullptr) {
            others_ = listenToServers<typename Kind::Listener>(core, Kind::kServer, settings, *data);
            topic.setDirect(others_.signals, others_.messages);
        }
        timer_ = std::make_unique<TimerThread>(
            // Thousands of peers are served in batches, not with a wake-up for each of them.
            Kind::kTimer, Lane::Signal, std::chrono::milliseconds{5}, clock,
            [this, &core] {
                return std::min(
                    {core.onTimer(), data_lane_.sessions.expire(), signal_lane_.sessions.expire()});
            },
            settings.turned);
        timer_ready_ = timer_.get();
    }

    void activate() {
        watches_ = {watch(limits_, *data_adapter_, data_lane_, routers_.get()),
                    watch(limits_, *signal_adapter_, signal_lane_, routers_.get())};
        if (others_.data)
            for (auto& one : watch(limits_, others_, links_)) watches_.push_back(std::move(one));
        if (router_adapter_ && links_ != nullptr) {
            // A router without TLS is on this machine, and may have said nothing yet but that it is there.
            auto endpoints = listenedEndpoints(*router_adapter_);
            std::erase_if(endpoints, [](const Endpoint& one) { return !one.tls; });
            const auto stateOf = [this](const std::string& ends) {
                return links_->hasCome(ends) ? ConnectionLimits::Peer::Exempt
                                             : ConnectionLimits::Peer::Stranger;
            };
            watches_.push_back(limits_.watch(std::move(endpoints), {stateOf}));
        }
        signal_adapter_->activate();
        data_adapter_->activate();
        if (router_adapter_) router_adapter_->activate();
        if (others_.data) others_.activate();
    }
    /// Joins its thread: the core is given no more time.
    void end() {
        if (timer_) timer_->end();
    }
    /// There is no server of the other kind in this process.
    bool isOneOfSeveral() const { return others_.data != nullptr; }
    /// The core wants to be given time before it said.
    void wake() {
        if (auto* thread = timer_ready_.load()) thread->wake();
    }

    /// What subscribes to the topic, a stringified proxy; empty where there is one server of each kind.
    const std::string& subscriber() const { return others_.subscriber; }
    /// "127.0.0.1:10412", with the port that was taken where 0 was asked for.
    std::string address(Lane lane) const {
        return addressOf(lane == Lane::Signal ? *signal_adapter_ : *data_adapter_);
    }
    /// Of the adapter for routers; empty where there is none.
    std::string routerAddress() const {
        return router_adapter_ ? addressOf(*router_adapter_) : std::string();
    }

  private:
    static inline const std::string kName = Kind::kServer;

    ReleaseNotes releases_{"this server", ourContract()};
    ItsLane data_lane_;
    ItsLane signal_lane_;
    std::shared_ptr<Ice::ObjectAdapter> data_adapter_;
    std::shared_ptr<Ice::ObjectAdapter> signal_adapter_;
    ConnectionLimits& limits_;
    LinkTrust* const links_;  // null: the links to the other servers are plain
    std::unique_ptr<RouterConnections> routers_;
    std::unique_ptr<RouterDoor> door_;
    std::shared_ptr<Ice::ObjectAdapter> router_adapter_;
    TopicAdapters others_;
    std::atomic<TimerThread*> timer_ready_{nullptr};
    std::vector<std::shared_ptr<void>> watches_;
    std::unique_ptr<TimerThread> timer_;  // destroyed first: it calls the core
};

}  // namespace axon::transport
