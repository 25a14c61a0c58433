// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "common/clock.hpp"
#include "direct/lane/spin.hpp"
#include "entity_manager/links/direct/data_door.hpp"
#include "entity_manager/ports/direct_lane.hpp"

namespace axon::entity_manager {

class ServerCommunicators;

/// Ports for the direct path: any free ones, or those of a range, which several Entity Managers may share.
struct DirectPorts {
    std::uint16_t first = 0;  ///< 0: any
    std::uint16_t last = 0;
};

/// The direct path at the Entity Manager (Axon.Direct).
struct DirectSettings {
    bool offered = false;
    std::string address;  ///< to listen at; empty: the one that leads to the server
    DirectPorts ports;
    Duration spin{};  ///< of the thread that reads data, at most kSpinMost (Axon.Direct.Spin); 0: none
    /// What clients are told to call instead of "host:port" where it listens: a test puts a relay there.
    /// Empty: as it listens.
    std::function<std::string(const std::string& endpoint)> named = {};
};

/// Where clients open direct paths: a port for each lane (docs/reference/direct.md), that of data by DataDoor
/// and that of signals over Ice. The only file of the direct path at the Entity Manager that knows Ice.
///
/// Both ports speak TLS, or neither does.
///
/// Where in the flow: beside EntityCommunicator. Threads: the strand's alone, and that of the signal lane's
/// adapter, under SCHED_RR where permitted; what comes goes to `events`. Ownership: listens until shut(); the
/// destructor waits until every opening is answered and joins the adapter's thread, so it runs neither on it
/// nor on the strand that answers. Failure: the constructor throws std::runtime_error with the fix where it
/// cannot listen.
class DirectDoor {
  public:
    DirectDoor(const asio::any_io_executor& strand, ServerCommunicators& ice, const std::string& address,
               const DirectSettings& settings, const std::string& entity, const Clock& clock,
               const std::weak_ptr<DirectEvents>& events,
               const std::shared_ptr<const direct::lane::Tls>& tls);
    ~DirectDoor();
    DirectDoor(const DirectDoor&) = delete;
    DirectDoor& operator=(const DirectDoor&) = delete;

    /// Takes no connection any more, and ends those that are there. Does not wait.
    void shut();
    /// DirectEvents::directMsg() may take more again.
    void roomAgain() { data_door_->roomAgain(); }
    /// "192.168.0.7:41234".
    const std::string& dataEndpoint() const { return data_; }
    const std::string& signalEndpoint() const { return signal_; }

  private:
    struct SignalDoor;
    std::unique_ptr<DataDoor> data_door_;
    std::unique_ptr<SignalDoor> signal_door_;
    std::string data_, signal_;
};

/// The doors of one Entity Manager, of which the last is open: an address that changes is rare, and an
/// earlier one costs little. Threads: the strand's alone, but for the destructor, which must not run there
/// (DirectDoor).
class DirectDoors {
  public:
    /// `tls`: clients are to call by TLS, with the certificates of `ice`. Where these cannot be used, the log
    /// says so, and nobody is offered a path.
    DirectDoors(asio::any_io_executor strand, DirectSettings settings,
                std::shared_ptr<ServerCommunicators> ice, std::string entity, const Clock& clock,
                std::weak_ptr<DirectEvents> events, bool tls);

    /// There is a session with the server: listens at the address where the way there begins, or anew where
    /// that is another one than before. The endpoints to tell holders, data and signals: "host:port", or
    /// "ssl://host:port"; empty, with a warning in the log, when there are none.
    std::pair<std::string, std::string> listen(const std::string& way_to_server);
    void shut();
    /// DirectEvents::directMsg() may take more again.
    void roomAgain() {
        for (const auto& door : doors_) door->roomAgain();
    }

  private:
    const asio::any_io_executor strand_;
    const DirectSettings settings_;
    const std::shared_ptr<ServerCommunicators> ice_;
    const std::string entity_;
    const Clock& clock_;
    const std::weak_ptr<DirectEvents> events_;
    const bool speaks_tls_;
    std::shared_ptr<const direct::lane::Tls> tls_;  // null: plain, or its certificate cannot be used
    std::vector<std::unique_ptr<DirectDoor>> doors_;
    std::string listens_at_;  // empty: none is open
};

}  // namespace axon::entity_manager
