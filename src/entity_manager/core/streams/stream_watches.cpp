// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/streams/stream_watches.hpp"

#include <algorithm>

namespace axon::entity_manager {

Result<std::vector<StreamWatches::Switch>> StreamWatches::watch(const std::string& client,
                                                                const std::vector<std::string>& streams,
                                                                const std::string& keep) {
    const auto wanted = streams.empty() ? std::vector<std::string>{""} : streams;
    const auto at = streams_.find(client);
    const std::size_t now = at == streams_.end() ? 0 : at->second.size();
    if (now + wanted.size() > kMaxStreams)
        return Refusal{
            RefusalCode::Overloaded,
            "A client may watch " + std::to_string(kMaxStreams) + " streams by name. Name none to watch all.",
            {}};
    std::vector<Switch> switches;
    if (at == streams_.end()) {
        if (streams_.size() >= kMaxWatchers) {
            const auto oldest = std::find_if(order_.begin(), order_.end(),
                                             [&](const std::string& watcher) { return watcher != keep; });
            switches = forget(std::string(*oldest));
        }
        order_.push_back(client);
    }
    for (const auto& stream : wanted)
        if (streams_[client].insert(stream).second && ++count_[stream] == 1)
            switches.push_back({stream, true});
    return switches;
}

std::vector<StreamWatches::Switch> StreamWatches::unwatch(const std::string& client,
                                                          const std::vector<std::string>& streams) {
    std::vector<Switch> switches;
    const auto at = streams_.find(client);
    if (at == streams_.end()) return switches;
    const auto ended =
        streams.empty() ? std::vector<std::string>(at->second.begin(), at->second.end()) : streams;
    for (const auto& stream : ended) {
        if (at->second.erase(stream) == 0) continue;
        if (--count_[stream] > 0) continue;
        count_.erase(stream);
        switches.push_back({stream, false});
    }
    if (at->second.empty()) {
        std::erase(order_, client);
        streams_.erase(at);
    }
    return switches;
}

std::vector<StreamWatches::Switch> StreamWatches::present() const {
    std::vector<Switch> switches;
    for (const auto& [stream, count] : count_) switches.push_back({stream, true});
    return switches;
}

std::vector<std::string> StreamWatches::watchersOf(std::string_view stream, const std::string& also) const {
    std::vector<std::string> clients;
    if (!also.empty()) clients.push_back(also);
    for (const auto& [client, streams] : streams_)
        if (client != also && (streams.contains(std::string(stream)) || streams.contains("")))
            clients.push_back(client);
    return clients;
}

}  // namespace axon::entity_manager
