// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/clock.hpp"

namespace Ice {
class Communicator;
}

namespace axon::transport {

class LinkTrust;

/// The two topics between the servers (thesis figures 3.14, 3.15). At IceStorm the number of the contracts
/// follows (contract.hpp).
inline constexpr const char* kFrontEndToEntityTopic = "FrontEndToEntity";
inline constexpr const char* kEntityToFrontEndTopic = "EntityToFrontEnd";

struct StormSettings {
    std::string manager;  ///< "IceStorm/TopicManager:tcp -h 127.0.0.1 -p 10430"
    std::string subscribe_to;
    std::string subscriber;  ///< a stringified proxy, whose identity is the same at each start of this server
    std::vector<std::string> publish_to;
    /// Of a server whose links are under TLS; null: they are plain.
    LinkTrust* links = nullptr;
};

/// Keeps this server's topics and its subscription in IceStorm: looks once a second whether the subscription
/// is still there, and makes topics and subscription again if not. IceStorm may start after the server, be
/// killed and be started again. Messages that are published while it is away are lost; `changed` reports
/// that.
///
/// Every ten seconds it looks for servers of other editions of the contracts at the same IceStorm; `note` is
/// called once for each edition.
///
/// Over TLS, who answers must show a certificate of the kind `storm`, and all calls go over that very
/// connection. What IceStorm says then is believed, also where its topics are.
///
/// The subscription is ordered and for ever: one message at a time, and no message that fails ends it.
/// States: searching ─ changed(publishers) ► found ─ a look failed: changed({}) ► searching. Threads: one of
/// its own, which calls `changed` and `note` and waits for IceStorm, two seconds at most; the destructor
/// joins it and ends the subscription. Destroy it before the communicator.
class StormTopics {
  public:
    /// A publisher for each of `publish_to`, in that order, as stringified proxies; none: they are out of
    /// reach.
    using Changed = std::function<void(const std::vector<std::string>& publishers)>;
    using Note = std::function<void(const std::string& line)>;

    /// Throws std::runtime_error where `manager` is no proxy (misconfiguration).
    StormTopics(StormSettings settings, std::shared_ptr<Ice::Communicator> communicator, const Clock& clock,
                Changed changed, Note note);
    ~StormTopics();

  private:
    class Search;
    std::unique_ptr<Search> search_;
};

}  // namespace axon::transport
