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
#include "entity_manager/service_profiler.hpp"
#include "entity_manager/state_table.hpp"
#include "entity_manager/stop_ledger.hpp"
#include "entity_manager/streams.hpp"
#include "entity_manager/task_memory.hpp"
#include "entity_manager/task_queue.hpp"
#include "entity_manager/teamwork.hpp"
#include "entity_manager/turn.hpp"
#include "messages/profile_reader.hpp"

namespace axon::entity_manager {

/// The inside of EntityManagerCore: it finds the row of each event in the state table and has one function
/// for each Action. Private to the core; machine.cpp has states and messages, machine_tasks.cpp tasks and
/// resources, machine_composites.cpp tasks with parts.
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
    /// A task that has begun: the robot application has been given it, or, of a composite, one part after the
    /// other.
    struct Active {
        enum class Phase : std::uint8_t { Dispatched, Running, Paused };
        const ServiceProfiler::Order& order() const { return task.plan.parts[part]; }
        bool lastPart() const { return part + 1 == task.plan.parts.size(); }

        Task task;
        Phase phase = Phase::Dispatched;  ///< of the whole
        bool halted = false;              ///< by a reset: its end lets the queue go on
        bool cancelled = false;           ///< asked for: no further part begins
        bool hold = false;          ///< a pause was asked for: no further part begins before it is resumed
        std::size_t part = 0;       ///< the present one
        std::optional<Id128> sent;  ///< the id under which the application has it; none between two parts
        bool answered = false;      ///< the application has granted it
        TimePoint answer_until{};   ///< while it has not
        std::optional<TimePoint> alone_until;   ///< without its client: then it is stopped
        std::optional<TimePoint> finish_until;  ///< likewise, of the whole, whatever its parts are allowed
        std::vector<proto::Param> results;  ///< of the parts of a composite, "Part.Name", the newest of each
    };
    /// A task whose end has been told to the client, and of which the robot application has not yet said that
    /// its handler has returned. Nothing that excludes it is dispatched before.
    struct Lingering {
        Id128 id;  ///< that the application knows
        int service;
        bool blocking;
    };

    // Rows.
    void process(Event event, Who who, const Header& head, proto::ToEntity* body);
    void fire(Incident& incident) override;
    using Turn::fire;
    void perform(Action action, Incident& incident);
    Refusal guard(Event event, Who who, const Header& head) const;
    void settle();

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
    /// An answer to the robot application's profiles, for its log; OK where nothing is wrong.
    void tellOfProfiles(const Refusal& refusal);
    void readProfile(const proto::ProfileUpload& upload);
    void keepProfile(proto::ProfileUpload& upload);
    void takeKeptProfiles();
    void considerProfiles();
    void expireProfiles();
    void takeProfiles();
    void tellServices(const std::vector<int>& services) override;
    void seekServer();
    /// A lease that outlived the session with the server is found again.
    Event serverUpEvent() const {
        return held() != nullptr && state_ == EntityState::ENVCONN ? Event::ServerReturned : Event::ServerUp;
    }
    std::string whyNotReady() const;
    void tellStatus();
    void serverLost(const std::string& reason);

    // Stop.
    void stopApplication(Incident& incident);
    void acknowledge(const Incident& incident);
    void deliverStops();
    void restampQueue();

    // Who holds it.
    void passOn();
    void passTime();
    void granted(Incident& granted) override;

    // Tasks (machine_tasks.cpp).
    void admitTask(const Incident& incident);
    Refusal admit(const proto::TaskRequest& request, std::int64_t sent_at_us);
    void dispatchNext();
    bool admissible(const Task& task) const;
    void lookAgain();
    void takeLook();
    Result<bool> prepare(Task& task);
    Refusal missingFiles(const Task& task);
    void refusePrepared(const Refusal& refusal);
    void tellHeldUp();
    void dispatch(Task task);
    bool mayStart() const;
    void sendPart(Active& active);
    void taskAnswer(const proto::TaskAnswer& answer);
    void taskUpdate(proto::TaskEvent& update);
    void granted(Active& active);
    void endTask(std::size_t at, proto::TaskEvent event);
    void endTask(std::size_t at, proto::TaskState state, const Refusal& reason);
    void endTasks(const Incident& incident, proto::TaskState state, bool linger);
    void voidQueue(const Incident& incident);
    void haltTasks();
    void leaveService(const Task& task, bool clear);
    void controlOwnTask(const Incident& incident);
    void expireTasks();
    bool lingeringEnded(const Id128& id);
    void applicationStatus(const proto::StatusNote& note);
    Active* findActive(const Id128& id);
    Active* findSent(const Id128& id);
    void markExecuting(const Task& task);
    /// It is gone from active_.
    void taskGone();
    bool anyRuns() const;
    /// To who asked for the task: the holder, or the master of the run of which it is a step.
    void tellTask(proto::TaskEvent& event);
    void sendTask(const Task& task, proto::TaskState state, const Refusal& reason);
    /// The one way in which an accepted task ends: noted, remembered, and told to the holder.
    void concludeTask(const Task& task, proto::TaskEvent& event);
    /// To a holder that was away: how the tasks of its lease have ended, again.
    void tellFinals();
    void expireAnswers();

    // Composite services (machine_composites.cpp).
    std::string partText(const Task& task, std::size_t part) const;
    std::string partText(const Active& active) const { return partText(active.task, active.part); }
    double progressOf(const Active& active, double of_part = -1) const;
    void nameAsWhole(const Active& active, proto::TaskEvent& event) const;
    void keepResults(Active& active, const proto::TaskEvent& event) const;
    bool goOn(std::size_t at, proto::TaskEvent& event);
    void endAsWhole(const Active& active, proto::TaskEvent& event) const;
    void continueParts();
    void controlBetweenParts(Active& active);

    // Tasks whose client is lost (machine_losses.cpp).
    proto::OnClientLoss lossPolicyOfParts(const Active& active) const;
    TimePoint finishesUntil(const Active& active) const;
    proto::OnClientLoss lossPolicyOf(const Active& active) const;
    bool survivesClientLoss() const;
    void loseHolder(Incident& lost) override;
    void spareTasks();
    void attendTasks();
    void watchHeld(Active& active);
    bool finishesAlone() const override;
    void endSpared(const std::string& why) override;
    void expireSpared();

    Refusal leavesRoom(int service, const proto::Param& param) const override;
    void reconfigure(int service, const proto::Param& param) override;
    std::size_t dispatchBytes(const ServiceProfiler::Plan& plan) const;

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
    Stops stops() const override {
        return {stops_.generation(), stops_.required(), stops_.allHandled(), stops_.standing()};
    }
    Refusal checkGeneration(std::int32_t seen) const override { return stops_.whyNot(seen); }
    Refusal checkLease(const Sender& sender, LeaseNumber under) const override {
        return ownership_.lease().check(sender, under);
    }
    Sender self() const override { return {uuid_, presence_.name(), Role::Operator}; }
    bool hasTasks() const override { return !active_.empty() || !queue_.empty(); }
    Refusal admitStep(const proto::TaskRequest& request) override { return admit(request, 0); }
    void controlTask(const Incident& incident) override;

    // Messages.
    void tell(const Sender& to, const char* type, const proto::ToClient& message, Lane lane) override;
    using Turn::tell;
    void reply(const Sender& to, const std::string& request_id, const Refusal& refusal, Lane lane);
    void reply(const Sender& to, const std::string& request_id, const Refusal& refusal) override {
        reply(to, request_id, refusal, Lane::Data);
    }
    void refuse(const Incident& incident, const Refusal& refusal) override;
    void passText(const Incident& incident);
    void passRaw(const Incident& incident);
    void answerStatus(const Incident& incident);
    Header headFor(const Sender& to, const char* type);

    const CoreSettings settings_;
    const Clock& clock_;
    RandomSource& random_;
    BackEndPort& back_end_;
    ServerPort& server_;
    Storage& storage_;
    ResourceStore& store_;
    StopGate& stop_gate_;
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
    bool application_busy_ = false;  ///< by its own account (setStatus)
    bool busy_told_ = false;
    bool quit_ = false;
    std::string reason_;
    std::string sought_;  ///< in UNAV: what the search for the application has found instead

    std::optional<Reading<proto::BasicProfile>> basic_;
    std::optional<Reading<proto::ServicesProfile>> services_;
    ResourceRoots roots_;  ///< that came with it
    /// Where the files of its resources lie: asked before it is used, and again while it is.
    std::optional<Later<std::vector<ResourcePlace>>> located_, located_again_;
    std::optional<TimePoint> profiles_due_;  ///< in INIT: what has not been uploaded by then is missing
    /// Uploaded while the entity was held: by whether it is the services profile.
    std::map<bool, proto::ProfileUpload> kept_profiles_;
    std::string warning_, news_;

    Presence presence_;
    Ownership ownership_;
    StopLedger stops_;

    ServiceProfiler profiler_;
    /// By the application since its link is up: on or off, and why.
    std::map<std::string, std::pair<bool, std::string>, std::less<>> active_told_;
    TaskQueue queue_;
    TaskMemory memory_;
    Teamwork teamwork_;
    std::vector<Active> active_;
    std::vector<Lingering> lingering_;
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
