// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <string>

#include "robots/common/byte_stream.hpp"
#include "robots/lms2xx/scan.hpp"

namespace axon::lms2xx {

/// One sweep, in the order in which it was made: from the right to the left. A value type.
struct Scan {
    TimePoint taken{};       ///< the middle of the sweep, before it travelled over the line
    double start_deg = -90;  ///< of the first range, to the left of straight ahead
    double step_deg = 1;
    std::vector<std::uint16_t> ranges_mm;  ///< kNothing_mm: none was measured
    bool polluted = false;                 ///< the laser says that its front screen is dirty
};

/// What a laser turned out to be and to do.
struct Setting {
    int baud = 0;         ///< of the line; 0: it has no speed
    Variant variant;      ///< as the laser answered; a scan's own number of values is what counts
    Measuring measuring;  ///< read, never written: it lies in the laser's memory, which wears out

    bool operator==(const Setting&) const = default;
};

/// The host's half of a session with one laser: finds the speed at which it listens, takes it to a faster
/// one, asks what its values mean, asks for 180 degrees in steps of one, and starts the continuous output of
/// scans.
///
/// - Closed: no link. begin() leads to Finding.
/// - Finding: the laser is told to end its output, at each speed in turn; it may still be sending to a
///   program that was killed. Its answer leads to Configuring; every speed tried kRounds times to Closed,
///   onLost.
/// - Configuring: one request after the other, each given kTries times kAnswerTimeout. When its output has
///   started: Scanning, onOnline. A refusal or silence: Closed, onLost.
/// - Scanning: scans arrive. silence_limit without one, a fault, a laser that was switched on again, and
///   end() lead to Closed, onLost.
///
/// Two requests may fail: the faster speed, then the line stays as it is; and the 180 degrees, then the laser
/// keeps its own. Threads: none, not thread-safe. I/O-free: time comes in with each call, bytes leave through
/// the port. Scans that are damaged, in parts or of a length that no variant has are dropped and counted.
class ClientSession {
  public:
    enum class State { Closed, Finding, Configuring, Scanning };

    class Port {
      public:
        virtual ~Port() = default;
        virtual void send(const Bytes& bytes) = 0;
        virtual void onOnline(const Setting& setting) = 0;
        virtual void onScan(const Scan& scan) = 0;
        virtual void onLost(const std::string& reason) = 0;
        /// Changes the speed of the serial line; false where that is impossible.
        virtual bool setSpeed(int baud) = 0;
    };

    /// The fastest that a line without special hardware has, and the laser too: ten scans of 181 values a
    /// second.
    static constexpr int kRaisedSpeed = 38400;
    static constexpr Duration kFindTimeout = std::chrono::milliseconds{1500};
    static constexpr int kRounds = 2;
    static constexpr Duration kAnswerTimeout =
        std::chrono::seconds{3};  // the listing's, for a change of mode
    static constexpr int kTries = 2;
    static constexpr Duration kSilenceLimit = std::chrono::seconds{2};
    /// From the middle of a sweep to its end; the mirror turns 75 times a second.
    static constexpr Duration kHalfASweep = std::chrono::milliseconds{7};

    explicit ClientSession(Port& port, Duration silence_limit = kSilenceLimit)
        : port_(port), silence_limit_(silence_limit) {}

    /// There is a link, whose speed this is.
    void begin(TimePoint now, const robots::LineSpeed& line);
    void receive(std::span<const std::uint8_t> bytes, TimePoint now);
    /// At least every 50 ms.
    void tick(TimePoint now);
    /// Ends the output and the session; nothing when closed already.
    void end(const std::string& reason);

    State state() const { return state_; }
    std::uint64_t droppedScans() const { return dropped_scans_; }
    const TelegramReader& reader() const { return reader_; }

  private:
    enum class Step { EndOutput, RaiseSpeed, ReadConfiguration, SetVariant, StartOutput };
    void take(Step step, TimePoint now);
    void ask(TimePoint now);
    void onTelegram(const TelegramReader::Item& item, TimePoint now);
    void onSpeedAnswer(bool done, TimePoint now);
    void onScanTelegram(const Telegram& telegram, TimePoint now, TimePoint arrived);
    void onNoAnswer(TimePoint now);
    void findElsewhere(TimePoint now);
    Duration onTheWire(std::size_t bytes) const;

    Port& port_;
    const Duration silence_limit_;
    State state_ = State::Closed;
    TelegramReader reader_{TelegramReader::From::Laser};
    robots::LineSpeed line_;
    std::vector<int> speeds_;  // at which the laser is looked for; none where the link has none
    int searches_ = 0;
    Step step_ = Step::EndOutput;
    int tries_ = 0;  // of this step
    TimePoint asked_{};
    TimePoint last_scan_{};
    Setting setting_;
    bool just_raised_ = false;   // and nothing was heard since
    bool raise_failed_ = false;  // once: it is not tried again
    std::uint64_t dropped_scans_ = 0;
};

}  // namespace axon::lms2xx
