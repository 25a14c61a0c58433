// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "common/clock.hpp"
#include "common/refusal.hpp"
#include "common/routed.hpp"
#include "entity_manager/core/turn/lease_book.hpp"

namespace axon::proto {
class BasicProfile;
class EmToEi;
class Param;
class TaskEvent;
class TaskRequest;
class ToClient;
class ToEntity;
}  // namespace axon::proto

namespace axon::entity_manager {

struct CoreCounters;
enum class Event : std::uint8_t;
struct Incident;

/// Bytes of a reason or fault of the robot application that people are told.
inline constexpr std::size_t kReasonMax = 2000;
/// Raw data that goes no further is answered this seldom: a stream of it would get a stream of refusals.
inline constexpr Duration kRawRefusalPeriod = std::chrono::milliseconds{200};

/// What an owner of a part of the Entity Manager's state (StopLedger, …) may see and do while one event is
/// handled. Owners do not know each other; what concerns several of them goes through the state table, and
/// where one needs an answer of another at once it asks here. Implemented by the core, and by a fake in an
/// owner's own unit test. Threads: the Entity Manager's strand.
class Turn {
  public:
    /// How far the strand has come with the stops (StopLedger).
    struct Stops {
        std::uint32_t generation = 0;
        std::uint32_t required = 0;  ///< a command counts only if its sender had seen at least this one
        bool all_handled = true;     ///< the strand knows of every stop that the signal thread has passed on
        bool standing = true;        ///< the application has confirmed every stop
    };

    virtual ~Turn() = default;

    // What is.
    virtual TimePoint now() const = 0;
    virtual EntityState state() const = 0;
    virtual bool latched() const = 0;
    /// Whether a robot application is linked.
    virtual bool linked() const = 0;
    /// Whether there is a session with the server.
    virtual bool connected() const = 0;
    virtual Stops stops() const = 0;
    /// The present lease. Null when nobody holds the entity. Valid until the lease changes.
    virtual const LeaseBook::Held* held() const = 0;
    /// Whether a command counts whose sender had seen this stop generation, as StopLedger::whyNot().
    virtual Refusal checkGeneration(std::int32_t seen) const = 0;
    /// Whether the sender is the holder and acts under the present lease, as LeaseBook::check().
    virtual Refusal checkLease(const Sender& sender, LeaseNumber under) const = 0;
    /// This entity as the sender of what it sends to another: its UUID, and its name for people.
    virtual Sender self() const = 0;

    const Sender* holder() const { return held() != nullptr ? &held()->holder : nullptr; }
    /// Whether the holder was lost, and its lease lives on for the grace.
    bool orphaned() const { return held() != nullptr && held()->grace_until; }

    // What happens.
    /// Takes it through the state table: the state may change, and the actions of its row run before this
    /// returns. They may change what the owner that calls has.
    virtual void fire(Incident& incident) = 0;
    void fire(Event event);
    /// Each kind of request is refused with its own kind of answer.
    virtual void refuse(const Incident& incident, const Refusal& refusal) = 0;
    virtual void reply(const Sender& to, const std::string& request_id, const Refusal& refusal) = 0;
    /// To a client. Nothing happens when there is no session or `to` has no id.
    virtual void tell(const Sender& to, const char* type, const proto::ToClient& message, Lane lane) = 0;
    void tell(const Sender& to, const char* type, const proto::ToClient& message) {
        tell(to, type, message, Lane::Data);
    }
    /// Stream samples and raw data to a client, which may be dropped, oldest first. Only while there is a
    /// session.
    virtual void tellDroppable(const Sender& to, const char* type, const proto::ToClient& message) = 0;
    /// To another entity, by its UUID. Nothing happens when there is no session. Lane::Signal for what the
    /// next one repeats: that may be left out without a word.
    virtual void tellPeer(Lane lane, const std::string& entity, const char* type,
                          const proto::ToEntity& message) = 0;
    /// False where the message is larger than the link takes at once: nothing was sent.
    virtual bool toApplication(const proto::EmToEi& message) = 0;
    /// For the operator's log.
    virtual void warn(std::string text) = 0;
    /// Likewise, of what is as it should be.
    virtual void tellNews(std::string text) = 0;
    /// Why the entity is not ready, for whoever asks while it is in INIT or ERR.
    virtual void notReady(std::string why) = 0;
    /// Tells the server how the entity is, where that has changed.
    virtual void tellStatus() = 0;
    /// There is no session any more, or one that counts.
    virtual void serverLost(const std::string& reason) = 0;
    virtual CoreCounters& count() = 0;

    // What a run asks of the entity's tasks.
    /// Whether a task waits or has begun.
    virtual bool hasTasks() const = 0;
    /// OK, or why the step is not taken as a task. Its end may have been told before this returns.
    virtual Refusal admitStep(const proto::TaskRequest& request) = 0;
    /// A pause, resume or cancel; answered as if its sender had sent it.
    virtual void controlTask(const Incident& incident) = 0;

    // What tasks ask of a run, and of the services.
    /// Whether the entity takes part in a run.
    virtual bool takesPart() const = 0;
    /// Whether it takes tasks of a master alone: also before the run that it leads has begun.
    virtual bool isReserved() const = 0;
    /// What a task tells. True: it was a step of a run, and its master has been told, or will be.
    virtual bool tellStep(proto::TaskEvent& event) = 0;
    /// For resources that have come since without a word; the answer may come later.
    virtual void lookAgain() = 0;
    /// A file that a task had for itself, unless another is being put in its place.
    virtual void removeResource(const std::string& service, const std::string& resource) = 0;

    /// The services of a profile have been loaded: whatever else goes by it is told, and ProfilesGood fired.
    virtual void profilesAreGood(const proto::BasicProfile& basic) = 0;

    // What the services' values mean for their tasks, and for who holds the entity.
    /// TOO_LARGE where a task that has been accepted could not be sent with this value of a service's own
    /// parameter.
    virtual Refusal leavesRoom(int service, const proto::Param& param) const = 0;
    /// A new value of a CONFIG parameter, to the application and to all that has been accepted.
    virtual void reconfigure(int service, const proto::Param& param) = 0;

    // What whoever holds the entity means for its tasks.
    /// Whether a task goes on to its end while its client is lost.
    virtual bool finishesAlone() const = 0;
    /// The holder is lost: ClientLost, or ClientSpared where all that runs may go on without it.
    virtual void loseHolder(Incident& lost) = 0;
    /// What has begun goes on without its client no longer: ClientLost, where there is anything.
    virtual void endSpared(const std::string& why) = 0;
    /// Fires CheckOutGranted or LeaseResumed, after which the holder's tasks have their client again.
    virtual void granted(Incident& granted) = 0;
    /// A profile that was kept while the entity was held, before the next who waits is given the entity.
    virtual void takeKeptProfiles() = 0;
};

/// An owner of a part of the state that time changes. The core asks all of them, in one order, so that no
/// deadline can be forgotten.
class Owner {
  public:
    virtual ~Owner() = default;
    /// Does what is due now and nothing else; may come early. May fire events.
    virtual void onTimer() = 0;
    /// When onTimer() has something to do; TimePoint::max() = not as things are.
    virtual TimePoint nextDeadline() const = 0;
};

}  // namespace axon::entity_manager
