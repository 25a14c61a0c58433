// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/link.pb.h>
#include <axon/messages.pb.h>

#include <cstdint>
#include <deque>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "collaboration/collaboration.hpp"
#include "common/ids.hpp"
#include "common/refusal.hpp"
#include "entity_manager/core/collaboration/farewells.hpp"
#include "entity_manager/core/collaboration/run_records.hpp"
#include "entity_manager/core/journal/journal_writer.hpp"
#include "entity_manager/core/services/service_profiler.hpp"
#include "entity_manager/core/services/task_memory.hpp"
#include "entity_manager/core/turn/incident.hpp"
#include "entity_manager/core/turn/turn.hpp"
#include "entity_manager/ports/later.hpp"

namespace axon::entity_manager {

/// What the entity does with others (ADR 0019): the run of a global service that it leads as the master, its
/// own part in a run, be it this one or that of another master, and the runs in which it took part before.
///
/// A step of a run is an ordinary task of this entity; what it tells is reported to the master instead of
/// being told to the holder. As the master it speaks with its own part as with that of any other entity, only
/// without the way over the server. What a stop, or the loss of the master, means for the robot are rows of
/// the state table. Bounded: one run, 64 runs of the past.
class Teamwork final : public Owner {
  public:
    struct Settings {
        std::string entity;  ///< its UUID
        Duration watchdog;   ///< of the master's silence, while its run goes on
    };
    /// What it asks of other owners.
    class Others {
      public:
        virtual ~Others() = default;
        /// This entity as the sender of what it sends to another: its UUID, and its name for people.
        virtual Sender self() const = 0;
        /// To another entity, by its UUID. Nothing happens when there is no session. Lane::Signal for what
        /// the next one repeats: that may be left out without a word.
        virtual void tellPeer(Lane lane, const std::string& entity, const char* type,
                              const proto::ToEntity& message) = 0;
        /// Whether a task waits or has begun.
        virtual bool hasTasks() const = 0;
        /// OK, or why the step is not taken as a task. Its end may have been told before this returns.
        virtual Refusal admitStep(const proto::TaskRequest& request) = 0;
        /// A pause, resume or cancel; answered as if its sender had sent it.
        virtual void controlTask(const Incident& incident) = 0;
    };
    /// `memory` has the ids of runs beside those of tasks: neither begins twice.
    Teamwork(Turn& turn, Others& others, JournalWriter& journal, Storage& storage, RandomSource& random,
             const ServiceProfiler& profiler, TaskMemory& memory, Settings settings);

    // Actions of the state table.

    /// A client asks for a run.
    void considerRun(const Incident& incident);
    void refuseRun(const Incident& incident, const Refusal& refusal);
    /// A master invites.
    void considerInvitation(const Sender& master, const proto::FromMaster& message);
    void declineInvitation(const Sender& master, const proto::FromMaster& message, const Refusal& refusal);
    /// Pause, resume and cancel of the run as a whole; false when the id is not that of a run.
    bool control(const Incident& incident);
    /// This entity has been stopped, released, lost: it stops by another way already, and the others must.
    void leave(const Refusal& reason);
    void tellHistory(const Incident& incident);

    // Messages.

    /// Messages of master and slaves that are no requests. False when it is something else.
    bool hear(const Header& head, proto::ToEntity& message);
    /// What was sent to this entity has not arrived.
    void unreachable(const std::string& entity, const Refusal& refusal);
    /// Whether it is another participant of the run.
    bool isPartner(std::string_view entity) const { return partner(entity) != nullptr; }
    /// Raw data of the robot application to another participant.
    void sendRaw(proto::LinkRaw& raw);

    // Tasks.

    /// Whether the entity takes part in a run.
    bool takesPart() const { return member_.has_value(); }
    /// Whether it takes tasks of the master alone: also before its own run has begun.
    bool isReserved() const { return member_ || run_noted_; }
    /// What a task tells. True: it was a step, and its master has been told, or will be.
    bool tellStep(proto::TaskEvent& event);

    // Time.

    /// What the run wants done, until nothing is left. Call after every event.
    void settle();
    void onTimer() override;
    TimePoint nextDeadline() const override;

  private:
    struct OpenStep {
        std::int32_t number;
        std::optional<TimePoint> began;
        std::optional<proto::TaskEvent> held;  ///< what is told once it is `due`, or with what is told before
        TimePoint due{};
    };
    /// This entity's part in a run, as a slave or as the master itself.
    struct Membership {
        Membership() {}  // clang: or std::optional takes it for not default constructible within Teamwork
        std::string run_id;
        Sender master;
        std::vector<proto::Participant> participants;
        std::map<Id128, OpenStep> steps;  ///< under way, by the task's id
        TimePoint heard{};                ///< from the master
        bool led = false;                 ///< it has begun to beat, or has given an order
        Duration beat_every{};
        TimePoint beat_at{};
        std::uint64_t beat = 0;
    };
    /// A run in which it took part.
    struct PastRun {
        std::string run_id, master;
        Refusal reason;  ///< why it left; OK = the master has ended it
    };

    bool isMaster(const Membership& member) const { return member.master.id == settings_.entity; }
    void beginRun();
    void tellRun(const Sender& to, const proto::RunEvent& event);
    void endRun();
    Refusal checkSubLease(const Sender& master, const proto::FromMaster& message) const;
    void problemsOf(const proto::Invitation& invitation, proto::InvitationAnswer& answer) const;
    void hearMaster(const Sender& master, const proto::FromMaster& message);
    void admitStep(const proto::StepOrder& order);
    void controlStep(const proto::StepControl& control);
    void endMembership(const proto::CollaborationEnd& end);
    void sendToMaster(Lane lane, const Sender& master, const proto::FromSlave& message);
    void holdOrTell(OpenStep& step, proto::TaskEvent& event);
    void reportStep(const OpenStep& step, const proto::TaskEvent& event);
    void depart(const Sender& master, const std::string& run_id, const Refusal& reason);
    /// Its part is over; why is told again to a master that does not know it.
    void endPart(const Refusal& reason = {});
    const PastRun* pastRun(const std::string& run_id) const;
    /// When the silence of the master stops this entity.
    TimePoint masterLostAt() const;
    void masterLost();
    /// What it has sent to another entity goes no further; a stream of them is told seldom.
    void refuseToApplication(const std::string& to, const Refusal& refusal);
    const proto::Participant* partner(std::string_view name) const;

    Turn& turn_;
    Others& others_;
    JournalWriter& journal_;
    RandomSource& random_;
    const ServiceProfiler& profiler_;
    TaskMemory& memory_;
    const Settings settings_;

    std::optional<collaboration::Collaboration> run_;  ///< of which this entity is the master
    std::optional<Later<bool>> run_noted_;             ///< its entry in the journal, until that is written
    bool settling_ = false;
    Farewells farewells_;
    RunRecords records_;

    std::optional<Membership> member_;  ///< of the run in which it takes part
    std::deque<PastRun> past_runs_;     ///< newest last
    TimePoint not_sent_told_{};
};

}  // namespace axon::entity_manager
