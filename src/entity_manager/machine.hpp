// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>
#include <axon/messages.pb.h>
#include <algorithm>
#include <array>

#include <deque>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "collaboration/collaboration.hpp"
#include "common/rate_limit.hpp"
#include "common/rights.hpp"
#include "entity_manager/entity_manager_core.hpp"
#include "entity_manager/incident.hpp"
#include "entity_manager/inputs.hpp"
#include "entity_manager/lease_book.hpp"
#include "entity_manager/ownership.hpp"
#include "entity_manager/presence.hpp"
#include "entity_manager/profiles.hpp"
#include "entity_manager/service_profiler.hpp"
#include "entity_manager/state_table.hpp"
#include "entity_manager/stop_ledger.hpp"
#include "entity_manager/streams.hpp"
#include "entity_manager/task_memory.hpp"
#include "entity_manager/tasks.hpp"
#include "entity_manager/teamwork.hpp"
#include "entity_manager/turn.hpp"

namespace axon::entity_manager {

/// The inside of EntityManagerCore: it finds the row of each event in the state table and has one function
/// for each Action. Private to the core.
class EntityManagerCore::Machine final : private Turn {
  public:
    Machine(CoreSettings settings, const Clock& clock, RandomSource& random, BackEndPort& back_end,
            ServerPort& server, Storage& storage, ResourceStore& resources, StopGate& stop_gate,
            Journal* journal);

    void start();
    void onLinkUp();
    void onApplicationSought(const std::string& finding);
    void onLinkDown(const std::string& reason, LinkEnd end);
    void onLinkMessage(proto::EiToEm& message);
    void onServerUp();
    void onServerDown(const std::string& reason);
    void onClientMsg(const Header& head, std::string_view bytes);
    void onPeerRefusal(const Header& head, const Refusal& refusal);
    void onStopSignal(const Header& head, StopCause cause, std::uint32_t generation);
    void onDrill(const Header& head, std::uint32_t number);
    void onStopRepeated(const Header& head, StopCause cause, std::uint32_t generation);
    void onSignal(Event event, const Header& head);
    void onClientUpdate(const Header& head, ClientChange change);
    void onServerHeartbeat();
    void onTimer();
    void onStored();
    TimePoint nextDeadline() const;
    void shutDown();

    EntityState state() const override { return state_; }
    bool latched() const override { return latched_; }
    bool connected() const override { return presence_.connected(); }
    const std::string& uuid() const { return uuid_; }
    void offerDatagrams(std::string endpoint) { ownership_.offerDatagrams(std::move(endpoint)); }
    void offerDirect(std::string data, std::string signal) {
        ownership_.offerDirect(std::move(data), std::move(signal));
    }
    const LeaseBook::Held* held() const override {
        return ownership_.lease().held() ? &*ownership_.lease().held() : nullptr;
    }
    EntityStatus status() const;
    CoreCounters& counters() override { return counters_; }
    std::string takeWarning() { return std::exchange(warning_, {}); }
    std::string takeNews() { return std::exchange(news_, {}); }

  private:
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
    void settle();
    /// In this order time passes for them: first whether there is a server at all, then who holds the entity.
    std::array<Owner*, 6> owners() {
        return {&presence_, &ownership_, &inputs_, &tasks_, &teamwork_, &profiles_};
    }
    std::array<const Owner*, 6> owners() const {
        return {&presence_, &ownership_, &inputs_, &tasks_, &teamwork_, &profiles_};
    }

    // The journal.
    void replayJournal();
    bool note(JournalRecord record) override;
    Later<bool> noteDispatch(JournalRecord record) override;
    void complete(JournalRecord& record) const;
    bool recorded(bool written) override;
    /// In the storage: the latch, and whether somebody holds the robot.
    void keepState();
    void noteRefusal(const Sender& who, LeaseNumber under, const Refusal& refusal) override;

    // States, profiles, server.
    void profilesAreGood(const proto::BasicProfile& basic) override;
    void tellServices(const std::vector<int>& services) override;
    void seekServer();
    /// A lease that outlived the session with the server is found again.
    Event serverUpEvent() const {
        return held() != nullptr && state_ == EntityState::ENVCONN ? Event::ServerReturned : Event::ServerUp;
    }
    std::string whyNotReady() const;
    void tellStatus() override;
    void serverLost(const std::string& reason) override;

    // Stop.
    void stopApplication(Incident& incident);
    void acknowledge(const Incident& incident);
    void deliverStops();

    // Who holds it.
    void granted(Incident& granted) override;

    // What the owners see of it.
    TimePoint now() const override { return clock_.now(); }
    bool linked() const override { return link_up_; }
    bool toApplication(const proto::EmToEi& message) override { return back_end_.send(message); }
    void tellDroppable(const Sender& to, const char* type, const proto::ToClient& message) override {
        server_.sendToClientDataSeq(headFor(to, type), message);
    }
    void tellPeer(Lane lane, const std::string& entity, const char* type,
                  const proto::ToEntity& message) override;
    void warn(std::string text) override { warning_ = std::move(text); }
    void tellNews(std::string text) override { news_ = std::move(text); }
    void notReady(std::string why) override { reason_ = std::move(why); }
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
        return tasks_.leaveRoom(service, param);
    }
    void reconfigure(int service, const proto::Param& param) override { tasks_.reconfigure(service, param); }
    bool finishesAlone() const override { return tasks_.finishAlone(); }
    void loseHolder(Incident& lost) override;
    void endSpared(const std::string& why) override { tasks_.endSpared(why); }
    void controlTask(const Incident& incident) override;

    // Messages.
    void tell(const Sender& to, const char* type, const proto::ToClient& message, Lane lane) override;
    using Turn::tell;
    void reply(const Sender& to, const std::string& request_id, const Refusal& refusal, Lane lane);
    void reply(const Sender& to, const std::string& request_id, const Refusal& refusal) override {
        reply(to, request_id, refusal, Lane::Data);
    }
    void refuse(const Incident& incident, const Refusal& refusal) override;
    void refuseRaw(const Sender& to, const Refusal& refusal);
    void passText(const Incident& incident);
    void passRaw(const Incident& incident);
    void answerStatus(const Incident& incident);
    Header headFor(const Sender& to, const char* type);

    const CoreSettings settings_;
    const Clock& clock_;
    BackEndPort& back_end_;
    ServerPort& server_;
    Storage& storage_;
    Journal* const journal_;  ///< null = none is kept
    const bool parts_lost_;   ///< of the state; before the others, which write theirs
    std::string uuid_;

    EntityState state_ = EntityState::UNAV;
    EntityState previous_ = EntityState::REG;  ///< where BUSY returns to
    bool latched_ = false;
    bool latch_kept_ = false;  ///< as the storage has it
    bool free_kept_ = false;   ///< likewise; false before anybody is granted the robot
    bool journal_failing_ = false;
    bool link_up_ = false;
    bool quit_ = false;
    std::string reason_;
    std::string sought_;  ///< in UNAV: what the search for the application has found instead

    std::string warning_, news_;

    Presence presence_;
    Ownership ownership_;
    StopLedger stops_;

    ServiceProfiler profiler_;
    TaskMemory memory_;
    Tasks tasks_;
    Profiles profiles_;
    Teamwork teamwork_;
    Inputs inputs_;
    Streams streams_{*this};
    TimePoint raw_refused_{};

    /// The resets and clears that were taken last. Between servers each goes two ways, and the second one,
    /// late, would end the next task.
    struct PassedSignals {
        bool seen(const Header& head) {
            if (head.sequence <= 0) return false;
            const std::pair key{head.sender.id, head.sequence};
            if (std::find(recent.begin(), recent.end(), key) != recent.end()) return true;
            recent[next++ % recent.size()] = key;
            return false;
        }
        std::array<std::pair<std::string, std::int64_t>, 32> recent;
        std::size_t next = 0;
    };
    PassedSignals passed_;

    std::int64_t sequence_ = 0;
    proto::ToEntity from_client_;  ///< kept for its memory
    proto::EmToEi raw_to_link_;
    proto::ToClient raw_to_client_;
    CoreCounters counters_;
    RateLimit refusals_noted_{10};
};

}  // namespace axon::entity_manager
