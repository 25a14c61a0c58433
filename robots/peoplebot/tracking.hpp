// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <deque>
#include <optional>
#include <string>
#include <vector>

#include "robots/arcos/vcc4.hpp"
#include "robots/peoplebot/blob_finder.hpp"
#include "robots/peoplebot/gripper_operation.hpp"
#include "robots/peoplebot/motion.hpp"

namespace axon::peoplebot {

/// Where the camera and the gripper sit: millimetres in the robot's frame (x forward, y left, origin on the
/// floor midway between the wheels). No source tells them of the real robot; these are the virtual one's.
struct GraspGeometry {
    double camera_x_mm = 60;  ///< the point about which it pans and tilts
    double camera_height_mm = 950;
    double camera_lens_mm = 35;                    ///< ahead of that point
    double view_deg = arcos::vcc4::kWideView_deg;  ///< horizontal
    double paddles_mm = 170;   ///< ahead: where what is grabbed is to be, between the beams
    double lift_top_mm = 790;  ///< height of the paddles' middle, lift all the way up
    double lift_travel_mm = 190;
    double lift_mm_s = 20;
};

/// What the camera sees of the colour that is looked for.
struct CameraView {
    std::uint64_t sequence = 0;
    TimePoint taken{};
    int width = 320;
    int height = 240;
    std::vector<Blob> blobs;  ///< the largest first
};

/// The service Table Object Tracking and Grabbing (thesis 4.1.2): looks for an object of a colour on a table,
/// drives up to it, grabs and lifts it, and backs off.
///
/// | phase | does | goes on when |
/// |---|---|---|
/// | Looking | opens the paddles and brings them to the table's height; looks about with the camera, then
/// turns round and looks again | a significant blob is seen → Centring; nowhere → fails | | Centring | looks
/// straight at it | seen again → Turning | | Clearing | backs away from a table that is too near for turning,
/// or for another try | → Looking | | Turning | turns on the spot until the object is ahead | → Centring, or
/// Approaching when it is ahead | | Approaching | drives towards it, slower the nearer it is, keeping it
/// ahead | a table sensor sees the table, or it is near → Reaching; out of sight for long → Looking | |
/// Reaching | creeps until the object breaks the beams between the paddles | → Closing | | Closing | closes
/// the paddles | both feel it → Lifting; else Clearing for one more try | | Lifting, BackingOff | | → done |
/// | GivingUp | robot stands, paddles open | → failed with the reason |
///
/// The object is remembered where it stands in the odometry's frame, so that it may be out of sight for a
/// while (under the camera's lower limit in the end). Bumpers, stalls and every sonar ahead guard all
/// driving. A failure leaves the robot standing and the paddles open, except after the object was lifted: it
/// is not dropped. I/O-free, not thread-safe: what the robot and the camera say comes in, velocities, orders
/// to the gripper and where the camera is to look go out. Whoever calls halts all three when it was stopped.
class Tracking {
  public:
    enum class Phase {
        Looking,
        Centring,
        Clearing,
        Turning,
        Approaching,
        Reaching,
        Closing,
        Lifting,
        BackingOff,
        GivingUp
    };
    struct Request {
        Colour colour = Colour::Red;
        double table_height_mm = 660;
        double back_off_mm = 500;         ///< after lifting
        double velocity_mm_s = 200;       ///< of the approach
        double range_threshold_mm = 150;  ///< of the sonars ahead; zero: they are not looked at
    };
    struct Step : MotionStep {
        std::vector<GripperCommand> gripper;
        std::optional<arcos::vcc4::PanTilt> look;
    };
    static constexpr Duration kTimeLimit = std::chrono::minutes{4};

    static std::string objection(const Request& request, const GraspGeometry& geometry,
                                 const arcos::RobotState& robot);

    Tracking(const Request& request, const GraspGeometry& geometry, TimePoint now);
    /// On the way too; within what objection() lets pass. The rest of the request stays.
    void reconfigure(double velocity_mm_s, double range_threshold_mm, double back_off_mm);
    /// `view`: the newest there is; the same may be given several times. None: the camera sends nothing.
    Step step(const arcos::RobotState& robot, const CameraView* view, TimePoint now);
    /// After a pause, in which step() is not called.
    void resume(TimePoint now);

    Phase phase() const { return phase_; }
    static const char* toString(Phase phase);

  private:
    struct Point {
        double x = 0;
        double y = 0;
    };
    struct PoseThen {
        TimePoint at{};
        double x = 0, y = 0, heading_deg = 0;
    };

    void enter(Phase phase, TimePoint now);
    void look(double pan_deg, double tilt_deg, TimePoint now, Step& step);
    void lookAtTarget(const arcos::RobotState& robot, TimePoint now, Step& step);
    /// True when this is a picture of after the camera had come to rest, not used before.
    bool fresh(const CameraView* view, TimePoint now);
    bool measure(const CameraView& view);
    PoseThen poseAt(TimePoint then) const;
    Point seenFrom(const arcos::RobotState& robot) const;  // the target in the robot's frame
    void prepareGripper(const arcos::GripperState& gripper, TimePoint now, Step& step);
    void giveUp(std::string reason, TimePoint now);
    /// Another try, or giving up.
    void tryAgain(const std::string& reason, bool clear, TimePoint now);
    /// False when it has not been felt for so long that it is no tremor.
    bool stillHolding(const arcos::GripperState& gripper, TimePoint now);
    std::optional<std::string> danger(const arcos::RobotState& robot, double forward, TimePoint now) const;
    double way(const arcos::RobotState& robot) const;  // since the phase began

    void stepLooking(const arcos::RobotState& robot, const CameraView* view, TimePoint now, Step& step);
    void stepCentring(const arcos::RobotState& robot, const CameraView* view, TimePoint now, Step& step);
    void stepClearing(const arcos::RobotState& robot, TimePoint now, Step& step);
    void stepTurning(const arcos::RobotState& robot, TimePoint now, Step& step);
    void stepApproaching(const arcos::RobotState& robot, const CameraView* view, TimePoint now, Step& step);
    void stepReaching(const arcos::RobotState& robot, const CameraView* view, TimePoint now, Step& step);
    void stepClosing(const arcos::RobotState& robot, TimePoint now, Step& step);
    void stepLifting(const arcos::RobotState& robot, TimePoint now, Step& step);
    void stepBackingOff(const arcos::RobotState& robot, TimePoint now, Step& step);
    void stepGivingUp(const arcos::RobotState& robot, TimePoint now, Step& step);

    Request request_;
    const GraspGeometry geometry_;
    const TimePoint started_;
    Phase phase_ = Phase::Looking;
    TimePoint since_;  // the phase began
    bool entered_ = true;
    PoseThen entry_;  // where the robot was then
    std::deque<PoseThen> history_;
    StandstillWatch standstill_;

    // The camera.
    std::optional<arcos::vcc4::PanTilt> looking_;  // where it was told to look
    TimePoint settled_{};                          // from then on it does
    std::uint64_t used_picture_ = 0;
    std::size_t next_look_ = 0;
    int rounds_ = 0;  // of looking about
    std::optional<double> turn_to_deg_;

    // The object.
    std::optional<Point> target_;
    TimePoint seen_{};
    int tries_ = 0;
    int centrings_ = 0;

    // The gripper.
    enum class Preparation { NotBegun, Raising, Lowering, Ready };
    Preparation preparation_ = Preparation::NotBegun;
    TimePoint prepared_since_{};
    TimePoint lowered_at_{};
    bool ordered_ = false;  // the phase's order to the gripper was given
    int squeezes_ = 0;      // of Closing
    bool holding_ = false;
    TimePoint held_{};                     // last felt
    std::optional<double> outer_beam_at_;  // way of Reaching at which the object came between the paddles
    TimePoint moving_{};

    std::string reason_;  // of giving up
};

}  // namespace axon::peoplebot
