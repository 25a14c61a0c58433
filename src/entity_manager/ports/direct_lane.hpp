// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "common/refusal.hpp"
#include "common/routed.hpp"
#include "direct/beats.hpp"
#include "direct/incoming_way.hpp"
#include "direct/proof.hpp"

namespace axon::entity_manager {

/// What the threads of a path's two lanes and the strand share. No lock: a beat waits for nobody.
struct DirectSigns {
    explicit DirectSigns(TimePoint now) : liveness(direct::livenessOfEnd(now)) {}
    /// The client's beat. Whether its next ones come faster.
    bool heard(TimePoint now, std::int64_t received, bool busy) {
        liveness.heard(now);
        acknowledged.store(received, std::memory_order_relaxed);
        const bool faster = busy && !liveness.busy();
        liveness.setBusy(busy, now);
        return faster;
    }
    Liveness liveness;                          ///< of the client
    std::atomic<std::int64_t> acknowledged{0};  ///< by the client
    std::atomic<std::int64_t> passed{0};        ///< to the core, for the answer to a beat
};

/// One connection of a direct path, as the Entity Manager sends by it. Threads: the strand's; does not wait.
/// Beyond the bounds of transport's outbox data is dropped, and all else ends the connection, which
/// directClosed() tells.
class DirectLane {
  public:
    virtual ~DirectLane() = default;
    /// `message` is an axon.proto.ToClient. On the signal lane: receipts.
    virtual void send(direct::Keeping keeping, const Header& head,
                      std::shared_ptr<const std::string> message) = 0;
    /// On the signal lane. `asks`: for a beat of the client's, at once.
    virtual void beat(std::int64_t passed, bool asks) = 0;
    /// At once; what is unsent is lost.
    virtual void close(const std::string& why) = 0;
    /// "192.168.0.9:50122", for logs.
    virtual std::string peer() const = 0;
};

/// Somebody wants to open a lane. One of the two is called, once; any thread.
struct DirectOpening {
    direct::Claim claim;
    std::string proof;
    /// As whom, and with what proof of this side. What comes from now on is told to DirectEvents.
    std::function<std::shared_ptr<DirectLane>(const Sender& sender, std::shared_ptr<DirectSigns> signs,
                                              std::string proof)>
        admit;
    std::function<void(const Refusal&)> refuse;
};

/// What comes by the direct path: messages on the strand, signals on Ice's thread, at the same time and each
/// in order; all else on either. The sender of each header is who the lane was opened for.
class DirectEvents {
  public:
    virtual ~DirectEvents() = default;
    virtual void directOpening(DirectOpening opening) = 0;
    /// May move from `head` and `bytes`. False: more waits than may, and it was not taken. The lane reads
    /// nothing until there is room again (DirectDoors::roomAgain) and says it once more: the client's end of
    /// the connection fills, and it is refused more there.
    virtual bool directMsg(const Id128& path, direct::Keeping keeping, Header& head, std::string& bytes) = 0;
    /// On the strand: the lane has said what it has for now.
    virtual void directTurnEnded() = 0;
    virtual void directStop(Header head, StopCause cause) = 0;
    virtual void directReset(Header head) = 0;
    virtual void directClear(Header head) = 0;
    /// Its beats come faster from now on, and must.
    virtual void directPace() = 0;
    virtual void directClosed(const Id128& path, const std::string& why) = 0;
};

}  // namespace axon::entity_manager
