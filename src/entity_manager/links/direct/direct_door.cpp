// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/links/direct/direct_door.hpp"

#include <Ice/Ice.h>
#include <axon/directcomm.h>
#include <spdlog/spdlog.h>

#include <deque>
#include <mutex>
#include <stdexcept>
#include <utility>

#include "common/rate_limit.hpp"
#include "entity_manager/links/server/server_communicators.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/direct_head.hpp"
#include "transport/ice/gate_calls.hpp"
#include "transport/ice/known_connections.hpp"
#include "transport/ice/lane_socket.hpp"
#include "transport/ice/peer_connection.hpp"
#include "transport/ice/tls.hpp"
#include "transport/outbox/outbox.hpp"

namespace axon::entity_manager {
namespace {

namespace slice = ::Axon::DirectComm;
using direct::Keeping;
using transport::ByteRange;
using transport::SendCallbacks;
using transport::Traffic;

constexpr const char* kGate = "DirectGate";
constexpr std::size_t kHeadBytes = 64;
/// Connections with a nonce that has not been used yet; more are strangers, and the oldest are forgotten.
constexpr std::size_t kChallenges = 64;

/// Receipts and beats to the client.
class IceLane final : public DirectLane {
  public:
    IceLane(std::shared_ptr<Ice::Connection> connection,
            const std::shared_ptr<slice::DirectCallbackPrx>& callback)
        : connection_(std::make_shared<transport::DirectConnection>(std::move(connection))),
          callback_(callback),
          outbox_(std::make_shared<transport::Outbox>(
              transport::OutboxLimits{}, [connection = connection_](bool, const std::string& why) {
                  connection->disconnect({false, why}, false);
              })) {}

    void send(Keeping, const Header& head, std::shared_ptr<const std::string> message) override {
        const auto call = [](slice::DirectCallbackPrx& to, const Header& its_head, const std::string& its,
                             SendCallbacks&& back) {
            to.newEntityMsgAsync(transport::toDirectHead(its_head), transport::toRange(its), nullptr,
                                 std::move(back.failed), std::move(back.sent));
        };
        outbox_->post(
            Traffic::Control, kHeadBytes + message->size(),
            [&](SendCallbacks&& back) { call(*callback_, head, *message, std::move(back)); },
            [&] {
                return transport::Outbox::Parcel(
                    [callback = callback_, call, head, message](SendCallbacks&& back) {
                        call(*callback, head, *message, std::move(back));
                    });
            });
    }
    void beat(std::int64_t passed, bool asks) override {
        const auto send = [callback = callback_, passed, asks](SendCallbacks&& back) {
            callback->newHeartbeatAsync(static_cast<double>(passed), asks, nullptr, std::move(back.failed),
                                        std::move(back.sent));
        };
        outbox_->post(Traffic::Heartbeat, kHeadBytes, send,
                      [send] { return transport::Outbox::Parcel(send); });
    }
    void close(const std::string& why) override {
        outbox_->close();
        connection_->disconnect({false, why}, false);
    }
    std::string peer() const override { return connection_->peer(); }
    transport::DirectConnection& connection() { return *connection_; }

  private:
    const std::shared_ptr<transport::DirectConnection> connection_;
    const std::shared_ptr<slice::DirectCallbackPrx> callback_;  // oneway
    const std::shared_ptr<transport::Outbox> outbox_;
};

/// The signal lane of one path. Who sends is what the opening proved, never an argument.
class SessionServant final : public slice::DirectSession {
  public:
    SessionServant(Sender sender, std::string entity, std::shared_ptr<DirectSigns> signs,
                   std::shared_ptr<IceLane> back, const Clock& clock, std::weak_ptr<DirectEvents> events)
        : sender_(std::move(sender)),
          entity_(std::move(entity)),
          signs_(std::move(signs)),
          back_(std::move(back)),
          clock_(clock),
          events_(std::move(events)) {}

    void sendStopSignal(slice::Head head, Axon::CommUtil::StopCause ice_cause,
                        const Ice::Current& current) override {
        auto its = signal(std::move(head), current);
        // What only servers may say is not taken from a client.
        auto cause = transport::fromIce(ice_cause);
        if (cause != StopCause::Drill) cause = StopCause::Requested;
        if (its.sequence >= kServerSequences) its.sequence = 0;
        // Its copy by the servers, where more are refused, is told.
        if (cause == StopCause::Drill && !drills_.admit(clock_.now())) return;
        if (const auto events = events_.lock()) events->directStop(std::move(its), cause);
    }
    void sendResetSignal(slice::Head head, const Ice::Current& current) override {
        auto its = signal(std::move(head), current);
        if (const auto events = events_.lock()) events->directReset(std::move(its));
    }
    void sendClearSignal(slice::Head head, const Ice::Current& current) override {
        auto its = signal(std::move(head), current);
        if (const auto events = events_.lock()) events->directClear(std::move(its));
    }
    void keepAlive(double received, bool busy, const Ice::Current& current) override {
        back_->connection().require(current);
        const bool faster = signs_->heard(clock_.now(), transport::whole(received), busy);
        back_->beat(signs_->passed.load(std::memory_order_acquire), false);
        if (const auto events = faster ? events_.lock() : nullptr) events->directPace();
    }

  private:
    Header signal(slice::Head&& head, const Ice::Current& current) {
        back_->connection().require(current);
        if (head.msgType.size() > transport::kHeadStringMax) {
            back_->connection().disconnect({true, std::string(transport::kImproperHead)}, false);
            throw Ice::ObjectNotExistException(__FILE__, __LINE__, current.id, current.facet,
                                               current.operation);
        }
        auto its = transport::fromDirectHead(std::move(head));
        its.sender = sender_;
        its.entity = entity_;
        return its;
    }

    const Sender sender_;
    const std::string entity_;
    const std::shared_ptr<DirectSigns> signs_;
    const std::shared_ptr<IceLane> back_;
    const Clock& clock_;
    const std::weak_ptr<DirectEvents> events_;
    RateLimit drills_{kDrillsPerSecond};
};

std::string toBytes(const Axon::CommUtil::Bytes& bytes) {
    return {bytes.begin(), bytes.end()};
}
Axon::CommUtil::Bytes toIceBytes(const std::string& bytes) {
    return {bytes.begin(), bytes.end()};
}
Refusal wrongState(const char* what) {
    return {RefusalCode::WrongState, std::string("direct path: ") + what, {}};
}

/// Strangers come here to open a signal lane: it gives nonces, reads what they say, and leaves the judgement
/// to the strand.
class GateServant final : public slice::DirectGate {
  public:
    GateServant(std::string entity, const Clock& clock, std::weak_ptr<DirectEvents> events,
                std::shared_ptr<DirectRefusals> refusals)
        : entity_(std::move(entity)),
          clock_(clock),
          events_(std::move(events)),
          refusals_(std::move(refusals)) {}

    /// By its ends (bothEnds()).
    bool hasSession(const std::string& ends) const { return sessions_->has(ends); }

    Axon::CommUtil::Bytes challenge(const Ice::Current& current) override {
        const auto nonce = Id128::random(random_);
        const std::lock_guard lock(mutex_);
        std::erase_if(challenges_, [&](const Challenge& one) {
            return one.connection.lock() == current.con || one.connection.expired();
        });
        if (challenges_.size() >= kChallenges) challenges_.pop_front();
        challenges_.push_back({current.con, nonce});
        return toIceBytes(nonce.bytes());
    }

    void openAsync(slice::Opening opening, std::shared_ptr<slice::DirectCallbackPrx> callback,
                   std::function<void(const slice::Opened&)> response,
                   std::function<void(std::exception_ptr)> exception, const Ice::Current& current) override {
        const auto refuse = [exception, entity = entity_, refusals = refusals_,
                             peer =
                                 transport::DirectConnection::peerOf(*current.con)](const Refusal& refusal) {
            refusals->refused(entity, peer, kSignalLane, refusal);
            exception(std::make_exception_ptr(transport::toIce(refusal)));
        };
        DirectOpening its;
        its.claim.lane = transport::fromIce(opening.lane);
        its.claim.lease = {opening.held.epoch, opening.held.number};
        const auto client = Id128::parse(opening.client);
        const auto path = Id128::fromBytes(toBytes(opening.path));
        if (!client || !path || path->isZero() || !callback || its.claim.lane != Lane::Signal)
            return refuse({RefusalCode::Malformed,
                           "direct path: expected the session UUID of the holder, a path of 16 bytes, a "
                           "callback, and the signal lane",
                           {}});
        if (hasSession(transport::DirectConnection::endsOf(*current.con)))
            return refuse(wrongState("expected a connection for each lane; this one has its session"));
        const auto nonce = takeNonce(current.con);
        if (!nonce)
            return refuse(wrongState("expected challenge() over the same connection before each open()"));
        its.claim.client = *client;
        its.claim.path = *path;
        its.claim.nonce = *nonce;
        its.proof = toBytes(opening.proof);
        its.refuse = refuse;
        its.admit = [path = *path, entity = entity_, &clock = clock_, events = events_, sessions = sessions_,
                     response, current, callback = transport::callbackProxy(callback, current)](
                        const Sender& sender, std::shared_ptr<DirectSigns> signs,
                        std::string proof) -> std::shared_ptr<DirectLane> {
            auto back = std::make_shared<IceLane>(current.con, callback);
            const auto ends = transport::DirectConnection::endsOf(*current.con);
            sessions->add(ends);
            transport::prepareSignalLane(*current.con);
            const auto session = current.adapter->addWithUUID(
                std::make_shared<SessionServant>(sender, entity, std::move(signs), back, clock, events));
            back->connection().onClosed([adapter = current.adapter, identity = session->ice_getIdentity(),
                                         path, events, sessions, ends](const transport::CloseReason& reason) {
                sessions->remove(ends);
                try {
                    adapter->remove(identity);
                } catch (const Ice::Exception&) {  // the adapter is being destroyed, and the servant with it
                }
                // Its holder closes it as it ends its lease or its program, so an end says nothing of the
                // network.
                const auto why = reason.improper ? reason.text : "its holder's end is closed";
                if (const auto its_events = events.lock()) its_events->directClosed(path, why);
            });
            slice::Opened opened;
            opened.session = Ice::uncheckedCast<slice::DirectSessionPrx>(session);
            opened.proof = toIceBytes(proof);
            response(opened);
            return back;
        };
        if (const auto events = events_.lock()) return events->directOpening(std::move(its));
        refuse(wrongState("the Entity Manager is ending"));
    }

  private:
    struct Challenge {
        std::weak_ptr<Ice::Connection> connection;
        Id128 nonce;
    };
    std::optional<Id128> takeNonce(const std::shared_ptr<Ice::Connection>& connection) {
        const std::lock_guard lock(mutex_);
        for (auto at = challenges_.begin(); at != challenges_.end(); ++at) {
            if (at->connection.lock() != connection) continue;
            const auto nonce = at->nonce;
            challenges_.erase(at);
            return nonce;
        }
        return std::nullopt;
    }

    const std::string entity_;
    const Clock& clock_;
    const std::weak_ptr<DirectEvents> events_;
    const std::shared_ptr<DirectRefusals> refusals_;
    const std::shared_ptr<transport::KnownConnections> sessions_ =
        std::make_shared<transport::KnownConnections>();
    SystemRandom random_;
    std::mutex mutex_;
    std::deque<Challenge> challenges_;  // guarded by mutex_
};

}  // namespace

/// The port of signals.
struct DirectDoor::SignalDoor {
    std::shared_ptr<Ice::ObjectAdapter> adapter;
    std::shared_ptr<void> watch;

    ~SignalDoor() {
        watch.reset();
        if (adapter) adapter->destroy();
    }
};

namespace {

/// `listen(port)` at the first port of the range where it does not throw.
template <class Listen>
auto listenAtOneOf(const std::string& address, DirectPorts ports, Listen listen) {
    for (std::uint32_t port = ports.first; port <= ports.last; ++port) {
        try {
            return listen(static_cast<std::uint16_t>(port));
        } catch (const std::runtime_error&) {
            if (port == 0) break;
        }
    }
    throw std::runtime_error(
        "no port to listen on at " + address +
        (ports.first == 0 ? std::string()
                          : ", from " + std::to_string(ports.first) + " to " + std::to_string(ports.last)));
}

}  // namespace

DirectDoor::DirectDoor(const asio::any_io_executor& strand, ServerCommunicators& ice,
                       const std::string& address, const DirectSettings& settings, const std::string& entity,
                       const Clock& clock, const std::weak_ptr<DirectEvents>& events,
                       const std::shared_ptr<const direct::lane::Tls>& tls)
    : signal_door_(std::make_unique<SignalDoor>()) {
    data_door_ = listenAtOneOf(address, settings.ports, [&](std::uint16_t port) {
        return std::make_unique<DataDoor>(strand, address, port, entity, settings.spin, clock, events, tls,
                                          ice.refusals());
    });
    const auto taken = data_door_->port();
    data_ = address + ":" + std::to_string(taken);
    try {
        // A name of its own: many Entity Managers share the communicators, and this one listens anew at
        // another address.
        const auto name = "Direct-" + Ice::generateUUID();
        auto& adapter = signal_door_->adapter;
        adapter = listenAtOneOf(address, settings.ports, [&](std::uint16_t port) {
            if (port == taken) throw std::runtime_error("that of data");
            return transport::listen(*ice.direct(tls != nullptr), name,
                                     transport::Endpoint{address, port, tls != nullptr}.text(), 0,
                                     transport::Idle::Watched);
        });
        const auto gate = std::make_shared<GateServant>(entity, clock, events, ice.refusals());
        transport::addGate(
            *adapter, gate, kGate,
            [entity, refusals = ice.refusals()](const Ice::Connection& connection, const std::string& why) {
                refusals->refused(entity, transport::DirectConnection::peerOf(connection), "a call",
                                  {RefusalCode::Malformed, why, {}});
            });
        signal_door_->watch = ice.limits().watch(
            transport::listenedEndpoints(*adapter), {[gate](const std::string& ends) {
                return gate->hasSession(ends) ? transport::ConnectionLimits::Peer::HasSession
                                              : transport::ConnectionLimits::Peer::Stranger;
            }});
        signal_ = address + ":" + std::to_string(transport::publishedEndpoints(*adapter).front().port);
        adapter->activate();
    } catch (...) {
        data_door_->shut();
        throw;
    }
}

DirectDoor::~DirectDoor() = default;

void DirectDoor::shut() {
    data_door_->shut();
    signal_door_->watch.reset();
    signal_door_->adapter->deactivate();
}

DirectDoors::DirectDoors(asio::any_io_executor strand, DirectSettings settings,
                         std::shared_ptr<ServerCommunicators> ice, std::string entity, const Clock& clock,
                         std::weak_ptr<DirectEvents> events, bool tls)
    : strand_(std::move(strand)),
      settings_(std::move(settings)),
      ice_(std::move(ice)),
      entity_(std::move(entity)),
      clock_(clock),
      events_(std::move(events)),
      speaks_tls_(tls) {
    if (!tls) return;
    // Here, because it takes too long for the strand.
    try {
        tls_ = direct::lane::Tls::of(transport::credentialsOf(ice_->properties()), transport::wallTime);
        static_cast<void>(ice_->direct(true));
    } catch (const certificates::Unusable& unusable) {
        spdlog::warn("clients are not offered a direct path: {}; fix: {}", unusable.what(), unusable.fix());
    } catch (const std::exception& error) {
        spdlog::warn("clients are not offered a direct path: {}", error.what());
    }
}

std::pair<std::string, std::string> DirectDoors::listen(const std::string& way_to_server) {
    const auto& address = settings_.address.empty() ? way_to_server : settings_.address;
    if (address.empty() || (speaks_tls_ && !tls_)) return {};
    if (listens_at_ != address) {
        shut();
        try {
            doors_.push_back(std::make_unique<DirectDoor>(strand_, *ice_, address, settings_, entity_, clock_,
                                                          events_, tls_));
        } catch (const std::runtime_error& error) {
            spdlog::warn(
                "clients are not offered a direct path: {} (expected an address of this machine and two free "
                "ports; see Axon.Direct)",
                error.what());
            return {};
        }
        listens_at_ = address;
    }
    const auto& door = *doors_.back();
    const auto told = [this](const std::string& endpoint) {
        return (speaks_tls_ ? "ssl://" : "") + (settings_.named ? settings_.named(endpoint) : endpoint);
    };
    return {told(door.dataEndpoint()), told(door.signalEndpoint())};
}

void DirectDoors::shut() {
    if (!listens_at_.empty()) doors_.back()->shut();
    listens_at_.clear();
}

}  // namespace axon::entity_manager
