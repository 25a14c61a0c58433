// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/direct/network_path.hpp"

#include <utility>

#include "client/connection/send_queue.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/convert.hpp"
#include "transport/ice/direct_head.hpp"
#include "transport/ice/lane_socket.hpp"
#include "transport/ice/tls.hpp"

static_assert(axon::direct::lane::kContract == Axon::CommUtil::ContractNumber,
              "the data lane of a direct path says the number of the contracts");

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

/// Why the connection is not one to the entity of this name; empty: it is. Its CA has been checked.
std::string mistrusted(const Ice::Connection& connection, const std::string& name) {
    const auto shown = transport::certificateOf(connection);
    if (!shown) return "was not shown";
    certificates::Certificate its;
    its.name = shown->name;
    its.unit = shown->unit;
    return certificates::mismatch(its, certificates::Kind::Entity, name);
}

Axon::CommUtil::Bytes toIceBytes(const std::string& bytes) {
    return {bytes.begin(), bytes.end()};
}

}  // namespace

/// Pushes of the Entity Manager on the signal lane. The entity is that of the connection.
class NetworkPath::Callback final : public slice::DirectCallback {
  public:
    explicit Callback(std::weak_ptr<NetworkPath> path) : path_(std::move(path)) {}

    void newEntityMsg(slice::Head head, ByteRange message, const Ice::Current&) override {
        const auto path = path_.lock();
        if (!path || path->ended() || head.msgType != kMsgReceipt) return;
        auto its = transport::fromDirectHead(std::move(head));
        its.entity = path->entity();
        if (const auto events = path->events_.lock())
            events->newDirectReceipt(*path, its, transport::toView(message));
    }
    void newHeartbeat(double received, bool asks, const Ice::Current&) override {
        if (const auto path = path_.lock()) path->heard(transport::whole(received), asks);
    }

  private:
    const std::weak_ptr<NetworkPath> path_;
};

NetworkPath::NetworkPath(std::shared_ptr<LaneReaders> readers, const LaneHome& signal, DirectOffer offer,
                         Id128 number, std::shared_ptr<Backlog> backlog, const Clock& clock,
                         std::weak_ptr<DirectPathEvents> events, std::shared_ptr<Communicators> secured)
    : DirectPath(std::move(offer), number, clock),
      readers_(std::move(readers)),
      plain_home_(signal),
      secured_(std::move(secured)),
      backlog_(std::move(backlog)),
      events_(std::move(events)) {}

NetworkPath::~NetworkPath() {
    for (const auto& closes : closing_) closes("it is no longer needed");
}

void NetworkPath::open(Duration timeout) {
    timeout_ms_ = static_cast<int>(std::chrono::duration_cast<std::chrono::milliseconds>(timeout).count());
    if (DirectOffer::overTls(offer_.signal_endpoint) != overTls() ||
        (overTls() && (!secured_ || !secured_->tls())))
        return close("this side has no certificate with which to check the other one over TLS");
    auto socket =
        direct::lane::LaneSocket::connectTo(std::string(DirectOffer::addressIn(offer_.data_endpoint)));
    if (!socket) return close(socket.refusal().message);
    data_ = std::make_shared<FramedLane>(
        readers_, std::move(socket).value(), [this](direct::lane::Wire& its) { return channelOver(its); },
        direct::lane::ClientOpening(
            claim(),
            [weak = weak_from_this()](const Id128& nonce) {
                const auto self = weak.lock();
                return self ? self->proofFor(Lane::Data, nonce) : std::string();
            },
            [weak = weak_from_this()](std::string_view proof) {
                const auto self = weak.lock();
                return self && self->trusts(proof);
            }),
        dataLimits(),
        [backlog = backlog_](std::size_t bytes) {
            backlog->add(bytes);
            return std::shared_ptr<void>(nullptr, [backlog, bytes](void*) { backlog->remove(bytes); });
        },
        clock_, std::shared_ptr<FramedLane::Owner>(shared_from_this(), this));
    bool late = false;
    {
        const std::lock_guard lock(mutex_);
        closing_.emplace_back([data = data_](const std::string& why) { data->end(why); });
        late = ended_;
    }
    if (late) return data_->end("it has ended");
    data_->start(timeout);
}

std::unique_ptr<direct::lane::Channel> NetworkPath::channelOver(direct::lane::Wire& socket) const {
    if (overTls()) return secured_->tls()->toEntity(offer_.name, socket);
    return std::make_unique<direct::lane::PlainChannel>(socket);
}

void NetworkPath::laneMessage(const direct::lane::MessageView& message) {
    if (ended_) return;
    const auto events = events_.lock();
    if (!events) return;
    Header head;
    message.into(head);
    head.entity = entity();
    events->newDirectMsg(*this, message.keeping, std::move(head), message.content);
}

void NetworkPath::laneRead() {
    if (const auto events = events_.lock()) events->directRead();
}

/// Ice's calls may throw at once; whatever they throw ends the path.
template <class Use>
void NetworkPath::step(Use use) {
    if (ended_) return;
    try {
        use();
    } catch (const std::exception&) {
        close(transport::translate(std::current_exception()).message);
    }
}

std::function<void(std::exception_ptr)> NetworkPath::failure() {
    return [self = shared_from_this()](const std::exception_ptr& error) {
        self->close(transport::translate(error).message);
    };
}

void NetworkPath::openSignals() {
    step([&] {
        home_ = overTls() ? secured_->directSignal() : plain_home_;
        // A connection identifier of its own: a path lives and dies with its connections.
        signal_.gate = Ice::uncheckedCast<slice::DirectGatePrx>(
            home_.communicator->stringToProxy("DirectGate:" + transport::tcpEndpoint(offer_.signal_endpoint))
                ->ice_connectionId(Ice::generateUUID())
                ->ice_invocationTimeout(timeout_ms_));
        signal_.gate->challengeAsync(
            [self = shared_from_this()](const Axon::CommUtil::Bytes& nonce) { self->challenged(nonce); },
            failure());
    });
}

void NetworkPath::challenged(const Axon::CommUtil::Bytes& nonce) {
    step([&] {
        const auto connection = signal_.gate->ice_getCachedConnection();
        if (!connection) throw Ice::ConnectionLostException(__FILE__, __LINE__);
        const auto number = Id128::fromBytes({reinterpret_cast<const char*>(nonce.data()), nonce.size()});
        if (!number) return close("its nonce is none");
        if (overTls()) {
            // Before anything is proved to it.
            if (const auto why = mistrusted(*connection, offer_.name); !why.empty()) {
                connection->close(Ice::ConnectionClose::Forcefully);
                return close("the certificate " + why);
            }
        }
        connection->setAdapter(home_.adapter);
        transport::prepareSignalLane(*connection);
        const auto callback = Ice::uncheckedCast<slice::DirectCallbackPrx>(
            home_.adapter->addWithUUID(std::make_shared<Callback>(weak_from_this())));
        signal_.callback = callback->ice_getIdentity();
        signal_.connection = std::make_shared<transport::DirectConnection>(connection);
        signal_.outbox = std::make_shared<transport::Outbox>(
            transport::OutboxLimits{}, [weak = weak_from_this()](bool, const std::string& why) {
                if (const auto self = weak.lock()) self->close("its outbox is full: " + why);
            });
        bool late = false;
        {
            const std::lock_guard lock(mutex_);
            closing_.emplace_back([its = signal_.connection](const std::string& why) {
                its->disconnect({false, why}, false);
            });
            late = ended_;
        }
        signal_.connection->onClosed([weak = weak_from_this(), adapter = home_.adapter,
                                      identity = signal_.callback](const transport::CloseReason& reason) {
            try {
                adapter->remove(identity);
            } catch (const Ice::Exception&) {  // the communicator is being destroyed, and the servant with it
            }
            if (const auto self = weak.lock()) self->close(reason.text);
        });
        if (late) return signal_.connection->disconnect({false, "it has ended"}, false);

        slice::Opening opening;
        opening.lane = transport::toIce(Lane::Signal);
        opening.held = {offer_.lease.epoch, offer_.lease.number};
        opening.client = uuidOf(offer_.client);
        opening.path = toIceBytes(number_.bytes());
        opening.proof = toIceBytes(proofFor(Lane::Signal, *number));
        signal_.gate->openAsync(
            opening, callback,
            [self = shared_from_this()](const slice::Opened& answer) { self->opened(answer); }, failure());
    });
}

void NetworkPath::opened(const slice::Opened& answer) {
    step([&] {
        if (!answer.session ||
            !trusts({reinterpret_cast<const char*>(answer.proof.data()), answer.proof.size()}))
            return close("who answers does not know the lease's key; is it another machine's address?");
        signal_.session =
            Ice::uncheckedCast<slice::DirectSessionPrx>(signal_.gate->ice_getCachedConnection()
                                                            ->createProxy(answer.session->ice_getIdentity())
                                                            ->ice_oneway()
                                                            ->ice_invocationTimeout(-1));
        liveness.heard(clock_.now());
        open_ = true;
        if (const auto events = events_.lock()) events->directChanged();
    });
}

void NetworkPath::close(const std::string& why) {
    std::vector<std::function<void(const std::string&)>> closing;
    {
        const std::lock_guard lock(mutex_);
        if (ended_) return;
        ended_ = true;
        reason_ = why;
        closing = std::exchange(closing_, {});
    }
    for (const auto& closes : closing) closes(why);
    if (const auto events = events_.lock()) events->directChanged();
}

std::string NetworkPath::reason() const {
    const std::lock_guard lock(mutex_);
    return reason_;
}

void NetworkPath::send(Keeping keeping, const Header& head,
                       std::shared_ptr<const std::string> message) const {
    if (isOpen()) data_->send(keeping, head, message);
}

template <class Send>
void NetworkPath::post(Traffic traffic, Send send) const {
    if (isOpen())
        signal_.outbox->post(traffic, kHeadBytes, send, [send] { return transport::Outbox::Parcel(send); });
}

void NetworkPath::sendStopSignal(const Header& head, StopCause cause) const {
    post(Traffic::Signal, [session = signal_.session, its = toDirectHead(head), cause](SendCallbacks&& back) {
        session->sendStopSignalAsync(its, transport::toIce(cause), nullptr, std::move(back.failed),
                                     std::move(back.sent));
    });
}
void NetworkPath::sendResetSignal(const Header& head) const {
    post(Traffic::Signal, [session = signal_.session, its = toDirectHead(head)](SendCallbacks&& back) {
        session->sendResetSignalAsync(its, nullptr, std::move(back.failed), std::move(back.sent));
    });
}
void NetworkPath::sendClearSignal(const Header& head) const {
    post(Traffic::Signal, [session = signal_.session, its = toDirectHead(head)](SendCallbacks&& back) {
        session->sendClearSignalAsync(its, nullptr, std::move(back.failed), std::move(back.sent));
    });
}
void NetworkPath::beat() const {
    post(Traffic::Heartbeat,
         [session = signal_.session, received = static_cast<double>(passed.load(std::memory_order_acquire)),
          busy = liveness.busy()](SendCallbacks&& back) {
             session->keepAliveAsync(received, busy, nullptr, std::move(back.failed), std::move(back.sent));
         });
}

}  // namespace axon::client
