// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <deque>
#include <map>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "common/result.hpp"

namespace axon::entity_manager {

/// Who watches which stream of the entity. The stream "" stands for all of them.
///
/// Threads: the core's strand. Bounded: kMaxStreams streams for each client, else OVERLOADED; of kMaxWatchers
/// clients the one that began first makes room for the next. The server tells of watchers that are gone; one
/// that it does not tell of, because it was killed itself, is known by its age only.
class StreamWatches {
  public:
    static constexpr std::size_t kMaxWatchers = 256;
    static constexpr std::size_t kMaxStreams = 64;
    /// A stream that the robot application must be told to switch.
    struct Switch {
        std::string stream;
        bool on;
    };

    /// `keep` is a client that does not make room: the holder; empty = nobody.
    Result<std::vector<Switch>> watch(const std::string& client, const std::vector<std::string>& streams,
                                      const std::string& keep = {});
    /// No stream named: none is watched any more.
    std::vector<Switch> unwatch(const std::string& client, const std::vector<std::string>& streams);
    std::vector<Switch> forget(const std::string& client) { return unwatch(client, {}); }
    /// All that are on, for a robot application that has just come.
    std::vector<Switch> present() const;

    /// The clients that watch this stream, `also` among them once when not empty.
    std::vector<std::string> watchersOf(std::string_view stream, const std::string& also) const;

  private:
    std::map<std::string, std::set<std::string>> streams_;  ///< client → streams
    std::deque<std::string> order_;                         ///< the clients, who began first at the front
    std::map<std::string, int> count_;                      ///< stream → watchers
};

}  // namespace axon::entity_manager
