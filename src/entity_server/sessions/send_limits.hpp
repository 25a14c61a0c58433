// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <cstdint>
#include <string_view>

#include "common/clock.hpp"
#include "common/rate_limit.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"

namespace axon::entity_server {

/// What one entity may send: how many messages in a second, and how much of it to other entities and on a
/// signal lane, which stops share.
///
/// admit() comes first, for everything but samples and raw data to clients (sendToClientDataSeq); an entity
/// that it turns away is dropped. What toClient() and toPeer() refuse does not go on, and their entity stays.
/// Threads: any, without a lock. Failure: none.
class SendLimits {
  public:
    explicit SendLimits(std::uint32_t messages_per_second) : messages_(messages_per_second) {}

    /// False: it floods the server.
    bool admit(TimePoint now) { return messages_.admit(now); }
    Result<void> toClient(Lane lane, std::string_view message, const Clock& clock);
    Result<void> toPeer(Lane lane, const Header& head, std::string_view message, const Clock& clock);

  private:
    // Of one entity for all others, of messages of runs: in one what a step may give back, which is a frame
    // of the link and some more; in a second the invitations of the largest run twice over. Raw data gives
    // way by itself.
    static constexpr std::size_t kPeerBytes = (1024 + 64) * 1024U;
    static constexpr std::uint32_t kPeerBytesPerSecond = 8 * 1024 * 1024U;
    // Of one entity for anybody on a signal lane: beats and ends of runs, receipts, refusals.
    static constexpr std::size_t kSignalBytes = 16 * 1024U;
    static constexpr std::uint32_t kSignalBytesPerSecond = 1024 * 1024U;
    static constexpr std::size_t kSignalOverhead = 64;  // of each

    bool tooMuchSignal(std::string_view message, const Clock& clock);
    static Refusal tooMuchOnSignalLane();

    RateLimit messages_;
    RateLimit peer_bytes_{kPeerBytesPerSecond};
    RateLimit signal_bytes_{kSignalBytesPerSecond};
};

}  // namespace axon::entity_server
