// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "robots/arcos/client_session.hpp"
#include "robots/common/byte_stream.hpp"

namespace axon::arcos {

/// A connection to one ARCOS robot that never gives up: connects, shakes hands, keeps the robot's watchdog
/// fed, offers the newest RobotState, and after a loss tries again for ever (after 100 ms, doubling up to 2
/// s).
///
/// Between a robot application's service logic above and a ByteStream (TCP or serial) below; the protocol
/// itself is ClientSession. Threads: one of its own, on which all callbacks run; they must not block. state()
/// and the commands may be called from any thread; a command is written to the link by the calling thread,
/// without a queue, so a stop is on the wire when the call returns. Destruction stops the robot, closes the
/// session and joins the thread; not from a callback. Failure: onLost with the reason. A command while the
/// robot is lost returns false and does nothing.
class ArcosClient {
  public:
    struct Callbacks {
        std::function<void(const RobotIdentity&)> on_online;
        std::function<void(const RobotState&)> on_state;         ///< ten times a second
        std::function<void(const std::string& reason)> on_lost;  ///< also for each failed attempt to connect
    };

    /// `silence_limit`: without a packet for so long, on `clock`, the robot counts as lost.
    ArcosClient(robots::StreamOpener open, Callbacks callbacks,
                Duration silence_limit = ClientSession::kSilenceLimit,
                std::shared_ptr<const Clock> clock = std::make_shared<SteadyClock>());
    ~ArcosClient();
    ArcosClient(const ArcosClient&) = delete;
    ArcosClient& operator=(const ArcosClient&) = delete;

    /// Begins to connect; once. Callbacks come from now on.
    void start();
    /// What the destructor does, while this object can still be used by a callback that is under way: stops
    /// the robot, closes the session, joins the thread. No callback comes any more, no command goes out.
    void finish();

    RobotState state() const;

    /// A sweep of a laser that is wired to this computer (ClientSession::newScan), from any thread. Only the
    /// newest is kept until the robot's next state.
    void newScan(LaserScan scan);

    bool command(Command command);
    bool command(Command command, int argument);
    /// A text: for the camera (Command::Tty2, vcc4.hpp).
    bool command(Command command, std::string_view text);
    /// Forward speed and rotation to the left, rounded to ARCOS's whole mm/s and deg/s.
    bool drive(double forward_mm_s, double left_deg_s);
    bool gripper(GripperOrder order) { return command(Command::Gripper, static_cast<int>(order)); }
    /// STOP with the robot's full deceleration (ESTOP): for the stop thread. The gripper has its own
    /// (GripperOrder::Halt), as motions end while it holds something.
    bool stop();

  private:
    class Worker;
    std::unique_ptr<Worker> worker_;
};

}  // namespace axon::arcos
