// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>

#include "robots/arcos/packet.hpp"

/// The Canon VC-C4, the PeopleBot's pan-tilt-zoom camera, as it is spoken to through the robot's second
/// serial port: the bytes travel as the text of Command::Tty2, answers are fetched with Command::GetAux and
/// come as kAuxPacket. A command is FF 30 30 00 | command | parameters in hexadecimal ASCII | EF and each is
/// answered with FE 30 30 | error | 30 | parameters | EF. A client may ignore the answers ("unidirectional")
/// if it gives the camera 300 ms between commands. Angles here are degrees with pan positive to the LEFT, as
/// all angles in Axon; the camera's own pan is positive to the right. Angles beyond the limits are clamped.
namespace axon::arcos::vcc4 {

inline constexpr double kUnit_deg = 0.1125;  // of all angles and rates on the wire
inline constexpr double kMaximumPan_deg = 98;
inline constexpr double kMinimumTilt_deg = -30;
inline constexpr double kMaximumTilt_deg = 88;
inline constexpr double kMaximumPanRate_deg_s = 90;
inline constexpr double kMaximumTiltRate_deg_s = 69;
inline constexpr int kMaximumZoom = 1960;
inline constexpr double kWideView_deg = 45;  // horizontal field of view at zoom 0
inline constexpr double kTeleView_deg = 1.97;

enum class Code : std::uint8_t {
    PanRate = 0x50,
    TiltRate = 0x51,
    Stop = 0x53,
    Initialise = 0x58,
    PanTilt = 0x62,
    PanTiltRequest = 0x63,
    SetRange = 0x64,
    Control = 0x90,
    Power = 0xA0,
    Zoom = 0xB3,
    ZoomRequest = 0xB4,
};

enum class Error : std::uint8_t {
    None = 0x30,
    Busy = 0x31,
    Parameter = 0x35,
    Mode = 0x39,  ///< not under the host's control: Power and Control come first
};

struct PanTilt {
    double pan_left_deg = 0;
    double tilt_up_deg = 0;
};

/// A command as it arrived at the camera: its parameters are still ASCII.
struct Request {
    Code code{};
    std::string parameters;
};

// What a client says. The bytes are the whole text for Command::Tty2.
std::string power(bool on);
std::string control();     ///< takes the camera under the host's control
std::string initialise();  ///< goes to pan 0, tilt 0
std::string panTilt(const PanTilt& to);
std::string panRate(double deg_s);
std::string tiltRate(double deg_s);
std::string fullTiltRange();  ///< without it the camera does not tilt above 30 degrees
std::string zoom(int position);
std::string stop();
std::string requestPanTilt();

// What a camera understands.
/// The degrees of the parameters of Code::PanTilt; nothing if they are malformed or beyond the limits.
std::optional<PanTilt> parsePanTilt(std::string_view parameters);
/// An unsigned hexadecimal number of one to four digits.
std::optional<int> parseNumber(std::string_view parameters);
std::string answer(Error error);
std::string answerPanTilt(const PanTilt& at);
std::string answerZoom(int position);
/// What the client makes of the answer to requestPanTilt(): nothing if it is not one or tells an error.
std::optional<PanTilt> parsePanTiltAnswer(std::string_view answer);

/// Finds the commands in what arrives on the camera's port. A command without an end is given up when the
/// next one begins, or after 32 bytes.
class RequestReader {
  public:
    std::vector<Request> feed(std::string_view bytes);

  private:
    std::string buffer_;
};

/// Degrees of horizontal view at a zoom position; the lens's angle shrinks geometrically, which is an
/// assumption between the two ends that the vendor tells.
double viewAt(int zoom);

}  // namespace axon::arcos::vcc4
