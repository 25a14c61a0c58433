// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <string>

#include "common/clock.hpp"
#include "common/routed.hpp"

namespace axon::proto {
class EmToEi;
class ToClient;
}  // namespace axon::proto

namespace axon::entity_manager {

struct CoreCounters;

/// Bytes of a reason or fault of the robot application that people are told.
inline constexpr std::size_t kReasonMax = 2000;

/// What an owner of a part of the Entity Manager's state (StopLedger, …) may see and do while one event is
/// handled. Owners do not know each other; what concerns several of them goes through the state table.
/// Implemented by the core, and by a fake in an owner's own unit test. Threads: the Entity Manager's strand.
class Turn {
  public:
    virtual ~Turn() = default;

    virtual TimePoint now() const = 0;
    virtual EntityState state() const = 0;
    /// Null when nobody holds the entity. Valid until the lease changes.
    virtual const Sender* holder() const = 0;
    /// Whether a robot application is linked.
    virtual bool linked() const = 0;
    /// Whether there is a session with the server.
    virtual bool connected() const = 0;
    /// To a client. Nothing happens when there is no session or `to` has no id.
    virtual void tell(const Sender& to, const char* type, const proto::ToClient& message, Lane lane) = 0;
    /// Stream samples and raw data to a client, which may be dropped, oldest first. Only while there is a
    /// session.
    virtual void tellDroppable(const Sender& to, const char* type, const proto::ToClient& message) = 0;
    /// False where the message is larger than the link takes at once: nothing was sent.
    virtual bool toApplication(const proto::EmToEi& message) = 0;
    /// For the operator's log.
    virtual void warn(std::string text) = 0;
    virtual CoreCounters& counters() = 0;
};

}  // namespace axon::entity_manager
