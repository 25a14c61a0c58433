// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <optional>
#include <span>

#include "lab/arcos_server.hpp"
#include "robots/lms2xx/scan.hpp"

namespace axon::lab {

/// The SICK LMS-200 of a PeopleBot whose laser has a line of its own, as on the real robot: the laser's half
/// of its telegrams.
///
/// It answers changes of mode (output continuous or on request, the speed of its line), changes of variant,
/// requests for its configuration and for one scan; what else is asked is refused (92) and counted. A damaged
/// request is answered by NAK. After the start it is silent at 9600 baud. Whoever is connected or not, it
/// goes on as it was told.
///
/// On a serial line a scan travels as long as its bytes take at the line's speed, and what is measured
/// meanwhile is not sent: 181 values take 97 ms at 38400 baud, 388 ms at 9600. On other links it is there at
/// once.
///
/// Threads: none, not thread-safe. I/O-free: time comes in with each call.
class LmsServer {
  public:
    struct Counters {
        std::uint64_t requests = 0;
        std::uint64_t refused = 0;
        std::uint64_t scans = 0;  ///< sent
    };

    /// `measuring`: as it is configured; nothing here changes that.
    explicit LmsServer(bool serial_line, lms2xx::Measuring measuring = {.millimetres = true, .mode = 6})
        : serial_line_(serial_line), measuring_(measuring) {}

    /// Bytes of the client; gives the answers.
    lms2xx::Bytes receive(std::span<const std::uint8_t> bytes, TimePoint now);
    /// One control period: gives the scan that arrives in it, if one does. `readings` of the robot that it
    /// sits on.
    lms2xx::Bytes step(Duration period, const BodyReadings& readings);

    /// How it scans now.
    LaserSettings scanning() const;
    /// The speed of its line.
    int baud() const { return baud_; }
    const Counters& counters() const { return counters_; }

  private:
    std::optional<lms2xx::Telegram> answer(const lms2xx::Telegram& request);
    bool changeMode(std::uint8_t mode);
    lms2xx::Telegram scanOf(const BodyReadings& readings) const;

    const bool serial_line_;
    const lms2xx::Measuring measuring_;
    lms2xx::TelegramReader reader_{lms2xx::TelegramReader::From::Host};
    int baud_ = 9600;
    lms2xx::Variant variant_;
    bool continuous_ = false;
    bool one_wanted_ = false;
    lms2xx::Bytes travelling_;
    Duration arrives_in_{};
    Counters counters_;
};

}  // namespace axon::lab
