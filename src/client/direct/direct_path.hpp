// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <utility>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "common/routed.hpp"
#include "direct/beats.hpp"
#include "direct/incoming_way.hpp"
#include "direct/proof.hpp"

namespace axon::client {

class DirectPath;

/// What happens on direct paths. On the path's threads: messages and signals at the same time, each in order.
class DirectPathEvents {
  public:
    virtual ~DirectPathEvents() = default;
    /// head.sender is empty.
    virtual void newDirectMsg(const DirectPath& path, direct::Keeping keeping, Header head,
                              std::string_view message) = 0;
    /// What had come has been told by newDirectMsg(). Another thread may read meanwhile: what takes long,
    /// such as a callback of the user's, belongs here.
    virtual void directRead() {}
    virtual void newDirectReceipt(const DirectPath& path, const Header& head, std::string_view message) = 0;
    /// It is open now, or has ended: ask it.
    virtual void directChanged() = 0;
};

/// Where to open a direct path, and by what right.
struct DirectOffer {
    std::string entity;
    LeaseNumber lease;
    std::string key;
    std::string client;                          ///< the holder's session UUID
    std::string data_endpoint, signal_endpoint;  ///< "host:port", or "ssl://host:port"
    std::string name = {};                       ///< the entity's, which its certificate has

    static constexpr std::string_view kTls = "ssl://";
    static bool overTls(std::string_view endpoint) { return endpoint.starts_with(kTls); }
    /// "host:port" in either case.
    static std::string_view addressIn(std::string_view endpoint) {
        return endpoint.substr(overTls(endpoint) ? kTls.size() : 0);
    }
};

/// Two connections with an Entity Manager, data and signals, without the servers in between
/// (docs/reference/direct.md).
///
/// Where in the flow: beside ServerConnection, for one lease; what carries it is NetworkPath, or a
/// simulated network. States: being opened ─► open ─► ended, or at once ended; it does not come back, another
/// attempt is another path. Threads: any. Nothing waits. Ownership: shared, because what comes may be under
/// way when it ends. Failure: it ends, with a reason.
class DirectPath {
  public:
    DirectPath(DirectOffer offer, Id128 number, const Clock& clock)
        : liveness(direct::livenessOfEnd(clock.now())),
          clock_(clock),
          offer_(std::move(offer)),
          number_(number),
          claim_{
              Lane::Data, offer_.lease, Id128::parse(uuidOf(offer_.client)).value_or(Id128{}), number_, {}} {}
    virtual ~DirectPath() = default;
    DirectPath(const DirectPath&) = delete;
    DirectPath& operator=(const DirectPath&) = delete;

    /// Once; `timeout` is that of each of its four calls.
    virtual void open(Duration timeout) = 0;
    bool isOpen() const { return open_ && !ended_; }
    bool ended() const { return ended_; }
    /// Why; empty until then.
    virtual std::string reason() const = 0;
    /// Ends it at once; what is unsent is lost.
    virtual void close(const std::string& why) = 0;

    const Id128& number() const { return number_; }
    const std::string& entity() const { return offer_.entity; }

    // While it is open; nothing happens otherwise.
    virtual void send(direct::Keeping keeping, const Header& head,
                      std::shared_ptr<const std::string> message) const = 0;
    virtual void sendStopSignal(const Header& head, StopCause cause) const = 0;
    virtual void sendResetSignal(const Header& head) const = 0;
    virtual void sendClearSignal(const Header& head) const = 0;
    virtual void beat() const = 0;

    /// A message goes: busy for a while. True when it was not before; then let it beat at once.
    bool enliven() const {
        const auto now = clock_.now();
        return lively_until_.exchange((now + direct::kLively).time_since_epoch().count()) <=
               now.time_since_epoch().count();
    }
    /// On one thread: beats if it is due and permitted. When next, and whether it is busy now and was not
    /// before. `moving`: the entity.
    std::pair<TimePoint, bool> beatIfDue(bool moving, bool permitted) {
        const auto now = clock_.now();
        const bool busy = moving || now.time_since_epoch().count() < lively_until_;
        const bool faster = busy && !liveness.busy();
        permitted_ = permitted;
        liveness.setBusy(busy, now);
        if (faster || now >= beat_at_) {
            beat_at_ = now + (busy ? direct::kBeatBusy : direct::kBeatIdle);
            if (permitted) beat();
        }
        return {beat_at_, faster};
    }

    // What its threads and its user's share; no lock, so that no beat waits.
    Liveness liveness;                          ///< of the Entity Manager
    std::atomic<std::int64_t> acknowledged{0};  ///< by the Entity Manager
    std::atomic<std::int64_t> passed{0};        ///< to the core, for the next beat

  protected:
    /// The Entity Manager's beat.
    void heard(std::int64_t received, bool asks) {
        liveness.heard(clock_.now());
        acknowledged.store(received, std::memory_order_relaxed);
        if (asks && permitted_) beat();
    }
    /// Lane and nonce are those of the last proofFor(); before it, data and none.
    const direct::Claim& claim() const { return claim_; }
    /// The nonce of a lane has come: this side's proof. One lane after the other.
    std::string proofFor(Lane lane, const Id128& nonce) {
        claim_.lane = lane;
        claim_.nonce = nonce;
        return direct::proofOf(claim_, direct::Prover::Client, offer_.key);
    }
    /// Whether the other side of the same lane knows the key too.
    bool trusts(std::string_view proof) const {
        return direct::proves(proof, claim_, direct::Prover::EntityManager, offer_.key);
    }

    const Clock& clock_;
    const DirectOffer offer_;
    const Id128 number_;
    std::atomic<bool> open_{false}, ended_{false};

  private:
    direct::Claim claim_;
    mutable std::atomic<Duration::rep> lively_until_{0};
    TimePoint beat_at_{};  // of the thread of beatIfDue()
    std::atomic<bool> permitted_{true};
};

}  // namespace axon::client
