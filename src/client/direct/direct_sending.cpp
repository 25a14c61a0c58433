// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/direct/direct_sending.hpp"

#include <utility>
#include <vector>

#include "client/connection/send_queue.hpp"
#include "direct/always_relayed.hpp"

namespace axon::client {

bool DirectSending::takes(Outgoing& message) {
    const bool by_path = byPath(message);
    if (auto left = leftBefore(message)) {
        left->by->close("another lease or path takes its place");
        fallBack(std::move(left));
    }
    return by_path && sendDirect(message);
}

bool DirectSending::sendDirect(Outgoing& message) {
    auto& link = *message.link;
    if (message.path) {
        if (message.path->ended() || link.forget) return true;
        link.by = message.path;
        link.servers = message.servers;
        link.out.begin();
        by_path_[message.head.entity] = message.link;
        message.sendByServers();
        return true;
    }
    // The end of the lease is the end of the path, and nothing of the next one may overtake it by the
    // servers.
    if (message.head.msg_type == kMsgRelease) link.by->close("the entity is released");
    if (link.by->ended()) {
        fallBack(message.link);
        return false;
    }
    switch (message.kind) {
        // Those come by all ways, and count once.
        case Operation::Reset:
            link.by->sendResetSignal(message.head);
            return false;
        case Operation::Clear:
            link.by->sendClearSignal(message.head);
            return false;
        case Operation::ToEntityDataSeq:
            if (link.by->enliven()) lively_();
            link.by->send(direct::Keeping::Droppable, message.head,
                          std::make_shared<const std::string>(std::move(message.bytes)));
            return true;
        case Operation::ToEntity:
            break;
        case Operation::Request:
            return false;
    }
    if (direct::alwaysRelayed(message.head.msg_type)) return false;
    const auto size = message.bytes.size() + kMessageOverhead;
    makeRoomToKeep(link, size);
    if (!link.by) return false;
    const auto bytes = std::make_shared<const std::string>(std::move(message.bytes));
    link.by->send(direct::Keeping::Kept, message.head, bytes);
    link.out.keep(message.head.sequence, size, {message.head, bytes});
    if (link.by->enliven()) lively_();
    return true;
}

/// All that is kept may fall back at the same moment, and must find room on the way to the server. Where it
/// would not, the path that keeps most is given up.
void DirectSending::makeRoomToKeep(DirectLink& link, std::size_t bytes) {
    link.out.acknowledged(link.by->acknowledged.load(std::memory_order_relaxed));
    for (bool looked = false;; looked = true) {
        std::size_t messages = 0, kept = 0;
        std::shared_ptr<DirectLink> most;
        for (const auto& [entity, one] : by_path_) {
            if (looked) one->out.acknowledged(one->by->acknowledged.load(std::memory_order_relaxed));
            messages += one->out.keptMessages();
            kept += one->out.keptBytes();
            if (!most || one->out.keptBytes() > most->out.keptBytes()) most = one;
        }
        if (messages == 0 || (messages < kKeptBounds.messages && kept + bytes <= kKeptBounds.bytes)) return;
        if (!looked) continue;
        most->by->close("the Entity Manager acknowledges too little");
        fallBack(most);
        if (most.get() == &link) return;
    }
}

/// The path is over: what the Entity Manager may not have goes by the servers, before anything else does.
void DirectSending::fallBack(std::shared_ptr<DirectLink> link) {
    std::erase_if(by_path_, [&](const auto& one) { return one.second == link; });
    link->out.acknowledged(link->by->acknowledged.load(std::memory_order_relaxed));
    link->by = nullptr;
    const auto servers = std::exchange(link->servers, nullptr);
    const auto left = link->out.end();
    if (link->forget || !servers) return;
    for (const auto& kept : left)
        servers->send(Operation::ToEntity, kept.message.head, *kept.message.message);
}

void DirectSending::fallBackFromEnded() {
    std::vector<std::shared_ptr<DirectLink>> ended;
    for (const auto& [entity, link] : by_path_)
        if (link->by->ended()) ended.push_back(link);
    for (auto& link : ended) fallBack(std::move(link));
}

/// The link of an earlier path of the entity, which falls back before this message; mostly null.
std::shared_ptr<DirectLink> DirectSending::leftBefore(const Outgoing& message) const {
    if (by_path_.empty()) return nullptr;
    const auto found = by_path_.find(message.head.entity);
    return found == by_path_.end() || (found->second == message.link && !message.path) ? nullptr
                                                                                       : found->second;
}

}  // namespace axon::client
