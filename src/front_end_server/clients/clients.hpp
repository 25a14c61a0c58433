// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <memory>
#include <string>
#include <string_view>
#include <unordered_map>

#include "common/routed.hpp"
#include "common/snapshot_table.hpp"
#include "front_end_server/clients/client.hpp"

namespace axon::front_end_server {

using ClientRef = std::shared_ptr<Client>;

/// The clients that are here: by their ids, and by their tokens until their signal lanes are attached.
///
/// A token is for one use, and is void when its client has been removed. Threads: each() and to() from any,
/// without a lock: they read immutable tables, of which each lane has its own references. The rest is not
/// thread-safe: its owner's mutex guards it. Bound: the owner's, who asks size(). Failure: none.
class Clients {
  public:
    using ById = std::unordered_map<std::string, ClientRef>;

    /// Calls `use(client)` for each.
    template <class Use>
    void each(Use&& use) const {
        table_.each(use);
    }
    /// Calls `send(client, outbox)` with the outbox of this lane: for one client, if it is here, or for all
    /// if `recipient` is empty.
    template <class Send>
    void to(Lane lane, const std::string& recipient, Send&& send) const {
        const auto its_lane = static_cast<std::size_t>(lane);
        const auto one = [&](const ClientRef& client) {
            if (lane == Lane::Signal) {
                send(*client, *client->signalOutbox());
            } else {
                send(*client, *client->data);
            }
        };
        if (recipient.empty()) {
            table_.each(one, its_lane);
        } else if (const auto client = table_.find(recipient, its_lane)) {
            one(client);
        }
    }

    void add(const ClientRef& client);
    /// Whose token it is, which is void from now on; null for one that nobody waits for.
    ClientRef takeToken(const std::string& token);
    /// False where it is no longer here.
    bool remove(const ClientRef& client);
    /// Null where it is not here.
    ClientRef find(const std::string& id) const;
    const ById& byId() const { return by_id_; }
    std::size_t size() const { return by_id_.size(); }

  private:
    SnapshotTable<ClientRef, 2> table_;  // by id, for each lane
    ById by_id_;
    std::unordered_map<std::string, std::weak_ptr<Client>> tokens_;
};

}  // namespace axon::front_end_server
