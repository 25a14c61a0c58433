// SPDX-License-Identifier: GPL-2.0-or-later
#include "raw_router.hpp"

#include <poll.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <cstring>
#include <deque>
#include <stdexcept>
#include <string>
#include <vector>

#include "child.hpp"
#include "common/descriptor.hpp"

namespace axon::bench {

namespace {

enum : std::uint32_t { kStop, kData, kWelcome };

/// Before every message, in the byte order of this machine: it never leaves it.
struct Frame {
    std::uint32_t receiver = 0, kind = 0, size = 0;
};
constexpr std::uint32_t kSender = 0xffffffff;
constexpr std::size_t kBuffer = 256 * 1024;

std::string_view bytesOfFrame(const Frame& frame) {
    return {reinterpret_cast<const char*>(&frame), sizeof(frame)};
}

/// Calls take(frame, message with its frame) for each whole one; how many bytes they were.
template <class Take>
std::size_t eachFrame(std::string_view received, const Take& take) {
    std::size_t used = 0;
    Frame frame;
    while (received.size() - used >= sizeof(frame)) {
        std::memcpy(&frame, received.data() + used, sizeof(frame));
        if (received.size() - used < sizeof(frame) + frame.size) break;
        take(frame, received.substr(used, sizeof(frame) + frame.size));
        used += sizeof(frame) + frame.size;
    }
    return used;
}

class Router {
  public:
    explicit Router(Descriptor listener) : listener_(std::move(listener)), epoll_(::epoll_create1(0)) {
        watch(listener_.get(), nullptr, EPOLLIN, EPOLL_CTL_ADD);
    }

    void turn() {
        std::array<epoll_event, 256> events{};
        const int ready = ::epoll_wait(epoll_.get(), events.data(), events.size(), 500);
        for (int i = 0; i < ready; ++i) {
            const auto& event = events[static_cast<std::size_t>(i)];
            if (event.data.ptr == nullptr) {
                auto& peer = peers_.emplace_back(
                    Peer{tcp::Connection(Descriptor(
                             ::accept4(listener_.get(), nullptr, nullptr, SOCK_NONBLOCK | SOCK_CLOEXEC))),
                         {},
                         {}});
                watch(peer.connection.fd(), &peer, EPOLLIN, EPOLL_CTL_ADD);
                continue;
            }
            auto& peer = *static_cast<Peer*>(event.data.ptr);
            if ((event.events & EPOLLOUT) != 0) flush(peer);
            if ((event.events & ~static_cast<std::uint32_t>(EPOLLOUT)) != 0) read(peer);
        }
    }

  private:
    struct Peer {
        tcp::Connection connection;
        tcp::Inbox inbox;
        std::string waiting;  ///< what its socket did not take
    };

    void read(Peer& peer) {
        try {
            peer.inbox.take(peer.connection, buffer_, [this, &peer](std::string_view received) {
                return eachFrame(received, [&](const Frame& frame, std::string_view message) {
                    if (frame.kind != kWelcome) {
                        if (frame.receiver < receivers_.size() && receivers_[frame.receiver] != nullptr)
                            send(*receivers_[frame.receiver], message);
                        return;
                    }
                    if (frame.receiver != kSender) {
                        if (receivers_.size() <= frame.receiver) receivers_.resize(frame.receiver + 1);
                        receivers_[frame.receiver] = &peer;
                    }
                    send(peer, message);
                });
            });
        } catch (const std::system_error&) {
            // It has gone; what is for it goes nowhere.
            ::epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, peer.connection.fd(), nullptr);
            for (auto& one : receivers_)
                if (one == &peer) one = nullptr;
        }
    }

    void send(Peer& to, std::string_view message) {
        if (to.waiting.empty()) {
            const auto written = ::send(to.connection.fd(), message.data(), message.size(), MSG_NOSIGNAL);
            if (written < 0 && errno != EAGAIN) return;
            message.remove_prefix(written < 0 ? 0 : static_cast<std::size_t>(written));
            if (message.empty()) return;
            watch(to.connection.fd(), &to, EPOLLIN | EPOLLOUT, EPOLL_CTL_MOD);
        }
        to.waiting.append(message);
    }

    void flush(Peer& to) {
        const auto written = ::send(to.connection.fd(), to.waiting.data(), to.waiting.size(), MSG_NOSIGNAL);
        if (written > 0) to.waiting.erase(0, static_cast<std::size_t>(written));
        if (to.waiting.empty()) watch(to.connection.fd(), &to, EPOLLIN, EPOLL_CTL_MOD);
    }

    void watch(int fd, Peer* peer, std::uint32_t events, int how) const {
        epoll_event wish{};
        wish.events = events;
        wish.data.ptr = peer;
        ::epoll_ctl(epoll_.get(), how, fd, &wish);
    }

    const Descriptor listener_, epoll_;
    std::deque<Peer> peers_;
    std::vector<Peer*> receivers_;
    std::vector<char> buffer_ = std::vector<char>(kBuffer);
};

/// called[i] becomes the time before receiver i's frame is written to connectionOf(i).
template <class ConnectionOf>
void sendToAll(Message message, const std::string& bytes, std::vector<std::int64_t>& called,
               const ConnectionOf& connectionOf) {
    Frame frame{0, message == Message::Stop ? kStop : kData, static_cast<std::uint32_t>(bytes.size())};
    for (; frame.receiver < called.size(); ++frame.receiver) {
        called[frame.receiver] = nowNs();
        connectionOf(frame.receiver).write({bytesOfFrame(frame), bytes});
    }
}

std::string portOf(const Child& router) {
    return field(router.waitForLine("ready "), "port");
}

/// A connection to the router, known there as this receiver (or kSender).
tcp::Connection connectTo(const Child& router, std::uint32_t receiver) {
    tcp::Connection connection(static_cast<std::uint16_t>(std::stoi(portOf(router))));
    connection.write({bytesOfFrame({receiver, kWelcome, 0})});
    Frame welcome;
    connection.readAll(reinterpret_cast<char*>(&welcome), sizeof(welcome));
    return connection;
}

class RawSubject final : public Subject {
  public:
    RawSubject(const std::filesystem::path& folder, std::size_t n)
        : board_((folder / "board").string(), n, true),
          router_(ourselves("raw-router"), folder / "router.log") {
        receivers_ = std::make_unique<Child>(
            ourselves("raw-receivers", {(folder / "board").string(), std::to_string(n), portOf(router_)}),
            folder / "receivers.log");
        receivers_->waitUntil([this] { return board_.ready() >= board_.size(); },
                              "the receivers of the raw router did not start", std::chrono::seconds{60});
        sender_ = std::make_unique<tcp::Connection>(connectTo(router_, kSender));
    }
    Board& board() override { return board_; }
    std::string ended() const override {
        return whichHasEnded({{"the router", &router_}, {"its receivers' process", receivers_.get()}});
    }
    void send(Message message, const std::string& bytes, std::vector<std::int64_t>& called) override {
        sendToAll(message, bytes, called, [this](std::size_t) -> const tcp::Connection& { return *sender_; });
    }

  private:
    Board board_;
    Child router_;
    std::unique_ptr<Child> receivers_;
    std::unique_ptr<tcp::Connection> sender_;
};

/// Without the router: a connection from the sender to each receiver.
class RawDirectSubject final : public Subject {
  public:
    RawDirectSubject(const std::filesystem::path& folder, std::size_t n)
        : board_((folder / "board").string(), n, true), to_(n) {
        std::uint16_t port = 0;
        const tcp::Connection listener(tcp::listen(port));
        receivers_ = std::make_unique<Child>(
            ourselves("raw-receivers",
                      {(folder / "board").string(), std::to_string(n), std::to_string(port)}),
            folder / "receivers.log");
        receivers_->waitUntil([&] { return take(listener) && board_.ready() >= board_.size(); },
                              "the receivers of the raw connections did not start", std::chrono::seconds{60});
    }
    Board& board() override { return board_; }
    std::string ended() const override {
        return whichHasEnded({{"its receivers' process", receivers_.get()}});
    }
    void send(Message message, const std::string& bytes, std::vector<std::int64_t>& called) override {
        sendToAll(message, bytes, called,
                  [this](std::size_t receiver) -> const tcp::Connection& { return *to_[receiver]; });
    }

  private:
    /// Those who have called by now; true.
    bool take(const tcp::Connection& listener) {
        for (pollfd wish{listener.fd(), POLLIN, 0}; ::poll(&wish, 1, 0) > 0;) {
            auto caller = std::make_unique<tcp::Connection>(
                Descriptor(::accept4(listener.fd(), nullptr, nullptr, SOCK_CLOEXEC)));
            Frame hello;
            caller->readAll(reinterpret_cast<char*>(&hello), sizeof(hello));
            caller->write({bytesOfFrame(hello)});
            to_.at(hello.receiver) = std::move(caller);
        }
        return true;
    }

    Board board_;
    std::unique_ptr<Child> receivers_;
    std::vector<std::unique_ptr<tcp::Connection>> to_;
};

}  // namespace

int runRawRouter() {
    std::uint16_t port = 0;
    Router router(tcp::listen(port));
    std::printf("ready port=%u\n", port);
    std::fflush(stdout);
    for (const auto parent = ::getppid(); ::getppid() == parent;) router.turn();
    return 0;
}

std::string RawReceiver::hello(std::size_t index) const {
    return std::string(bytesOfFrame({static_cast<std::uint32_t>(index), kWelcome, 0}));
}

std::size_t RawReceiver::consume(const tcp::Connection&, std::string_view received, std::int64_t when,
                                 Slot& slot, const std::function<void()>& ready) const {
    return eachFrame(received, [&](const Frame& frame, std::string_view message) {
        if (frame.kind == kWelcome) return ready();
        slot.arrived(frame.kind == kStop ? Kind::Stop : Kind::Data, when, message.data() + sizeof(Frame),
                     message.size() - sizeof(Frame));
    });
}

std::unique_ptr<Subject> startRawRouter(const std::filesystem::path& folder, std::size_t n) {
    return std::make_unique<RawSubject>(folder, n);
}
std::unique_ptr<Subject> startRawDirect(const std::filesystem::path& folder, std::size_t n) {
    return std::make_unique<RawDirectSubject>(folder, n);
}

RawPair::RawPair(const std::filesystem::path& folder)
    : router_(ourselves("raw-router"), folder / "router.log"), connection_(connectTo(router_, 0)) {}

void RawPair::trips(std::size_t bytes, int count, std::vector<double>& times) const {
    const auto sent =
        std::string(bytesOfFrame({0, kData, static_cast<std::uint32_t>(bytes)})) + content(bytes);
    std::string back(sent.size(), ' ');
    for (int i = 0; i < count; ++i) {
        const auto begin = nowNs();
        connection_.write({sent});
        connection_.readAll(back.data(), back.size());
        times.push_back(static_cast<double>(nowNs() - begin) / 1e3);
        if (back != sent) throw std::runtime_error("what the raw router sent back is not what was sent");
    }
}

}  // namespace axon::bench
