// SPDX-License-Identifier: GPL-2.0-or-later
#include "relay.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <deque>
#include <map>
#include <mutex>
#include <random>
#include <set>
#include <string_view>
#include <system_error>
#include <thread>
#include <utility>
#include <vector>

#include "common/descriptor.hpp"

namespace axon::faults {

namespace {

using Steady = std::chrono::steady_clock;
constexpr std::size_t kWaitingMax = 8U << 20U;  // of one direction; then its source is not read
constexpr int kForEver = -1;

[[noreturn]] void fail(const std::string& what) {
    throw std::system_error(errno, std::generic_category(), what);
}

sockaddr_in addressOf(const std::string& address, std::uint16_t port) {
    sockaddr_in at{};
    at.sin_family = AF_INET;
    at.sin_port = htons(port);
    if (::inet_pton(AF_INET, address.c_str(), &at.sin_addr) != 1)
        throw std::invalid_argument("'" + address + "': expected an IPv4 address");
    return at;
}

/// Its peer sees RST and not FIN.
void closeWithReset(Descriptor& socket) {
    const linger now{1, 0};
    ::setsockopt(socket.get(), SOL_SOCKET, SO_LINGER, &now, sizeof now);
    socket.reset();
}

}  // namespace

class Relay::Pump {
  public:
    enum class Mode { Pass, Cut, Stall };

    Pump() : poll_(::epoll_create1(EPOLL_CLOEXEC)), wake_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {
        if (!poll_.open() || !wake_.open()) fail("epoll");
        watch(wake_.get(), EPOLLIN, EPOLL_CTL_ADD);
        thread_ = std::thread([this] { run(); });
    }
    ~Pump() {
        ending_ = true;
        wake();
        thread_.join();
        listeners_.clear();
        while (!pairs_.empty()) drop(*pairs_.begin(), true);
    }

    std::uint16_t open(Hop hop, const std::string& address, std::uint16_t port, const sockaddr_in& target) {
        Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
        if (!socket.open()) fail("socket");
        const int fd = socket.get();
        const int on = 1;
        ::setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
        auto at = addressOf(address, port);
        if (::bind(fd, reinterpret_cast<sockaddr*>(&at), sizeof at) != 0 || ::listen(fd, 1024) != 0)
            fail("the relay cannot listen on " + address + ":" + std::to_string(port));
        socklen_t size = sizeof at;
        ::getsockname(fd, reinterpret_cast<sockaddr*>(&at), &size);
        const std::lock_guard lock(mutex_);
        listeners_[fd] = {std::move(socket), hop, target};
        watch(fd, EPOLLIN, EPOLL_CTL_ADD);
        return ntohs(at.sin_port);
    }

    void divert(const std::string& source, Hop hop) {
        const std::lock_guard lock(mutex_);
        diverted_[addressOf(source, 0).sin_addr.s_addr] = hop;
    }

    void set(Hop hop, Mode mode) {
        const std::lock_guard lock(mutex_);
        mode_[index(hop)] = mode;
        for (auto* pair : copyOf(hop)) {
            if (mode == Mode::Cut) {
                pair->spoilt = true;
                for (auto& side : pair->sides) side.waiting.clear(), side.bytes = 0;
            }
            if (mode == Mode::Pass && pair->spoilt)
                drop(pair, true);
            else
                refresh(*pair);
        }
        wake();
    }
    void reset(Hop hop) {
        const std::lock_guard lock(mutex_);
        for (auto* pair : copyOf(hop)) drop(pair, true);
    }
    void delay(Hop hop, std::chrono::milliseconds by) {
        const std::lock_guard lock(mutex_);
        delay_[index(hop)] = by;
        wake();
    }
    void impair(Hop hop, const Impairment& how) {
        const std::lock_guard lock(mutex_);
        impaired_[index(hop)] = how;
        random_.seed(how.seed);
    }
    std::size_t count(Hop hop) const {
        const std::lock_guard lock(mutex_);
        return static_cast<std::size_t>(
            std::count_if(pairs_.begin(), pairs_.end(), [&](const auto* p) { return p->hop == hop; }));
    }

  private:
    struct Piece {
        Steady::time_point due;
        std::string bytes;
        std::size_t sent = 0;
    };
    /// One end; `waiting` is what is to be written to it.
    struct Side {
        Descriptor socket;
        bool ended = false;     // it will send no more
        bool end_told = false;  // and the other was told so
        std::deque<Piece> waiting;
        std::size_t bytes = 0;
        std::uint32_t interest = 0;
    };
    struct Pair {
        Hop hop;
        bool spoilt = false;  // bytes of it were swallowed
        std::array<Side, 2> sides;
    };
    struct Listener {
        Descriptor socket;
        Hop hop;
        sockaddr_in target;
    };

    static std::size_t index(Hop hop) { return static_cast<std::size_t>(hop); }
    Mode mode(const Pair& pair) const { return mode_[index(pair.hop)]; }
    std::vector<Pair*> copyOf(Hop hop) const {
        std::vector<Pair*> found;
        for (auto* pair : pairs_)
            if (pair->hop == hop) found.push_back(pair);
        return found;
    }
    void watch(int fd, std::uint32_t events, int operation) const {
        epoll_event event{};
        event.events = events;
        event.data.fd = fd;
        ::epoll_ctl(poll_.get(), operation, fd, &event);
    }
    void wake() const {
        const std::uint64_t one = 1;
        [[maybe_unused]] const auto written = ::write(wake_.get(), &one, sizeof one);
    }

    void run() {
        std::array<epoll_event, 64> events;
        while (!ending_) {
            const int count =
                ::epoll_wait(poll_.get(), events.data(), static_cast<int>(events.size()), waitMs());
            const std::lock_guard lock(mutex_);
            for (int i = 0; i < count; ++i) {
                const int fd = events[static_cast<std::size_t>(i)].data.fd;
                if (fd == wake_.get()) {
                    std::uint64_t many = 0;
                    [[maybe_unused]] const auto got = ::read(wake_.get(), &many, sizeof many);
                } else if (const auto listener = listeners_.find(fd); listener != listeners_.end()) {
                    accept(fd, listener->second);
                } else if (const auto at = by_fd_.find(fd); at != by_fd_.end()) {
                    serve(*at->second, fd, events[static_cast<std::size_t>(i)].events);
                }
            }
            // What was delayed and is due now.
            const std::vector<Pair*> all(pairs_.begin(), pairs_.end());
            for (auto* pair : all)
                if (pairs_.contains(pair) &&
                    (!pair->sides[0].waiting.empty() || !pair->sides[1].waiting.empty()))
                    flush(*pair);
        }
    }

    int waitMs() const {
        const std::lock_guard lock(mutex_);
        auto first = Steady::time_point::max();
        for (const auto* pair : pairs_) {
            if (mode(*pair) != Mode::Pass) continue;
            for (const auto& side : pair->sides)
                if (!side.waiting.empty() && side.waiting.front().sent == 0)
                    first = std::min(first, side.waiting.front().due);
        }
        if (first == Steady::time_point::max()) return kForEver;
        const auto left = std::chrono::ceil<std::chrono::milliseconds>(first - Steady::now()).count();
        return static_cast<int>(std::clamp<std::int64_t>(left, 1, 1000));
    }

    void accept(int fd, const Listener& listener) {
        while (true) {
            sockaddr_in peer{};
            socklen_t size = sizeof peer;
            Descriptor from(
                ::accept4(fd, reinterpret_cast<sockaddr*>(&peer), &size, SOCK_NONBLOCK | SOCK_CLOEXEC));
            if (!from.open()) return;
            const auto diverted = diverted_.find(peer.sin_addr.s_addr);
            const auto hop = diverted != diverted_.end() ? diverted->second : listener.hop;
            Descriptor to(::socket(AF_INET, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
            const bool reached =
                to.open() && (::connect(to.get(), reinterpret_cast<const sockaddr*>(&listener.target),
                                        sizeof listener.target) == 0 ||
                              errno == EINPROGRESS);
            if (!reached) {
                closeWithReset(from);
                continue;
            }
            const int on = 1;
            for (const int one : {from.get(), to.get()})
                ::setsockopt(one, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
            auto* pair = new Pair{hop, mode_[index(hop)] == Mode::Cut, {}};
            pair->sides[0].socket = std::move(from);
            pair->sides[1].socket = std::move(to);
            pairs_.insert(pair);
            for (auto& side : pair->sides) {
                by_fd_[side.socket.get()] = pair;
                watch(side.socket.get(), 0, EPOLL_CTL_ADD);
            }
            refresh(*pair);
        }
    }

    void serve(Pair& pair, int fd, std::uint32_t events) {
        const std::size_t which = pair.sides[0].socket.get() == fd ? 0 : 1;
        auto& side = pair.sides[which];
        auto& other = pair.sides[1 - which];
        if (mode(pair) == Mode::Stall && !(events & (EPOLLERR | EPOLLHUP))) return;
        if (events & (EPOLLIN | EPOLLERR | EPOLLHUP)) {
            char bytes[65536];
            while (true) {
                const auto got = ::recv(fd, bytes, sizeof bytes, 0);
                if (got > 0) {
                    if (mode(pair) == Mode::Cut) continue;
                    queue(other, pair.hop, {bytes, static_cast<std::size_t>(got)});
                    other.bytes += static_cast<std::size_t>(got);
                    if (other.bytes > kWaitingMax) break;
                    continue;
                }
                if (got < 0 && (errno == EAGAIN || errno == EINTR)) break;
                if (mode(pair) == Mode::Cut || mode(pair) == Mode::Stall) {
                    // The other side must not notice: this end goes, that one stays.
                    pair.spoilt = true;
                    hide(side);
                    return;
                }
                if (got < 0) {
                    drop(&pair, true);
                    return;
                }
                side.ended = true;
                break;
            }
        }
        flush(pair);
    }

    std::size_t roll(std::size_t most) {
        return std::uniform_int_distribution<std::size_t>(0, most)(random_);
    }
    bool chance(double part) { return std::bernoulli_distribution(part)(random_); }

    /// In pieces, each of which is due at its own time; a piece waits for all before it.
    void queue(Side& to, Hop hop, std::string_view bytes) {
        const auto& how = impaired_[index(hop)];
        const auto now = Steady::now() + delay_[index(hop)];
        while (!bytes.empty()) {
            const auto size = how.piece == 0 ? bytes.size() : std::min(bytes.size(), 1 + roll(how.piece - 1));
            std::chrono::microseconds late{0};
            if (how.late.count() > 0)
                late = std::chrono::microseconds(roll(static_cast<std::size_t>(how.late.count()) * 1000));
            if (how.lost > 0 && chance(how.lost)) {
                const auto retry = static_cast<std::size_t>(how.retry.count()) * 500;
                auto wait = std::chrono::microseconds(retry + roll(retry));
                late += wait;
                while (chance(how.lost_again)) late += wait *= 2;
                if (how.most.count() > 0) late = std::min<std::chrono::microseconds>(late, how.most);
            }
            to.waiting.push_back({now + late, std::string(bytes.substr(0, size))});
            bytes.remove_prefix(size);
        }
    }

    void flush(Pair& pair) {
        if (mode(pair) != Mode::Pass) return;
        const auto now = Steady::now();
        for (std::size_t i = 0; i < 2; ++i) {
            auto& side = pair.sides[i];
            while (!side.waiting.empty() && side.socket.open()) {
                auto& piece = side.waiting.front();
                if (piece.due > now) break;
                const auto sent = ::send(side.socket.get(), piece.bytes.data() + piece.sent,
                                         piece.bytes.size() - piece.sent, MSG_NOSIGNAL);
                if (sent < 0 && (errno == EAGAIN || errno == EINTR || errno == ENOTCONN)) break;
                if (sent < 0) {
                    drop(&pair, true);
                    return;
                }
                piece.sent += static_cast<std::size_t>(sent);
                side.bytes -= static_cast<std::size_t>(sent);
                if (piece.sent == piece.bytes.size()) side.waiting.pop_front();
            }
            auto& source = pair.sides[1 - i];
            if (source.ended && side.waiting.empty() && !source.end_told && side.socket.open()) {
                source.end_told = true;
                ::shutdown(side.socket.get(), SHUT_WR);
            }
        }
        if (pair.sides[0].end_told && pair.sides[1].end_told) {
            drop(&pair, false);
            return;
        }
        refresh(pair);
    }

    /// What epoll is to tell of: level-triggered, so what nobody wants now must not be asked for.
    void refresh(Pair& pair) {
        for (std::size_t i = 0; i < 2; ++i) {
            auto& side = pair.sides[i];
            if (!side.socket.open()) continue;
            const bool reads =
                mode(pair) != Mode::Stall && !side.ended && pair.sides[1 - i].bytes <= kWaitingMax;
            const bool writes = mode(pair) == Mode::Pass && !side.waiting.empty() &&
                                side.waiting.front().due <= Steady::now();
            const std::uint32_t interest = (reads ? EPOLLIN : 0U) | (writes ? EPOLLOUT : 0U);
            if (std::exchange(side.interest, interest) != interest)
                watch(side.socket.get(), interest, EPOLL_CTL_MOD);
        }
    }

    void hide(Side& side) {
        by_fd_.erase(side.socket.get());
        side.socket.reset();
    }

    void drop(Pair* pair, bool with_reset) {
        for (auto& side : pair->sides) {
            if (!side.socket.open()) continue;
            by_fd_.erase(side.socket.get());
            if (with_reset) closeWithReset(side.socket);
        }
        pairs_.erase(pair);
        delete pair;
    }

    const Descriptor poll_;
    const Descriptor wake_;
    std::atomic<bool> ending_{false};
    mutable std::mutex mutex_;
    // Guarded by mutex_:
    std::map<int, Listener> listeners_;
    std::map<int, Pair*> by_fd_;
    std::set<Pair*> pairs_;
    std::map<in_addr_t, Hop> diverted_;
    std::array<Mode, kHops> mode_{};
    std::array<std::chrono::milliseconds, kHops> delay_{};
    std::array<Impairment, kHops> impaired_{};
    std::mt19937_64 random_;
    std::thread thread_;
};

Relay::Relay() : pump_(std::make_unique<Pump>()) {}
Relay::~Relay() = default;

std::uint16_t Relay::open(Hop hop, const std::string& address, std::uint16_t port, const std::string& target,
                          std::uint16_t target_port) {
    return pump_->open(hop, address, port, addressOf(target, target_port));
}
void Relay::divert(const std::string& source, Hop hop) {
    pump_->divert(source, hop);
}
void Relay::cut(Hop hop) {
    pump_->set(hop, Pump::Mode::Cut);
}
void Relay::stall(Hop hop) {
    pump_->set(hop, Pump::Mode::Stall);
}
void Relay::heal(Hop hop) {
    pump_->set(hop, Pump::Mode::Pass);
}
void Relay::reset(Hop hop) {
    pump_->reset(hop);
}
void Relay::delay(Hop hop, std::chrono::milliseconds by) {
    pump_->delay(hop, by);
}
void Relay::impair(Hop hop, Impairment how) {
    pump_->impair(hop, how);
}
std::size_t Relay::connections(Hop hop) const {
    return pump_->count(hop);
}

}  // namespace axon::faults
