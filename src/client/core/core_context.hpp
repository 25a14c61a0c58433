// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <string>

#include "client/base/server_link.hpp"
#include "client/base/session_observer.hpp"
#include "client/base/signal_marks.hpp"
#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/refusal.hpp"
#include "common/routed.hpp"

namespace axon::proto {
class ToEntity;
}

namespace axon::client {

class CheckOuts;
class Entities;
class Leases;
class Requests;
class Runs;
class ServerWatch;
class Tasks;
class Watches;

/// Settings of one session's behaviour.
struct SessionCoreSettings {
    Duration timeout = std::chrono::seconds{5};              ///< of every request that waits for an answer
    Duration server_silence_busy = std::chrono::seconds{1};  ///< 5 to 20 heartbeats of the server missed
    Duration server_silence_idle = std::chrono::seconds{10};
    std::size_t tasks_kept = 1024;  ///< finished tasks whose reports can still be asked for
    std::size_t runs_kept = 64;     ///< finished runs whose reports can still be asked for
    /// After a lost connection: how often a master that has not ended a run yet is asked what became of it.
    Duration outcome_again = std::chrono::seconds{1};
    bool resume = true;  ///< leases outlive the connection for their grace
    /// How long after this client a server may notice that the connection is gone; the grace begins then. Its
    /// idle watchdog, where that is longer.
    Duration loss_notice = std::chrono::seconds{10};
    /// A place in a wait list is asked for again this often; it is given up after three times as long.
    Duration wait_refresh = std::chrono::seconds{5};
    /// Several that were free and then were not: when to try again, at least; at most twice as long.
    Duration retry = std::chrono::milliseconds{200};
};

/// What the parts of SessionCore share: the world as it was injected, and who this session is.
struct CoreContext {
    Header header(const std::string& entity, const char* msg_type, LeaseNumber lease = {});
    /// Returns the sequence number of the message.
    std::int64_t send(const std::string& entity, const char* msg_type, LeaseNumber lease,
                      const proto::ToEntity& body);
    static Refusal notConnected() {
        return {RefusalCode::NotConnected,
                "There is no connection to the server at the moment. Try again when it is back.",
                {}};
    }

    const SessionCoreSettings settings;
    const Clock& clock;
    RandomSource& random;
    ServerLink& link;
    SessionObserver& observer;
    SignalMarks& marks;

    bool connected = false;
    Sender self = {};
    std::int64_t sequence = 0;    ///< of the last message
    std::uint64_t malformed = 0;  ///< messages that were dropped
};

/// The parts of SessionCore, each with its own state, and what each may ask of the others.
struct CoreParts {
    CoreContext& context;
    Requests& requests;
    Entities& entities;
    Leases& leases;
    CheckOuts& check_outs;
    Tasks& tasks;
    Runs& runs;
    Watches& watches;
    ServerWatch& server;
};

}  // namespace axon::client
