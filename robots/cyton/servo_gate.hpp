// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <functional>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "common/clock.hpp"
#include "robots/cyton/geometry.hpp"

namespace axon::cyton {

/// What the arm is commanded: seven angles and the opening of the gripper.
struct Posture {
    Joints joints{};                        ///< rad
    double opening_mm = gripper::kHome_mm;  ///< between the pads
};

using Pulses = std::array<double, kChannels>;  ///< us
Pulses pulsesOf(const Posture& posture);
Posture postureOf(const Pulses& pulses);

/// Stands between motions and the servos: a task takes the arm, its commands pass while the gate is open, a
/// stop closes it and freezes the arm in one step, and the task that was stopped cannot open it again.
///
/// It also knows where the arm is, as far as anybody does: the servos tell nothing, so the position is that
/// of the last command, interpolated over its time as the controller does it. Before the first command after
/// power-up the position is unknown.
///
/// States: free → taken, open (take()) → taken, closed (stop(), lost()) → free (giveBack(); also from open).
/// Threads: any; the stop thread calls stop(). The lock is held for one write that does not block, never
/// while waiting.
class ServoGate {
  public:
    /// Writes lines to the controller without blocking; false when it cannot be reached.
    using Send = std::function<bool(const std::string&)>;

    explicit ServoGate(Send send) : send_(std::move(send)) {}

    /// What the controller told of its pulses, us; 0: no pulse yet. A position that is known more finely and
    /// agrees with it stays.
    void told(const std::vector<int>& pulses_us, TimePoint now);

    /// False, and nothing taken, when another motion has the arm or the task was told to stop already; as
    /// peoplebot::DriveGate has it.
    bool take(const std::function<bool()>& stop_requested);
    /// Goes on to that posture, to be there after `time`. False when the gate is closed or the controller
    /// cannot be reached.
    bool command(const Posture& posture, Duration time, TimePoint now);
    /// Closes, and commands every servo the pulse that it has at this moment; true when the controller was
    /// told.
    bool stop(TimePoint now);
    /// The controller is lost: closes. It ends the move that it has, which is a short one.
    void lost();
    /// The arm is free for the next task; it stays where it is.
    void giveBack(TimePoint now);

    /// Where the arm is commanded to be now; nothing when nobody knows.
    std::optional<Posture> present(TimePoint now) const;

  private:
    std::optional<Pulses> presentPulses(TimePoint now) const;
    bool freeze(TimePoint now);

    struct Move {
        Pulses from{}, to{};
        TimePoint begin{};
        Duration time{};
    };

    const Send send_;
    mutable std::mutex mutex_;
    bool taken_ = false;  // these guarded by mutex_
    bool open_ = false;
    bool known_ = false;        // where the present move began
    std::optional<Move> move_;  // the last one, also when it is over
};

}  // namespace axon::cyton
