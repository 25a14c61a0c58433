// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <algorithm>
#include <cstdint>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/rights.hpp"
#include "common/routed.hpp"
#include "entity_manager/core/collaboration/teamwork.hpp"
#include "entity_manager/core/inputs/inputs.hpp"
#include "entity_manager/core/journal/journal_writer.hpp"
#include "entity_manager/core/outgoing_messages.hpp"
#include "entity_manager/core/ownership/ownership.hpp"
#include "entity_manager/core/presence/presence.hpp"
#include "entity_manager/core/presence/profiles.hpp"
#include "entity_manager/core/presence/readiness.hpp"
#include "entity_manager/core/request_reader.hpp"
#include "entity_manager/core/services/service_profiler.hpp"
#include "entity_manager/core/services/task_memory.hpp"
#include "entity_manager/core/status_report.hpp"
#include "entity_manager/core/stops/latch.hpp"
#include "entity_manager/core/stops/passed_signals.hpp"
#include "entity_manager/core/stops/stop_ledger.hpp"
#include "entity_manager/core/stops/stop_orders.hpp"
#include "entity_manager/core/streams/holder_channel.hpp"
#include "entity_manager/core/streams/streams.hpp"
#include "entity_manager/core/tasks/tasks.hpp"
#include "entity_manager/core/turn/incident.hpp"
#include "entity_manager/core/turn/lease_book.hpp"
#include "entity_manager/core/turn/state_table.hpp"
#include "entity_manager/core/turn/turn.hpp"
#include "entity_manager/ports/core_settings.hpp"
#include "entity_manager/ports/ports.hpp"
#include "entity_manager/ports/stop_generations.hpp"

namespace axon::entity_manager {

/// The Entity Manager without its sockets: states, latch, profiler, lease, queue (ADR 0007,
/// docs/design/state-machine.md).
///
/// Where in the flow: between the entity server (ServerPort) and the robot application's Entity Interfacer
/// (BackEndPort). An event goes in as one call of on…(); effects leave through the ports before the call
/// returns. States: the nine of EntityState plus the latch flag; the table is state_table.hpp. Threads: one
/// strand only. What may be called from elsewhere is onServerHeartbeat(), StopGenerations and
/// BackEndPort::stop. Failure: an event that the table does not list for the present state is refused with
/// WRONG_STATE to whoever sent it; malformed bytes are refused with MALFORMED. Nothing that arrives from
/// outside can make it throw.
///
/// It finds the row of each event in the state table and passes each action on to whichever part of the state
/// it is about (actions.def), as it does with what the robot application says (reports.def). The parts see
/// each other through Turn and their Others; the core lends some of them the journal, the readiness, the
/// services and the memory of tasks.
class EntityManagerCore final : private Turn,
                                private StopOrders::Others,
                                private Ownership::Others,
                                private Tasks::Others,
                                private Teamwork::Others,
                                private Profiles::Others,
                                private Inputs::Others,
                                private StatusReport::Others {
  public:
    /// Without a journal a task id is known for this life only.
    EntityManagerCore(EntityManagerCoreSettings settings, const Clock& clock, RandomSource& random,
                      BackEndPort& back_end, ServerPort& server, Storage& storage, ResourceStore& resources,
                      StopGenerations& stop_generations, Journal* journal = nullptr);
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
    /// False where it was a sample or raw data, after which everything here is as it was, nextDeadline() too.
    bool onLinkMessage(const proto::EiToEm& message) {
        auto copy = message;
        return hear(copy);
    }
    /// The same without a copy of bulk data; the message is left in some valid state.
    bool onLinkMessage(proto::EiToEm&& message) { return hear(message); }

    // From the server. `bytes` is an axon.proto.ToEntity.
    void onServerUp();
    void onServerDown(const std::string& reason);
    /// Or from another entity, whose UUID is head.sender.id then. False where it was raw data that was passed
    /// on, after which everything here is as it was, nextDeadline() too.
    bool onClientMsg(const Header& head, std::string_view bytes);
    /// What was sent to another entity (ServerPort::sendToPeer) did not arrive; `head` is that of the
    /// message.
    void onPeerRefusal(const Header& head, const Refusal& refusal);
    /// The signal thread has forwarded the stop to the EI already, under `generation` of the StopGenerations.
    void onStopSignal(const Header& head, StopCause cause, std::uint32_t generation);
    /// Likewise a drill, under `number` of StopGenerations::drill. It measures the way of a stop and changes
    /// nothing.
    void onDrill(const Header& head, std::uint32_t number);
    /// A stop that has been seen before, under `generation`: its receipt is told again.
    void onStopRepeated(const Header& head, StopCause cause, std::uint32_t generation);
    void onResetSignal(const Header& head) { onSignal(Event::Reset, head); }
    void onClearSignal(const Header& head) { onSignal(Event::Clear, head); }
    void onClientUpdate(const Header& head, ClientChange change);
    /// On any thread, at any time; takes no lock. Only makes deadlines later.
    void onServerHeartbeat() { presence_.heard(); }

    /// Re-reads nothing, changes nothing but what is due: watchdog, reservations, grace, places, not_after.
    /// Call at nextDeadline().
    void onTimer();
    TimePoint nextDeadline() const;

    /// ResourceStore::onAnswer() or Journal::onAnswer() has called.
    void onStored();

    /// Where the holder may send stops as datagrams (docs/reference/datagrams.md); told with each grant from
    /// now on.
    void offerDatagrams(std::string endpoint) { ownership_.offerDatagrams(std::move(endpoint)); }
    /// Where the holder may open a direct path (docs/reference/direct.md): "host:port" of each lane, both
    /// empty = nowhere; told with each grant from now on.
    void offerDirect(std::string data, std::string signal) {
        ownership_.offerDirect(std::move(data), std::move(signal));
    }

    /// The operator of the daemon wants it to end: stop, tell the server, leave.
    void shutDown();

    EntityState state() const override { return state_; }
    bool latched() const override { return latch_.isSet(); }
    /// Whether it counts on a session with the server; a silent one it has given up.
    bool serverUp() const { return presence_.connected(); }
    const std::string& uuid() const { return uuid_; }
    /// The present lease; null when nobody holds the entity.
    const LeaseBook::Held* held() const override {
        return ownership_.lease().held() ? &*ownership_.lease().held() : nullptr;
    }
    EntityStatus status() const { return status_.forServers(); }
    const CoreCounters& counters() const { return counters_; }
    /// Something for the operator's log: the server has been silent for a good part of what its watchdog
    /// allows. Once a minute at most; empty otherwise. Look after onTimer().
    std::string takeWarning() { return std::exchange(warning_, {}); }
    /// Likewise, of what is as it should be.
    std::string takeNews() { return std::exchange(news_, {}); }

  private:
    /// From the link; the message is left in some valid state.
    bool hear(proto::EiToEm& message);
    void rawCame(proto::LinkRaw& raw) {
        raw.to().empty() ? holder_channel_.rawCame(raw) : teamwork_.sendRaw(raw);
    }
    void onSignal(Event event, const Header& head);

    // Rows.
    void process(Event event, Who who, const Header& head, proto::ToEntity* body);
    void fire(Incident& incident) override;
    using Turn::fire;
    void perform(Action action, Incident& incident);
    void latch(const Incident& incident);
    void unlatch(const Incident& incident);
    void sendGrant(const Incident& incident);
    void noteWatch(const Incident& incident);
    Refusal guard(Event event, Who who, const Header& head) const;
    Refusal whyNotHolder(Who who, const Header& head) const;
    bool latchForbids(Event event) const;
    void settle();
    /// In this order time passes for them: first whether there is a server at all, then who holds the entity.
    template <class Use>
    static void eachOwner(auto& core, Use use) {
        use(core.presence_), use(core.ownership_), use(core.inputs_), use(core.tasks_), use(core.teamwork_),
            use(core.profiles_);
    }

    /// In the storage: the latch, and whether somebody holds the robot.
    void keepState() { latch_.keep(held() != nullptr); }

    // States, profiles, server.
    void profilesAreGood(const proto::BasicProfile& basic) override;
    std::string whyNotReady() const { return readiness_.whyNot(state_); }
    void tellStatus() override { presence_.tell(status()); }

    // Who holds it.
    void granted(Incident& granted) override;

    // What the owners see of it.
    bool connected() const override { return presence_.connected(); }
    CoreCounters& count() override { return counters_; }
    TimePoint now() const override { return clock_.now(); }
    bool linked() const override { return link_up_; }
    bool toApplication(const proto::EmToEi& message) override { return back_end_.send(message); }
    void tellDroppable(const Sender& to, const char* type, const proto::ToClient& message) override {
        outgoing_.tellDroppable(to, type, message);
    }
    void tellPeer(Lane lane, const std::string& entity, const char* type,
                  const proto::ToEntity& message) override {
        outgoing_.tellPeer(lane, self(), entity, type, message);
    }
    void warn(std::string text) override { warning_ = std::move(text); }
    void tellNews(std::string text) override { news_ = std::move(text); }
    void lookAgain() override { profiles_.lookAgain(); }
    void takeKeptProfiles() override { profiles_.takeKept(); }
    Stops stops() const override {
        return {stops_.generation(), stops_.required(), stops_.allHandled(), stops_.standing()};
    }
    Refusal checkGeneration(std::int32_t seen) const override { return stops_.whyNot(seen); }
    Refusal checkLease(const Sender& sender, LeaseNumber under) const override {
        return ownership_.lease().check(sender, under);
    }
    Sender self() const override { return {uuid_, presence_.name(), Role::Operator}; }
    bool hasTasks() const override { return tasks_.begun() + tasks_.waiting() > 0; }
    Refusal admitStep(const proto::TaskRequest& request) override { return tasks_.admit(request, 0); }
    bool takesPart() const override { return teamwork_.takesPart(); }
    bool isReserved() const override { return teamwork_.isReserved(); }
    bool tellStep(proto::TaskEvent& event) override { return teamwork_.tellStep(event); }
    void removeResource(const std::string& service, const std::string& resource) override {
        inputs_.remove(service, resource);
    }
    Refusal leavesRoom(int service, const proto::Param& param) const override {
        return tasks_.leavesRoom(service, param);
    }
    void reconfigure(int service, const proto::Param& param) override { tasks_.reconfigure(service, param); }
    void stopReachesTasks(bool ends) override {
        tasks_.restamp();
        if (ends) tasks_.applicationStopped();
    }
    std::size_t waitingClients() const override { return ownership_.waiting(); }
    const std::string& takenFromHolder() const override { return ownership_.taken(); }
    void describeServices(proto::EntityStatus& status) override;
    void describeWork(proto::EntityStatus& status) const override {
        tasks_.describe(status);
        presence_.describeWatchdogs(back_end_.margins(), status);
    }
    TaskCounts taskCounts() const override { return {tasks_.begun(), tasks_.waiting()}; }
    bool robotMoves() const override { return tasks_.robotMoves(); }
    bool finishesAlone() const override { return tasks_.finishesAlone(); }
    void loseHolder(Incident& lost) override;
    void endSpared(const std::string& why) override { tasks_.endSpared(why); }
    void controlTask(const Incident& incident) override {
        if (!teamwork_.control(incident)) tasks_.control(incident);
    }

    // Messages.
    void tell(const Sender& to, const char* type, const proto::ToClient& message, Lane lane) override {
        outgoing_.tell(to, type, message, lane);
    }
    using Turn::tell;
    void reply(const Sender& to, const std::string& request_id, const Refusal& refusal, Lane lane) {
        outgoing_.reply(to, request_id, refusal, lane);
    }
    void reply(const Sender& to, const std::string& request_id, const Refusal& refusal) override {
        reply(to, request_id, refusal, Lane::Data);
    }
    void refuse(const Incident& incident, const Refusal& refusal) override;

    const EntityManagerCoreSettings settings_;
    const Clock& clock_;
    BackEndPort& back_end_;
    ServerPort& server_;
    const bool parts_lost_;  ///< of the state; before the others, which write theirs
    std::string uuid_;
    Latch latch_;
    JournalWriter journal_;
    Readiness readiness_;

    EntityState state_ = EntityState::UNAV;
    EntityState previous_ = EntityState::REG;  ///< where BUSY returns to
    bool link_up_ = false;
    bool quit_ = false;
    std::string warning_, news_;

    OutgoingMessages outgoing_;
    Presence presence_;
    Ownership ownership_;
    StopLedger stops_;
    StopOrders stop_orders_;

    ServiceProfiler profiler_;
    TaskMemory memory_;
    Tasks tasks_;
    Profiles profiles_;
    Teamwork teamwork_;
    Inputs inputs_;
    StatusReport status_;
    Streams streams_{*this};
    HolderChannel holder_channel_{*this};
    RequestReader reader_{*this, journal_};

    PassedSignals passed_signals_;

    CoreCounters counters_;
};

}  // namespace axon::entity_manager
