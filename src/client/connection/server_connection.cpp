// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/connection/server_connection.hpp"

#include <future>
#include <utility>

#include "client/connection/send_queue.hpp"
#include "common/heartbeat.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/contract.hpp"
#include "transport/ice/convert.hpp"
#include "transport/ice/lane_socket.hpp"
#include "transport/outbox/header_scratch.hpp"
#include "transport/sessions/routed_session.hpp"

namespace axon::client {
namespace {

using transport::ByteRange;
using transport::SendCallbacks;
using transport::toIce;
using transport::toRange;
using transport::Traffic;
namespace slice = ::Axon::FrontEndComm;

constexpr int kLeaveTimeoutMs = 1000;
constexpr std::size_t kHeaderBytes = 200;

static_assert(kMessageBytesMax + 64 * 1024 <= transport::kMessageSizeMaxKib * std::size_t{1024},
              "a message that is admitted must fit the lane, with its header");

/// What users send is refused before it is lost. Besides it there are uploads, in the Entity Managers'
/// windows.
transport::OutboxLimits dataLimits() {
    transport::OutboxLimits limits;
    limits.data_bytes = kWaitingBytesMax + 1024 * 1024;
    limits.control_bytes = 2 * kWaitingBytesMax;
    limits.signals_unsent = kSignalsUnsent;  // the second chance of stops
    return limits;
}

/// Stops, resets, clears and heartbeats, each small.
transport::OutboxLimits signalLimits() {
    transport::OutboxLimits limits;
    limits.signals_unsent = kSignalsUnsent;
    return limits;
}

/// Pushes of the server, for one lane of one attempt.
class CallbackServant final : public slice::ClientCallback {
  public:
    CallbackServant(std::weak_ptr<ConnectionEvents> events, std::uint64_t attempt, Lane lane,
                    std::shared_ptr<transport::AnsweredBeats> beats)
        : events_(std::move(events)), attempt_(attempt), lane_(lane), beats_(std::move(beats)) {}

    void newBasicPrflMsg(Axon::CommUtil::Presence presence, Axon::CommUtil::Registration registration,
                         ByteRange profile, const Ice::Current&) override {
        tell([&](auto& events) {
            events.newProfile(attempt_, transport::fromIce(presence),
                              transport::fromIce(std::move(registration)), transport::toView(profile));
        });
    }
    void newStatusMsg(Axon::CommUtil::EntityStatus status, const Ice::Current&) override {
        tell([&](auto& events) { events.newStatus(attempt_, transport::fromIce(std::move(status))); });
    }
    void newEntityMsg(Axon::CommUtil::Header head, ByteRange message, const Ice::Current&) override {
        tell([&](auto& events) {
            events.newEntityMsg(attempt_, lane_, direct::Keeping::Kept, transport::fromIce(std::move(head)),
                                transport::toView(message));
        });
    }
    void newEntityMsgDataSeq(Axon::CommUtil::Header head, ByteRange message, const Ice::Current&) override {
        tell([&](auto& events) {
            events.newEntityMsg(attempt_, lane_, direct::Keeping::Droppable,
                                transport::fromIce(std::move(head)), transport::toView(message));
        });
    }
    void newRefusalMsg(Axon::CommUtil::Header head, int code, std::string reason,
                       const Ice::Current&) override {
        tell([&](auto& events) {
            events.newRefusal(attempt_, transport::fromIce(std::move(head)),
                              {static_cast<RefusalCode>(code), std::move(reason), {}});
        });
    }
    void newStopAccepted(Axon::CommUtil::Header head, int entities, const Ice::Current&) override {
        tell([&](auto& events) {
            events.newStopAccepted(attempt_, transport::fromIce(std::move(head)), entities);
        });
    }
    void newUpdateMsg(int code, std::string text, const Ice::Current&) override {
        tell([&](auto& events) { events.newServerText(attempt_, code, text); });
    }
    void newHeartbeat(double, const Ice::Current& current) override {
        tell([&](auto& events) {
            beats_->heard();
            events.newServerHeartbeat(attempt_);
            if (!current.ctx.empty()) events.newServerRelease(transport::releaseIn(current.ctx));
        });
    }

  private:
    template <class Tell>
    void tell(Tell&& what) {
        if (const auto events = events_.lock()) what(*events);
    }
    const std::weak_ptr<ConnectionEvents> events_;
    const std::uint64_t attempt_;
    const Lane lane_;
    const std::shared_ptr<transport::AnsweredBeats> beats_;
};

Traffic trafficOf(Operation operation) {
    return operation == Operation::ToEntityDataSeq ? Traffic::Data : Traffic::Control;
}

void call(slice::ClientSessionPrx& session, Operation operation, const Header& head, std::string_view bytes,
          SendCallbacks&& callbacks) {
    auto answered = std::move(callbacks.answered);
    auto failed = std::move(callbacks.failed);
    auto sent = std::move(callbacks.sent);
    const auto& its = transport::HeaderScratch::ofThread().of(head);
    switch (operation) {
        case Operation::ToEntity:
            session.sendToEntityAsync(its, toRange(bytes), std::move(answered), std::move(failed),
                                      std::move(sent));
            break;
        case Operation::ToEntityDataSeq:
            session.sendToEntityDataSeqAsync(its, toRange(bytes), std::move(answered), std::move(failed),
                                             std::move(sent));
            break;
        case Operation::Request:
            session.sendRequestAsync(its, toRange(bytes), std::move(answered), std::move(failed),
                                     std::move(sent));
            break;
        case Operation::Reset:
        case Operation::Clear:
            break;  // of the other lane: send()
    }
}

/// Sends a small message that is cheap to copy.
template <class Send>
void post(transport::Outbox& outbox, Traffic traffic, Send send) {
    outbox.post(traffic, kHeaderBytes, send, [send] { return transport::Outbox::Parcel(send); });
}

}  // namespace

namespace {

struct Opened {
    std::shared_ptr<Ice::Connection> connection;
    std::shared_ptr<slice::ClientSessionPrx> session;
    std::shared_ptr<slice::ClientCallbackPrx> callback;
};

Opened openAtGate(const LaneHome& home, const std::string& endpoint, const Login& login, int timeout_ms,
                  const std::shared_ptr<CallbackServant>& servant) {
    // A connection identifier of its own: sessions live and die with their connection, and must not find an
    // old one.
    const auto gate =
        Ice::uncheckedCast<slice::ClientGatePrx>(home.communicator->stringToProxy("ClientGate:" + endpoint)
                                                     ->ice_connectionId(Ice::generateUUID())
                                                     ->ice_context(transport::contractContext())
                                                     ->ice_invocationTimeout(timeout_ms));
    try {
        const auto opened = gate->open(login.user, login.password, login.display_name);
        const auto connection = gate->ice_getCachedConnection();
        return {
            connection,
            Ice::uncheckedCast<slice::ClientSessionPrx>(connection->createProxy(opened->ice_getIdentity()))
                ->ice_invocationTimeout(timeout_ms),
            Ice::uncheckedCast<slice::ClientCallbackPrx>(home.adapter->addWithUUID(servant))};
    } catch (...) {
        if (const auto connection = gate->ice_getCachedConnection())
            connection->close(Ice::ConnectionClose::Forcefully);
        try {
            throw;
        } catch (const Ice::ObjectNotExistException&) {
            throw Axon::CommUtil::RequestRefused(static_cast<int>(RefusalCode::Malformed),
                                                 "a program that speaks Ice answers there, and it is not "
                                                 "where clients log in. Is it the port of the Entity "
                                                 "Managers, or of the signal lane? axon-server says its "
                                                 "addresses when it starts: ready client=HOST:PORT …");
        }
    }
}

Opened openThroughRouter(const LaneHome& home, const std::string& token, const Login& login, int timeout_ms,
                         const std::shared_ptr<CallbackServant>& servant) {
    std::promise<transport::RoutedSession> promise;
    transport::openRoutedSession(
        home.router, {login.user, login.password, login.display_name, token, timeout_ms},
        [&](transport::RoutedSession session) { promise.set_value(std::move(session)); },
        [&](const std::exception_ptr& error) { promise.set_exception(error); });
    const auto session = promise.get_future().get();
    return {session.connection, Ice::uncheckedCast<slice::ClientSessionPrx>(session.session),
            Ice::uncheckedCast<slice::ClientCallbackPrx>(session.callback(*home.adapter, servant))};
}

}  // namespace

ServerConnection::LaneEnd ServerConnection::openLane(const LaneHome& home, transport::OutboxLimits limits,
                                                     const std::string& endpoint, const std::string& token,
                                                     const Login& login,
                                                     const std::shared_ptr<ConnectionEvents>& events,
                                                     const std::shared_ptr<transport::AnsweredBeats>& beats) {
    const auto timeout =
        static_cast<int>(std::chrono::duration_cast<std::chrono::milliseconds>(login.timeout).count());
    // The first has no token.
    const auto servant = std::make_shared<CallbackServant>(events, login.attempt,
                                                           token.empty() ? Lane::Data : Lane::Signal, beats);
    const auto opened = home.router ? openThroughRouter(home, token, login, timeout, servant)
                                    : openAtGate(home, endpoint, login, timeout, servant);
    opened.connection->setAdapter(home.adapter);
    LaneEnd lane;
    lane.connection = std::make_shared<transport::DirectConnection>(opened.connection);
    lane.callback = opened.callback;
    lane.session = opened.session;
    lane.oneway = lane.session->ice_oneway()->ice_invocationTimeout(-1);
    lane.batch = lane.session->ice_batchOneway()->ice_invocationTimeout(-1);
    lane.paced = lane.session->ice_invocationTimeout(-1);
    lane.outbox = std::make_shared<transport::Outbox>(
        limits,
        [connection = lane.connection](bool, const std::string& why) {
            connection->disconnect({false, why}, false);
        },
        home.router ? transport::Until::Answered : transport::Until::Written);
    lane.connection->onClosed(
        [events = std::weak_ptr(events), attempt = login.attempt, adapter = home.adapter,
         identity = lane.callback->ice_getIdentity()](const transport::CloseReason& reason) {
            try {
                adapter->remove(identity);
            } catch (const Ice::Exception&) {  // the communicator is being destroyed, and the servant with it
            }
            if (const auto alive = events.lock()) alive->closed(attempt, reason.text);
        });
    return lane;
}

std::shared_ptr<Ice::Endpoint> ServerConnection::endpoint() const {
    return data_.connection->get()->getEndpoint();
}

Result<std::shared_ptr<const ServerConnection>> ServerConnection::open(
    const LaneHome& data, const LaneHome& signal, const Login& login,
    const std::shared_ptr<ConnectionEvents>& events, const Clock& clock) {
    auto connection = std::make_shared<ServerConnection>();
    const auto& beats = connection->beats_ = std::make_shared<transport::AnsweredBeats>(clock);
    connection->attempt_ = login.attempt;
    connection->routed_ = data.router != nullptr;
    try {
        auto its_data = data;
        if (connection->routed_) its_data.router = transport::lostLast(data.router, login.lost_router);
        connection->data_ = openLane(its_data, dataLimits(), login.endpoint.text(), {}, login, events, beats);
        const auto facts = connection->data_.session->setCallback(connection->data_.callback);
        connection->me_ = transport::fromIce(Axon::CommUtil::Sender(facts.me));
        connection->entities_ = facts.entities;
        if (facts.watchdogBusyMs > 0)
            connection->watchdogs_.busy = std::chrono::milliseconds{facts.watchdogBusyMs};
        if (facts.watchdogIdleMs > 0)
            connection->watchdogs_.idle = std::chrono::milliseconds{facts.watchdogIdleMs};
        beats->expect(heartbeatToBusyClient(connection->watchdogs_.busy));
        const auto endpoint =
            facts.signalEndpoint.empty()
                ? login.endpoint.text()
                : transport::asCalled(
                      facts.signalEndpoint, login.endpoint,
                      transport::DirectConnection::remoteAddressOf(*connection->data_.connection->get()));
        auto its_signal = signal;
        if (connection->routed_)
            its_signal.router = transport::sameRouter(signal.router, *connection->data_.connection->get());
        connection->signal_ =
            openLane(its_signal, signalLimits(), endpoint, facts.token, login, events, beats);
        transport::prepareSignalLane(*connection->signal_.connection->get());
        connection->signal_.session->attachSignalLane(facts.token, connection->signal_.callback);
    } catch (...) {
        const auto refusal = transport::translate(std::current_exception(), login.endpoint.tls);
        connection->drop();
        return refusal;
    }
    return std::shared_ptr<const ServerConnection>(std::move(connection));
}

void ServerConnection::send(Operation operation, const Header& head, std::string bytes) const {
    if (operation == Operation::Reset) return sendResetSignal(head);
    if (operation == Operation::Clear) return sendClearSignal(head);
    const auto size = bytes.size() + kHeaderBytes;
    // The copy for the queue is made only when the message has to wait.
    data_.outbox->post(
        trafficOf(operation), size,
        [&](SendCallbacks&& callbacks) {
            auto& proxy = callbacks.answered ? *data_.paced : *data_.oneway;
            call(proxy, operation, head, bytes, std::move(callbacks));
        },
        [&] {
            backlog_->add(size);
            std::shared_ptr<void> waits(nullptr,
                                        [backlog = backlog_, size](void*) { backlog->remove(size); });
            return transport::Outbox::Parcel([oneway = data_.oneway, paced = data_.paced, operation, head,
                                              owned = std::move(bytes),
                                              waits = std::move(waits)](SendCallbacks&& callbacks) {
                auto& proxy = callbacks.answered ? *paced : *oneway;
                call(proxy, operation, head, owned, std::move(callbacks));
            });
        });
}

void ServerConnection::add(Operation operation, const Header& head, std::string bytes) const {
    const auto& lane = data_;
    // What has to wait may be taken out of the queue at any moment, and must not overtake what was added
    // before it.
    const bool joined =
        !routed_ && lane.outbox->postAtOnce(
                        trafficOf(operation), bytes.size() + kHeaderBytes, [&](SendCallbacks&& callbacks) {
                            call(*lane.batch, operation, head, bytes, {{}, callbacks.failed, {}});
                            added_.push_back(std::move(callbacks));
                        });
    if (joined) return;
    write();
    send(operation, head, std::move(bytes));
}

void ServerConnection::write() const {
    if (added_.empty()) return;
    const auto added = std::make_shared<const std::vector<SendCallbacks>>(std::exchange(added_, {}));
    const auto fail = [added](const std::exception_ptr& error) {
        for (const auto& message : *added) message.failed(error);
    };
    try {
        data_.batch->ice_flushBatchRequestsAsync(fail, [added](bool at_once) {
            for (const auto& message : *added) message.sent(at_once);
        });
    } catch (const std::exception&) {  // the connection or the communicator is gone
        fail(std::current_exception());
    }
}

void ServerConnection::sendStopSignal(Lane lane, const Header& head, StopCause cause) const {
    const auto& end = lane == Lane::Signal ? signal_ : data_;
    post(*end.outbox, Traffic::Signal, [session = end.oneway, head, cause](SendCallbacks&& callbacks) {
        session->sendStopSignalAsync(toIce(head), toIce(cause), nullptr, std::move(callbacks.failed),
                                     std::move(callbacks.sent));
    });
}

void ServerConnection::sendStopSignals(Lane lane, const Header& head,
                                       const std::vector<std::string>& entities, StopCause cause) const {
    constexpr std::size_t kUuidBytes = 37;
    const auto& end = lane == Lane::Signal ? signal_ : data_;
    // A signal is sent at once or not at all, so the parcel that would own a copy is never made.
    const auto send = [&](SendCallbacks&& callbacks) {
        end.oneway->sendStopSignalsAsync(toIce(head), Axon::CommUtil::StopList(entities), toIce(cause),
                                         nullptr, std::move(callbacks.failed), std::move(callbacks.sent));
    };
    end.outbox->post(Traffic::Signal, kHeaderBytes + entities.size() * kUuidBytes, send,
                     [] { return transport::Outbox::Parcel(); });
}

void ServerConnection::sendResetSignal(const Header& head) const {
    post(*signal_.outbox, Traffic::Signal, [session = signal_.oneway, head](SendCallbacks&& callbacks) {
        session->sendResetSignalAsync(toIce(head), nullptr, std::move(callbacks.failed),
                                      std::move(callbacks.sent));
    });
}

void ServerConnection::sendClearSignal(const Header& head) const {
    post(*signal_.outbox, Traffic::Signal, [session = signal_.oneway, head](SendCallbacks&& callbacks) {
        session->sendClearSignalAsync(toIce(head), nullptr, std::move(callbacks.failed),
                                      std::move(callbacks.sent));
    });
}

void ServerConnection::keepAlive(std::int64_t sequence) const {
    if (routed_ && beats_->ask()) {
        try {
            signal_.session->keepAliveAsync(
                static_cast<double>(sequence), [beats = beats_] { beats->answered(); },
                [connection = signal_.connection](const std::exception_ptr& error) {
                    connection->disconnect({false, transport::translate(error).message}, false);
                });
        } catch (const Ice::Exception&) {  // the connection has closed, and says so
        }
        return;
    }
    post(*signal_.outbox, Traffic::Heartbeat,
         [session = signal_.oneway, sequence](SendCallbacks&& callbacks) {
             session->keepAliveAsync(static_cast<double>(sequence), nullptr, std::move(callbacks.failed),
                                     std::move(callbacks.sent));
         });
}

void ServerConnection::leave() const {
    try {
        data_.session->ice_invocationTimeout(kLeaveTimeoutMs)->leave();
    } catch (const Ice::Exception&) {  // the server is gone or does not answer: closing the connection says
                                       // the same
    }
    drop();
}

void ServerConnection::drop() const {
    for (const auto* lane : {&data_, &signal_}) {
        if (lane->outbox) lane->outbox->close();
        if (lane->connection)
            lane->connection->disconnect({false, "this client closed the connection"}, false);
    }
}

}  // namespace axon::client
