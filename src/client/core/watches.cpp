// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/watches.hpp"

#include <axon/messages.pb.h>

#include <algorithm>

#include "client/core/entities.hpp"

namespace axon::client {

Result<void> Watches::watch(const std::string& entity, const std::vector<std::string>& streams) {
    if (!parts_.context.connected) return CoreContext::notConnected();
    const auto known = parts_.entities.entity(entity);
    if (!known) return known.refusal();
    auto& counts = watches_[entity];
    if (streams.empty()) ++counts[""];
    for (const auto& stream : streams) ++counts[stream];
    send(entity);
    return {};
}

void Watches::unwatch(const std::string& entity, const std::vector<std::string>& streams) {
    const auto found = watches_.find(entity);
    if (found == watches_.end()) return;
    auto& counts = found->second;
    std::vector<std::string> off;
    const auto drop = [&](const std::string& stream) {
        const auto count = counts.find(stream);
        if (count == counts.end() || --count->second > 0) return;
        counts.erase(count);
        off.push_back(stream);
    };
    if (streams.empty()) drop("");
    for (const auto& stream : streams) drop(stream);
    if (counts.empty()) watches_.erase(found);
    if (off.empty() || !parts_.context.connected || !parts_.entities.isThere(entity)) return;
    proto::ToEntity body;
    auto& watch = *body.mutable_watch();
    watch.set_on(false);
    for (const auto& stream : off) {
        if (!stream.empty()) watch.add_streams(stream);
    }
    parts_.context.send(entity, kMsgWatch, {}, body);
    // Switching "all" off takes the single ones with it.
    if (std::find(off.begin(), off.end(), "") != off.end()) send(entity);
}

void Watches::send(const std::string& entity) {
    const auto found = watches_.find(entity);
    if (found == watches_.end()) return;
    proto::ToEntity body;
    auto& watch = *body.mutable_watch();
    watch.set_on(true);
    if (found->second.count("") == 0) {
        for (const auto& [stream, count] : found->second) watch.add_streams(stream);
    }
    parts_.context.send(entity, kMsgWatch, {}, body);
}

void Watches::sendAll() {
    for (const auto& [entity, streams] : watches_) {
        if (parts_.entities.isThere(entity)) send(entity);
    }
}

}  // namespace axon::client
