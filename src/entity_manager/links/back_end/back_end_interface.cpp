// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/links/back_end/back_end_interface.hpp"

#include <arpa/inet.h>
#include <axon/link.pb.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <asio/buffer.hpp>
#include <asio/ip/tcp.hpp>
#include <asio/post.hpp>
#include <asio/steady_timer.hpp>
#include <asio/write.hpp>
#include <atomic>
#include <cerrno>
#include <cstring>
#include <deque>
#include <functional>
#include <map>
#include <set>
#include <stdexcept>
#include <vector>

#include "common/backoff.hpp"
#include "common/descriptor.hpp"
#include "common/frame.hpp"
#include "common/liveness.hpp"
#include "common/message_frame.hpp"
#include "common/release.hpp"
#include "common/snapshot.hpp"
#include "entity_manager/strand/due_timer.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using tcp = asio::ip::tcp;

constexpr std::uint32_t kProtocol = 1;
constexpr std::size_t kHelloMax = 4096;
constexpr auto kHelloTime = 1s;
constexpr auto kLookPeriod = 100ms;
constexpr Duration kFirstBackoff = 50ms;
constexpr Duration kLastBackoff = 1s;
constexpr unsigned kNearPorts = 32;   // tried at every look
constexpr std::size_t kAtOnce = 16;   // handshakes under way
constexpr int kConnectsPerTurn = 64;  // then the strand may do something else
constexpr Duration kPassOtherApplication = 500ms;
constexpr Duration kPassStranger = 2s;
constexpr Duration kPassClosed = 200ms;
constexpr Duration kSlack = 50ms;  // for a sign of life that has arrived and has not been read yet
constexpr std::size_t kQueueFrames = 1024;
constexpr std::size_t kQueueBytes = 4 * 1024 * 1024;
constexpr std::size_t kQueueRaw = 256;        // frames of raw data, of which the oldest are dropped
constexpr std::size_t kWriteAtOnce = 65'536;  // what the queue no longer has cannot be dropped
constexpr Duration kLastWords = 50ms;
constexpr std::size_t kPartingMax = 300;
constexpr int kPriority = 6;  // SO_PRIORITY: the highest that needs no privilege

/// The signal connection for those who may not wait for the strand. A duplicate descriptor, so that it
/// outlives the strand's own for as long as somebody is writing. Threads: any; no lock: one small send(2) is
/// atomic.
class SignalSocket {
  public:
    explicit SignalSocket(int original) : socket_(::dup(original)) {}

    /// Whole and at once, or the connection ends, which stops the robot as well.
    void write(const proto::EmToEi& message) const {
        std::string frame;
        appendFrameOf(frame, message);
        const auto sent = ::send(socket_.get(), frame.data(), frame.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
        if (sent != static_cast<ssize_t>(frame.size())) cut();
    }
    void cut() const { ::shutdown(socket_.get(), SHUT_RDWR); }
    bool open() const { return socket_.open(); }

  private:
    const Descriptor socket_;
};

}  // namespace

class BackEndInterface::Connections : public std::enable_shared_from_this<Connections> {
  public:
    Connections(asio::any_io_executor strand, BackEndSettings settings,
                const StopGenerations& stop_generations, const Clock& clock, RandomSource& random,
                BackEndEvents& events)
        : strand_(std::move(strand)),
          settings_(std::move(settings)),
          stop_generations_(stop_generations),
          clock_(clock),
          random_(random),
          events_(events),
          look_timer_(strand_),
          beat_timer_(strand_, clock_),
          search_({settings_.application, settings_.instance, settings_.where, settings_.ports_from},
                  settings_.report_after),
          liveness_(settings_.watchdog_busy, settings_.watchdog_idle, now()) {}

    void start() {
        if (closed_ || started_) return;
        started_ = true;
        search_.begin(now());
        lookIn(Duration::zero());
    }

    void close() {
        closed_ = true;
        look_timer_.cancel();
        beat_timer_.cancel();
        abandonHandshakes();
        dropPeer();
    }

    bool send(const proto::EmToEi& message) {
        const auto peer = peer_;
        if (!peer) return true;
        const bool idle = peer->writing.empty();  // nothing waits
        std::string waits;
        auto& frame = idle ? peer->writing : waits;
        if (!appendFrameOf(frame, message)) {
            refused({RefusalCode::TooLarge,
                     "a message to the robot application exceeds 1 MiB: send less at once",
                     {}});
            return false;
        }
        // A task must not wait for a generation that nobody has announced.
        if (message.has_task() && message.task().stop_generation() > announced_.load()) {
            announce(message.task().stop_generation());
            beat();
        }
        if (idle) {
            writeNow(peer);
            return true;
        }
        const auto full = [&] {
            return peer->queued_bytes + peer->writing.size() + frame.size() > kQueueBytes ||
                   peer->queued.size() >= kQueueFrames;
        };
        // Old raw data is worth less than anything that comes after it.
        while (peer->queued_raw > 0 && (full() || (message.has_raw() && peer->queued_raw >= kQueueRaw)))
            dropRaw(*peer);
        if (full()) {
            if (message.has_raw()) {
                ++raw_dropped_;
                return true;
            }
            asio::post(strand_, [self = shared_from_this(), peer] {
                self->lost(peer, "the robot application does not read: the queue to it is full",
                           LinkEnd::Silent);
            });
            return true;
        }
        peer->queued_bytes += frame.size();
        if (message.has_raw()) ++peer->queued_raw;
        peer->queued.push_back({std::move(frame), message.has_raw()});
        return true;
    }
    std::uint64_t rawDropped() const { return raw_dropped_; }

    void stop(std::uint32_t generation, StopCause cause) {
        if (const auto signal = signal_.load()) {
            proto::EmToEi message;
            auto& stop = *message.mutable_stop();
            if (cause == StopCause::Drill) {
                stop.set_drill(generation);
            } else {
                stop.set_stop_generation(generation);
            }
            stop.set_cause(static_cast<proto::StopCause>(cause));
            signal->write(message);
        }
        if (cause == StopCause::Drill) return;
        announce(generation);  // after it, lest a beat arrives first and hides the cause
    }

    std::vector<HopMargin> margins() const {
        if (!peer_) return {};
        return {{"entity manager watches application", liveness_.longest(now())},
                {"application watches entity manager", told_}};
    }

    void setBusy(bool busy) {
        if (liveness_.busy() == busy) return;
        liveness_.setBusy(busy, now());
        if (peer_) onBeatTimer();
    }

  private:
    TimePoint now() const { return clock_.now(); }

    /// The connections of one link.
    struct Peer {
        Peer(tcp::socket signal_socket, FrameReader from_signal, tcp::socket data_socket,
             FrameReader from_data)
            : signal(std::move(signal_socket)),
              data(std::move(data_socket)),
              signal_reader(std::move(from_signal)),
              data_reader(std::move(from_data)) {}
        tcp::socket signal, data;
        FrameReader signal_reader, data_reader;
        struct Queued {
            std::string frame;
            bool raw;
        };
        std::deque<Queued> queued;
        std::size_t queued_bytes = 0, queued_raw = 0;
        std::string writing;  // while it is empty, so is the queue
        bool signal_ended = false,
             data_ended = false;  // after one of them last words on the other are awaited
        std::string parting;      // why the application ends the link, in its own words
        bool stopped = false;     // it ends in order: its stop callback has returned

        bool ending() const { return signal_ended || data_ended; }
    };

    /// One connection on which Hello has been said and Welcome is awaited.
    struct Handshake {
        Handshake(const asio::any_io_executor& strand, std::uint16_t to)
            : port(to), socket(strand), deadline(strand), reader(kHelloMax) {}
        const std::uint16_t port;
        tcp::socket socket;
        asio::steady_timer deadline;
        FrameReader reader;
        std::string nonce, hello;
        std::string release;  // of the application; bounded by its frame
        bool closed = false;  // by the peer, which is then no stranger that keeps silent
        std::array<char, kHelloMax> bytes;
        std::function<void(const std::shared_ptr<Handshake>&, const proto::Welcome*)>
            done;  // null = no valid answer
    };

    void lookIn(Duration time) {
        look_timer_.expires_after(time);
        look_timer_.async_wait([self = shared_from_this()](const asio::error_code& error) {
            if (!error) self->look();
        });
    }

    void look() {
        if (closed_ || peer_ || linking_) return;
        ports_.clear();
        const auto time = now();
        if (const auto report = search_.report(time)) events_.onLinkSought(*report);
        const auto& range = settings_.where.ports;
        const bool whole = time >= next_whole_look_;
        if (whole) next_whole_look_ = time + backoff_.next();
        if (last_good_ != 0) ports_.push_back(last_good_);
        const unsigned last =
            whole ? range.last : std::min<unsigned>(range.last, range.first + kNearPorts - 1);
        for (unsigned port = range.first; port <= last; ++port)
            if (port != last_good_) ports_.push_back(static_cast<std::uint16_t>(port));
        std::erase_if(pass_over_, [&](const auto& entry) { return entry.second <= time; });
        tryNext();
    }

    void tryNext() {
        if (closed_ || peer_ || linking_) return;
        for (int turn = 0; !ports_.empty() && handshakes_.size() < kAtOnce; ++turn) {
            if (turn >= kConnectsPerTurn) {
                asio::post(strand_, [self = shared_from_this()] { self->tryNext(); });
                return;
            }
            const auto port = ports_.front();
            ports_.pop_front();
            if (pass_over_.contains(port) || underWay(port)) continue;
            // A nonce for each: an answer then belongs to one connection only.
            if (!shake(port, proto::LANE_SIGNAL, Id128::random(random_).bytes(),
                       [this](const auto& handshake, const auto* welcome) {
                           onSignalAnswer(handshake, welcome);
                       }))
                continue;
        }
        if (ports_.empty()) lookIn(kLookPeriod);
    }

    bool underWay(std::uint16_t port) const {
        return std::any_of(handshakes_.begin(), handshakes_.end(),
                           [&](const auto& h) { return h->port == port; });
    }

    /// False when nobody listens there.
    template <class Done>
    bool shake(std::uint16_t port, proto::LinkLane lane, const std::string& nonce, Done done) {
        Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
        if (!socket.open()) return false;
        sockaddr_in to{};
        to.sin_family = AF_INET;
        to.sin_port = htons(port);
        ::inet_pton(AF_INET, settings_.where.address.c_str(), &to.sin_addr);
        int failure =
            ::connect(socket.get(), reinterpret_cast<const sockaddr*>(&to), sizeof to) == 0 ? 0 : errno;
        if (failure == EINPROGRESS) {
            // On loopback a refusal has arrived by now, which keeps a look at the whole range cheap.
            socklen_t size = sizeof failure;
            ::getsockopt(socket.get(), SOL_SOCKET, SO_ERROR, &failure, &size);
        }
        if (failure != 0) return false;
        const int on = 1;
        ::setsockopt(socket.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
        if (lane == proto::LANE_SIGNAL)
            ::setsockopt(socket.get(), SOL_SOCKET, SO_PRIORITY, &kPriority, sizeof kPriority);
        const auto handshake = std::make_shared<Handshake>(strand_, port);
        handshake->socket.assign(tcp::v4(), socket.release());
        handshake->done = std::move(done);
        proto::EmToEi message;
        auto& hello = *message.mutable_hello();
        hello.set_protocol(kProtocol);
        hello.set_application(settings_.application);
        hello.set_instance(settings_.instance);
        hello.set_lane(lane);
        hello.set_nonce(nonce);
        hello.set_manager(settings_.manager);
        hello.set_watchdog_busy_ms(static_cast<std::uint32_t>(settings_.watchdog_busy.count()));
        hello.set_watchdog_idle_ms(static_cast<std::uint32_t>(settings_.watchdog_idle.count()));
        hello.set_release(kRelease);
        appendFrameOf(handshake->hello, message);
        handshakes_.insert(handshake);
        handshake->nonce = nonce;
        handshake->deadline.expires_after(kHelloTime);
        handshake->deadline.async_wait([self = shared_from_this(), handshake](const asio::error_code& error) {
            if (!error) self->answered(handshake, nullptr);
        });
        handshake->socket.async_wait(
            tcp::socket::wait_write, [self = shared_from_this(), handshake](const asio::error_code& error) {
                if (error) return self->answered(handshake, nullptr);
                asio::async_write(handshake->socket, asio::buffer(handshake->hello),
                                  [self, handshake](const asio::error_code& failed, std::size_t) {
                                      if (failed) handshake->closed = true;
                                      if (failed) return self->answered(handshake, nullptr);
                                      self->readWelcome(handshake);
                                  });
            });
        return true;
    }

    void readWelcome(const std::shared_ptr<Handshake>& handshake) {
        handshake->socket.async_read_some(
            asio::buffer(handshake->bytes),
            [self = shared_from_this(), handshake](const asio::error_code& error, std::size_t count) {
                if (error) {
                    handshake->closed = true;
                    return self->answered(handshake, nullptr);
                }
                handshake->reader.feed({handshake->bytes.data(), count});
                std::string payload;
                if (!handshake->reader.next(payload)) {
                    if (handshake->reader.failed()) return self->answered(handshake, nullptr);
                    return self->readWelcome(handshake);
                }
                proto::EiToEm message;
                if (!message.ParseFromString(payload) || !message.has_welcome())
                    return self->answered(handshake, nullptr);
                self->answered(handshake, &message.welcome());
            });
    }

    /// Once per handshake: it leaves the set, whatever the answer. Without one its connection ends, which
    /// otherwise would live as long as what waits to be read from it.
    void answered(const std::shared_ptr<Handshake>& handshake, const proto::Welcome* welcome) {
        if (handshakes_.erase(handshake) == 0) return;
        handshake->deadline.cancel();
        asio::error_code ignored;
        if (welcome == nullptr) handshake->socket.close(ignored);
        const auto done = std::exchange(handshake->done, nullptr);
        if (!closed_) done(handshake, welcome);
    }

    void abandonHandshakes() {
        for (const auto& handshake : handshakes_) {
            asio::error_code ignored;
            handshake->deadline.cancel();
            handshake->socket.close(ignored);
            handshake->done = nullptr;
        }
        handshakes_.clear();
    }

    void onSignalAnswer(const std::shared_ptr<Handshake>& signal, const proto::Welcome* welcome) {
        const auto& nonce = signal->nonce;
        if (welcome == nullptr || linking_ || peer_) {
            if (welcome == nullptr)
                pass_over_[signal->port] = now() + (signal->closed ? kPassClosed : kPassStranger);
        } else if (welcome->refusal().code() != proto::OK) {
            pass_over_[signal->port] = now() + kPassOtherApplication;
            const bool ours = welcome->application() == settings_.application &&
                              welcome->refusal().code() != proto::UNKNOWN_ENTITY;
            search_.met(signal->port, welcome->application(), welcome->instance(),
                        ours ? welcome->refusal().message() : std::string(), now());
            if (ours) {
                pass_over_.erase(signal->port);  // ours, and its other Entity Manager may go at any time
                refused(
                    {static_cast<RefusalCode>(welcome->refusal().code()), welcome->refusal().message(), {}});
            }
        } else if (welcome->protocol() != kProtocol || welcome->nonce() != nonce ||
                   welcome->application() != settings_.application) {
            pass_over_[signal->port] = now() + kPassStranger;  // an echo, perhaps
        } else if (const auto stranger = settings_.where.users.check(signal->socket.native_handle())) {
            pass_over_[signal->port] = now() + kPassOtherApplication;
            search_.met(signal->port, welcome->application(), welcome->instance(), {}, now());
            refused(*stranger);
        } else {
            linking_ = true;
            signal->release = welcome->release();
            abandonHandshakes();
            const bool shaking = shake(signal->port, proto::LANE_DATA, nonce,
                                       [this, signal](const auto& data, const auto* second) {
                                           linking_ = false;
                                           if (second == nullptr || second->refusal().code() != proto::OK)
                                               return lookIn(kFirstBackoff);
                                           up(signal, data);
                                       });
            if (shaking) return;
            linking_ = false;
            lookIn(kFirstBackoff);
            return;
        }
        tryNext();
    }

    void refused(const Refusal& refusal) {
        if (refusal.code == last_refusal_.code && refusal.message == last_refusal_.message) return;
        last_refusal_ = refusal;
        asio::post(strand_, [self = shared_from_this(), refusal] {
            if (!self->closed_) self->events_.onLinkRefused(refusal);
        });
    }

    void up(const std::shared_ptr<Handshake>& signal, const std::shared_ptr<Handshake>& data) {
        const auto duplicate = std::make_shared<const SignalSocket>(signal->socket.native_handle());
        if (!duplicate->open())
            return lookIn(kLastBackoff);  // out of descriptors: without a stop there is no link
        peer_ = std::make_shared<Peer>(std::move(signal->socket), std::move(signal->reader),
                                       std::move(data->socket), std::move(data->reader));
        peer_->signal_reader.setLimit(kFrameMax);
        peer_->data_reader.setLimit(kFrameMax);
        last_good_ = signal->port;
        last_refusal_ = {};
        search_.end();
        backoff_.reset();
        next_whole_look_ = {};
        look_timer_.cancel();
        liveness_.restart(now());
        told_ = {};
        announced_ = stop_generations_.generation();
        generation_seen_ = announced_;
        signal_.store(duplicate);
        onBeatTimer();
        const auto peer = peer_;
        if (const auto note = releases_.onPeer("a robot application", signal->release))
            events_.onLinkRelease(*note);
        events_.onLinkUp();
        // What came in one piece with the answers. Then the reads, which put bytes into the same readers.
        if (!deliver(peer, peer->signal_reader, true) || !deliver(peer, peer->data_reader, false)) return;
        readSignal(peer);
        readData(peer);
    }

    void readSignal(const std::shared_ptr<Peer>& peer) {
        const auto room = peer->signal_reader.room();
        peer->signal.async_read_some(
            asio::buffer(room.data(), room.size()),
            [self = shared_from_this(), peer](const asio::error_code& error, std::size_t count) {
                if (self->peer_ != peer) return;
                if (error) return self->ended(peer, peer->signal_ended);
                peer->signal_reader.filled(count);
                if (self->deliver(peer, peer->signal_reader, true)) self->readSignal(peer);
            });
    }

    /// One of the two connections. An application that ends the link says why on the signal connection, and
    /// what became of its tasks on the data connection; their ends may be read in either order. The
    /// application has stopped by itself.
    void ended(const std::shared_ptr<Peer>& peer, bool& connection) {
        const bool last = peer->ending() && !connection;
        if (std::exchange(connection, true)) return;
        if (last) return closed(peer);
        look_timer_.expires_after(kLastWords);
        look_timer_.async_wait([self = shared_from_this(), peer](const asio::error_code& error) {
            if (!error) self->closed(peer);
        });
    }

    void closed(const std::shared_ptr<Peer>& peer) {
        if (peer->parting.empty() && !peer->stopped)
            return lost(peer, "the robot application has closed the link", LinkEnd::Closed);
        lost(peer, "the robot application has ended the link: " + peer->parting,
             peer->stopped ? LinkEnd::GoodBye : LinkEnd::Closed);
    }

    void readData(const std::shared_ptr<Peer>& peer) {
        const auto room = peer->data_reader.room();
        peer->data.async_read_some(
            asio::buffer(room.data(), room.size()),
            [self = shared_from_this(), peer](const asio::error_code& error, std::size_t count) {
                if (self->peer_ != peer) return;
                if (error) return self->ended(peer, peer->data_ended);
                peer->data_reader.filled(count);
                if (self->deliver(peer, peer->data_reader, false)) self->readData(peer);
            });
    }

    /// False when the link has ended meanwhile.
    bool deliver(const std::shared_ptr<Peer>& peer, FrameReader& reader, bool signal) {
        proto::EiToEm message;
        while (peer_ == peer) {
            const auto payload = reader.nextView();
            if (!payload) break;
            const bool parsed = message.ParseFromArray(payload->data(), static_cast<int>(payload->size()));
            const bool is_signal = message.has_beat() || message.has_stop_done() || message.has_end();
            if (!parsed || message.has_welcome() ||
                (is_signal != signal && message.body_case() != proto::EiToEm::BODY_NOT_SET)) {
                lost(peer, "the robot application has sent a malformed message", LinkEnd::Closed);
                return false;
            }
            if (message.has_beat()) {
                liveness_.heard(now());
                told_ = {std::chrono::milliseconds{message.beat().longest_gap_ms()},
                         std::chrono::milliseconds{message.beat().allowed_ms()}};
            } else if (message.has_end()) {
                peer->parting = message.end().reason().substr(0, kPartingMax);
                peer->stopped = message.end().stopped();
            } else if (message.body_case() != proto::EiToEm::BODY_NOT_SET) {
                events_.onLinkMessage(message);
            }
        }
        if (peer_ != peer) return false;
        if (!reader.failed()) return true;
        lost(peer, "the robot application has sent a malformed frame: " + reader.error(), LinkEnd::Closed);
        return false;
    }

    void dropRaw(Peer& peer) {
        const auto oldest = std::find_if(peer.queued.begin(), peer.queued.end(),
                                         [](const auto& queued) { return queued.raw; });
        peer.queued_bytes -= oldest->frame.size();
        --peer.queued_raw;
        peer.queued.erase(oldest);
        ++raw_dropped_;
    }

    /// Nothing is being written.
    void writeNext(const std::shared_ptr<Peer>& peer) {
        while (!peer->queued.empty()) {
            do {
                auto& next = peer->queued.front();
                peer->queued_bytes -= next.frame.size();
                if (next.raw) --peer->queued_raw;
                if (peer->writing.empty()) {
                    peer->writing.swap(next.frame);
                } else {
                    peer->writing += next.frame;
                }
                peer->queued.pop_front();
            } while (!peer->queued.empty() &&
                     peer->writing.size() + peer->queued.front().frame.size() <= kWriteAtOnce);
            if (!writeNow(peer)) return;
        }
    }

    /// What is being written, as far as the socket takes it at once; whether that is all. The end of an
    /// asynchronous write would be a turn of the strand, on another thread.
    bool writeNow(const std::shared_ptr<Peer>& peer) {
        const auto sent = ::send(peer->data.native_handle(), peer->writing.data(), peer->writing.size(),
                                 MSG_DONTWAIT | MSG_NOSIGNAL);
        if (sent == static_cast<ssize_t>(peer->writing.size())) {
            peer->writing.clear();
            return true;
        }
        writeRest(peer, sent < 0 ? 0 : static_cast<std::size_t>(sent));
        return false;
    }

    /// When the socket takes it. A failure is told here, too: never from within send().
    void writeRest(const std::shared_ptr<Peer>& peer, std::size_t sent) {
        asio::async_write(peer->data, asio::buffer(peer->writing) + sent,
                          [self = shared_from_this(), peer](const asio::error_code& error, std::size_t) {
                              if (self->peer_ != peer) return;
                              if (error) return self->ended(peer, peer->data_ended);
                              peer->writing.clear();
                              self->writeNext(peer);
                          });
    }

    void announce(std::uint32_t generation) {
        auto known = announced_.load();
        while (known < generation && !announced_.compare_exchange_weak(known, generation)) {
        }
    }

    void beat() {
        // The level heals itself: a generation that was raised a whole period ago, and never given to stop(),
        // is announced here. Younger ones are about to arrive with their cause.
        const auto generation = stop_generations_.generation();
        if (generation_seen_ == generation) announce(generation);
        generation_seen_ = generation;
        proto::EmToEi message;
        auto& body = *message.mutable_beat();
        body.set_sequence(++beat_sequence_);
        body.set_busy(liveness_.busy());
        body.set_stop_generation(announced_);
        if (const auto signal = signal_.load()) signal->write(message);
    }

    void onBeatTimer() {
        if (closed_ || !peer_ || peer_->ending()) return;
        const auto peer = peer_;
        beat();
        const auto time = now();
        if (liveness_.expired(time)) {
            asio::error_code error;
            const bool unread = peer->signal.available(error) > 0 && !error;
            if (!unread || time >= liveness_.deadline() + kSlack) {
                const auto ms =
                    std::chrono::duration_cast<std::chrono::milliseconds>(liveness_.timeout()).count();
                asio::post(strand_, [self = shared_from_this(), peer, ms] {
                    // It was this process that hung, and the application has said so.
                    if (!peer->parting.empty()) return self->closed(peer);
                    self->lost(peer,
                               "the robot application has been silent for " + std::to_string(ms) + " ms",
                               LinkEnd::Silent);
                });
                return;
            }
        }
        if (time >= liveness_.lateFrom() && time >= warn_again_) {
            warn_again_ = time + Liveness::kWarnAgain;
            asio::post(strand_, [self = shared_from_this(), text = describe(liveness_.longest(time))] {
                if (!self->closed_) self->events_.onLinkSlow(text);
            });
        }
        auto next = time + liveness_.timeout() / 5;
        if (liveness_.deadline() > time) next = std::min(next, liveness_.deadline());
        beatAt(next);
    }

    void beatAt(TimePoint due) {
        beat_timer_.at(due, [weak = weak_from_this(), peer = peer_] {
            const auto self = weak.lock();
            if (self && self->peer_ == peer && !peer->ending()) self->onBeatTimer();
        });
    }

    void dropPeer() {
        if (!peer_) return;
        if (const auto signal = signal_.load()) signal->cut();
        signal_.store(nullptr);
        asio::error_code ignored;
        peer_->signal.close(ignored);
        peer_->data.close(ignored);
        peer_.reset();
        beat_timer_.cancel();
    }

    void lost(const std::shared_ptr<Peer>& peer, const std::string& reason, LinkEnd end) {
        if (closed_ || peer_ != peer) return;
        dropPeer();
        search_.begin(now());
        lookIn(kFirstBackoff);
        events_.onLinkDown(reason, end);
    }

    // Constant after construction
    const asio::any_io_executor strand_;
    const BackEndSettings settings_;
    const StopGenerations& stop_generations_;
    const Clock& clock_;
    RandomSource& random_;
    BackEndEvents& events_;

    // Any thread
    Snapshot<SignalSocket> signal_{nullptr};
    std::atomic<std::uint32_t> announced_{0};

    std::atomic<std::uint64_t> raw_dropped_{0};

    // Confined to the strand
    bool started_ = false, closed_ = false, linking_ = false;
    asio::steady_timer look_timer_;
    DueTimer beat_timer_;
    std::deque<std::uint16_t> ports_;
    std::map<std::uint16_t, TimePoint> pass_over_;
    std::set<std::shared_ptr<Handshake>> handshakes_;
    std::uint16_t last_good_ = 0;
    Backoff backoff_{kFirstBackoff, kLastBackoff};
    TimePoint next_whole_look_{};
    Refusal last_refusal_;
    std::shared_ptr<Peer> peer_;
    ApplicationSearch search_;
    ReleaseNotes releases_{"this Entity Manager", "protocol " + std::to_string(kProtocol)};
    Liveness liveness_;   // of the application
    Liveness::Gap told_;  // by the application: what it heard of us
    TimePoint warn_again_{};
    std::uint64_t beat_sequence_ = 0;
    std::uint32_t generation_seen_ = 0;
};

BackEndInterface::BackEndInterface(asio::any_io_executor strand, BackEndSettings settings,
                                   const StopGenerations& stop_generations, const Clock& clock,
                                   RandomSource& random, BackEndEvents& events) {
    if (settings.application.empty() || settings.application.size() > 255)
        throw std::invalid_argument(
            "application: expected the name of the robot application, 1 to 255 characters: set it");
    in_addr ignored{};
    if (::inet_pton(AF_INET, settings.where.address.c_str(), &ignored) != 1)
        throw std::invalid_argument("address '" + settings.where.address +
                                    "': expected an IPv4 address such as 127.0.0.1");
    if (!settings.beyond_loopback && !isLoopback(settings.where.address))
        throw std::invalid_argument(
            "address " + settings.where.address +
            ": expected a loopback address (127.x.y.z), for the link has no authentication: use "
            "one, or allow others explicitly on a network you trust");
    const auto range = checkPortRange(settings.where.ports.first, settings.where.ports.last, "ports");
    if (!range) throw std::invalid_argument(range.refusal().message);
    connections_ = std::make_shared<Connections>(std::move(strand), std::move(settings), stop_generations,
                                                 clock, random, events);
}

BackEndInterface::~BackEndInterface() {
    connections_->close();
}
void BackEndInterface::start() {
    connections_->start();
}
void BackEndInterface::close() {
    connections_->close();
}
bool BackEndInterface::send(const proto::EmToEi& message) {
    return connections_->send(message);
}
std::uint64_t BackEndInterface::rawDropped() const {
    return connections_->rawDropped();
}
void BackEndInterface::stop(std::uint32_t generation, StopCause cause) {
    connections_->stop(generation, cause);
}
std::vector<HopMargin> BackEndInterface::margins() const {
    return connections_->margins();
}
void BackEndInterface::setBusy(bool busy) {
    connections_->setBusy(busy);
}

}  // namespace axon::entity_manager
