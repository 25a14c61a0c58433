// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <functional>
#include <memory>
#include <string>
#include <unordered_map>

#include "client/base/lanes.hpp"
#include "client/base/server_link.hpp"
#include "client/direct/direct_links.hpp"

namespace axon::client {

/// A message of the core's on its way out.
struct Outgoing {
    Operation kind;
    Header head;
    std::string bytes;
    std::shared_ptr<DirectLink> link;  ///< of the entity, where it offers one (DirectLinks::linkOf)
    /// Of the session in which it was put, null if there was none: it goes by no other one, since what was
    /// put before it may be lost with its session.
    std::shared_ptr<const DataLane> servers;
    std::shared_ptr<DirectPath> path = {};  ///< of a mark: taken when it has been sent

    void sendByServers() {
        if (servers) servers->send(kind, head, std::move(bytes));
    }
};

/// Which way each message of a client takes: through the servers, or over the direct path of its entity (ADR
/// 0021).
///
/// Where in the flow: between SessionCore and the connections; DirectLinks says which paths there are.
/// Messages come in the order of sending. What a path has not acknowledged when it is over goes by the
/// servers of its session before anything else of that entity. Threads: none of its own, not thread-safe; its
/// owner confines it, as `out` and `by` of the links. Failure: a path that breaks is noticed by the next
/// message for its entity, and by fallBackFromEnded(). Bound: kKeptBounds.
class DirectSending {
  public:
    /// `lively`: a path was idle and is not: let it beat at once.
    explicit DirectSending(std::function<void()> lively) : lively_(std::move(lively)) {}

    /// Whether a path is concerned: where not, takes() is false and does nothing.
    bool concerns(const Outgoing& message) const { return byPath(message) || leftBefore(message); }
    /// Takes the next of all messages. True: it was sent, or need not be sent. False: send it through the
    /// servers now. Moves from `message`.
    bool takes(Outgoing& message);
    /// A path has ended: what was not acknowledged is sent.
    void fallBackFromEnded();

  private:
    static bool byPath(const Outgoing& message) {
        return message.link && (message.path || message.link->out.direct());
    }
    std::shared_ptr<DirectLink> leftBefore(const Outgoing& message) const;
    bool sendDirect(Outgoing& message);
    void makeRoomToKeep(DirectLink& link, std::size_t bytes);
    void fallBack(std::shared_ptr<DirectLink> link);

    const std::function<void()> lively_;
    std::unordered_map<std::string, std::shared_ptr<DirectLink>>
        by_path_;  // by entity, links whose messages go by a path
};

}  // namespace axon::client
