// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "common/clock.hpp"

namespace axon::ssc32 {

/// One connection with an SSC-32, without I/O: finds out whether there is one, which pulses it gives, and
/// keeps asking whether its moves are over, which is the only way to notice that it is gone.
///
/// | state | until |
/// |---|---|
/// | Closed | begin() |
/// | Probing | no move is left and the pulses of all channels were told → Online; 2 s of silence → Closed |
/// | Online | silence_limit without an answer, or end() → Closed |
///
/// Answers carry no mark of what they answer, so that only one query is under way at a time; bytes that
/// nobody asked for are counted and dropped. Threads: none, not thread-safe. Nothing here ever moves a servo.
class ClientSession {
  public:
    enum class State { Closed, Probing, Online };
    static constexpr Duration kSilenceLimit = std::chrono::milliseconds{1000};
    static constexpr Duration kProbeLimit = std::chrono::seconds{2};
    static constexpr Duration kQueryPeriod = std::chrono::milliseconds{100};

    /// What the session wants done; called from within its functions.
    class Port {
      public:
        virtual ~Port() = default;
        virtual void send(const std::string& bytes) = 0;
        /// The pulse of each channel in the order given to the constructor, us; 0: none since power-up.
        virtual void onOnline(const std::vector<int>& pulses_us) = 0;
        /// The pulses again, because askPulses() was called.
        virtual void onPulses(const std::vector<int>& pulses_us) = 0;
        /// Ten times a second: whether a move is under way.
        virtual void onStatus(bool moving) = 0;
        virtual void onLost(const std::string& reason) = 0;
    };

    /// Port is not owned.
    ClientSession(Port& port, std::vector<std::size_t> channels, Duration silence_limit = kSilenceLimit);

    void begin(TimePoint now);
    void receive(std::span<const std::uint8_t> bytes, TimePoint now);
    void tick(TimePoint now);
    /// Nothing when closed already.
    void end(const std::string& reason);
    /// The pulses are read once more; onPulses() follows.
    void askPulses() { pulses_wanted_ = true; }

    State state() const { return state_; }
    std::uint64_t unexpectedBytes() const { return unexpected_bytes_; }

  private:
    enum class Query { Status, Pulse };
    void ask(Query query, TimePoint now);
    void onPulse(std::uint8_t byte, TimePoint now);

    Port& port_;
    const std::vector<std::size_t> channels_;
    const Duration silence_limit_;
    State state_ = State::Closed;
    std::optional<Query> under_way_;
    std::vector<int> pulses_us_;  // as many as are known of the present round
    bool pulses_wanted_ = false;
    TimePoint heard_{};
    TimePoint asked_{};
    TimePoint began_{};
    std::uint64_t unexpected_bytes_ = 0;
};

}  // namespace axon::ssc32
