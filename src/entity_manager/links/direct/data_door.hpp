// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <asio/any_io_executor.hpp>
#include <cstdint>
#include <memory>
#include <string>

#include "common/clock.hpp"
#include "direct/lane/tls_channel.hpp"
#include "entity_manager/links/direct_refusals.hpp"
#include "entity_manager/ports/direct_lane.hpp"

namespace axon::entity_manager {

/// Where clients open the data lanes of direct paths: a port of TCP or TLS, and the connections that came to
/// it (docs/reference/direct.md, "Frames of the data lane").
///
/// Where in the flow: on the strand of the Entity Manager. A thread of the door's own reads, and takes the
/// strand itself when it is free, so that a message that comes is handled, and its answer written, by the
/// thread that has read it. With TLS another thread opens it on each new connection, so that the arithmetic
/// of strangers delays neither the strand nor a holder; records are opened and sealed on the strand, like
/// everything else. Threads: the strand's alone, but for the destructor, which comes after shut() and joins
/// those threads. Bounds: of connections without a path 64 of one address and 256
/// in all are kept, for 10 s, the oldest are closed; at most 64 are taken in each 100 ms (16 with TLS), so
/// that a flood of them leaves the strand to others. Failure: the constructor throws std::runtime_error where
/// it cannot listen.
class DataDoor {
  public:
    /// `port` 0: a free one. `spin`: how long its thread may spin before it sleeps (direct::lane::Spinner).
    /// `refusals`: is told of who is turned away; null: nobody is. `tls`: what is spoken there; null: plain
    /// TCP.
    DataDoor(const asio::any_io_executor& strand, const std::string& address, std::uint16_t port,
             std::string entity, Duration spin, const Clock& clock, std::weak_ptr<DirectEvents> events,
             std::shared_ptr<const direct::lane::Tls> tls = nullptr,
             std::shared_ptr<DirectRefusals> refusals = nullptr);
    ~DataDoor();
    DataDoor(const DataDoor&) = delete;
    DataDoor& operator=(const DataDoor&) = delete;

    /// Takes no more connections, and ends those that are there.
    void shut();
    /// DirectEvents::directMsg() may take more again.
    void roomAgain();
    std::uint16_t port() const;

  private:
    class Connection;
    class Connections;
    const std::shared_ptr<Connections> connections_;
};

}  // namespace axon::entity_manager
