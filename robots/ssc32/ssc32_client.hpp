// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "robots/common/byte_stream.hpp"
#include "robots/ssc32/client_session.hpp"

namespace axon::ssc32 {

/// A connection to one SSC-32 that never gives up: connects, finds out the pulses, notices when it is gone,
/// and tries again for ever (after 100 ms, doubling up to 2 s). It never moves a servo of itself.
///
/// Between a robot application above and a ByteStream (TCP or serial) below; the protocol is ClientSession.
/// Threads: one of its own, on which all callbacks run; they must not block. send() from any thread: written
/// to the link by the caller, without a queue, so that a stop is on the wire when the call returns.
/// Destruction joins the thread and leaves the servos where they are; not from a callback.
class Ssc32Client {
  public:
    struct Callbacks {
        std::function<void(const std::vector<int>& pulses_us)> on_online;
        std::function<void(const std::vector<int>& pulses_us)> on_pulses;  ///< after askPulses()
        std::function<void(bool moving)> on_status;                        ///< ten times a second
        std::function<void(const std::string& reason)> on_lost;  ///< also for each failed attempt to connect
    };

    Ssc32Client(robots::StreamOpener open, std::vector<std::size_t> channels, Callbacks callbacks,
                Duration silence_limit = ClientSession::kSilenceLimit,
                std::shared_ptr<const Clock> clock = std::make_shared<SteadyClock>());
    ~Ssc32Client();
    Ssc32Client(const Ssc32Client&) = delete;
    Ssc32Client& operator=(const Ssc32Client&) = delete;

    /// Begins to connect; once.
    void start();
    bool online() const;
    /// Whole lines. False when the controller cannot be reached; a link that does not take them at once is
    /// given up and opened again.
    bool send(const std::string& lines);
    void askPulses();

  private:
    class Worker;
    std::unique_ptr<Worker> worker_;
};

}  // namespace axon::ssc32
