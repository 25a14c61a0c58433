// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "robots/arcos/gripper.hpp"
#include "robots/arcos/laser.hpp"
#include "robots/arcos/pose_history.hpp"
#include "robots/arcos/server_information.hpp"
#include "robots/common/byte_stream.hpp"

namespace axon::arcos {

/// Who the robot says it is, in its answer to SYNC2.
struct RobotIdentity {
    std::string name;
    std::string type;     ///< the class of robots: "Pioneer"
    std::string subtype;  ///< the model: "peoplebot-sh"

    bool operator==(const RobotIdentity&) const = default;
};

/// One sweep of the laser: assembled from the robot's packets, or given to newScan(). Immutable once
/// published.
struct LaserScan {
    std::uint64_t sequence = 0;  ///< from 1 per connection; packets that are missing cost their whole scan
    TimePoint taken{};           ///< when its last packet arrived; of newScan(): when it was made
    double x_mm = 0;             ///< odometry of the sweep, in the frame of RobotState
    double y_mm = 0;
    double heading_deg = 0;
    double start_deg =
        -90;  ///< of the first reading, to the left of straight ahead; the first is on the right
    double step_deg = 1;
    std::vector<std::uint16_t>
        ranges_mm;  ///< 181 of an LMS-200; what sees nothing reads LaserPacket::kNothing_mm

    /// Whether anything was measured at all. A laser that looks into the sun measures nothing anywhere, and
    /// must not be taken for one that sees no obstacle.
    bool sees() const;
};

/// The two-degrees-of-freedom gripper as its limit switches, beams and paddles tell. There is no position.
struct GripperState {
    bool known = false;   ///< the robot has answered whether it has a gripper
    bool fitted = false;  ///< and it has
    bool open = false;    ///< paddles at their outer limit
    bool closed = false;  ///< paddles at rest at their inner limit or on what they hold
    bool lift_up = false;
    bool lift_down = false;
    bool lift_at_limit = false;  ///< at one of the two; robots that do not tell which have this alone
    bool paddles_moving = false;
    bool lift_moving = false;
    bool paddle_error = false;
    bool lift_error = false;
    bool outer_beam = false;  ///< something is between the paddles' tips
    bool inner_beam = false;  ///< something is between the paddles' roots
    bool left_pressed = false;
    bool right_pressed = false;

    bool operator==(const GripperState&) const = default;
};

/// What the robot last said of itself, in units a person thinks in. A value type.
struct RobotState {
    static constexpr int kSonars = 32;
    struct Sonar {
        int range_mm = kNoEcho_mm;
        TimePoint heard{};  ///< the epoch: never
    };

    bool online = false;
    int baud = 0;  ///< the speed of the serial line that the robot is spoken to on; 0: there is none
    std::uint64_t sequence = 0;  ///< of the server information packet, from 1 per connection
    TimePoint taken{};           ///< when that packet arrived
    double x_mm = 0;             ///< odometry since OPEN, accumulated over the 15-bit wrap of the wire
    double y_mm = 0;
    double heading_deg = 0;  ///< accumulated over full turns; positive is to the left
    double left_mm_s = 0;
    double right_mm_s = 0;
    double rotation_deg_s = 0;
    bool moving = false;
    bool motors_on = false;
    bool left_stall = false;
    bool right_stall = false;
    unsigned front_bumpers = 0;  ///< bit 0 is segment 1
    unsigned rear_bumpers = 0;
    bool table_left = false;  ///< the infrared table sensors see something
    bool table_right = false;
    bool column_left =
        false;  ///< the break beams along the column: something reaches into the robot's outline
    bool column_right = false;
    double battery_v = 0;
    std::array<Sonar, kSonars> sonars{};
    std::shared_ptr<const LaserScan> laser;  ///< the newest; none until the robot has sent one
    GripperState gripper;
    std::shared_ptr<const RobotConfig> config;  ///< what the robot is and how it is tuned; none until it told

    double speed_mm_s() const { return (left_mm_s + right_mm_s) / 2; }
};

/// The client's half of an ARCOS session: shakes hands (SYNC0, SYNC1, SYNC2, OPEN), raises the speed of a
/// serial line, sends PULSE when nothing else was sent, turns packets into a RobotState, and says when the
/// robot is lost.
///
/// - Closed: no link. begin() leads to Synchronising.
/// - Synchronising: SYNCn was sent, its echo is awaited; after kSyncTimeout it begins with SYNC0 again.
///   The third echo leads to Opening; kSyncAttempts used up to Closed, onLost.
/// - Opening: OPEN was sent, the first server information is awaited for kOpenTimeout. It leads to Online,
///   onOnline; its absence to Closed, onLost.
/// - Online: no server information for the silence limit, and end(), lead to Closed, onLost.
///
/// A robot may still be driving as a program told it that was killed: on a serial line nobody tells it, and
/// whoever shakes hands keeps its watchdog from tripping, because SYNC0 is PULSE to a robot whose session is
/// open. So on a serial line each SYNC0 follows an ESTOP, and every other one a CLOSE as well; on other links
/// they are sent once the robot is heard to be in an old session. ESTOP is also sent to a robot that has
/// fallen silent: it may hear.
///
/// Speeds: the robot is looked for at the line's present speed, at kFirstSpeed and at kRaisedSpeed in turn.
/// Then HOSTBAUD takes it to the speed that the address asks for, else to kRaisedSpeed, and the line follows.
/// A robot that is not heard there within kSpeedPatience is spoken to at the speed at which it was found.
///
/// Threads: none, not thread-safe; the owner confines it (ArcosClient does). I/O-free: time comes in with
/// each call, bytes leave through the port. Failure: only onLost, with a reason for a person.
class ClientSession {
  public:
    enum class State { Closed, Synchronising, Opening, Online };

    class Port {
      public:
        virtual ~Port() = default;
        virtual void send(const Bytes& bytes) = 0;
        virtual void onOnline(const RobotIdentity& identity) = 0;
        virtual void onState(const RobotState& state) = 0;
        virtual void onLost(const std::string& reason) = 0;
        /// Changes the speed of the serial line; false where that is impossible.
        virtual bool setSpeed(int /*baud*/) { return false; }
    };

    static constexpr int kRaisedSpeed = 38400;
    /// Until a HOSTBAUD that was written has left the computer; an adapter on USB keeps it for some
    /// milliseconds.
    static constexpr Duration kSpeedPause = std::chrono::milliseconds{50};
    static constexpr Duration kSpeedPatience = std::chrono::milliseconds{900};
    static constexpr Duration kSyncTimeout = std::chrono::milliseconds{500};
    static constexpr int kSyncAttempts = 12;
    static constexpr Duration kOpenTimeout = std::chrono::seconds{2};
    static constexpr Duration kSilenceLimit = std::chrono::milliseconds{500};   // five packets missing
    static constexpr Duration kGripperRequestPeriod = std::chrono::seconds{1};  // until it is answered
    /// A quarter of the robot's watchdog, between these two.
    static constexpr Duration kShortestPulsePeriod = std::chrono::milliseconds{50};
    static constexpr Duration kPulsePeriod = std::chrono::milliseconds{500};

    explicit ClientSession(Port& port, Duration silence_limit = kSilenceLimit)
        : port_(port), silence_limit_(silence_limit) {}

    /// There is a link, whose speed this is: start shaking hands.
    void begin(TimePoint now, const robots::LineSpeed& line = {});
    /// The link is gone; onLost(reason) unless the session was closed already.
    void end(const std::string& reason);
    void receive(std::span<const std::uint8_t> bytes, TimePoint now);
    /// To be called at least every 50 ms.
    void tick(TimePoint now);
    /// A sweep of a laser that is wired to this computer: its angles, ranges, and when it was made. It is
    /// part of the next RobotState, with a sequence and with where the robot was then. After the first one
    /// the robot's own laser packets are ignored. Nothing happens before the robot is online.
    void newScan(LaserScan scan);
    /// Something else was sent by the owner: no PULSE is needed for a while.
    void commandSent(TimePoint now) { last_sent_ = now; }

    State state() const { return state_; }
    const RobotIdentity& identity() const { return identity_; }
    const RobotState& robot() const { return robot_; }
    const PacketReader& reader() const { return reader_; }

  private:
    void sendSync(TimePoint now);
    Duration pulsePeriod() const;
    void send(const Bytes& bytes, TimePoint now);
    void onPacket(const Packet& packet, TimePoint now);
    void onSync(const Packet& packet, TimePoint now);
    void onServerInformation(const ServerInformation& sip, TimePoint now, Duration on_the_wire);
    void onLaser(const LaserPacket& packet, TimePoint now);
    void askForEverything(TimePoint now);
    void changeSpeed(TimePoint now);
    void publishScan(LaserScan scan);
    Duration onTheWire(std::size_t bytes) const;
    void readGripper(std::uint8_t grip_state, std::uint8_t general_io);
    bool isMobileSim() const { return identity_.name == "MobileSim"; }

    Port& port_;
    const Duration silence_limit_;
    State state_ = State::Closed;
    PacketReader reader_;
    RobotIdentity identity_;
    RobotState robot_;
    LaserScanAssembler laser_;
    robots::LineSpeed line_;
    std::vector<int> speeds_;  // at which the robot is looked for; none where the link has none
    std::size_t speed_ = 0;    // which of them
    std::optional<TimePoint> speed_change_due_;  // HOSTBAUD was sent, the line is to follow
    int speed_before_ = 0;                       // the line has followed, and nothing was heard yet
    TimePoint speed_changed_{};
    int sync_ = 0;               // which of SYNC0 to SYNC2 is awaited
    int attempts_ = 0;           // to begin with SYNC0
    int old_session_seen_ = -1;  // in which attempt
    TimePoint last_sent_{};
    TimePoint last_heard_{};
    TimePoint gripper_asked_{};
    std::uint8_t gripper_type_ = GripperPacket::kNone;
    bool gripper_known_ = false;  // it was answered, if only that there is none
    // What the wire last said, to accumulate differences.
    std::optional<ServerInformation> previous_;
    bool table_sensors_by_io_ = false;
    PoseHistory poses_;
    bool laser_of_ours_ = false;
    std::optional<LaserScan> scan_;  // until the next server information
};

}  // namespace axon::arcos
