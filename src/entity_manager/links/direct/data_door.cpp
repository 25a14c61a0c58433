// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/links/direct/data_door.hpp"

#include <pthread.h>
#include <sys/socket.h>

#include <asio/bind_executor.hpp>
#include <asio/buffer.hpp>
#include <asio/executor_work_guard.hpp>
#include <asio/io_context.hpp>
#include <asio/ip/tcp.hpp>
#include <asio/post.hpp>
#include <asio/thread_pool.hpp>
#include <map>
#include <optional>
#include <thread>
#include <utility>
#include <variant>
#include <vector>

#include "common/frame.hpp"
#include "common/ids.hpp"
#include "direct/lane/channel.hpp"
#include "direct/lane/frames.hpp"
#include "direct/lane/lane_outbox.hpp"
#include "direct/lane/lane_socket.hpp"
#include "direct/lane/opening.hpp"
#include "direct/lane/spin.hpp"
#include "entity_manager/strand/due_timer.hpp"
#include "transport/ice/connection_limits_core.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using direct::Keeping;
using direct::lane::Channel;
using direct::lane::LaneOutbox;
using direct::lane::ManagerOpening;
using tcp = asio::ip::tcp;
using transport::ConnectionLimitsCore;

constexpr int kFramesPerTurn = 128;  // then the strand may do something else
constexpr int kAcceptsPerLook = 64;
constexpr int kTlsAcceptsPerLook = 16;  // each costs a handshake
constexpr Duration kLooks = 100ms;
constexpr Duration kTold = 11s;  // after the last connection was closed: the log hears of it within 10 s
constexpr transport::ConnectionBounds kBounds{
    .strangers_of_one_address = 64, .strangers = 256, .to_log_in = 10s, .silence = 60s};
constexpr std::size_t kStrangerBytes = 64 * 1024;
constexpr const char* kHolderClosed = "its holder's end is closed";

/// The thread that reads and accepts for one door, and waits until something can be written. It takes the
/// strand itself when that is free, as the threads of Ice do. It is an ordinary one: the strand's own thread
/// runs with priority, because it beats, and a holder who floods must not have that. Nor must a thread that
/// spins.
class Reader {
  public:
    /// `spin`: as Spinner's.
    Reader(asio::any_io_executor its_strand, Duration spin, bool tls)
        : strand(std::move(its_strand)), spin_(spin) {
        if (!tls) return;
        handshakes_.emplace(1U);
        asio::post(*handshakes_, [] { ::pthread_setname_np(::pthread_self(), "axon-handshake"); });
    }

    /// What runs the connections' operations. Held by whoever has some.
    asio::io_context io{1};
    const asio::any_io_executor strand;

    void start() {
        thread_ = std::thread([this] {
            ::pthread_setname_np(::pthread_self(), "axon-direct");
            run();
        });
    }
    /// Once every connection has ended, so that nothing more comes.
    void join() {
        if (handshakes_) handshakes_->join();  // which hands over to the other thread
        work_.reset();
        if (thread_.joinable()) thread_.join();
    }
    /// On the strand.
    template <class Handler>
    auto then(Handler handler) const {
        return asio::bind_executor(strand, std::move(handler));
    }
    /// On the thread that opens TLS.
    template <class Handler>
    auto apart(Handler handler) {
        return asio::bind_executor(handshakes_->get_executor(), std::move(handler));
    }
    template <class Handler>
    void later(Handler handler) {
        asio::post(io, then(std::move(handler)));
    }

  private:
    void run() {
        direct::lane::Spinner spinner(spin_);
        if (!spinner.spins()) {
            io.run();
            return;
        }
        for (;;) {
            if (spinner.spin([this] { return io.poll() > 0; })) continue;
            if (io.run_one() == 0) return;
            spinner.came();
        }
    }

    const Duration spin_;
    asio::executor_work_guard<asio::io_context::executor_type> work_{io.get_executor()};
    std::thread thread_;
    std::optional<asio::thread_pool> handshakes_;  // with TLS
};

}  // namespace

/// One connection: first a stranger's, and then the data lane of a path. With TLS the handshake comes before
/// that, on a thread of its own; until it is over, nothing else touches socket, channel and frames.
///
///     Awaited ── a claim ──► Judged ── admit() ──► Open ──► over
///        └───────────────────── over ◄───┘ refuse()
class DataDoor::Connection final : public DirectLane,
                                   public direct::lane::Wire,
                                   public std::enable_shared_from_this<Connection> {
  public:
    Connection(std::shared_ptr<Reader> reader, std::weak_ptr<Connections> home, std::uint64_t id,
               tcp::socket socket, const Id128& nonce, const direct::lane::Tls* tls)
        : id(id),
          thread_(std::move(reader)),
          home_(std::move(home)),
          socket_(std::move(socket)),
          channel_(tls != nullptr ? tls->fromCaller(*this)
                                  : std::make_unique<direct::lane::PlainChannel>(*this)),
          opening_(nonce),
          handshaking_(tls != nullptr) {
        asio::error_code ignored;
        socket_.non_blocking(true, ignored);
        const auto from = socket_.remote_endpoint(ignored);
        address = from.address().to_string();
        peer_ = address + ":" + std::to_string(from.port());
        direct::lane::prepare(socket_.native_handle());
    }

    void start() {
        if (handshaking_) return shakeHands();
        if (writeWhole(opening_.greeting()) && deliver()) read();
    }
    void end(const std::string& why);
    /// The same, and it is told: it was not an honest peer's end.
    void turnAway(RefusalCode code, const std::string& why);
    /// There is room for more.
    void goOn() {
        if (std::exchange(stalled_, false)) later();
    }
    bool isStranger() const { return opening_.state() != ManagerOpening::State::Open; }

    // DirectLane.
    void send(Keeping keeping, const Header& head, std::shared_ptr<const std::string> message) override {
        if (over_) return;
        switch (outbox_.post(keeping, head, message)) {
            case LaneOutbox::Outcome::Taken:
                return awaitWritable();
            case LaneOutbox::Outcome::Overflow:
                return end("it does not read its messages");
            case LaneOutbox::Outcome::TooLarge:
                return end("a message for it is larger than 4096 KiB");
            case LaneOutbox::Outcome::Over:
                return end(kHolderClosed);
        }
    }
    void beat(std::int64_t, bool) override {}  // by the signal lane
    void close(const std::string& why) override { end(why); }
    std::string peer() const override { return peer_; }

    // Wire: of the socket.
    std::optional<std::size_t> write(std::span<const std::string_view> pieces) override {
        return direct::lane::writeTo(socket_.native_handle(), pieces);
    }

    const std::uint64_t id;
    std::string address;

  private:
    /// Of the opening: a new connection has room for it.
    bool writeWhole(const std::string& frame) {
        const std::string_view piece(frame);
        if (over_ || channel_->write({&piece, 1}) == frame.size()) return !over_;
        end(kHolderClosed);
        return false;
    }
    /// At first on the strand, then on the thread of handshakes.
    void shakeHands() {
        const auto room = channel_->room(reader_);
        socket_.async_read_some(
            asio::buffer(room.data(), room.size()),
            thread_->apart([self = shared_from_this()](const asio::error_code& error, std::size_t count) {
                if (!error && self->channel_->filled(self->reader_, count) == Channel::State::Opening)
                    return self->shakeHands();
                self->thread_->later([self, lost = static_cast<bool>(error)] { self->shaken(lost); });
            }));
    }
    void shaken(bool lost);
    void read() {
        if (over_ || reading_) return;
        reading_ = true;
        const auto room = channel_->room(reader_);
        socket_.async_read_some(
            asio::buffer(room.data(), room.size()),
            thread_->then([self = shared_from_this()](const asio::error_code& error, std::size_t count) {
                self->reading_ = false;
                if (self->over_) return;
                if (error) return self->end(kHolderClosed);
                // Over TLS that need not be a frame.
                if (self->isStranger() && (self->heard_ += count) > kStrangerBytes)
                    return self->turnAway(RefusalCode::Malformed, "it makes no claim");
                const bool open = self->channel_->filled(self->reader_, count) != Channel::State::Over;
                if (self->deliver() && open) return self->read();
                if (open) return;
                const auto why = self->channel_->why();
                if (why.starts_with("TLS ")) return self->turnAway(RefusalCode::Malformed, why);
                self->end(why);
            }));
    }
    /// What has been read. False when nothing more is to be read for now. Nothing may escape: the thread may
    /// be one of Ice.
    bool deliver() noexcept;
    void later() {
        thread_->later([self = shared_from_this()] {
            if (self->deliver()) self->read();
        });
    }
    void onClaim(std::string_view frame, DirectEvents& events);
    void awaitWritable() {
        if (over_ || awaiting_writable_ || !outbox_.waiting()) return;
        awaiting_writable_ = true;
        socket_.async_wait(tcp::socket::wait_write,
                           thread_->then([self = shared_from_this()](const asio::error_code& error) {
                               self->awaiting_writable_ = false;
                               if (self->over_) return;
                               if (error || self->outbox_.flush() == LaneOutbox::Outcome::Over)
                                   return self->end(kHolderClosed);
                               self->awaitWritable();
                           }));
    }
    std::shared_ptr<DirectLane> admit(const Sender& sender, const std::string& proof);
    void refuse(const Refusal& refusal) {
        if (over_ || opening_.state() != ManagerOpening::State::Judged) return;
        if (writeWhole(opening_.refuse(refusal))) turnAway(refusal.code, refusal.message);
    }

    const std::shared_ptr<Reader> thread_;  // before the socket, which ends first
    const std::weak_ptr<Connections> home_;
    tcp::socket socket_;
    const std::unique_ptr<Channel> channel_;
    std::string peer_;
    ManagerOpening opening_;
    FrameReader reader_{direct::lane::kClaimMax};
    LaneOutbox outbox_{transport::OutboxLimits{}, *channel_};
    Id128 path_;  // that was claimed
    Sender sender_;
    // The message that is handled; sender and entity stay in the head.
    Header head_;
    std::string bytes_;
    std::optional<Keeping> refused_;  // it is still there: it found no room
    std::size_t heard_ = 0;           // bytes, of a stranger
    bool stalled_ = false;            // until there is some
    bool reading_ = false, awaiting_writable_ = false;
    bool handshaking_;
    bool over_ = false;
};

/// Those that came to one port. Handlers of asio hold it, which may come after the door has gone.
class DataDoor::Connections : public std::enable_shared_from_this<Connections> {
  public:
    Connections(const asio::any_io_executor& strand, const std::string& address, std::uint16_t port,
                std::string its_entity, Duration spin, const Clock& clock,
                std::weak_ptr<DirectEvents> its_events, std::shared_ptr<const direct::lane::Tls> tls,
                std::shared_ptr<DirectRefusals> refusals)
        : entity(std::move(its_entity)),
          events(std::move(its_events)),
          clock_(clock),
          refusals_(refusals ? std::move(refusals) : std::make_shared<DirectRefusals>(nullptr)),
          tls_(std::move(tls)),
          thread_(std::make_shared<Reader>(strand, spin, tls_ != nullptr)),
          acceptor_(thread_->io, tcp::endpoint(asio::ip::make_address(address), port)),
          timer_(strand, clock) {}

    void start() {
        accept();
        thread_->start();
    }
    /// On any thread but the door's.
    void join() {
        if (!shut_) shut();  // the other door could not listen
        thread_->join();
    }
    void shut() {
        shut_ = true;
        asio::error_code ignored;
        acceptor_.close(ignored);
        timer_.cancel();
        // Ending one takes it out of the table.
        for (const auto& connection : all()) connection->end("the Entity Manager ends, or listens elsewhere");
    }
    void roomAgain() {
        for (const auto& connection : all()) connection->goOn();
    }
    void forget(std::uint64_t id) { connections_.erase(id); }
    void noteRefused(const std::string& peer, const std::string& what, const Refusal& refusal) {
        refusals_->refused(entity, peer, what, refusal);
    }
    std::uint16_t port() const { return acceptor_.local_endpoint().port(); }

    const std::string entity;
    const std::weak_ptr<DirectEvents> events;

  private:
    std::vector<std::shared_ptr<Connection>> all() const {
        std::vector<std::shared_ptr<Connection>> copies;
        for (const auto& [id, connection] : connections_) copies.push_back(connection);
        return copies;
    }
    void accept() {
        if (shut_ || accepting_) return;
        accepting_ = true;
        acceptor_.async_accept(
            thread_->then([self = shared_from_this()](const asio::error_code& error, tcp::socket socket) {
                self->accepting_ = false;
                if (self->shut_) return;
                // Where it failed there are no descriptors; those that are refused until the next look are
                // tried again by the kernel of whoever calls.
                if (!error) self->take(std::move(socket));
                if (error || ++self->accepted_ >= self->accepts_per_look_) return self->lookIn(kLooks);
                self->accept();
            }));
    }
    void take(tcp::socket socket) {
        const auto connection = std::make_shared<Connection>(
            thread_, weak_from_this(), ++last_, std::move(socket), Id128::random(random_), tls_.get());
        connections_.emplace(connection->id, connection);
        connection->start();
        look();
    }
    void look() {
        std::vector<ConnectionLimitsCore::Seen> strangers;
        for (const auto& [id, connection] : connections_)
            if (connection->isStranger())
                strangers.push_back({id, connection->address, ConnectionLimitsCore::Peer::Stranger, {}});
        const auto now = clock_.now();
        std::vector<std::uint64_t> close;
        const auto verdict = limits_.look(strangers, now, [&close](std::uint64_t id) {
            close.push_back(id);
            return true;
        });
        for (const auto& line : verdict.notes) refusals_->closed(entity, line);
        for (const auto id : close) {
            look_until_ = now + kTold;
            if (const auto found = connections_.find(id); found != connections_.end())
                std::shared_ptr(found->second)->end("it has no path");
        }
        if (verdict.strangers || now < look_until_) lookIn(1s);
    }
    void lookIn(Duration time) {
        const auto at = clock_.now() + time;
        if (shut_ || at >= timer_.due()) return;
        timer_.at(at, [weak = weak_from_this()] {
            const auto self = weak.lock();
            if (!self) return;
            self->accepted_ = 0;
            self->look();
            self->accept();
        });
    }

    const Clock& clock_;
    const std::shared_ptr<DirectRefusals> refusals_;
    const std::shared_ptr<const direct::lane::Tls> tls_;  // null: plain
    SystemRandom random_;
    const std::shared_ptr<Reader> thread_;  // before the acceptor, which ends first
    tcp::acceptor acceptor_;
    DueTimer timer_;
    ConnectionLimitsCore limits_{kBounds};
    std::map<std::uint64_t, std::shared_ptr<Connection>> connections_;
    const int accepts_per_look_ = tls_ ? kTlsAcceptsPerLook : kAcceptsPerLook;
    std::uint64_t last_ = 0;
    int accepted_ = 0;  // since the last look
    TimePoint look_until_{};
    bool accepting_ = false, shut_ = false;
};

void DataDoor::Connection::end(const std::string& why) {
    if (std::exchange(over_, true)) return;
    outbox_.close();
    asio::error_code ignored;
    if (handshaking_) {
        ::shutdown(socket_.native_handle(),
                   SHUT_RDWR);  // the other thread hears that, and shaken() closes it
    } else {
        socket_.close(ignored);
    }
    const auto home = home_.lock();
    if (!home) return;
    home->forget(id);
    if (isStranger()) return;
    if (const auto events = home->events.lock()) events->directClosed(path_, why);
}

void DataDoor::Connection::turnAway(RefusalCode code, const std::string& why) {
    if (over_) return;
    if (const auto home = home_.lock()) home->noteRefused(peer_, kDataLane, {code, why, {}});
    end(why);
}

void DataDoor::Connection::shaken(bool lost) {
    handshaking_ = false;
    asio::error_code ignored;
    if (over_) {
        socket_.close(ignored);
    } else if (lost) {
        end(kHolderClosed);
    } else if (const auto why = channel_->why(); !why.empty()) {
        if (const auto home = home_.lock())
            home->noteRefused(peer_, "TLS: a connection", {RefusalCode::PermissionDenied, why, {}});
        end(why);
    } else {
        start();
    }
}

bool DataDoor::Connection::deliver() noexcept {
    const auto home = home_.lock();
    const auto events = home ? home->events.lock() : nullptr;
    if (!events) return false;
    bool told = false, all = false;
    for (int frames = 0; !all && !over_ && !stalled_; ++frames) {
        if (frames == kFramesPerTurn) {
            later();
            break;
        }
        if (!refused_) {
            const auto frame = reader_.nextView();
            if (!frame) {
                if (reader_.failed())
                    turnAway(RefusalCode::Malformed, "it broke the protocol: " + reader_.error());
                all = true;
                break;
            }
            if (isStranger()) {
                onClaim(*frame, *events);
                break;  // what follows is read when it is judged
            }
            const auto message = direct::lane::messageIn(*frame);
            if (!message) {
                turnAway(RefusalCode::Malformed, "it broke the protocol: a frame is no message");
                break;
            }
            // Both keep their memory from message to message.
            if (head_.entity.empty()) {
                head_.sender = sender_;
                head_.entity = home->entity;
            }
            message->into(head_);
            bytes_ = message->content;
            refused_ = message->keeping;
        }
        stalled_ = !events->directMsg(path_, *refused_, head_, bytes_);
        if (!stalled_) refused_.reset();
        told = true;
    }
    if (told) events->directTurnEnded();
    return all && !over_;
}

void DataDoor::Connection::onClaim(std::string_view frame, DirectEvents& events) {
    auto heard = opening_.onFrame(frame);
    if (const auto* refusal = std::get_if<Refusal>(&heard)) return refuse(*refusal);
    auto& claimed = std::get<ManagerOpening::Claimed>(heard);
    path_ = claimed.claim.path;
    DirectOpening its;
    its.claim = claimed.claim;
    its.proof = std::move(claimed.proof);
    its.refuse = [self = shared_from_this()](const Refusal& refusal) { self->refuse(refusal); };
    its.admit = [self = shared_from_this()](const Sender& sender, const std::shared_ptr<DirectSigns>&,
                                            const std::string& proof) { return self->admit(sender, proof); };
    events.directOpening(std::move(its));
}

std::shared_ptr<DirectLane> DataDoor::Connection::admit(const Sender& sender, const std::string& proof) {
    sender_ = sender;
    const auto frame = opening_.admit(proof);
    if (over_) {  // while it was judged
        const auto home = home_.lock();
        if (const auto events = home ? home->events.lock() : nullptr)
            events->directClosed(path_, kHolderClosed);
    } else if (writeWhole(frame)) {
        reader_.setLimit(direct::lane::kMessageFrameMax);
        later();
    }
    return shared_from_this();
}

DataDoor::DataDoor(const asio::any_io_executor& strand, const std::string& address, std::uint16_t port,
                   std::string entity, Duration spin, const Clock& clock, std::weak_ptr<DirectEvents> events,
                   std::shared_ptr<const direct::lane::Tls> tls, std::shared_ptr<DirectRefusals> refusals)
    : connections_(std::make_shared<Connections>(strand, address, port, std::move(entity), spin, clock,
                                                 std::move(events), std::move(tls), std::move(refusals))) {
    connections_->start();
}

DataDoor::~DataDoor() {
    connections_->join();
}

void DataDoor::shut() {
    connections_->shut();
}

void DataDoor::roomAgain() {
    connections_->roomAgain();
}

std::uint16_t DataDoor::port() const {
    return connections_->port();
}

}  // namespace axon::entity_manager
