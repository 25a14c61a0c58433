// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>
#include <axon/directcomm.h>

#include <atomic>
#include <cstdint>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>

#include "client/backlog.hpp"
#include "client/server_connection.hpp"
#include "common/clock.hpp"
#include "common/routed.hpp"
#include "direct/beats.hpp"
#include "direct/incoming_way.hpp"
#include "direct/proof.hpp"
#include "transport/outbox.hpp"
#include "transport/peer_connection.hpp"

namespace axon::client {

class DirectPath;

/// What happens on direct paths. On Ice's threads: data and signals at the same time, each in order.
class DirectPathEvents {
  public:
    virtual ~DirectPathEvents() = default;
    /// head.sender is empty.
    virtual void newDirectMsg(const DirectPath& path, direct::Keeping keeping, Header head, std::string_view message) = 0;
    virtual void newDirectReceipt(const DirectPath& path, const Header& head, std::string_view message) = 0;
    /// It is open now, or has ended: ask it.
    virtual void directChanged() = 0;
};

/// Where to open a direct path, and by what right.
struct DirectOffer {
    std::string entity;
    LeaseNumber lease;
    std::string key;
    std::string client;  ///< the holder's session UUID
    std::string data_endpoint, signal_endpoint;  ///< "host:port"
};

/// Two connections with an Entity Manager, data and signals, without the servers in between (docs/reference/direct.md).
///
/// Where in the flow: beside ServerConnection, for one lease. States: being opened ─► open ─► ended, or at once ended;
/// it does not come back, another attempt is another path. Threads: any. Nothing waits: it is opened by asynchronous
/// calls, what is sent goes to the socket from the caller's thread or into the lane's outbox. Ownership: shared, because Ice's
/// callbacks may be under way when it ends. Failure: it ends, with a reason.
class DirectPath : public std::enable_shared_from_this<DirectPath> {
  public:
    DirectPath(const LaneHome& data, const LaneHome& signal, DirectOffer offer, Id128 number, std::shared_ptr<Backlog> backlog,
               const Clock& clock, std::weak_ptr<DirectPathEvents> events);
    ~DirectPath();
    DirectPath(const DirectPath&) = delete;
    DirectPath& operator=(const DirectPath&) = delete;

    /// Once; `timeout` is that of each of its four calls.
    void open(Duration timeout);
    bool isOpen() const { return open_ && !ended_; }
    bool ended() const { return ended_; }
    /// Why; empty until then.
    std::string reason() const;
    /// Ends it at once; what is unsent is lost.
    void close(const std::string& why);

    const Id128& number() const { return number_; }
    const std::string& entity() const { return offer_.entity; }

    // While it is open; nothing happens otherwise.
    void send(direct::Keeping keeping, const Header& head, std::shared_ptr<const std::string> message) const;
    void sendStopSignal(const Header& head, StopCause cause) const;
    void sendResetSignal(const Header& head) const;
    void sendClearSignal(const Header& head) const;
    void beat() const;
    /// A message goes: busy for a while. True when it was not before; then let it beat at once.
    bool enliven() const;
    /// On one thread: beats if it is due and permitted. When next, and whether it is busy now and was not before. `moving`: the entity.
    std::pair<TimePoint, bool> beatIfDue(bool moving, bool permitted);

    // What its threads and its user's share; no lock, so that no beat waits.
    direct::Silence silence;                      ///< of the Entity Manager
    std::atomic<std::int64_t> acknowledged{0};    ///< by the Entity Manager
    std::atomic<std::int64_t> passed{0};          ///< to the core, for the next beat

  private:
    class Callback;
    struct LaneEnd {
        std::shared_ptr<Axon::DirectComm::DirectGatePrx> gate;
        std::shared_ptr<transport::DirectConnection> connection;
        std::shared_ptr<Axon::DirectComm::DirectSessionPrx> session;  // oneway
        std::shared_ptr<transport::Outbox> outbox;
        Ice::Identity callback;
    };
    void openLane(Lane lane);
    void challenged(Lane lane, const Axon::CommUtil::Bytes& nonce);
    void opened(Lane lane, const Axon::DirectComm::Opened& its);
    LaneEnd& end(Lane lane) { return lane == Lane::Data ? data_ : signal_; }
    const LaneHome& home(Lane lane) const { return lane == Lane::Data ? data_home_ : signal_home_; }
    std::function<void(std::exception_ptr)> failure();
    template <class Use>
    void step(Use use);
    template <class Send>
    void post(transport::Traffic traffic, Send send) const;

    const LaneHome data_home_, signal_home_;
    const DirectOffer offer_;
    const Id128 number_;
    const std::shared_ptr<Backlog> backlog_;
    const Clock& clock_;
    const std::weak_ptr<DirectPathEvents> events_;
    mutable std::atomic<Duration::rep> lively_until_{0};
    TimePoint beat_at_{};  // of the thread of beatIfDue()
    std::atomic<bool> permitted_{true};
    int timeout_ms_ = 0;
    // Each written by one step of the opening, and read after open_ by others.
    LaneEnd data_, signal_;
    direct::Claim claim_;
    std::atomic<bool> open_{false}, ended_{false};
    mutable std::mutex mutex_;
    // Guarded by mutex_: what is to be closed, as far as it is there, and why it was.
    std::vector<std::shared_ptr<transport::DirectConnection>> connections_;
    std::string reason_;
};

}  // namespace axon::client
