// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <spdlog/spdlog.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <utility>

#include "common/refusal.hpp"
#include "transport/ice/contract.hpp"
#include "transport/outbox/forward.hpp"
#include "transport/outbox/proxy_sender.hpp"
#include "transport/sessions/routed_connection.hpp"

namespace axon::transport {

/// How a server sends to the peer of one lane's session, whose callback `Prx` is: a ProxySender that
/// disconnects the peer where it overflows, with what every callback has. Threads: any. Failure: the peer is
/// disconnected, or its connection ends, and PeerConnection tells the session.
template <class Prx>
class PeerSender : public ProxySender<Prx> {
  public:
    /// `server` is for the log: "entity server".
    PeerSender(const std::shared_ptr<Prx>& callback, OutboxLimits limits,
               std::shared_ptr<PeerConnection> peer, std::string server)
        : ProxySender<Prx>(callback, limits, untilOf(*peer),
                           [peer](bool improper, const std::string& why) {
                               peer->disconnect({improper, why}, false);
                           }),
          peer_(std::move(peer)),
          server_(std::move(server)) {}

    void refuse(const Header& head, const Refusal& refusal) const {
        this->send(Traffic::Control, head, {},
                   forward<Prx>(&Prx::newRefusalMsgAsync, static_cast<int>(refusal.code), refusal.message));
    }
    /// The first one also tells our release. It cannot be left out, because none waits before it.
    void beat(std::int64_t sequence) const {
        if (!told_.load(std::memory_order_relaxed) && !told_.exchange(true)) {
            const auto first = [sequence](Prx& prx, Answered answered, Failed failed, Sent sent) {
                prx.newHeartbeatAsync(static_cast<double>(sequence), std::move(answered), std::move(failed),
                                      std::move(sent), releaseContext());
            };
            this->send(Traffic::Heartbeat, 0, first);
            return;
        }
        this->send(Traffic::Heartbeat, 0,
                   forward<Prx>(&Prx::newHeartbeatAsync, static_cast<double>(sequence)));
    }
    /// Orderly: after the replies that are under way. What still waits is not sent.
    void disconnect(bool orderly, const std::string& why) const {
        if (const auto dropped = this->counts().dropped; dropped > 0) {
            spdlog::info("{}: {} messages to {} were dropped, it did not read them in time", server_, dropped,
                         peer_->peer());
        }
        peer_->disconnect({false, why}, orderly);
        this->close();
    }

    const void* connection() const { return peer_->connection(); }

  private:
    const std::shared_ptr<PeerConnection> peer_;
    const std::string server_;
    mutable std::atomic<bool> told_{false};  // our release
};

}  // namespace axon::transport
