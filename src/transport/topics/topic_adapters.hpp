// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/DispatchInterceptor.h>
#include <Ice/Ice.h>

#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/neighbours.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/link_trust.hpp"

namespace axon::transport {

/// Where one of several servers is reached by the others: two adapters, one for each lane, and the
/// stringified proxies of what is behind them.
struct TopicAdapters {
    std::shared_ptr<Ice::ObjectAdapter> data, signal;  // null where the other server is in this process
    std::string subscriber;                            ///< what comes by the topic
    std::string signals, messages;                     ///< what comes straight, for each lane

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

/// Makes them, not active yet; `Servant(core, lane, via, links)` listens, and `Servant::callerOf(operation)`
/// says which kind of server may call it straight. `kind` is that of the server, "EntityServer". With
/// `settings.links` they are under TLS. Throws std::runtime_error where it cannot listen.
template <class Servant, class Core, class Settings>
TopicAdapters listenToServers(Core& core, const std::string& kind, const Settings& settings,
                              Ice::Communicator& data) {
    using certificates::Kind;
    TopicAdapters made;
    auto* const links = settings.links;
    made.data = listen(data, kind + "Topic", settings.topic_endpoint);
    made.signal = listen(*settings.topic_signals, kind + "TopicSignal", settings.topic_signal_endpoint);
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
        return adapter.add(servant, identity)->ice_toString();
    };
    made.subscriber = add(*made.data, Lane::Data, Via::Topic);
    made.signals = add(*made.signal, Lane::Signal, Via::Straight);
    made.messages = add(*made.data, Lane::Data, Via::Straight);
    return made;
}

}  // namespace axon::transport
