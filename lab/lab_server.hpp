// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <memory>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "lab/laboratory.hpp"

namespace axon::lab {

/// A Laboratory behind TCP, in real time: one port per robot (ARCOS), device and laser (LMS-200), one
/// client each (a second one is accepted and closed at once), pictures and colour blobs of each robot's
/// camera (PictureServer), and a control port (Control). The world is stepped to keep pace with the monotonic
/// clock times a speed, or only when the control port says so.
///
/// Threads: run() is the loop of the calling thread; pictures have a thread that draws and one that sends.
/// stop() may be called from any thread and from a signal handler. Owns its sockets. The constructor listens
/// already, so that ports() is known before run(); it throws BadDescription for a bad world and
/// std::system_error for an address that cannot be listened on. Failure: a client that does not read until
/// the kernel's buffer is full is dropped and counts as lost; a world that needs more time than there is runs
/// slower than asked, and says so once.
class LabServer {
  public:
    static constexpr int kFirstPort = 8101;
    static constexpr int kFirstCameraPort = 8301;
    static constexpr int kFirstActsPort = 8401;
    static constexpr int kFirstLaserPort = 8501;
    static constexpr int kControlPort = 8100;
    static constexpr int kOverviewPort = 8099;

    struct Options {
        std::string listen = "127.0.0.1";
        int first_port = kFirstPort;  ///< of the first robot without a port of its own; 0: any free one. With
                                      ///< any other than the default all other ports are free ones
        double speed = 1;             ///< seconds of the world in a second
        std::string truth_path;  ///< not empty: JSON lines are appended, per robot every 100 ms of the world,
                                 ///< per device and object when it has moved
        bool step = false;       ///< time passes only by the control port
        std::uint64_t seed = 1;  ///< of the sensors' noise
        double noise = 0;        ///< 1: as much as the real sensors have
        bool overview = false;   ///< streams the room from above
        bool pty = false;     ///< robots, devices and lasers on pseudo-terminals instead of ports, as serial
                              ///< lines: they have speeds, and nobody notices there that a client is gone
        bool lasers = false;  ///< each robot's laser is an LMS-200 on a line of its own (LmsServer)
        std::string clock_path;  ///< not empty: the laboratory's time for other programs (ClockFile)

        bool operator==(const Options&) const = default;
    };

    LabServer(WorldDescription world, Options options);
    ~LabServer();
    LabServer(const LabServer&) = delete;
    LabServer& operator=(const LabServer&) = delete;

    /// The port of each robot, in the order of the description; 0 with `pty`.
    std::vector<int> ports() const;
    /// What can be reached where: "PeopleBot" and "127.0.0.1:8101", "PeopleBot.laser", "PeopleBot.camera",
    /// "PeopleBot.acts", "Cyton", "control", "overview"; with `pty` paths for robots, lasers and devices.
    /// Robots first.
    std::vector<std::pair<std::string, std::string>> addresses() const;
    /// Of one of them; throws std::out_of_range.
    std::string address(const std::string& name) const;
    /// Until stop().
    void run();
    void stop() noexcept;

  private:
    class Loop;
    std::unique_ptr<Loop> loop_;
};

}  // namespace axon::lab
