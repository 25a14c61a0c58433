// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>

#include "common/clock.hpp"
#include "common/refusal.hpp"
#include "common/routed.hpp"
#include "entity_manager/core/turn/lease_book.hpp"

namespace axon::proto {
class EmToEi;
class ToClient;
}  // namespace axon::proto

namespace axon::entity_manager {

struct CoreCounters;
enum class Event : std::uint8_t;
struct Incident;

/// Bytes of a reason or fault of the robot application that people are told.
inline constexpr std::size_t kReasonMax = 2000;
/// Raw data that goes no further is answered this seldom: a stream of it would get a stream of refusals.
inline constexpr Duration kRawRefusalPeriod = std::chrono::milliseconds{200};

/// What all owners of parts of the Entity Manager's state (StopLedger, …) may see and do while one event is
/// handled. Owners do not know each other; what concerns several of them goes through the state table. Where
/// one needs an answer of another at once, it asks by an interface of its own, Others, which says no more
/// than it needs. The core implements all of them; an owner's own unit test has fakes. Threads: the Entity
/// Manager's strand.
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
    /// Whether the sender is the holder and acts under the present lease, as LeaseBook::check().
    virtual Refusal checkLease(const Sender& sender, LeaseNumber under) const = 0;
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
    /// False where the message is larger than the link takes at once: nothing was sent.
    virtual bool toApplication(const proto::EmToEi& message) = 0;
    /// For the operator's log.
    virtual void warn(std::string text) = 0;
    virtual CoreCounters& count() = 0;
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
