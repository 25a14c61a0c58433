// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "common/clock.hpp"
#include "common/routed.hpp"
#include "datagrams/datagram_lane.hpp"
#include "datagrams/stop_sentry.hpp"
#include "entity_manager/core/turn/lease_book.hpp"
#include "entity_manager/ports/stop_generations.hpp"

namespace axon::entity_manager {

/// Where stops may arrive as datagrams (Axon.Datagrams).
struct DatagramSettings {
    bool offered = false;
    std::string address;     ///< empty: the one that leads to the server
    std::uint16_t port = 0;  ///< 0: a free one
};

/// Receives stops as authenticated datagrams (docs/reference/datagrams.md) and sets them on the way that
/// every stop takes.
///
/// Where in the flow: beside EntityCommunicator. A datagram that the sentry accepts becomes an ordinary stop
/// signal of the same sender and sequence number, so that its twin on the TCP signal lane, before or after
/// it, is taken for the same stop; each copy is acknowledged, after the stop has gone to the robot
/// application. States: closed; open. Threads: open(), hold() and close() on the strand; the datagram thread,
/// one of the signal lane, calls `stop`. Failure: an address that cannot be bound is logged, and stops travel
/// by TCP alone.
class DatagramDesk {
  public:
    using Stop = std::function<void(Header head, StopCause cause)>;

    DatagramDesk(DatagramSettings settings, const Clock& clock, StopGenerations& stop_generations,
                 std::string entity, Stop stop);

    /// Opens the socket, or anew where the way to the server begins at another address than before. The
    /// endpoint to tell clients; empty when there is none.
    std::string open(const std::string& way_to_server);
    /// Who holds the entity now: only they can stop it by datagram. Cheap when nothing has changed.
    void hold(const LeaseBook::Held* held);
    void close();

    datagrams::StopSentry::Counters counters() const { return sentry_.counters(); }

  private:
    void tellCounts();
    bool received(const datagrams::DatagramLane& lane, const datagrams::Endpoint& from,
                  std::string_view bytes);

    const DatagramSettings settings_;
    const Clock& clock_;
    StopGenerations& stop_generations_;
    const std::string entity_;
    const Stop stop_;
    datagrams::StopSentry sentry_;
    // Confined to the strand.
    datagrams::Endpoint bound_;
    datagrams::StopSentry::Counters told_;
    LeaseNumber held_;
    std::string holder_;
    std::unique_ptr<datagrams::DatagramLane> lane_;
};

}  // namespace axon::entity_manager
