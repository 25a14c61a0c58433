// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/liveness.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"
#include "entity_manager/ports/journal_record.hpp"
#include "entity_manager/ports/later.hpp"
#include "entity_manager/ports/resource_places.hpp"

namespace axon::proto {
class BasicProfile;
class EmToEi;
class ResourceOffer;
class ToClient;
class ToEntity;
}  // namespace axon::proto

namespace axon::entity_manager {

/// How near the dead-man of one hop came to its end: the longest silence of the last minute.
struct HopMargin {
    std::string hop;  ///< who watches whom
    Liveness::Gap gap;
};

/// How the link to the robot application has ended, which decides whether anybody can say that its robot was
/// stopped.
enum class LinkEnd : std::uint8_t {
    GoodBye,  ///< its stop callback has returned, and it said so
    Closed,   ///< by the application or its death, or because it sent nonsense: no word of its robot
    Silent,   ///< nothing was closed and nothing came: it may live, and move its robot
};

// What EntityManagerCore needs from the world, each an interface that the daemon, the benchmark and a
// simulation implement in their own way. The core calls them from its strand; none may call back into the
// core before returning.

/// The link to the Entity Interfacer (thesis: BackEndInterface). Implementations: BackEndInterface over TCP;
/// an in-memory one in tests and benchmarks.
class BackEndPort {
  public:
    virtual ~BackEndPort() = default;
    /// Data lane, in order. When the link's bounded queue is full the link is closed (control overflow), and
    /// the core learns of it as onLinkDown. False when the message is larger than a frame: nothing was sent.
    virtual bool send(const proto::EmToEi& message) = 0;
    /// Signal lane. Idempotent by generation: the EI calls the application once per generation. A drill has a
    /// number of its own (StopGenerations::drill) in its place, and the EI answers it without the
    /// application. Any thread; never blocks, takes no lock that data holds. Does nothing when the link is
    /// down (the EI has stopped by itself then).
    virtual void stop(std::uint32_t generation, StopCause cause) = 0;
    /// Whether a task runs: heartbeat period and watchdog of the link (safety.md, "Watchdogs": 250 ms
    /// and 500 ms).
    virtual void setBusy(bool busy) = 0;
    /// Of both directions of the link, as far as they have been measured.
    virtual std::vector<HopMargin> margins() const { return {}; }
};

/// The way to the entity server and through it to clients (thesis: EntityCommunicator, SessionPrx).
class ServerPort {
  public:
    virtual ~ServerPort() = default;
    /// From now on try for ever, with backoff, to have a session; onServerUp and onServerDown report.
    /// Not wanted: leave, and stop trying.
    virtual void wantConnection(bool wanted) = 0;
    virtual void sendBasicPrfl(const Registration& registration, const proto::BasicProfile& profile) = 0;
    virtual void sendStatus(const EntityStatus& status) = 0;
    /// head.sender.id is the recipient, empty = everybody who watches. Lane::Signal for receipts.
    virtual void sendToClient(Lane lane, const Header& head, const proto::ToClient& message) = 0;
    /// To another entity: head.entity is its UUID, and the server fills in head.sender. Not delivered: comes
    /// back as onPeerRefusal. Lane::Signal for what the next one repeats (beats): that may be left out
    /// without a word.
    virtual void sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) = 0;
    /// Stream samples and raw data: may be dropped, oldest first.
    virtual void sendToClientDataSeq(const Header& head, const proto::ToClient& message) = 0;
};

/// The same, as what chooses between two ways has it (direct_desk.hpp).
class RelayedWay : public ServerPort {
  public:
    /// An axon.proto.ToClient that has been written already; otherwise as sendToClient.
    virtual void sendToClientBytes(Lane lane, const Header& head, const std::string& message) = 0;
};

inline constexpr const char* kUuidKey = "uuid";  ///< of the entity's UUID in the Storage

/// What must survive a restart: small named values. The daemon keeps a file for each.
class Storage {
  public:
    virtual ~Storage() = default;
    // For the start, before anything waits for the strand: these two wait for the disk.
    virtual std::optional<std::string> load(std::string_view key) = 0;
    virtual void save(std::string_view key, std::string_view value) = 0;
    /// Does not wait. The disk has it soon, and it is tried again until it has; what ends the process before
    /// is as if it had not been called.
    virtual void keep(std::string_view key, std::string_view value) { save(key, value); }
    /// Does not wait. Soon a next life does not find it; needs no room on the disk, and goes before all that
    /// is to be kept.
    virtual void forget(std::string_view key) = 0;
};

/// The record of what was decided, append-only and bounded: the oldest entries go first (ADR 0013). Nothing
/// here but replay() waits for the disk.
class Journal {
  public:
    virtual ~Journal() = default;
    /// Written soon. False: it is not going to be.
    virtual bool append(const JournalRecord& record) = 0;
    /// The entry that goes before a task. True: it outlives a kill of this process from now on. False: it is
    /// not written, and the task may not begin.
    virtual Later<bool> appendDispatch(const JournalRecord& record) { return append(record); }
    /// Not an entry: it may come too often, and nothing follows from it in a next life. For whoever records
    /// more than a journal keeps (AuditedJournal).
    virtual void mention(const JournalRecord&) {}
    /// `come` is called, on any thread, when an answer that was not there at once has come.
    virtual void onAnswer(std::function<void()>) {}
    /// All entries that are kept, oldest first. Called once, before the first append().
    virtual void replay(const std::function<void(const JournalRecord&)>& each) = 0;
};

/// Where resources (files) arrive. Names have been checked before any of these is called. No call waits for
/// the disk. The calls about one transfer, and those about one resource, take effect in their order.
class ResourceStore {
  public:
    virtual ~ResourceStore() = default;
    /// How many bytes of exactly this content (same hash and size) are here already, from an earlier transfer
    /// of the same owner: 0 to offer.size().
    virtual Later<Result<std::uint64_t>> begin(const proto::ResourceOffer& offer,
                                               const std::string& owner) = 0;
    /// After begin() has answered. `offset` continues where the last write of this transfer ended.
    virtual Result<void> write(std::string_view transfer_id, std::uint64_t offset,
                               std::string_view content) = 0;
    /// Bytes that write() has taken and that are not in their file yet; or why they never will be.
    virtual Result<std::uint64_t> waiting(std::string_view) const { return std::uint64_t{0}; }
    /// `come` is called, on any thread, when an answer that was not there at once has come, or waiting() of a
    /// transfer has changed.
    virtual void onAnswer(std::function<void()>) {}
    /// When nothing waits any more: compares size and SHA-256. Where the robot application may look at the
    /// file, or HASH_MISMATCH (what arrived is deleted).
    virtual Later<Result<std::string>> check(std::string_view transfer_id) = 0;
    /// After check(), of what the robot application has accepted: it takes the place of the file that was
    /// there. Where it lies from now on.
    virtual Later<Result<std::string>> place(std::string_view transfer_id) = 0;
    /// Keeps what has arrived, so that a later offer of the same content resumes: for a while, and for its
    /// owner.
    virtual void suspend(std::string_view transfer_id) = 0;
    /// Deletes what has arrived.
    virtual void drop(std::string_view transfer_id) = 0;
    /// Deletes a resource that is not savable after its task.
    virtual void remove(std::string_view service, std::string_view resource) = 0;
    /// Path of a savable resource that was here when this life began or has come since.
    virtual std::optional<std::string> find(std::string_view service, std::string_view resource) = 0;
    /// Where the resources of a services profile lie, in the order of the queries. What is placed and removed
    /// from now on goes by it.
    virtual Later<std::vector<ResourcePlace>> locate(const ResourceRoots& /*roots*/,
                                                     std::vector<ResourceQuery> queries) {
        std::vector<ResourcePlace> places;
        for (const auto& query : queries) {
            auto path = query.savable ? find(query.service, query.resource) : std::nullopt;
            auto& place = places.emplace_back();
            place.there = path.has_value();
            place.path = std::move(path).value_or(std::string());
        }
        return places;
    }
    /// Which of these files are not there.
    virtual Later<std::vector<std::string>> absent(std::vector<std::string>) {
        return std::vector<std::string>{};
    }
};

}  // namespace axon::entity_manager
