// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <string>

#include "lab/camera_control.hpp"
#include "lab/gripper_control.hpp"
#include "lab/motion_control.hpp"
#include "robots/arcos/server_information.hpp"
#include "robots/common/byte_stream.hpp"

namespace axon::lab {

/// How the laser range finder scans: reading n at start + n * resolution, degrees from straight ahead, to the
/// left positive.
struct LaserSettings {
    static constexpr int kMaximumReadings = 401;
    bool on = false;
    double start_deg = -90;
    double end_deg = 90;
    double resolution_deg = 1;

    int readings() const;  ///< 1 to kMaximumReadings
    bool operator==(const LaserSettings&) const = default;
};

/// What the virtual body senses, once per control period.
struct BodyReadings {
    static constexpr int kSonars = 24;
    double left_wheel_mm = 0;  ///< encoder: way of the wheel's rim since the start of the world
    double right_wheel_mm = 0;
    double left_mm_s = 0;
    double right_mm_s = 0;
    unsigned front_bumpers = 0;  ///< bit 0 is segment 1
    unsigned rear_bumpers = 0;
    bool left_blocked = false;  ///< the motor pushes with all it has, and the wheel does not turn
    bool right_blocked = false;
    bool table_left = false;
    bool table_right = false;
    double battery_v = 0;
    double charge = 1;               ///< of the battery, 0 to 1
    std::uint32_t sonars_fired = 0;  ///< bit n: sonar n fired in this period; its range is in sonar_mm[n]
    std::array<std::uint16_t, kSonars> sonar_mm{};
    GripperReadings gripper;
    bool laser_scanned = false;  ///< in this period; the scan is in laser_mm
    std::vector<std::uint16_t> laser_mm;
};

/// The controller of one virtual PeopleBot: the robot's half of an ARCOS session, and with it the motors.
/// Commands come in as bytes, server information goes out as bytes, wheel speeds go to the body.
///
/// | state | means | leaves on |
/// |---|---|---|
/// | NoClient | no link | clientConnected() → Synchronising |
/// | Synchronising | SYNC0, SYNC1, SYNC2 awaited in this order; any other packet → back to SYNC0 | SYNC2
/// answered → Synchronised | | Synchronised | identity told, no server information yet | OPEN → Open · SYNC0
/// → the handshake anew | | Open | commands are obeyed, server information every 100 ms | CLOSE →
/// Synchronising · clientLost() → NoClient |
///
/// Leaving Open, and kWatchdog without a whole packet, stop the robot; leaving Open also switches the motors
/// off. After the watchdog tripped nothing moves again until there is a new motion command (the manuals leave
/// this open). A bumper that is set to stall (BUMPSTALL), and a blocked motor, halt the motors at once; for
/// kStallPause the stall bits are set and every motion command is dropped, and after it motion towards a
/// pressed bumper stalls again.
///
/// Old and new clients give the same numbers to different orders. GripperValue right after an order that
/// needs one, and GripperRequest with 0 to 2, are the gripper's; all others of them are the laser's angles.
/// Gripper, camera and laser are at rest when the session ends; the paddles keep what they hold.
///
/// Threads: none, not thread-safe. I/O-free: time comes in with each call, bytes leave through the port.
/// Bytes with a bad checksum are ignored and counted; unknown commands are ignored and counted.
class ArcosServer {
  public:
    enum class State { NoClient, Synchronising, Synchronised, Open };

    struct Identity {
        std::string name = "PeopleBot";
        std::string type = "Pioneer";
        std::string subtype = "peoplebot-sh";
    };

    struct Counters {
        std::uint64_t commands = 0;
        std::uint64_t unknown_commands = 0;
        std::uint64_t malformed_commands = 0;
        std::uint64_t out_of_order_syncs = 0;
        std::uint64_t watchdog_trips = 0;
        std::uint64_t stalls = 0;
    };

    class Port {
      public:
        virtual ~Port() = default;
        virtual void send(const arcos::Bytes& bytes) = 0;
    };

    static constexpr Duration kWatchdog = std::chrono::milliseconds{2000};
    static constexpr Duration kSipPeriod = std::chrono::milliseconds{100};
    static constexpr Duration kStallPause = std::chrono::milliseconds{500};
    /// 2 / DiffConvFactor of the vendor's parameter file, so that ARIA's conversions agree with this
    /// odometry.
    static constexpr double kTrack_mm = 2 / 0.006;

    /// `laser`: false on a robot whose laser is wired to the computer; orders for it are then unknown.
    ArcosServer(Identity identity, Port& port, bool laser = true)
        : identity_(std::move(identity)), port_(port), has_laser_(laser) {}

    void clientConnected(TimePoint now);
    void clientLost();
    void receive(std::span<const std::uint8_t> bytes, TimePoint now);

    /// One control period: odometry, watchdog, stalls, ramps, and the server information packet when it is
    /// due. Gives the rim speeds that the wheels are to have.
    struct WheelSpeeds {
        double left_mm_s = 0;
        double right_mm_s = 0;
    };
    WheelSpeeds step(Duration period, const BodyReadings& readings, TimePoint now);

    /// After step(): what the gripper's motors are to do, where the camera is to look, how the laser is to
    /// scan.
    const GripperSpeeds& gripper() const { return gripper_speeds_; }
    const CameraPose& camera() const { return camera_.pose(); }
    const LaserSettings& laser() const { return laser_; }
    /// The speed of its serial line, for whoever carries the bytes over one. It is kFirstSpeed until HOSTBAUD
    /// changes it, and stays so until the robot is switched off (assumed: the manual does not say when it
    /// ends).
    int baud() const { return baud_; }

    /// The encoders jumped, the robot did not move: the next readings count from there.
    void encodersJumped() { encoders_known_ = false; }

    State state() const { return state_; }
    bool motorsOn() const { return motors_on_; }
    /// Whether the sonar array (0: base front, 1: base rear, 2: top) is switched on.
    bool sonarOn(int array) const { return (sonar_arrays_ & (1U << static_cast<unsigned>(array))) != 0; }
    const MotionControl& motion() const { return motion_; }
    const Counters& counters() const { return counters_; }
    std::uint64_t badChecksums() const { return reader_.badChecksums(); }

  private:
    void onPacket(const arcos::Packet& packet, TimePoint now);
    void onSync(const arcos::Packet& packet);
    void onCommand(const arcos::Packet& packet, TimePoint now);
    void onMotion(arcos::Command command, const arcos::Argument& argument);
    void onSonar(int argument);
    void onGripper(arcos::Command command, int argument);
    void onLaser(arcos::Command command, int argument);
    void onCamera(arcos::Command command, const arcos::Argument& argument);
    void sendAuxiliary();
    void sendGripper();
    void sendLaser(const BodyReadings& readings);
    void endSession(State next);
    void stall(TimePoint now, bool left, bool right);
    void watchBody(const BodyReadings& readings, TimePoint now);
    void updateOdometry(const BodyReadings& readings);
    void sendServerInformation(const BodyReadings& readings);
    void sendConfig();
    void sendInputsOutputs();

    const Identity identity_;
    Port& port_;
    const bool has_laser_;
    int baud_ = robots::kFirstSpeed;
    State state_ = State::NoClient;
    arcos::PacketReader reader_;
    MotionControl motion_;
    Counters counters_;
    int sync_ = 0;

    bool motors_on_ = false;
    unsigned bump_stall_ = 0;        // bit 0 front, bit 1 rear
    unsigned sonar_arrays_ = 0b111;  // bit n: array n
    int io_requests_ = 0;            // 0 none, 1 one, 2 with every server information packet
    int gripper_requests_ = 0;       // as io_requests_
    GripperControl gripper_;
    GripperSpeeds gripper_speeds_;
    CameraControl camera_;
    std::string auxiliary_;  // what the camera said and nobody has fetched yet
    std::size_t auxiliary_wanted_ = 0;
    LaserSettings laser_;
    bool laser_reflectances_ = false;
    std::uint8_t digital_out_ = 0;
    std::uint8_t digital_in_ = 0xFF;
    TimePoint last_packet_{};
    TimePoint next_sip_{};
    TimePoint stalled_until_{};
    bool watchdog_tripped_ = false;
    bool stalled_ = false;
    bool left_stall_ = false;
    bool right_stall_ = false;
    std::uint32_t sonars_pending_ = 0;

    // Odometry: since OPEN or SETO (pose), and since ever (distance, heading).
    bool encoders_known_ = false;
    double last_left_mm_ = 0;
    double last_right_mm_ = 0;
    double x_mm_ = 0;
    double y_mm_ = 0;
    double theta_deg_ = 0;
    double distance_mm_ = 0;
};

}  // namespace axon::lab
