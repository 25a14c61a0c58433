// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstdint>
#include <string>

#include "common/clock.hpp"
#include "common/routed.hpp"
#include "front_end_server/clients/holdings.hpp"
#include "front_end_server/endings/gone_clients.hpp"
#include "front_end_server/ports/ports.hpp"

namespace axon::front_end_server {

/// What entities are told when a client is gone.
///
/// Every entity that it held is stopped, and where several clients fall silent at once, those of all of them
/// before anything else is said: no entity's stop waits for another one's paperwork. Only one on which no
/// task runs is not stopped, if its client ended the session in order. Threads: any, concurrently; no lock.
/// Failure: none.
class Settlement {
  public:
    Settlement(const Clock& clock, EntityTopic& topic) : clock_(clock), topic_(topic) {}

    /// First: the entities that it held.
    void stop(const Sender& client, Ending ending, const Holdings::Held& held);
    /// Then the same are told why.
    void tellGone(const Sender& client, Ending ending, const Holdings::Held& held);
    /// One that it did not hold, but which may know of it.
    void tellGone(const Sender& client, const std::string& entity, Ending ending);

  private:
    const Clock& clock_;
    EntityTopic& topic_;
    std::atomic<std::int64_t> stops_{0};
};

}  // namespace axon::front_end_server
