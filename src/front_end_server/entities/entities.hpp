// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <unordered_map>
#include <unordered_set>
#include <vector>

#include "common/clock.hpp"
#include "common/other_servers.hpp"
#include "common/routed.hpp"
#include "common/snapshot_table.hpp"
#include "front_end_server/entities/missed_news.hpp"

namespace axon::front_end_server {

/// The front-end server's copy of what entities there are, as the entity servers tell it.
///
/// An entity belongs to the entity server that announced its joining last. What another one says of it is
/// not taken, but remembered as a dispute: when the entity leaves, the others are to be asked whether it is
/// there after all. What a server that is gone says late is not taken either. A status arrives over the topic
/// and straight, and the copy with the highest number counts. A server on whose entities a task runs is
/// watched closely. Whether all that a server published has come says MissedNews; the only entity server is
/// never asked.
///
/// Threads: serverOf(), nameOf(), has(), each(), targets() and known() from any, without a lock: they read
/// immutable tables, of which each lane has its own references. The rest is not thread-safe: its owner's
/// mutex guards it. Failure: none.
class Entities {
  public:
    /// Replaced whole.
    struct Record {
        Registration registration;
        std::shared_ptr<const std::string> profile;  ///< never null
        EntityStatus status;
        bool heard = false;       ///< the status: it comes after the profile
        std::int64_t number = 0;  ///< of the status, as its server counts
    };
    using RecordRef = std::shared_ptr<const Record>;
    using Records = std::unordered_map<std::string, RecordRef>;
    /// What clients are to be told of an entity, or of one that has left.
    struct News {
        Presence presence;
        RecordRef record;
        bool disputed;  ///< ask all servers
    };
    struct Left {
        std::vector<RecordRef> records;
        bool disputed;  ///< ask all servers
    };

    /// `alone`: there is but one entity server. `servers` outlives it.
    Entities(bool alone, OtherServers::Group& servers, const Clock& clock);

    /// Which entity server has it; null where the entity is not known.
    std::shared_ptr<const std::string> serverOf(const std::string& entity, Lane lane) const;
    /// What it is called; null where the entity is not known.
    std::shared_ptr<const std::string> nameOf(const std::string& entity, Lane lane) const;
    bool has(const std::string& entity, Lane lane) const {
        return known_.find(entity, index(lane)) != nullptr;
    }
    /// How many a signal to it reaches; empty = all.
    std::size_t targets(const std::string& entity) const;
    std::size_t known() const { return known_.size(); }

    /// Calls `use(record)` for each, of which server and name are up to date; without a lock.
    template <class Use>
    void each(Lane lane, Use&& use) const {
        known_.each(use, index(lane));
    }

    const Records& records() const { return records_; }
    /// Null where it is not known.
    RecordRef find(const std::string& entity) const;
    /// None where nothing is new.
    std::optional<News> update(Presence presence, Registration registration, std::string_view profile);
    /// `number`: grows with each of its server; 0 = there is one copy. The record before; null where it is
    /// not to be told.
    RecordRef update(const EntityStatus& status, std::int64_t number, Via via);
    /// All entities of this server have left, but those of the list.
    Left forget(const std::string& server, const std::unordered_set<std::string>& but);

    MissedNews& missed() { return missed_; }

  private:
    static constexpr std::size_t index(Lane lane) { return static_cast<std::size_t>(lane); }
    void hear(const std::string& server);
    RecordRef takeOut(Records::iterator found);
    void countBusy(const Record* before, const Record* now);

    const bool alone_;
    OtherServers::Group& servers_;
    const Clock& clock_;
    SnapshotTable<RecordRef, 2>
        known_;  // by entity, for each lane; of these only server and name are up to date
    Records records_;
    MissedNews missed_;
    // Entities that another server than the record's has spoken of.
    std::unordered_set<std::string> disputed_;
};

}  // namespace axon::front_end_server
