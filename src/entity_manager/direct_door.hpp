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

class ServerCommunicators;

/// What the threads of a path's two lanes and the strand share. No lock: a beat waits for nobody.
struct DirectSigns {
    explicit DirectSigns(TimePoint now) : silence(now) {}
    direct::Silence silence;                      ///< of the client
    std::atomic<std::int64_t> acknowledged{0};    ///< by the client
    std::atomic<std::int64_t> passed{0};          ///< to the core, for the answer to a beat
};

/// One connection of a direct path, as the Entity Manager sends by it. Threads: any; does not wait. Beyond the bounds of
/// transport's outbox data is dropped, and all else ends the connection, which closed() tells.
class DirectLane {
  public:
    virtual ~DirectLane() = default;
    /// `message` is an axon.proto.ToClient. On the signal lane: receipts.
    virtual void send(direct::Keeping keeping, const Header& head, std::shared_ptr<const std::string> message) = 0;
    /// `asks`: for a beat of the client's, at once.
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
    std::function<std::shared_ptr<DirectLane>(const Sender& sender, std::shared_ptr<DirectSigns> signs, std::string proof)> admit;
    std::function<void(const Refusal&)> refuse;
};

/// What comes by the direct path, on Ice's threads: data and signals at the same time, each in order. The sender of each
/// header is who the lane was opened for.
class DirectEvents {
  public:
    virtual ~DirectEvents() = default;
    virtual void directOpening(DirectOpening opening) = 0;
    /// Waits while more of them wait than may: the client's end of the connection fills, and it is refused more there.
    virtual void directMsg(const Id128& path, direct::Keeping keeping, Header head, std::string bytes) = 0;
    virtual void directStop(Header head, StopCause cause) = 0;
    virtual void directReset(Header head) = 0;
    virtual void directClear(Header head) = 0;
    /// Its beats come faster from now on, and must.
    virtual void directPace(const Id128& path) = 0;
    virtual void directClosed(const Id128& path, const std::string& why) = 0;
};

/// Ports for the direct path: any free ones, or those of a range, which several Entity Managers may share.
struct DirectPorts {
    std::uint16_t first = 0;  ///< 0: any
    std::uint16_t last = 0;
};

/// Where clients open direct paths: a port for each lane (docs/reference/direct.md). The only file of the direct path at the
/// Entity Manager that knows Ice.
///
/// Where in the flow: beside EntityCommunicator. Threads: those of the two adapters, one each, the signal lane's under SCHED_RR
/// where permitted; what they bring goes to `events`. Ownership: listens until shut(); the destructor waits until every opening
/// is answered and joins the threads, so it runs neither on one of them nor on the strand that answers. Failure: the constructor
/// throws std::runtime_error with the mend where it cannot listen.
class DirectDoor {
  public:
    DirectDoor(ServerCommunicators& ice, const std::string& address, DirectPorts ports, std::string entity, const Clock& clock,
               std::weak_ptr<DirectEvents> events);
    ~DirectDoor();
    DirectDoor(const DirectDoor&) = delete;
    DirectDoor& operator=(const DirectDoor&) = delete;

    /// Takes no connection any more, and ends those that are there. Does not wait.
    void shut();
    /// "192.168.0.7:41234".
    const std::string& dataEndpoint() const { return data_; }
    const std::string& signalEndpoint() const { return signal_; }

  private:
    struct Adapters;
    std::unique_ptr<Adapters> adapters_;
    std::string data_, signal_;
};

}  // namespace axon::entity_manager
