// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <string>
#include <vector>

#include "lab/laboratory.hpp"

namespace axon::lab {

/// A Laboratory behind TCP, in real time: one listening port per robot, one client per robot (a second one is
/// accepted and closed at once), the world stepped to keep pace with the monotonic clock times a speed.
///
/// Threads: none of its own; run() is the loop of the calling thread, stop() may be called from any thread
/// and from a signal handler. Owns its sockets. The constructor listens already, so that ports() is known
/// before run(); it throws BadDescription for a bad world and std::system_error for an address that cannot be
/// listened on. Failure: a client that does not read its server information until the kernel's buffer is full
/// is dropped and counts as lost; a world that needs more time than there is runs slower than asked, and says
/// so once.
class LabServer {
  public:
    struct Options {
        std::string listen = "127.0.0.1";
        int first_port = 8101;   ///< of the first robot without a port of its own; 0: any free one
        double speed = 1;        ///< seconds of the world in a second
        std::string truth_path;  ///< not empty: a JSON line per robot and 100 ms of the world is appended
    };

    LabServer(WorldDescription world, Options options);
    ~LabServer();
    LabServer(const LabServer&) = delete;
    LabServer& operator=(const LabServer&) = delete;

    /// The port of each robot, in the order of the description.
    std::vector<int> ports() const;
    /// Until stop().
    void run();
    void stop() noexcept;

  private:
    class Loop;
    std::unique_ptr<Loop> loop_;
};

}  // namespace axon::lab
