// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/direct/ice_direct_path.hpp"

#include <utility>

#include "client/connection/send_queue.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/convert.hpp"
#include "transport/ice/direct_head.hpp"
#include "transport/ice/lane_socket.hpp"

namespace axon::client {
namespace {

namespace slice = ::Axon::DirectComm;
using direct::Keeping;
using transport::ByteRange;
using transport::SendCallbacks;
using transport::toDirectHead;
using transport::Traffic;

constexpr std::size_t kHeadBytes = 64;

/// As of the connection to the server: what users send is refused before it is lost.
transport::OutboxLimits dataLimits() {
    transport::OutboxLimits limits;
    limits.data_bytes = kWaitingBytesMax + 1024 * 1024;
    limits.control_bytes = 2 * kWaitingBytesMax;
    return limits;
}

Axon::CommUtil::Bytes toIceBytes(const std::string& bytes) {
    return {bytes.begin(), bytes.end()};
}

}  // namespace

/// Pushes of the Entity Manager, for one lane. The entity is that of the connection.
class IceDirectPath::Callback final : public slice::DirectCallback {
  public:
    Callback(std::weak_ptr<IceDirectPath> path, Lane lane) : path_(std::move(path)), lane_(lane) {}

    void newEntityMsg(slice::Head head, ByteRange message, const Ice::Current&) override {
        tell([&](IceDirectPath& path, DirectPathEvents& events) {
            auto its = headFrom(path, std::move(head));
            if (lane_ == Lane::Data)
                events.newDirectMsg(path, Keeping::Kept, std::move(its), transport::toView(message));
            else if (its.msg_type == kMsgReceipt)
                events.newDirectReceipt(path, its, transport::toView(message));
        });
    }
    void newEntityMsgDataSeq(slice::Head head, ByteRange message, const Ice::Current&) override {
        if (lane_ != Lane::Data) return;
        tell([&](IceDirectPath& path, DirectPathEvents& events) {
            events.newDirectMsg(path, Keeping::Droppable, headFrom(path, std::move(head)),
                                transport::toView(message));
        });
    }
    void newHeartbeat(double received, bool asks, const Ice::Current&) override {
        const auto path = path_.lock();
        if (!path || lane_ != Lane::Signal) return;
        path->heard(transport::whole(received), asks);
    }

  private:
    static Header headFrom(const IceDirectPath& path, slice::Head&& head) {
        auto its = transport::fromDirectHead(std::move(head));
        its.entity = path.entity();
        return its;
    }
    template <class Tell>
    void tell(Tell what) {
        const auto path = path_.lock();
        if (!path || path->ended()) return;
        if (const auto events = path->events_.lock()) what(*path, *events);
    }
    const std::weak_ptr<IceDirectPath> path_;
    const Lane lane_;
};

IceDirectPath::IceDirectPath(const LaneHome& data, const LaneHome& signal, DirectOffer offer, Id128 number,
                             std::shared_ptr<Backlog> backlog, const Clock& clock,
                             std::weak_ptr<DirectPathEvents> events)
    : DirectPath(std::move(offer), number, clock),
      data_home_(data),
      signal_home_(signal),
      backlog_(std::move(backlog)),
      events_(std::move(events)) {}

IceDirectPath::~IceDirectPath() {
    for (const auto& connection : connections_)
        connection->disconnect({false, "it is of no use any more"}, false);
}

void IceDirectPath::open(Duration timeout) {
    timeout_ms_ = static_cast<int>(std::chrono::duration_cast<std::chrono::milliseconds>(timeout).count());
    openLane(Lane::Data);
}

/// Ice's calls may throw at once; whatever they throw ends the path.
template <class Use>
void IceDirectPath::step(Use use) {
    if (ended_) return;
    try {
        use();
    } catch (const std::exception&) {
        close(transport::translate(std::current_exception()).message);
    }
}

std::function<void(std::exception_ptr)> IceDirectPath::failure() {
    return [self = shared_from_this()](const std::exception_ptr& error) {
        self->close(transport::translate(error).message);
    };
}

void IceDirectPath::openLane(Lane lane) {
    step([&] {
        const auto endpoint =
            transport::tcpEndpoint(lane == Lane::Data ? offer_.data_endpoint : offer_.signal_endpoint);
        // A connection identifier of its own: a path lives and dies with its connections.
        auto& gate = end(lane).gate;
        gate = Ice::uncheckedCast<slice::DirectGatePrx>(
            home(lane)
                .communicator->stringToProxy("DirectGate:" + endpoint)
                ->ice_connectionId(Ice::generateUUID())
                ->ice_invocationTimeout(timeout_ms_));
        gate->challengeAsync([self = shared_from_this(),
                              lane](const Axon::CommUtil::Bytes& nonce) { self->challenged(lane, nonce); },
                             failure());
    });
}

void IceDirectPath::challenged(Lane lane, const Axon::CommUtil::Bytes& nonce) {
    step([&] {
        auto& its = end(lane);
        const auto connection = its.gate->ice_getCachedConnection();
        if (!connection) throw Ice::ConnectionLostException(__FILE__, __LINE__);
        const auto number = Id128::fromBytes({reinterpret_cast<const char*>(nonce.data()), nonce.size()});
        if (!number) return close("its nonce is none");
        connection->setAdapter(home(lane).adapter);
        if (lane == Lane::Signal) transport::prepareSignalLane(*connection);
        const auto callback = Ice::uncheckedCast<slice::DirectCallbackPrx>(
            home(lane).adapter->addWithUUID(std::make_shared<Callback>(weak_from_this(), lane)));
        its.callback = callback->ice_getIdentity();
        its.connection = std::make_shared<transport::DirectConnection>(connection);
        its.outbox =
            std::make_shared<transport::Outbox>(lane == Lane::Data ? dataLimits() : transport::OutboxLimits{},
                                                [weak = weak_from_this()](bool, const std::string& why) {
                                                    if (const auto self = weak.lock())
                                                        self->close("its outbox is full: " + why);
                                                });
        bool late = false;
        {
            const std::lock_guard lock(mutex_);
            connections_.push_back(its.connection);
            late = ended_;
        }
        its.connection->onClosed([weak = weak_from_this(), adapter = home(lane).adapter,
                                  identity = its.callback](const transport::CloseReason& reason) {
            try {
                adapter->remove(identity);
            } catch (const Ice::Exception&) {  // the communicator is being destroyed, and the servant with it
            }
            if (const auto self = weak.lock()) self->close(reason.text);
        });
        if (late) return its.connection->disconnect({false, "it has ended"}, false);

        slice::Opening opening;
        opening.lane = transport::toIce(lane);
        opening.held = {offer_.lease.epoch, offer_.lease.number};
        opening.client = uuidOf(offer_.client);
        opening.path = toIceBytes(number_.bytes());
        opening.proof = toIceBytes(proofFor(lane, *number));
        its.gate->openAsync(
            opening, callback,
            [self = shared_from_this(), lane](const slice::Opened& answer) { self->opened(lane, answer); },
            failure());
    });
}

void IceDirectPath::opened(Lane lane, const slice::Opened& answer) {
    step([&] {
        auto& its = end(lane);
        if (!answer.session ||
            !trusts({reinterpret_cast<const char*>(answer.proof.data()), answer.proof.size()}))
            return close("who answers does not know the lease's key; is it another machine's address?");
        its.session =
            Ice::uncheckedCast<slice::DirectSessionPrx>(its.gate->ice_getCachedConnection()
                                                            ->createProxy(answer.session->ice_getIdentity())
                                                            ->ice_oneway()
                                                            ->ice_invocationTimeout(-1));
        if (lane == Lane::Data) return openLane(Lane::Signal);
        liveness.heard(clock_.now());
        open_ = true;
        if (const auto events = events_.lock()) events->directChanged();
    });
}

void IceDirectPath::close(const std::string& why) {
    std::vector<std::shared_ptr<transport::DirectConnection>> connections;
    {
        const std::lock_guard lock(mutex_);
        if (ended_) return;
        ended_ = true;
        reason_ = why;
        connections = std::exchange(connections_, {});
    }
    for (const auto& connection : connections) connection->disconnect({false, why}, false);
    if (const auto events = events_.lock()) events->directChanged();
}

std::string IceDirectPath::reason() const {
    const std::lock_guard lock(mutex_);
    return reason_;
}

void IceDirectPath::send(Keeping keeping, const Header& head,
                         std::shared_ptr<const std::string> message) const {
    if (!isOpen()) return;
    const bool data = keeping == Keeping::Droppable;
    const auto call = [data](slice::DirectSessionPrx& to, const Header& its_head, const std::string& its,
                             SendCallbacks&& back) {
        const auto range = transport::toRange(its);
        if (data)
            to.sendToEntityDataSeqAsync(toDirectHead(its_head), range, nullptr, std::move(back.failed),
                                        std::move(back.sent));
        else
            to.sendToEntityAsync(toDirectHead(its_head), range, nullptr, std::move(back.failed),
                                 std::move(back.sent));
    };
    const auto bytes = kHeadBytes + message->size();
    data_.outbox->post(
        data ? Traffic::Data : Traffic::Control, bytes,
        [&](SendCallbacks&& back) { call(*data_.session, head, *message, std::move(back)); },
        [&] {
            backlog_->add(bytes);
            std::shared_ptr<void> waits(nullptr,
                                        [backlog = backlog_, bytes](void*) { backlog->remove(bytes); });
            return transport::Outbox::Parcel([session = data_.session, call, head, message,
                                              waits = std::move(waits)](SendCallbacks&& back) {
                call(*session, head, *message, std::move(back));
            });
        });
}

template <class Send>
void IceDirectPath::post(Traffic traffic, Send send) const {
    if (isOpen())
        signal_.outbox->post(traffic, kHeadBytes, send, [send] { return transport::Outbox::Parcel(send); });
}

void IceDirectPath::sendStopSignal(const Header& head, StopCause cause) const {
    post(Traffic::Signal, [session = signal_.session, its = toDirectHead(head), cause](SendCallbacks&& back) {
        session->sendStopSignalAsync(its, transport::toIce(cause), nullptr, std::move(back.failed),
                                     std::move(back.sent));
    });
}
void IceDirectPath::sendResetSignal(const Header& head) const {
    post(Traffic::Signal, [session = signal_.session, its = toDirectHead(head)](SendCallbacks&& back) {
        session->sendResetSignalAsync(its, nullptr, std::move(back.failed), std::move(back.sent));
    });
}
void IceDirectPath::sendClearSignal(const Header& head) const {
    post(Traffic::Signal, [session = signal_.session, its = toDirectHead(head)](SendCallbacks&& back) {
        session->sendClearSignalAsync(its, nullptr, std::move(back.failed), std::move(back.sent));
    });
}
void IceDirectPath::beat() const {
    post(Traffic::Heartbeat,
         [session = signal_.session, received = static_cast<double>(passed.load(std::memory_order_acquire)),
          busy = liveness.busy()](SendCallbacks&& back) {
             session->keepAliveAsync(received, busy, nullptr, std::move(back.failed), std::move(back.sent));
         });
}

}  // namespace axon::client
