// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <memory>
#include <string>

namespace axon::faults {

/// Which cable a connection goes through.
enum class Hop : std::size_t { Client, Manager, Link, Master };
inline constexpr std::size_t kHops = 4;

/// What a bad cable does to a TCP connection, as its peers see it: TCP repeats what was lost and puts in
/// order what was not, so nothing is missing and nothing overtakes; but the stream comes in pieces, late, and
/// with all that is behind a late piece later still. This is on the stream, not on packets: those are for
/// axon-channel.
struct Impairment {
    std::size_t piece = 0;  ///< bytes of a piece at most, from one on; 0 = as they come
    double lost = 0;        ///< part of the pieces that must be repeated …
    double lost_again = 0;  ///< … and of those that must be once more, each after twice the time
    std::chrono::milliseconds retry{0};  ///< until the first repetition, at most; at least half of it
    std::chrono::milliseconds most{0};   ///< by all its repetitions together, at most; 0 = no bound
    std::chrono::milliseconds late{0};   ///< each piece, at most
    std::uint64_t seed = 1;
};

/// Stands in the middle of TCP connections and spoils them, one cable (hop) at a time.
///
/// | state of a hop | bytes | ends of connections |
/// |---|---|---|
/// | passing | go on, after the delay | are passed on |
/// | cut | are swallowed, both ways | are hidden: neither FIN nor RST reaches the other side |
/// | stalled | wait, both ways, and go on when the stall is over | wait too |
///
/// Where in the flow: between any two peers whose address was replaced by the relay's. Threads: one of its
/// own for all connections; every member may be called from any thread. Failure: std::system_error where it
/// cannot listen; a connection whose target refuses is reset.
class Relay {
  public:
    Relay();
    ~Relay();
    Relay(const Relay&) = delete;
    Relay& operator=(const Relay&) = delete;

    /// Passes what arrives at address:port on to target:port. Port 0 takes a free one; the one taken.
    std::uint16_t open(Hop hop, const std::string& address, std::uint16_t port, const std::string& target,
                       std::uint16_t target_port);
    /// Connections that come from this address belong to that hop from now on, wherever they are accepted.
    void divert(const std::string& source, Hop hop);
    void cut(Hop hop);
    void stall(Hop hop);
    /// Ends what was cut (it has lost bytes) with RST to both sides, lets go what was stalled, and passes
    /// again.
    void heal(Hop hop);
    /// RST to both sides of every connection there is.
    void reset(Hop hop);
    /// Each piece arrives so much later.
    void delay(Hop hop, std::chrono::milliseconds by);
    /// From now on; {} = the cable is good again. What is on its way comes as it was to come.
    void impair(Hop hop, Impairment how);
    std::size_t connections(Hop hop) const;

  private:
    class Pump;
    std::unique_ptr<Pump> pump_;
};

}  // namespace axon::faults
