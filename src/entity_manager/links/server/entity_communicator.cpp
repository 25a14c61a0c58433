// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/links/server/entity_communicator.hpp"

#include <Ice/Ice.h>
#include <axon/entitycomm.h>
#include <axon/messages.pb.h>
#include <spdlog/spdlog.h>

#include <asio/post.hpp>
#include <asio/steady_timer.hpp>

#include "common/backoff.hpp"
#include "entity_manager/links/server/server_communicators.hpp"
#include "entity_manager/strand/due_timer.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/convert.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/lane_socket.hpp"
#include "transport/ice/peer_connection.hpp"
#include "transport/outbox/forward.hpp"
#include "transport/outbox/proxy_sender.hpp"
#include "transport/sessions/answered_beats.hpp"
#include "transport/sessions/routed_session.hpp"

namespace axon::entity_manager {

namespace {

using namespace std::chrono_literals;
namespace wire = ::Axon::CommUtil;
using ::Axon::EntityComm::EntityCallback;
using ::Axon::EntityComm::EntityCallbackPrx;
using ::Axon::EntityComm::EntityGatePrx;
using ::Axon::EntityComm::EntitySessionPrx;
using transport::ByteRange;
using transport::forward;
using transport::toIce;
using transport::toRange;
using transport::Traffic;

constexpr Duration kFirstBackoff = 100ms;
constexpr Duration kLastBackoff = 2s;
constexpr int kLoginTimeoutMs = 3000;

/// What may wait for a server that does not read. At least 256 bytes are counted for each message, so of
/// control and data the bounds of bytes are met first. Signals: a master beats to 256 participants every
/// 50 ms, and the connection gives up after 3 s.
transport::OutboxLimits outboxLimits(Lane lane) {
    auto limits = lane == Lane::Signal ? transport::OutboxLimits::ofSignals() : transport::OutboxLimits{};
    limits.control_bytes = 16 * 1024 * 1024;
    limits.control_messages = limits.data_messages = 64 * 1024;
    limits.signals_unsent = 16 * 1024;
    return limits;
}

/// Carries what the server pushes to the events, and tells of its heartbeats. One for each lane of a session.
class EntityCallbackServant final : public EntityCallback {
  public:
    EntityCallbackServant(Lane lane, std::weak_ptr<ServerEvents> events,
                          std::shared_ptr<ReleaseNotes> releases,
                          std::shared_ptr<transport::AnsweredBeats> answered)
        : lane_(lane),
          events_(std::move(events)),
          releases_(std::move(releases)),
          answered_(std::move(answered)) {}

    void newClientMsg(wire::Header head, ByteRange msg, const Ice::Current&) override {
        if (const auto events = events_.lock())
            events->clientMsg(lane_, transport::fromIce(std::move(head)),
                              std::string(transport::toView(msg)));
    }
    void newClientMsgDataSeq(wire::Header head, ByteRange data, const Ice::Current&) override {
        if (const auto events = events_.lock())
            events->clientMsgDataSeq(transport::fromIce(std::move(head)),
                                     std::string(transport::toView(data)));
    }
    void stopSignal(wire::Header head, wire::StopCause cause, const Ice::Current&) override {
        if (const auto events = events_.lock())
            events->stopSignal(transport::fromIce(std::move(head)), transport::fromIce(cause));
    }
    void resetSignal(wire::Header head, const Ice::Current&) override {
        if (const auto events = events_.lock()) events->resetSignal(transport::fromIce(std::move(head)));
    }
    void clearSignal(wire::Header head, const Ice::Current&) override {
        if (const auto events = events_.lock()) events->clearSignal(transport::fromIce(std::move(head)));
    }
    void newClientUpdate(wire::Header head, wire::ClientChange change, const Ice::Current&) override {
        if (const auto events = events_.lock())
            events->clientUpdate(transport::fromIce(std::move(head)), transport::fromIce(change));
    }
    void newHeartbeat(double, const Ice::Current& current) override {
        const auto events = events_.lock();
        if (!events) return;
        answered_->heard();
        events->serverHeartbeat();
        if (current.ctx.empty()) return;
        if (const auto note = releases_->onPeer("an entity server", transport::releaseIn(current.ctx)))
            spdlog::info("{}", *note);
    }
    void newRefusalMsg(wire::Header head, int code, std::string reason, const Ice::Current&) override {
        if (const auto events = events_.lock())
            events->undeliverable(lane_, transport::fromIce(std::move(head)),
                                  {static_cast<RefusalCode>(code), std::move(reason), {}});
    }

  private:
    const Lane lane_;
    const std::weak_ptr<ServerEvents> events_;
    const std::shared_ptr<ReleaseNotes> releases_;
    const std::shared_ptr<transport::AnsweredBeats> answered_;
};

}  // namespace

/// Lives on the strand; Ice's callbacks hold it weakly and post to it, with the number of the attempt that
/// they belong to, so that what arrives late from an earlier attempt changes nothing.
class EntityCommunicator::Connection : public std::enable_shared_from_this<Connection> {
  public:
    Connection(asio::any_io_executor strand, std::shared_ptr<ServerCommunicators> ice, ServerAddress address,
               const Clock& clock, std::weak_ptr<ServerEvents> events)
        : strand_(std::move(strand)),
          ice_(std::move(ice)),
          address_(std::move(address)),
          clock_(clock),
          events_(std::move(events)),
          retry_(strand_),
          beat_(strand_, clock_) {}

    void want(bool wanted) {
        if (wanted == wanted_) return;
        wanted_ = wanted;
        if (wanted) {
            backoff_.reset();
            login();
            return;
        }
        if (up_) leave();
        drop();
    }

    /// After this no event is raised any more.
    void close() {
        wanted_ = false;
        closed_ = true;
        if (up_) leave();
        drop();
    }

    void sendBasicPrfl(const Registration& registration, const proto::BasicProfile& profile) {
        if (!up_) return;
        busy_period_ = std::chrono::milliseconds(registration.heartbeat_busy_ms);
        answered_->expect(busy_period_);
        idle_period_ = std::chrono::milliseconds(registration.heartbeat_idle_ms);
        // A call of its own: it wants an answer on any way, which tells that the entity is registered.
        const auto call =
            [session = session_, its = toIce(registration), secret = address_.secret, weak = weak_from_this(),
             attempt = attempt_, refused = failure(attempt_, "registration")](
                EntitySessionPrx&, const wire::Header&, const ByteRange& bytes,
                const transport::Answered& answered, const transport::Failed&, transport::Sent sent) {
                const auto accepted = [weak, attempt, answered] {
                    if (answered) answered();
                    if (const auto self = weak.lock())
                        self->post([attempt](Connection& me) {
                            if (attempt == me.attempt_) me.registered();
                        });
                };
                session->sendBasicPrflAsync(its, bytes, toRange(secret), accepted, refused, std::move(sent));
            };
        data_outbox_->send(Traffic::Control, {}, profile.SerializeAsString(), call);
    }

    void sendStatus(const EntityStatus& status) {
        if (!up_) return;
        const bool busy = status.state == EntityState::BUSY;
        data_outbox_->send(Traffic::Control, textBytes(status),
                           forward<EntitySessionPrx>(&EntitySessionPrx::sendStatusAsync, toIce(status)));
        if (std::exchange(busy_, busy) != busy) keepAlive();
    }

    void sendToClientBytes(Lane lane, const Header& head, const std::string& message) {
        if (!up_) return;
        outbox(lane).send(trafficOf(lane), head, message,
                          forward<EntitySessionPrx>(&EntitySessionPrx::sendToClientAsync));
    }

    void sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) {
        if (!up_) return;
        // Raw data may be dropped, as that for a client; it must not cost the session.
        const bool raw = lane == Lane::Data && head.msg_type == kMsgRaw;
        outbox(lane).send(raw ? Traffic::Data : trafficOf(lane), head, message.SerializeAsString(),
                          forward<EntitySessionPrx>(&EntitySessionPrx::sendToPeerAsync));
    }

    void sendToClientDataSeq(const Header& head, const std::string& message) {
        if (!up_) return;
        data_outbox_->send(Traffic::Data, head, message,
                           forward<EntitySessionPrx>(&EntitySessionPrx::sendToClientDataSeqAsync));
    }

    std::string localAddress() const {
        return data_connection_ ? transport::DirectConnection(data_connection_).localAddress()
                                : std::string();
    }

  private:
    using LaneOutbox = transport::ProxySender<EntitySessionPrx>;

    static Traffic trafficOf(Lane lane) { return lane == Lane::Signal ? Traffic::Signal : Traffic::Control; }
    const LaneOutbox& outbox(Lane lane) const {
        return lane == Lane::Signal ? *signal_outbox_ : *data_outbox_;
    }

    std::unique_ptr<const LaneOutbox> makeOutbox(Lane lane, const std::shared_ptr<EntitySessionPrx>& session,
                                                 const std::shared_ptr<Ice::Connection>& connection) {
        return std::make_unique<const LaneOutbox>(
            session->ice_oneway()->ice_invocationTimeout(-1), outboxLimits(lane),
            address_.router.empty() ? transport::Until::Written : transport::Until::Answered,
            [weak = weak_from_this(), attempt = attempt_, connection](bool improper, const std::string& why) {
                // Posted, because the core waits for the call that was one too many.
                if (const auto self = weak.lock())
                    self->post([attempt, reason = improper
                                                      ? "the server does not read what it is sent"
                                                      : why](Connection& me) { me.failed(attempt, reason); });
                connection->close(Ice::ConnectionClose::Gracefully);  // also of one that has been left
            });
    }

    /// AMI calls may throw at once; the close callback of the connection reports the loss, so there is
    /// nothing to add.
    template <class Call>
    void guarded(Call call) {
        try {
            call();
        } catch (const Ice::Exception& e) {
            const auto attempt = attempt_;
            const std::string reason = e.what();
            post([attempt, reason](Connection& self) { self.failed(attempt, reason); });
        }
    }

    template <class Action>
    void post(Action action) {
        asio::post(strand_, [weak = weak_from_this(), action = std::move(action)] {
            if (const auto self = weak.lock()) action(*self);
        });
    }

    /// What to do when step `what` of the attempt fails; runs on an Ice thread.
    std::function<void(std::exception_ptr)> failure(std::uint64_t attempt, std::string what) {
        return [weak = weak_from_this(), attempt, what = std::move(what)](const std::exception_ptr& problem) {
            const auto self = weak.lock();
            if (!self) return;
            const auto reason = what + ": " + transport::translate(problem, self->address_.tls).message;
            self->post([attempt, reason](Connection& me) { me.failed(attempt, reason); });
        };
    }

    void failed(std::uint64_t attempt, const std::string& reason) {
        if (attempt == attempt_) lost(reason);
    }

    transport::Endpoint called() const { return {address_.host, address_.port, address_.tls}; }

    void login() {
        const auto attempt = ++attempt_;
        answered_ = std::make_shared<transport::AnsweredBeats>(clock_);
        open(attempt, Lane::Data, called().text(), {}, [attempt](Connection& self, const Opened& opened) {
            self.data_connection_ = opened.connection;
            self.last_router_ = opened.connection->getEndpoint();
            self.session_ = opened.session;
            self.data_callback_ = opened.callback;
            self.nameOurselves(attempt);
        });
    }

    /// A lane's session that was opened, and the callback that the server is told of.
    struct Opened {
        std::shared_ptr<Ice::Connection> connection;
        std::shared_ptr<EntitySessionPrx> session;
        std::shared_ptr<EntityCallbackPrx> callback;
    };

    /// At the endpoint, or through the router; `token` is that of the first session, for the second. `then`
    /// runs on the strand.
    template <class Then>
    void open(std::uint64_t attempt, Lane lane, const std::string& endpoint, const std::string& token,
              Then then) {
        guarded([&] {
            if (address_.router.empty()) {
                openAtGate(attempt, lane, endpoint, then);
            } else {
                openThroughRouter(attempt, lane, token, then);
            }
        });
    }

    template <class Then>
    void openAtGate(std::uint64_t attempt, Lane lane, const std::string& endpoint, Then then) {
        // A connection identifier of its own: Entity Managers that share the communicator must not share
        // connections.
        const auto proxy = communicator(lane)->stringToProxy("EntityGate:" + endpoint + " -t 3000");
        const auto gate = Ice::uncheckedCast<EntityGatePrx>(
            proxy
                ->ice_connectionId(std::to_string(reinterpret_cast<std::uintptr_t>(this)) + "-" +
                                   std::to_string(attempt_))
                ->ice_context(transport::contractContext())
                ->ice_invocationTimeout(kLoginTimeoutMs));
        gate->openAsync(
            address_.user, address_.password,
            [weak = weak_from_this(), attempt, lane, gate,
             then](const std::shared_ptr<EntitySessionPrx>& session) {
                if (const auto self = weak.lock())
                    self->post([attempt, lane, gate, then, session](Connection& me) {
                        if (attempt != me.attempt_) return;
                        me.guarded([&] {
                            const auto connection = gate->ice_getCachedConnection();
                            me.adopt(attempt, lane, connection);
                            then(me, {connection,
                                      Ice::uncheckedCast<EntitySessionPrx>(
                                          connection->createProxy(session->ice_getIdentity())
                                              ->ice_invocationTimeout(kLoginTimeoutMs)),
                                      Ice::uncheckedCast<EntityCallbackPrx>(
                                          me.adapter(lane)->addWithUUID(me.servant(lane)))});
                        });
                    });
            },
            [failed = failure(attempt, "log-in at " + address_.text())](std::exception_ptr problem) {
                try {
                    std::rethrow_exception(problem);
                } catch (const Ice::ObjectNotExistException&) {
                    problem = std::make_exception_ptr(
                        Axon::CommUtil::RequestRefused(static_cast<int>(RefusalCode::Malformed),
                                                       "a program that speaks Ice answers there, and it is "
                                                       "not where Entity Managers log in. Is "
                                                       "it the port of the clients, or of the signal lane? "
                                                       "Entity Managers connect to 10412 by "
                                                       "default; axon-server says its addresses when it "
                                                       "starts: ready … entity=HOST:PORT …"));
                } catch (...) {  // told as it is
                }
                failed(problem);
            });
    }

    template <class Then>
    void openThroughRouter(std::uint64_t attempt, Lane lane, const std::string& token, Then then) {
        auto router = transport::routerProxy(*communicator(lane), address_.router);
        router = lane == Lane::Signal ? transport::sameRouter(router, *data_connection_)
                                      : transport::lostLast(router, last_router_);
        transport::openRoutedSession(
            router, {address_.user, address_.password, {}, token, kLoginTimeoutMs},
            [weak = weak_from_this(), attempt, lane, then](const transport::RoutedSession& routed) {
                const auto self = weak.lock();
                if (!self) return routed.connection->close(Ice::ConnectionClose::Forcefully);
                self->post([attempt, lane, then, routed](Connection& me) {
                    if (attempt != me.attempt_)
                        return routed.connection->close(Ice::ConnectionClose::Forcefully);
                    me.guarded([&] {
                        me.adopt(attempt, lane, routed.connection);
                        then(me, {routed.connection, Ice::uncheckedCast<EntitySessionPrx>(routed.session),
                                  Ice::uncheckedCast<EntityCallbackPrx>(
                                      routed.callback(*me.adapter(lane), me.servant(lane)))});
                    });
                });
            },
            failure(attempt, "log-in through " + address_.router));
    }

    const std::shared_ptr<Ice::Communicator>& communicator(Lane lane) const {
        return lane == Lane::Signal ? ice_->signal() : ice_->data();
    }
    std::shared_ptr<EntityCallbackServant> servant(Lane lane) const {
        return std::make_shared<EntityCallbackServant>(lane, events_, ice_->releases(), answered_);
    }
    const std::shared_ptr<Ice::ObjectAdapter>& adapter(Lane lane) const {
        return lane == Lane::Signal ? ice_->signalAdapter() : ice_->dataAdapter();
    }

    void adopt(std::uint64_t attempt, Lane lane, const std::shared_ptr<Ice::Connection>& connection) {
        if (!connection) throw Ice::ConnectionLostException(__FILE__, __LINE__);
        connection->setAdapter(adapter(lane));
        connection->setCloseCallback(
            [weak = weak_from_this(), attempt](const std::shared_ptr<Ice::Connection>&) {
                if (const auto self = weak.lock())
                    self->post([attempt](Connection& me) {
                        me.failed(attempt, "the server closed the connection");
                    });
            });
    }

    void nameOurselves(std::uint64_t attempt) {
        session_->setCallbackAsync(
            data_callback_,
            [weak = weak_from_this(), attempt](const ::Axon::EntityComm::SessionFacts& facts) {
                if (const auto self = weak.lock())
                    self->post([attempt, facts](Connection& me) {
                        if (attempt == me.attempt_) me.loginSignalLane(attempt, facts);
                    });
            },
            failure(attempt, "setCallback"));
    }

    void loginSignalLane(std::uint64_t attempt, const ::Axon::EntityComm::SessionFacts& facts) {
        // Behind a router it is empty.
        const auto endpoint =
            facts.signalEndpoint.empty()
                ? facts.signalEndpoint
                : transport::asCalled(facts.signalEndpoint, called(),
                                      transport::DirectConnection::remoteAddressOf(*data_connection_));
        open(attempt, Lane::Signal, endpoint, facts.token,
             [attempt, token = facts.token](Connection& self, const Opened& opened) {
                 self.signal_connection_ = opened.connection;
                 transport::prepareSignalLane(*self.signal_connection_);
                 self.signal_session_ = opened.session;
                 self.signal_callback_ = opened.callback;
                 self.signal_session_->attachSignalLaneAsync(
                     token, self.signal_callback_,
                     [weak = self.weak_from_this(), attempt] {
                         if (const auto me = weak.lock())
                             me->post([attempt](Connection& it) {
                                 if (attempt == it.attempt_) it.joined();
                             });
                     },
                     self.failure(attempt, "attachSignalLane"));
             });
    }

    void joined() {
        data_outbox_ = makeOutbox(Lane::Data, session_, data_connection_);
        signal_outbox_ = makeOutbox(Lane::Signal, signal_session_, signal_connection_);
        up_ = true;
        busy_ = false;
        if (const auto events = events_.lock()) events->serverUp();
        keepAlive();
    }

    /// Only now: a server that lets us in and refuses the registration must not be asked ten times a second.
    void registered() {
        registered_ = true;
        said_ = false;
        backoff_.reset();
    }

    void keepAlive() {
        if (!up_) return;
        const auto beat = static_cast<double>(++beats_);
        if (address_.router.empty() || !answered_->ask()) {
            signal_outbox_->send(Traffic::Heartbeat, 0,
                                 forward<EntitySessionPrx>(&EntitySessionPrx::keepAliveAsync, beat));
        } else {
            guarded([&] {
                signal_session_->keepAliveAsync(
                    beat, [answered = answered_] { answered->answered(); },
                    failure(attempt_, "sign of life"));
            });
        }
        beat_.at(clock_.now() + (busy_ ? busy_period_ : idle_period_), [weak = weak_from_this()] {
            if (const auto self = weak.lock()) self->keepAlive();
        });
    }

    /// An orderly end: the server hears of it, and of all that was sent before, before the connection closes.
    /// The outbox may be sending that on another thread at this moment, so the last message closes it. A
    /// router forgets what it has not passed on when the connection closes, so there its answer does.
    void leave() {
        data_outbox_->sendAll();
        // The end of either connection is the end of the session.
        const auto close = [data = std::exchange(data_connection_, nullptr),
                            signal = std::exchange(signal_connection_, nullptr)] {
            for (const auto& connection : {data, signal}) connection->close(Ice::ConnectionClose::Gracefully);
        };
        const auto leave = [say = forward<EntitySessionPrx>(&EntitySessionPrx::leaveAsync), close](
                               EntitySessionPrx& session, transport::Answered answered,
                               transport::Failed failed, transport::Sent sent) {
            if (!answered) {
                say(session, nullptr, std::move(failed), std::move(sent));
                return close();
            }
            say(
                session,
                [answered = std::move(answered), close] {
                    answered();
                    close();
                },
                [failed = std::move(failed), close](std::exception_ptr error) {
                    failed(std::move(error));
                    close();
                },
                std::move(sent));
        };
        data_outbox_->send(Traffic::Control, 0, leave);
        noteDropped();
        data_outbox_ = nullptr;  // not closed: what waits there goes on
    }

    void noteDropped() const {
        if (const auto dropped = data_outbox_->counts().dropped; dropped > 0)
            spdlog::info(
                "{} data messages to the entity server at {} were dropped, it did not read them in time",
                dropped, address_.text());
    }

    void lost(const std::string& reason) {
        const bool was_up = up_;
        const bool was_registered = registered_;
        drop();
        if (closed_) return;
        if (const auto events = events_.lock(); events && was_up) events->serverDown(reason);
        if (!wanted_) return;
        if (was_registered)
            spdlog::warn("the session with the entity server at {} is lost: {}", address_.text(), reason);
        else if (!std::exchange(said_, true))
            spdlog::warn("no session with the entity server at {} ({}); trying again until there is one",
                         address_.text(), reason);
        retry_.expires_after(backoff_.next());
        retry_.async_wait([weak = weak_from_this()](const asio::error_code& cancelled) {
            if (cancelled) return;
            const auto self = weak.lock();
            if (self && self->wanted_ && !self->up_) self->login();
        });
    }

    void drop() {
        ++attempt_;
        up_ = false;
        registered_ = false;
        if (data_outbox_) noteDropped();
        for (auto* outbox : {&data_outbox_, &signal_outbox_}) {
            if (*outbox) (*outbox)->close();
            outbox->reset();
        }
        retry_.cancel();
        beat_.cancel();
        forget(data_callback_, ice_->dataAdapter());
        forget(signal_callback_, ice_->signalAdapter());
        for (auto* connection : {&data_connection_, &signal_connection_}) {
            if (*connection) (*connection)->close(Ice::ConnectionClose::Gracefully);
            connection->reset();
        }
        session_ = signal_session_ = nullptr;
    }

    void forget(std::shared_ptr<EntityCallbackPrx>& callback,
                const std::shared_ptr<Ice::ObjectAdapter>& adapter) {
        if (!callback) return;
        try {
            adapter->remove(callback->ice_getIdentity());
        } catch (const Ice::Exception&) {  // the communicator has been destroyed: nothing is left to forget
        }
        callback = nullptr;
    }

    // Constant after construction.
    const asio::any_io_executor strand_;
    const std::shared_ptr<ServerCommunicators> ice_;
    const ServerAddress address_;
    const Clock& clock_;
    const std::weak_ptr<ServerEvents> events_;

    // Confined to the strand.
    asio::steady_timer retry_;
    DueTimer beat_;
    std::shared_ptr<Ice::Connection> data_connection_, signal_connection_;
    std::shared_ptr<EntityCallbackPrx> data_callback_, signal_callback_;
    std::shared_ptr<EntitySessionPrx> session_, signal_session_;
    std::shared_ptr<transport::AnsweredBeats> answered_;             // of the attempt, and so of its session
    std::shared_ptr<Ice::Endpoint> last_router_;                     // where the last data lane led
    std::unique_ptr<const LaneOutbox> data_outbox_, signal_outbox_;  // while it is up
    Backoff backoff_{kFirstBackoff, kLastBackoff};
    std::uint64_t attempt_ = 0;
    std::uint64_t beats_ = 0;
    std::chrono::milliseconds busy_period_{50};  // of the registration: what the server expects
    std::chrono::milliseconds idle_period_{2000};
    bool wanted_ = false;
    bool up_ = false;
    bool registered_ = false;
    bool busy_ = false;
    bool said_ = false;
    bool closed_ = false;
};

EntityCommunicator::EntityCommunicator(asio::any_io_executor strand, std::shared_ptr<ServerCommunicators> ice,
                                       ServerAddress address, const Clock& clock,
                                       std::weak_ptr<ServerEvents> events)
    : connection_(std::make_shared<Connection>(std::move(strand), std::move(ice), std::move(address), clock,
                                               std::move(events))) {}

EntityCommunicator::~EntityCommunicator() {
    connection_->close();
}

void EntityCommunicator::wantConnection(bool wanted) {
    connection_->want(wanted);
}
void EntityCommunicator::sendBasicPrfl(const Registration& registration, const proto::BasicProfile& profile) {
    connection_->sendBasicPrfl(registration, profile);
}
void EntityCommunicator::sendStatus(const EntityStatus& status) {
    connection_->sendStatus(status);
}
void EntityCommunicator::sendToClient(Lane lane, const Header& head, const proto::ToClient& message) {
    connection_->sendToClientBytes(lane, head, message.SerializeAsString());
}
void EntityCommunicator::sendToClientBytes(Lane lane, const Header& head, const std::string& message) {
    connection_->sendToClientBytes(lane, head, message);
}
void EntityCommunicator::sendToPeer(Lane lane, const Header& head, const proto::ToEntity& message) {
    connection_->sendToPeer(lane, head, message);
}
void EntityCommunicator::sendToClientDataSeq(const Header& head, const proto::ToClient& message) {
    connection_->sendToClientDataSeq(head, message.SerializeAsString());
}
void EntityCommunicator::sendToClientDataSeqBytes(const Header& head, const std::string& message) {
    connection_->sendToClientDataSeq(head, message);
}
std::string EntityCommunicator::localAddress() const {
    return connection_->localAddress();
}

}  // namespace axon::entity_manager
