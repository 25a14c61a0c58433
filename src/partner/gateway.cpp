// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/gateway.hpp"

#include <sodium.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <asio/post.hpp>
#include <asio/strand.hpp>
#include <future>
#include <stdexcept>
#include <utility>

#include "client/base/durations.hpp"
#include "client/connection/send_queue.hpp"
#include "common/ids.hpp"
#include "entity_manager/links/server/server_communicators.hpp"
#include "partner/translation.hpp"
#include "transport/ice/bound_uuid.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/sessions/routed_session.hpp"

namespace axon::partner {
namespace {

constexpr std::size_t kEventBytes = 512;  // of what waits for the strand, besides its message
static_assert(2 * SignalRelay::kShared + 64 < client::kSignalsUnsent,
              "the shared session bears what passes at the edge of a second, and its own heartbeats");
/// A server that does not answer takes a second each.
constexpr std::size_t kLeavingMax = 32;

}  // namespace

/// The entity session at home of one entity, and what its server says.
class Gateway::HomeLink final : public entity_manager::ServerEvents,
                                public std::enable_shared_from_this<HomeLink> {
  public:
    HomeLink(std::weak_ptr<Gateway> gateway, ShownEntity entity)
        : gateway_(std::move(gateway)), entity_(std::move(entity)) {}

    void connect(const asio::any_io_executor& strand,
                 std::shared_ptr<entity_manager::ServerCommunicators> ice,
                 entity_manager::ServerAddress address, const Clock& clock) {
        server_ = std::make_unique<entity_manager::EntityCommunicator>(
            strand, std::move(ice), std::move(address), clock, weak_from_this());
        server_->wantConnection(true);
    }
    entity_manager::EntityCommunicator& server() { return *server_; }
    /// On the strand, as one of Ice's threads may be the last that has this link.
    void end() { server_.reset(); }

    void serverUp() override {
        tell([home = entity_.home](PartnerCore& core) { core.onHomeUp(home); });
    }
    void serverDown(const std::string& reason) override {
        tell([home = entity_.home, reason](PartnerCore& core) { core.onHomeDown(home, reason); });
    }
    void clientMsg(Lane lane, Header head, std::string bytes) override {
        if (lane == Lane::Signal) return;  // of another entity's run, in which this one takes no part
        pass(false, std::move(head), std::move(bytes));
    }
    void clientMsgDataSeq(Header head, std::string bytes) override {
        pass(true, std::move(head), std::move(bytes));
    }
    void stopSignal(Header head, StopCause cause) override {
        if (const auto gateway = gateway_.lock()) gateway->stopSignal(entity_, head, cause);
    }
    void resetSignal(Header head) override {
        if (const auto gateway = gateway_.lock()) gateway->command(client::Operation::Reset, entity_, head);
    }
    void clearSignal(Header head) override {
        if (const auto gateway = gateway_.lock()) gateway->command(client::Operation::Clear, entity_, head);
    }
    void clientUpdate(Header head, ClientChange change) override {
        counted([home = entity_.home, client = head.sender.id, change](PartnerCore& core) {
            core.onClientUpdate(home, client, change);
        });
    }
    void serverHeartbeat() override {
        counted([home = entity_.home](PartnerCore& core) { core.onHomeHeartbeat(home); });
    }
    void undeliverable(Lane, Header head, const Refusal& refusal) override {
        spdlog::debug("{}: the server at home refused a {}: {}", entity_.name, head.msg_type,
                      refusal.message);
    }

  private:
    void tell(std::function<void(PartnerCore&)> event) {
        if (const auto gateway = gateway_.lock()) gateway->post(std::move(event));
    }
    void counted(std::function<void(PartnerCore&)> event) {
        if (const auto gateway = gateway_.lock()) gateway->postBounded(0, false, std::move(event));
    }
    void pass(bool droppable, Header head, std::string bytes) {
        const auto gateway = gateway_.lock();
        if (!gateway) return;
        const auto size = bytes.size();
        const auto client = head.sender.id;
        const auto verdict = gateway->shares_.take(client, size + kEventBytes, kEventBytes);
        if (verdict == StrandShares::Verdict::Drop) return;
        if (verdict == StrandShares::Verdict::Refuse) {
            proto::ToEntity asked;
            if (droppable || !asked.ParseFromString(bytes))
                return gateway->shares_.give(client, kEventBytes, verdict);
            gateway->postShare(
                gateway->shares_, client, verdict, 0, false,
                [home = entity_.home, client = head.sender, answer = refused(asked, {})](
                    PartnerCore& core) mutable { core.onClientFlood(home, client, std::move(answer)); });
            return;
        }
        gateway->postShare(
            gateway->shares_, client, verdict, size, droppable,
            [home = entity_.home, droppable, head = std::move(head), bytes = std::move(bytes)](
                PartnerCore& core) mutable { core.onClientMsg(home, droppable, head, std::move(bytes)); });
    }

    const std::weak_ptr<Gateway> gateway_;
    const ShownEntity entity_;
    std::unique_ptr<entity_manager::EntityCommunicator> server_;  // of the strand
};

/// A client session there, and what its server says.
class Gateway::Session final : public client::ConnectionEvents {
  public:
    Session(std::weak_ptr<Gateway> gateway, SessionNumber number, Use use)
        : gateway_(std::move(gateway)), number_(number), watches_(use == Use::Watch) {}

    void newProfile(std::uint64_t, Presence presence, const Registration& registration,
                    std::string_view profile) override {
        if (!watches_) return;
        watching(profile.size(), [=, number = number_, profile = std::string(profile)](PartnerCore& core) {
            core.onProfile(number, presence, registration, profile);
        });
    }
    void newStatus(std::uint64_t, const EntityStatus& status) override {
        if (!watches_) return;
        watching(textBytes(status),
                 [status, number = number_](PartnerCore& core) { core.onStatus(number, status); });
    }
    void newEntityMsg(std::uint64_t, Lane lane, direct::Keeping keeping, const Header& head,
                      std::string_view message) override {
        const bool droppable = keeping == direct::Keeping::Droppable;
        bounded(message.size(), droppable,
                [=, number = number_, bytes = std::string(message)](PartnerCore& core) {
                    core.onEntityMsg(number, lane, droppable, head, bytes);
                });
    }
    void newRefusal(std::uint64_t, const Header& head, const Refusal& refusal) override {
        bounded(refusal.message.size(), false, [head, refusal, number = number_](PartnerCore& core) {
            core.onRefusal(number, head, refusal);
        });
    }
    void newStopAccepted(std::uint64_t, const Header&, int) override {}  // the server at home has said that
    void newServerText(std::uint64_t, int, const std::string& text) override {
        spdlog::info("the partner's server says: {}", text);
    }
    void newServerHeartbeat(std::uint64_t) override {
        const auto beat = [number = number_](PartnerCore& core) { core.onHeartbeat(number); };
        watches_ ? watching(0, beat) : bounded(0, false, beat);
    }
    void newServerRelease(const std::string&) override {}
    void closed(std::uint64_t, const std::string& reason) override {
        const auto gateway = gateway_.lock();
        if (!gateway) return;
        gateway->signals_.noStopBy(number_);  // at once: a stop does not wait for the strand
        asio::post(gateway->strand_, [weak = gateway_, number = number_, reason] {
            if (const auto self = weak.lock(); self && !self->stopping_) self->closed(number, reason);
        });
    }

    // Of the gateway's strand.
    std::shared_ptr<const client::ServerConnection> connection;  // once it is open
    std::string client;                                          // of home, once it is known
    std::string display_name;
    std::optional<std::string> closed_early;  // before the strand has heard that it is open

  private:
    /// What the session that watches is for.
    void watching(std::size_t bytes, std::function<void(PartnerCore&)> event) {
        if (const auto gateway = gateway_.lock()) gateway->postBounded(bytes, false, std::move(event));
    }
    void bounded(std::size_t bytes, bool droppable, std::function<void(PartnerCore&)> event) {
        const auto gateway = gateway_.lock();
        if (!gateway) return;
        auto& shares = gateway->there_shares_;
        auto verdict = StrandShares::Verdict::Drop;
        const auto fate = share_.admit(shares, bytes + kEventBytes, droppable, verdict);
        if (fate == SessionShare::Fate::Post)
            gateway->postShare(shares, share_.name(), verdict, bytes, droppable, std::move(event));
        else if (fate == SessionShare::Fate::End)
            closed(0, "this gateway does not keep up with what it is sent");
    }

    const std::weak_ptr<Gateway> gateway_;
    const SessionNumber number_;
    const bool watches_;
    SessionShare share_{std::to_string(number_), !watches_};
};

Gateway::Gateway(GatewaySettings settings, const Clock& clock)
    : settings_(std::move(settings)),
      clock_(clock),
      strand_(asio::make_strand(executor_)),
      home_ice_(std::make_shared<entity_manager::ServerCommunicators>(1, 1, settings_.home_properties)),
      signals_(clock),
      core_(settings_.core, clock, *this, *this, signals_,
            [](const std::string& line) { spdlog::info("{}", line); }),
      timer_(strand_, clock_),
      feed_timer_(strand_, steady_) {}

std::shared_ptr<Gateway> Gateway::create(GatewaySettings settings, const Clock& clock) {
    const std::shared_ptr<Gateway> self(new Gateway(std::move(settings), clock));
    if (!self->settings_.home.router.empty())
        transport::routerProxy(*self->home_ice_->data(), self->settings_.home.router);  // or a fix
    if (const auto opened = self->there_ice_.open(self->settings_.there); !opened)
        throw std::runtime_error(opened.refusal().message);
    return self;
}

Gateway::~Gateway() = default;

void Gateway::watchedBy(transport::ServiceWatchdog::Worker turned) {
    turned_ = std::move(turned);
}

void Gateway::start() {
    post([](PartnerCore& core) { core.start(); });
    asio::post(strand_, [weak = weak_from_this()] {
        const auto self = weak.lock();
        if (!self) return;
        self->turn();
        if (self->turned_) self->feed();
    });
}

void Gateway::turn() {
    if (stopping_) return;
    core_.onTimer();
    timer_.at(clock_.now() + PartnerCore::kTurn / 2, [weak = weak_from_this()] {
        if (const auto self = weak.lock()) self->turn();
    });
}

void Gateway::feed() {
    if (stopping_) return;
    feed_timer_.at(steady_.now() + turned_(), [weak = weak_from_this()] {
        if (const auto self = weak.lock()) self->feed();
    });
}

void Gateway::stop() {
    std::promise<void> done;
    asio::post(strand_, [this, &done] {
        stopping_ = true;
        timer_.cancel();
        feed_timer_.cancel();
        core_.stop();
        done.set_value();
    });
    done.get_future().wait();
    leavers_.join();
    there_ice_.destroy();  // ends a log-in that an opener may be waiting for
    openers_.join();
    standing_.join();
    // What the sessions at home say last is on its way when their communicators have ended.
    std::promise<void> left;
    asio::post(strand_, [&left] { left.set_value(); });
    left.get_future().wait();
    home_ice_->destroy();
    executor_.join();
}

void Gateway::post(std::function<void(PartnerCore&)> event) {
    asio::post(strand_, [weak = weak_from_this(), event = std::move(event)] {
        if (const auto self = weak.lock(); self && !self->stopping_) event(self->core_);
    });
}

void Gateway::postShare(StrandShares& shares, const std::string& client, StrandShares::Verdict verdict,
                        std::size_t bytes, bool droppable, std::function<void(PartnerCore&)> event) {
    const auto size = bytes + kEventBytes;
    const bool posted = postBounded(
        bytes, droppable, [&shares, client, verdict, size, event = std::move(event)](PartnerCore& core) {
            shares.give(client, size, verdict);
            event(core);
        });
    if (!posted) shares.give(client, size, verdict);
}

bool Gateway::postBounded(std::size_t bytes, bool droppable, std::function<void(PartnerCore&)> event) {
    const auto size = bytes + kEventBytes;
    if (waiting_.load() + size > (droppable ? kWaitingData : kWaitingControl)) {
        if (!droppable && !overflown_.exchange(true))
            post([this](PartnerCore& core) {
                overflown_ = false;
                core.onOverflow();
            });
        return false;
    }
    waiting_ += size;
    post([this, size, event = std::move(event)](PartnerCore& core) {
        waiting_ -= size;
        event(core);
    });
    return true;
}

// Signals.

void Gateway::stopSignal(const ShownEntity& entity, const Header& head, StopCause cause) {
    if (head.msg_type == kMsgDrill) return;  // of the server at home, which measures entities of its own
    const auto& client = head.sender.id;
    if (cause != StopCause::Requested && cause != StopCause::Drill) {
        // The client is gone from home. What that means for a running task, the Entity Manager decides, so
        // its session there ends in the same way.
        // Without a session there it holds nothing: it has ended already, for another entity, or this is
        // somebody of the partner's, whom a server at home knows only as the holder and takes for gone.
        const auto connection = connectionOf(client);
        if (!connection) return;
        return cause == StopCause::Released ? leaveSoon(connection) : connection->drop();
    }
    const auto passed = signals_.stop(entity.there, head, cause);
    if (passed == SignalRelay::Passed::Sent || !warnings_.admit(clock_.now())) return;
    spdlog::warn("a stop of {} for {} was not passed on: {}", head.sender.name, entity.name,
                 passed == SignalRelay::Passed::TooMany
                     ? "there are too many, while the session for them is opened again"
                     : "there is no session in its laboratory");
}

void Gateway::command(client::Operation operation, const ShownEntity& entity, const Header& head) {
    if (signals_.command(operation, entity.there, head)) return;
    const auto verdict = shares_.take(head.sender.id, kEventBytes, kEventBytes);
    if (verdict == StrandShares::Verdict::Drop) return;
    postShare(shares_, head.sender.id, verdict, 0, false,
              [home = entity.home, head](PartnerCore& core) { core.onCommandOfStranger(home, head); });
}

std::shared_ptr<const client::ServerConnection> Gateway::connectionOf(const std::string& client) const {
    const std::lock_guard lock(visitors_mutex_);
    const auto found = visitors_.find(client);
    return found == visitors_.end() ? nullptr : found->second;
}

void Gateway::leaveSoon(std::shared_ptr<const client::ServerConnection> connection) {
    if (leaving_.fetch_add(1) >= kLeavingMax) {
        --leaving_;
        return connection->drop();
    }
    asio::post(leavers_, [this, connection = std::move(connection)] {
        connection->leave();
        --leaving_;
    });
}

// Home.

std::string Gateway::derived(std::string_view what, std::string_view id) const {
    const auto text = std::string(what).append(" ").append(id);
    std::string mac(crypto_auth_hmacsha256_BYTES, '\0');
    crypto_auth_hmacsha256(reinterpret_cast<unsigned char*>(mac.data()),
                           reinterpret_cast<const unsigned char*>(text.data()), text.size(),
                           reinterpret_cast<const unsigned char*>(settings_.secret.data()));
    return mac;
}

std::string Gateway::uuidAtHome(std::string_view there) {
    return transport::boundUuid(derived("entity", there));
}

std::string Gateway::strangerAtHome(std::string_view id) {
    return Id128::fromBytes(std::string_view(derived("client", id)).substr(0, 16))->toString();
}

void Gateway::join(const ShownEntity& entity) {
    auto address = settings_.home;
    address.secret = derived("entity", entity.there);
    auto link = std::make_shared<HomeLink>(weak_from_this(), entity);
    links_[entity.home] = link;
    link->connect(strand_, home_ice_, std::move(address), clock_);
}

void Gateway::leave(const std::string& home) {
    auto link = links_.extract(home);
    if (link.empty()) return;
    // Not within a call of its own.
    asio::post(strand_, [its = std::move(link.mapped())] { its->end(); });
}

void Gateway::renew(const std::string& home) {
    const auto link = links_.find(home);
    if (link == links_.end()) return;
    link->second->server().wantConnection(false);
    link->second->server().wantConnection(true);
}

void Gateway::show(const Registration& registration, const proto::BasicProfile& profile) {
    if (const auto link = links_.find(registration.entity); link != links_.end())
        link->second->server().sendBasicPrfl(registration, profile);
}

void Gateway::tellStatus(const EntityStatus& status) {
    if (const auto link = links_.find(status.entity); link != links_.end())
        link->second->server().sendStatus(status);
}

void Gateway::toClient(Lane lane, const Header& head, const std::string& bytes) {
    if (const auto link = links_.find(head.entity); link != links_.end())
        link->second->server().sendToClientBytes(lane, head, bytes);
}

void Gateway::toClientDataSeq(const Header& head, const std::string& bytes) {
    if (const auto link = links_.find(head.entity); link != links_.end())
        link->second->server().sendToClientDataSeqBytes(head, bytes);
}

// There.

void Gateway::open(SessionNumber session, const std::string& display_name, Use use) {
    auto its = std::make_shared<Session>(weak_from_this(), session, use);
    its->display_name = display_name;
    sessions_[session] = its;
    // A log-in waits for the server. Visitors' do not hold up the sessions that all others need.
    if (use != Use::Visit) return logIn(standing_, session, its);
    openings_.add(session);
    openNext();
}

void Gateway::openNext() {
    while (const auto session = openings_.next()) logIn(openers_, *session, sessions_.at(*session));
}

void Gateway::logIn(asio::thread_pool& threads, SessionNumber session, const std::shared_ptr<Session>& its) {
    client::Login login;
    const auto& options = settings_.there;
    if (there_ice_.routed())
        login.endpoint.tls = transport::isTlsRouter(options.server);
    else
        login.endpoint = transport::parseEndpoint(options.server);
    login.user = options.user;
    login.password = options.password;
    login.display_name = its->display_name;
    login.timeout = client::toDuration(options.timeout);
    login.attempt = session;
    const bool visits = &threads == &openers_;
    asio::post(threads, [this, weak = weak_from_this(), session, its, login, visits] {
        if (stopping_) return;
        const auto opened =
            client::ServerConnection::open(there_ice_.data(), there_ice_.signal(), login, its, clock_);
        const auto self = weak.lock();
        if (!self) return;
        asio::post(strand_, [self, session, its, opened, visits] {
            if (visits) self->openings_.done();
            if (visits && !self->stopping_) self->openNext();
            if (!self->sessions_.contains(session) || self->stopping_) {
                if (opened) opened.value()->drop();
                return;
            }
            if (!opened) {
                self->sessions_.erase(session);
                return self->core_.onRefused(session, opened.refusal());
            }
            its->connection = opened.value();
            self->core_.onOpened(session, its->connection->me(), its->connection->watchdogs());
            if (its->closed_early) self->core_.onClosed(session, *its->closed_early);
        });
    });
}

// A log-in that fails half-way closes what it has opened: why it failed is said by the log-in.
void Gateway::closed(SessionNumber session, const std::string& reason) {
    const auto found = sessions_.find(session);
    if (found == sessions_.end()) return;
    if (!found->second->connection)
        found->second->closed_early = reason;
    else
        core_.onClosed(session, reason);
}

std::shared_ptr<const client::ServerConnection> Gateway::connectionOf(SessionNumber session) const {
    const auto found = sessions_.find(session);
    return found == sessions_.end() ? nullptr : found->second->connection;
}

void Gateway::stopsBy(SessionNumber session, bool shared) {
    if (const auto its = connectionOf(session)) signals_.stopBy(session, its->me(), its, shared);
}

void Gateway::visits(SessionNumber session, const Sender& client) {
    const auto its = connectionOf(session);
    if (!its) return;
    sessions_.at(session)->client = client.id;
    {
        const std::lock_guard lock(visitors_mutex_);
        visitors_[client.id] = its;
    }
    signals_.visit(client, its->me(), {its, its});
}

bool Gateway::send(SessionNumber session, client::Operation operation, const Header& head,
                   std::string bytes) {
    const auto its = connectionOf(session);
    if (!its || its->waitingBytes() + bytes.size() > client::kWaitingBytesMax) return false;
    its->send(operation, head, std::move(bytes));
    return true;
}

void Gateway::keepAlive(SessionNumber session, std::int64_t sequence) {
    if (const auto its = connectionOf(session)) its->keepAlive(sequence);
}

std::shared_ptr<Gateway::Session> Gateway::forget(SessionNumber session) {
    openings_.forget(session);
    auto found = sessions_.extract(session);
    if (found.empty()) return nullptr;
    const auto& its = found.mapped();
    const std::lock_guard lock(visitors_mutex_);
    if (const auto visitor = visitors_.find(its->client);
        visitor != visitors_.end() && visitor->second == its->connection)
        visitors_.erase(visitor);
    return its;
}

void Gateway::leave(SessionNumber session) {
    if (const auto its = forget(session); its && its->connection) leaveSoon(its->connection);
}

void Gateway::drop(SessionNumber session) {
    if (const auto its = forget(session); its && its->connection) its->connection->drop();
}

}  // namespace axon::partner
