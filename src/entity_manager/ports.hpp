// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/life_signs.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"
#include "entity_manager/journal_record.hpp"

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
    LifeSigns::Gap gap;
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
    /// Signal lane. Idempotent by generation: the EI calls the application once per generation.
    /// Any thread; never blocks, takes no lock that data holds. Does nothing when the link is down (the EI
    /// has stopped by itself then).
    virtual void stop(std::uint32_t generation, StopCause cause) = 0;
    /// Whether a task runs: heartbeat period and watchdog of the link (safety.md: 250 ms and 500 ms).
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
    /// To another entity: head.entity is its UUID, and the server fills in head.sender. Not delivered: comes back as
    /// onPeerRefusal. Lane::Signal for what the next one repeats (beats): that may be left out without a word.
    virtual void sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) = 0;
    /// Stream samples and raw data: may be dropped, oldest first.
    virtual void sendToClientDataSeq(const Header& head, const proto::ToClient& message) = 0;
};

/// What must survive a restart: small named values. The daemon keeps a file for each.
class Storage {
  public:
    virtual ~Storage() = default;
    virtual std::optional<std::string> load(std::string_view key) = 0;
    /// The disk has it when it returns: for the start, before anything waits for the strand.
    virtual void save(std::string_view key, std::string_view value) = 0;
    /// The disk has it soon, and it is tried again until it has: nobody waits for that, and what ends the
    /// process before is as if it had not been called.
    virtual void keep(std::string_view key, std::string_view value) { save(key, value); }
    /// A next life does not find it, however this one ends. Needs no room on the disk, and does not wait for
    /// it.
    virtual void forget(std::string_view key) = 0;
};

/// The record of what was decided, append-only and bounded: the oldest entries go first (ADR 0013).
class Journal {
  public:
    virtual ~Journal() = default;
    /// A dispatch would outlive a kill of this process when it returns; the others are written soon, and a
    /// stop does not wait for them. False: it is not written, and what must not happen unrecorded may not
    /// happen.
    virtual bool append(const JournalRecord& record) = 0;
    /// All entries that are kept, oldest first. Called once, before the first append().
    virtual void replay(const std::function<void(const JournalRecord&)>& each) = 0;
};

/// Where resources (files) arrive. Names have been checked before any of these is called.
class ResourceStore {
  public:
    virtual ~ResourceStore() = default;
    /// How many bytes of exactly this content (same hash and size) are here already: 0 to offer.size().
    virtual Result<std::uint64_t> begin(const proto::ResourceOffer& offer) = 0;
    /// `offset` continues where the last write of this transfer ended. Nobody waits for the disk.
    virtual Result<void> write(std::string_view transfer_id, std::uint64_t offset,
                               std::string_view content) = 0;
    /// Bytes that write() has taken and that are not in their file yet; or why they never will be.
    virtual Result<std::uint64_t> waiting(std::string_view) const { return std::uint64_t{0}; }
    /// `changed` is called, on any thread, when waiting() of a transfer has. Set before the first begin(). Where
    /// nothing ever waits it is not called.
    virtual void onWritten(std::function<void()>) {}
    /// When nothing waits any more. Checks size and SHA-256 and puts the file in its place; its path, or HASH_MISMATCH (what arrived is
    /// deleted).
    virtual Result<std::string> finish(std::string_view transfer_id) = 0;
    /// Keeps what has arrived, so that a later offer of the same content resumes.
    virtual void suspend(std::string_view transfer_id) = 0;
    /// Who could resume what is suspended has gone: it is deleted.
    virtual void dropSuspended() = 0;
    /// Deletes a resource that is not savable after its task.
    virtual void remove(std::string_view service, std::string_view resource) = 0;
    /// Path and facts of a savable resource that is already here.
    virtual std::optional<std::string> find(std::string_view service, std::string_view resource) = 0;
};

}  // namespace axon::entity_manager
