// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <string>

#include "robots/lms2xx/client_session.hpp"

namespace axon::lms2xx {

/// A connection to one laser that never gives up: finds it, sets it up, passes its scans on, notices when it
/// is gone, and tries again for ever (after 100 ms, doubling up to 2 s).
///
/// Between a robot application above and a ByteStream below, a serial line or TCP; the protocol is
/// ClientSession. Threads: one of its own, which owns the line and on which all callbacks run; they must not
/// block. Destruction ends the laser's output and joins the thread; not from a callback.
class Lms2xxClient {
  public:
    struct Callbacks {
        std::function<void(const Setting&)> on_online;
        std::function<void(const Scan&)> on_scan;                ///< ten times a second at 38400 baud
        std::function<void(const std::string& reason)> on_lost;  ///< also for each failed attempt to connect
    };

    /// `silence_limit`: without a scan for so long, on `clock`, the laser counts as lost.
    Lms2xxClient(robots::StreamOpener open, Callbacks callbacks,
                 Duration silence_limit = ClientSession::kSilenceLimit,
                 std::shared_ptr<const Clock> clock = std::make_shared<SteadyClock>());
    ~Lms2xxClient();
    Lms2xxClient(const Lms2xxClient&) = delete;
    Lms2xxClient& operator=(const Lms2xxClient&) = delete;

    /// Begins to connect; once.
    void start();

  private:
    class Worker;
    std::unique_ptr<Worker> worker_;
};

}  // namespace axon::lms2xx
