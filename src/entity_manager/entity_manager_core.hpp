// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/routed.hpp"
#include "entity_manager/lease_book.hpp"
#include "entity_manager/ports.hpp"
#include "entity_manager/stop_counter.hpp"

namespace axon::proto {
class EiToEm;
}

namespace axon::entity_manager {

/// Settings of one Entity Manager that its behaviour depends on (docs/reference/configuration.md).
struct EntityManagerCoreSettings {
    std::string application;  ///< name of the robot application it is for
    Duration server_watchdog_busy = std::chrono::milliseconds{250};  ///< 50 ms to 2 s
    Duration server_watchdog_idle = std::chrono::seconds{10};
    Duration lease_grace =
        std::chrono::seconds{5};  ///< how long a lease outlives the loss of its holder; 0 = not at all
    std::size_t task_queue_bound = 64;
    std::uint64_t resource_bytes_max = 1ULL << 30U;  ///< of one upload
    std::uint64_t resource_window = 512 * 1024;      ///< bytes a client may send ahead
    Duration answer_within =
        std::chrono::seconds{10};  ///< what the robot application is asked; then TIMED_OUT
    Duration profiles_within =
        std::chrono::seconds{3};  ///< after the link is up; then what has not been uploaded is missing
    std::string uuid = {};        ///< to take where the state has none; empty: a random one
};

/// What has been dropped without an answer, because there is nobody to answer or because the answer would be
/// a flood.
struct CoreCounters {
    std::uint64_t unexpected = 0;  ///< facts without a row, and reports of tasks that are not known
    std::uint64_t malformed = 0;  ///< messages that could not be read, or whose header says what they are not
    std::uint64_t anonymous = 0;  ///< messages without a sender
    std::uint64_t undelivered =
        0;  ///< texts, raw data and samples that nobody held or watched the entity for
    std::uint64_t raw_refused = 0;    ///< raw data of somebody who may not send it
    std::uint64_t peer_refusals = 0;  ///< messages to other entities that did not arrive
    std::uint64_t unrecorded = 0;     ///< entries that the journal did not take, and refusals above its rate
};

/// The Entity Manager without its sockets: states, latch, profiler, lease, queue (ADR 0007,
/// docs/design/state-machine.md).
///
/// Where in the flow: between the entity server (ServerPort) and the robot application's Entity Interfacer
/// (BackEndPort). An event goes in as one call of on…(); effects leave through the ports before the call
/// returns. States: the nine of EntityState plus the latch flag; the table is state_table.hpp. Threads: one
/// strand only. What may be called from elsewhere is StopCounter and BackEndPort::stop. Failure: an event
/// that the table does not list for the present state is refused with WRONG_STATE to whoever sent it;
/// malformed bytes are refused with MALFORMED. Nothing that arrives from outside can make it throw.
class EntityManagerCore {
  public:
    /// Without a journal a task id is known for this life only.
    EntityManagerCore(EntityManagerCoreSettings settings, const Clock& clock, RandomSource& random,
                      BackEndPort& back_end, ServerPort& server, Storage& storage, ResourceStore& resources,
                      StopCounter& stop_counter, Journal* journal = nullptr);
    ~EntityManagerCore();
    EntityManagerCore(const EntityManagerCore&) = delete;
    EntityManagerCore& operator=(const EntityManagerCore&) = delete;

    /// From now on it wants a session with the server, whatever becomes of the robot application: until that
    /// has uploaded valid profiles the entity is registered there as one that is not ready (ADR 0023).
    void start();

    // From the link to the robot application.
    void onLinkUp();
    /// It has been looked for in vain: what was found instead, for whoever asks why the entity is UNAV.
    void onApplicationSought(const std::string& finding);
    void onLinkDown(const std::string& reason, LinkEnd end = LinkEnd::Closed);
    void onLinkMessage(const proto::EiToEm& message);
    /// The same without a copy of bulk data; the message is left in some valid state.
    void onLinkMessage(proto::EiToEm&& message);

    // From the server. `bytes` is an axon.proto.ToEntity.
    void onServerUp();
    void onServerDown(const std::string& reason);
    /// Or from another entity, whose UUID is head.sender.id then.
    void onClientMsg(const Header& head, std::string_view bytes);
    /// What was sent to another entity (ServerPort::sendToPeer) did not arrive; `head` is that of the
    /// message.
    void onPeerRefusal(const Header& head, const Refusal& refusal);
    /// The signal thread has forwarded the stop to the EI already, under `generation` of the StopCounter.
    void onStopSignal(const Header& head, StopCause cause, std::uint32_t generation);
    /// Likewise a drill, under `number` of StopCounter::drill. It measures the way of a stop and changes
    /// nothing.
    void onDrill(const Header& head, std::uint32_t number);
    /// A stop that has been seen before, under `generation`: its receipt is told again.
    void onStopRepeated(const Header& head, StopCause cause, std::uint32_t generation);
    void onResetSignal(const Header& head);
    void onClearSignal(const Header& head);
    void onClientUpdate(const Header& head, ClientChange change);
    void onServerHeartbeat();

    /// Re-reads nothing, changes nothing but what is due: watchdog, reservations, grace, places, not_after.
    /// Call at nextDeadline().
    void onTimer();
    TimePoint nextDeadline() const;

    /// ResourceStore::onAnswer() or Journal::onAnswer() has called.
    void onStored();

    /// Where the holder may send stops as datagrams (docs/reference/datagrams.md); told with each grant from
    /// now on.
    void offerDatagrams(std::string endpoint);
    /// Where the holder may open a direct path (docs/reference/direct.md): "host:port" of each lane, both
    /// empty = nowhere; told with each grant from now on.
    void offerDirect(std::string data, std::string signal);

    /// The operator of the daemon wants it to end: stop, tell the server, leave.
    void shutDown();

    EntityState state() const;
    bool latched() const;
    /// Whether it counts on a session with the server; a silent one it has given up.
    bool serverUp() const;
    const std::string& uuid() const;
    /// The present lease; null when nobody holds the entity.
    const LeaseBook::Held* held() const;
    EntityStatus status() const;
    const CoreCounters& counters() const;
    /// Something for the operator's log: the server has been silent for a good part of what its watchdog
    /// allows. Once a minute at most; empty otherwise. Look after onTimer().
    std::string takeWarning();
    /// Likewise, of what is as it should be.
    std::string takeNews();

  private:
    class Machine;
    std::unique_ptr<Machine> machine_;
};

}  // namespace axon::entity_manager
