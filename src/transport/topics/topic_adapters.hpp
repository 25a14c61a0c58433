// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/DispatchInterceptor.h>
#include <Ice/Ice.h>

#include <functional>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>
#include <unordered_set>
#include <utility>
#include <vector>

#include "common/neighbours.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/connection_limits.hpp"
#include "transport/ice/known_connections.hpp"
#include "transport/ice/link_trust.hpp"
#include "transport/ice/peer_connection.hpp"

namespace axon::transport {

/// Which connections of one lane have brought a call, where no certificate says who is there. Threads: any.
/// Bound: one entry for each of them that is open.
class TopicCallers : public std::enable_shared_from_this<TopicCallers> {
  public:
    void heard(const std::shared_ptr<Ice::Connection>& connection) {
        if (!connection) return;
        {
            const std::lock_guard lock(mutex_);
            if (!callers_.insert(connection.get()).second) return;
        }
        const auto ends = DirectConnection::endsOf(*connection);
        known_.add(ends);
        connection->setCloseCallback(
            [its = shared_from_this(), ends](const std::shared_ptr<Ice::Connection>& closed) {
                its->known_.remove(ends);
                const std::lock_guard lock(its->mutex_);
                its->callers_.erase(closed.get());
            });
    }
    /// By its ends (bothEnds()).
    bool has(const std::string& ends) const { return known_.has(ends); }

  private:
    std::mutex mutex_;  // taken for each message, so nothing else is done under it
    std::unordered_set<const Ice::Connection*> callers_;  // guarded by mutex_
    KnownConnections known_;
};

/// Where one of several servers is reached by the others: two adapters, one for each lane, and the
/// stringified proxies of what is behind them.
struct TopicAdapters {
    std::shared_ptr<Ice::ObjectAdapter> data, signal;  // null where the other server is in this process
    std::shared_ptr<TopicCallers> data_callers, signal_callers;  // null under TLS
    std::string subscriber;                                      ///< what comes by the topic
    std::string signals, messages;                               ///< what comes straight, for each lane

    void activate() const {
        signal->activate();
        data->activate();
    }
};

/// The calls of one way to a servant of this server, over TLS: `kind_of(operation)` says which kind of
/// certificate the caller must have shown; who has not is disconnected before the call is read.
class JudgedCalls final : public Ice::DispatchInterceptor {
  public:
    using KindOf = std::function<certificates::Kind(std::string_view operation)>;
    JudgedCalls(std::shared_ptr<Ice::Object> servant, LinkTrust& links, KindOf kind_of)
        : servant_(std::move(servant)), links_(links), kind_of_(std::move(kind_of)) {}
    bool dispatch(Ice::Request& request) override {
        const auto& current = request.getCurrent();
        if (!links_.mayCall(current, kind_of_(current.operation)))
            throw Ice::ObjectNotExistException(__FILE__, __LINE__, current.id, current.facet,
                                               current.operation);
        return servant_->ice_dispatch(request);
    }

  private:
    const std::shared_ptr<Ice::Object> servant_;
    LinkTrust& links_;
    const KindOf kind_of_;
};

/// The calls of one way to a servant of this server without TLS: who has called is known to be a server.
class HeardCalls final : public Ice::DispatchInterceptor {
  public:
    HeardCalls(std::shared_ptr<Ice::Object> servant, std::shared_ptr<TopicCallers> callers)
        : servant_(std::move(servant)), callers_(std::move(callers)) {}
    bool dispatch(Ice::Request& request) override {
        callers_->heard(request.getCurrent().con);
        return servant_->ice_dispatch(request);
    }

  private:
    const std::shared_ptr<Ice::Object> servant_;
    const std::shared_ptr<TopicCallers> callers_;
};

/// Makes them, not active yet; `Servant(core, lane, via, links)` listens, and `Servant::callerOf(operation)`
/// says which kind of server may call it straight. `kind` is that of the server, "EntityServer". With
/// `settings.links` they are under TLS. Throws std::runtime_error where it cannot listen.
template <class Servant, class Core, class Settings>
TopicAdapters listenToServers(Core& core, const std::string& kind, const Settings& settings,
                              Ice::Communicator& data) {
    using certificates::Kind;
    TopicAdapters made;
    auto* const links = settings.links;
    made.data = listen(data, kind + "Topic", settings.topic_endpoint, 0, Idle::Watched);
    made.signal = listen(*settings.topic_signals, kind + "TopicSignal", settings.topic_signal_endpoint, 0,
                         Idle::Watched);
    if (links == nullptr) {
        made.data_callers = std::make_shared<TopicCallers>();
        made.signal_callers = std::make_shared<TopicCallers>();
    }
    if (links != nullptr) {
        std::vector<Kind> callers(Servant::kCallers.begin(), Servant::kCallers.end());
        links->admit(*made.signal, callers);
        callers.push_back(Kind::Storm);
        links->admit(*made.data, callers);
    }
    const auto add = [&](Ice::ObjectAdapter& adapter, Lane lane, Via via) {
        const Ice::Identity identity{settings.core.name, via == Via::Topic ? kind : kind + "Straight"};
        const bool straight = via == Via::Straight;
        std::shared_ptr<Ice::Object> servant =
            std::make_shared<Servant>(core, lane, via, straight ? links : nullptr);
        if (links != nullptr)
            servant = std::make_shared<JudgedCalls>(
                std::move(servant), *links, [straight](std::string_view operation) {
                    return straight ? Servant::callerOf(operation) : Kind::Storm;
                });
        else
            servant = std::make_shared<HeardCalls>(
                std::move(servant), lane == Lane::Signal ? made.signal_callers : made.data_callers);
        return adapter.add(servant, identity)->ice_toString();
    };
    made.subscriber = add(*made.data, Lane::Data, Via::Topic);
    made.signals = add(*made.signal, Lane::Signal, Via::Straight);
    made.messages = add(*made.data, Lane::Data, Via::Straight);
    return made;
}

/// While the returned objects live, strangers cannot keep connections to these adapters. A stranger is who
/// has not shown the certificate of a server (`links`), or without TLS has not called.
[[nodiscard]] inline std::vector<std::shared_ptr<void>> watch(ConnectionLimits& limits,
                                                              const TopicAdapters& adapters,
                                                              LinkTrust* links) {
    using Peer = ConnectionLimits::Peer;
    const auto stateBy = [links](const std::shared_ptr<TopicCallers>& callers) {
        return [links, callers](const std::string& ends) {
            const bool known = links != nullptr ? links->hasCome(ends) : callers->has(ends);
            return known ? Peer::HasSession : Peer::Stranger;
        };
    };
    return {limits.watch(listenedEndpoints(*adapters.data), {stateBy(adapters.data_callers)}),
            limits.watch(listenedEndpoints(*adapters.signal), {stateBy(adapters.signal_callers)})};
}

}  // namespace axon::transport
