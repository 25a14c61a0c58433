// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <memory>
#include <string>

#include "common/neighbours.hpp"
#include "transport/ice/adapter.hpp"

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

/// Makes them, not active yet; `Servant(core, lane, via)` listens. `kind` is that of the server,
/// "EntityServer". Throws std::runtime_error where it cannot listen.
template <class Servant, class Core, class Settings>
TopicAdapters listenToServers(Core& core, const std::string& kind, const Settings& settings,
                              Ice::Communicator& data) {
    TopicAdapters made;
    made.data = listen(data, kind + "Topic", settings.topic_endpoint);
    made.signal = listen(*settings.topic_signals, kind + "TopicSignal", settings.topic_signal_endpoint);
    const auto add = [&](Ice::ObjectAdapter& adapter, Lane lane, Via via) {
        const Ice::Identity identity{settings.core.name, via == Via::Topic ? kind : kind + "Straight"};
        return adapter.add(std::make_shared<Servant>(core, lane, via), identity)->ice_toString();
    };
    made.subscriber = add(*made.data, Lane::Data, Via::Topic);
    made.signals = add(*made.signal, Lane::Signal, Via::Straight);
    made.messages = add(*made.data, Lane::Data, Via::Straight);
    return made;
}

}  // namespace axon::transport
