// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <algorithm>
#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "board.hpp"
#include "child.hpp"
#include "host_probe.hpp"
#include "relay.hpp"
#include "robots.hpp"

namespace axon::faults {

/// What a kind of fault needs of the laboratory.
struct Needs {
    bool relay_clients = false, relay_managers = false,
         relay_links = false;  ///< which hops go through the relay
    bool daemons =
        false;  ///< a process for each Entity Manager, for faults of one; without, only where robots are few
    bool slow_disk =
        false;  ///< the disk of every Entity Manager takes its time (with daemons): Laboratory::slowDisk()
    bool tenth_apart =
        false;  ///< the Entity Managers of the last tenth of the robots are in no process with others
    bool together = false;      ///< the robots move as steps of one run; Desk::master is whose it is
    bool first_master = false;  ///< it is always the first robot's, whose Entity Manager has a cable of its
                                ///< own: Hop::Master (with relay_managers and daemons)
};

/// What the person asked for.
struct Wishes {
    std::filesystem::path programs;  ///< where axon-server and axon-entity-manager lie
    std::size_t entities = 8;
    std::uint64_t seed = 1;
    bool busy = false;
    bool keep_logs = false;
};

/// A server, Entity Managers, a robot application and a client: real processes with real sockets on loopback
/// addresses of the run's own, and whatever the relay is to spoil in between. Threads: one. Throws
/// std::runtime_error where a program does not start; the message has the end of its log.
class Laboratory {
  public:
    Laboratory(const Wishes& wishes, const Needs& needs);
    ~Laboratory();
    Laboratory(const Laboratory&) = delete;
    Laboratory& operator=(const Laboratory&) = delete;

    /// Starts what does not run, and returns when every robot moves; false when that took longer than
    /// `patience`.
    bool prepare(std::chrono::seconds patience = std::chrono::seconds{30});
    /// Starts what does not run but the client process.
    void startAll();
    /// Ends the client process, which holds every robot.
    void endClient();
    /// Ends every process, heals every hop, and starts all but the client anew.
    void startAnew();

    Board& board() { return *board_; }
    Relay& relay() { return relay_; }
    HostProbe& probe() { return probe_; }
    Child& server() { return *server_; }
    Child& client() { return *operator_; }
    Child& application() { return *application_; }
    /// The one of the i-th robot; without Needs::daemons others are in the same process.
    Child& manager(std::size_t i) { return *managers_[managerIndex(i)]; }
    /// The first robot of the last tenth, which has at least one.
    std::size_t lastTenth() const { return lastTenthOf(wishes_.entities); }
    /// The processes of the Entity Managers of the last tenth (Needs::tenth_apart, or daemons).
    std::vector<Child*> managersOfLastTenth();
    /// Clients that hold a robot each and send data while Desk::load says so (load.hpp).
    void startLoad();
    void endLoad();
    Child& load() { return *load_; }
    bool managerOfEach() const { return daemons_; }
    std::size_t entities() const { return wishes_.entities; }
    const std::filesystem::path& folder() const { return folder_; }
    /// HOST:PORT for clients, through the relay where one is in between.
    std::string clientAddress() const;
    /// From now on every operation on the state folder of an Entity Manager takes two seconds.
    void slowDisk();
    /// Motions that were logged since the last call.
    std::vector<Motion> newMotions();
    /// Leaves the logs where they are when something went wrong.
    void keepLogs() { keep_logs_ = true; }

  private:
    void endAll();
    void startServer();
    void startApplication();
    void startManagers();
    std::size_t managerIndex(std::size_t i) const;

    const Wishes wishes_;
    const Needs needs_;
    const bool daemons_;
    std::filesystem::path folder_;
    std::string own_, between_;  // loopback addresses: of the programs, of the relay
    std::unique_ptr<Board> board_;
    HostProbe probe_;
    Relay relay_;
    std::unique_ptr<Burners> burners_;
    std::unique_ptr<Child> server_, application_, operator_, load_;
    std::vector<std::unique_ptr<Child>> managers_;
    std::uintmax_t motions_read_ = 0;
    std::uint32_t orders_ = 0;
    bool keep_logs_ = false;
};

/// Waits for what real processes do; false when the time is up or Ctrl-C came.
bool waitUntil(const std::function<bool()>& holds, std::chrono::milliseconds time);

}  // namespace axon::faults
