// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/streams/streams.hpp"

#include <axon/link.pb.h>

#include "entity_manager/ports/core_settings.hpp"

namespace axon::entity_manager {

namespace {
constexpr std::size_t kStreamName = 255;
}

Result<void> Streams::watch(const std::string& client, const proto::Watch& watch) {
    const std::vector<std::string> streams(watch.streams().begin(), watch.streams().end());
    for (const auto& stream : streams)
        if (stream.size() > kStreamName)
            return Refusal{RefusalCode::BadName, "A stream's name has at most 255 bytes.", {}};
    if (!watch.on()) {
        tellApplication(watches_.unwatch(client, streams));
        return {};
    }
    const auto switches = watches_.watch(client, streams, holderId());
    if (!switches) return switches.refusal();
    tellApplication(switches.value());
    return {};
}

void Streams::tellApplication(const std::vector<StreamWatches::Switch>& switches) {
    if (!turn_.linked()) return;  // what is on is told when the application has come
    proto::EmToEi message;
    const auto tell = [&](const StreamWatches::Switch& change) {
        message.mutable_stream()->set_stream(change.stream);
        message.mutable_stream()->set_on(change.on);
        turn_.toApplication(message);
    };
    for (const auto& change : switches) {
        if (change.stream.empty()) {
            if (!change.on && turn_.holder() != nullptr)
                continue;  // who is sent all streams counts as one who watches them
            all_off_ = !change.on;
        }
        tell(change);
        // An application may take it for a switch of every stream.
        if (change.stream.empty() && !change.on)
            for (const auto& named : watches_.present()) tell(named);
    }
}

void Streams::pass(proto::StreamSample& sample) {
    const auto clients = watches_.watchersOf(sample.stream(), holderId());
    if (clients.empty() || !turn_.connected()) {
        ++turn_.count().undelivered;
        return;
    }
    message_.mutable_sample()->Swap(&sample);
    Sender to;
    for (const auto& client : clients) {
        to.id = client;
        turn_.tellDroppable(to, kMsgStream, message_);
    }
}

std::string Streams::holderId() const {
    const auto* holder = turn_.holder();
    return holder != nullptr ? holder->id : std::string();
}

}  // namespace axon::entity_manager
