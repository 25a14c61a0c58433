// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <string_view>

#include "axon/global.hpp"
#include "axon/types.hpp"
#include "client/base/server_link.hpp"
#include "client/base/session_observer.hpp"
#include "client/base/signal_marks.hpp"
#include "client/core/check_outs.hpp"
#include "client/core/commands.hpp"
#include "client/core/core_context.hpp"
#include "client/core/entities.hpp"
#include "client/core/leases.hpp"
#include "client/core/requests.hpp"
#include "client/core/runs.hpp"
#include "client/core/server_watch.hpp"
#include "client/core/tasks.hpp"
#include "client/core/watches.hpp"
#include "common/clock.hpp"
#include "common/ids.hpp"

namespace axon::proto {
class CheckOutReply;
class EntityStatus;
class Reply;
}  // namespace axon::proto

namespace axon::client {

/// A client's session without its connections: entities, leases, tasks, runs, requests (ADR 0007).
/// Stops are StopDesk's.
///
/// Where in the flow: the first station. An event of the server goes in as one call of on…(), a wish of the
/// user as one of the other calls; messages leave through ServerLink, news through SessionObserver, answers
/// through the `done` of the request, all before the call returns (answers mostly later). Every request is
/// answered exactly once: granted, refused, TIMED_OUT, or NOT_CONNECTED and OUTCOME_UNKNOWN when the
/// connection is lost. `done` must not call back into the core.
///
/// It dispatches; what it knows is kept by its parts, each with its own state: Entities, Leases, CheckOuts,
/// Tasks, Runs, Commands, Watches, Requests, ServerWatch. Wishes that concern one of them go to it directly:
/// core.tasks().run(…).
///
/// States: connected or not; each entity held, orphaned or neither. On a lost connection entities are
/// forgotten until the server tells of them again, requests are answered, and leases become orphaned: each is
/// resumed with its key as soon as its entity is there again (onResumed), and its tasks are asked after. It
/// is lost (onLost, tasks Unknown) when its Entity Manager refuses, its time is up, or it has no grace. A run
/// shares the fate of its master's lease as a task does; its master is asked after it.
///
/// Threads: none of its own, not thread-safe; the owner confines it. Failure: refusals. Malformed bytes are
/// counted and dropped.
class SessionCore {
  public:
    SessionCore(SessionCoreSettings settings, const Clock& clock, RandomSource& random, ServerLink& link,
                SessionObserver& observer, SignalMarks& marks);
    SessionCore(const SessionCore&) = delete;  // its parts refer to each other
    SessionCore& operator=(const SessionCore&) = delete;

    // From the server. Profiles may come before onConnected: the handshake's reply can be overtaken by them.
    /// `watchdogs`: of the server, for this client.
    void onConnected(const Sender& self, int entities, const Watchdogs& watchdogs = {});
    /// `for_good`: there will be no other connection, so nothing is kept.
    void onDisconnected(const std::string& reason, bool for_good = false);
    void onProfile(Presence presence, const Registration& registration, std::string_view profile);
    void onStatus(const EntityStatus& status);
    /// `bytes` is an axon.proto.ToClient; receipts in it are not for this object. `of_server`: the server has
    /// brought it, and lives.
    void onEntityMsg(const Header& head, std::string_view bytes, bool of_server = true);
    /// newRefusalMsg: `head` repeats the sequence and entity of what this client sent.
    void onRefusal(const Header& head, const Refusal& refusal);
    void onServerText(int code, const std::string& text);
    void onServerHeartbeat() { server_.heard(); }

    // What is due, at nextDeadline(): requests that nobody answered.
    void onTimer();
    TimePoint nextDeadline() const;
    // The beat that says that this client lives, apart from the above: its owner may have to ask somebody
    // first.
    void onHeartbeatTimer() { server_.onTimer(); }
    TimePoint nextHeartbeat() const { return server_.nextBeat(); }
    /// The server has been silent for longer than it may be.
    bool serverSilent() const { return server_.silent(); }
    TimePoint serverDeadline() const { return server_.deadline(); }

    // What is known.
    bool connected() const { return context_.connected; }
    const Sender& self() const { return context_.self; }
    /// Every entity that the server promised at the connection has been told of.
    bool complete() const { return connected() && entities_.complete(); }
    /// A task or a run of this client is not final, or an entity that it holds is busy: heartbeats are fast.
    bool busy() const { return server_.busy(); }
    std::uint64_t malformed() const { return context_.malformed; }
    std::size_t pendingRequests() const { return requests_.size(); }

    const Entities& entities() const { return entities_; }
    Entities& entities() { return entities_; }
    const Leases& leases() const { return leases_; }
    Leases& leases() { return leases_; }
    CheckOuts& checkOuts() { return check_outs_; }
    const Tasks& tasks() const { return tasks_; }
    Tasks& tasks() { return tasks_; }
    const Runs& runs() const { return runs_; }
    Runs& runs() { return runs_; }
    Watches& watches() { return watches_; }
    Commands& commands() { return commands_; }

  private:
    void onCheckOutReply(const Header& head, const proto::CheckOutReply& reply);
    void onReply(const Header& head, const proto::Reply& reply);
    void onStatusMsg(const Header& head, const proto::EntityStatus& status);
    /// The servers have refused a request that waits.
    void onRequestRefused(Requests::Key key, const std::string& entity, const Refusal& refusal);
    void onRequestDue(Requests::Key key);

    CoreContext context_;
    Requests requests_;
    Entities entities_;
    Leases leases_;
    CheckOuts check_outs_;
    Tasks tasks_;
    Runs runs_;
    Watches watches_;
    Commands commands_;
    const CoreParts parts_;
    ServerWatch server_;
};

}  // namespace axon::client
