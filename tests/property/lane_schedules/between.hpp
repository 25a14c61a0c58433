// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdint>
#include <deque>
#include <functional>
#include <list>
#include <memory>
#include <mutex>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>

#include "common/descriptor.hpp"
#include "common/routed.hpp"
#include "direct/incoming_way.hpp"
#include "lane_schedules/book.hpp"

namespace axon::schedules {

/// The two servers between a client and an Entity Manager: a queue for each direction, in order, which is
/// lost together with the session of the client. Threads: any.
class Relay {
  public:
    struct Item {
        Keeping keeping = Keeping::Kept;
        Header head;
        std::string bytes;
    };
    /// The client has a session, under this name.
    void join(std::string client) {
        const std::lock_guard lock(mutex_);
        client_ = std::move(client);
    }
    void lose() {
        const std::lock_guard lock(mutex_);
        client_.clear();
        to_manager_.clear();
        to_client_.clear();
    }
    /// `client`: whose session sends. A server fills in who sends.
    void fromClient(const std::string& client, Item item) {
        const std::lock_guard lock(mutex_);
        if (client != client_) return;
        item.head.sender = {client, "a client", Role::Operator};
        to_manager_.push_back(std::move(item));
    }
    void fromManager(Item item) {
        const std::lock_guard lock(mutex_);
        if (item.head.sender.id == client_ && !client_.empty()) to_client_.push_back(std::move(item));
    }
    std::optional<Item> nextToManager() { return next(to_manager_); }
    std::optional<Item> nextToClient() { return next(to_client_); }
    /// It found no room, and comes again.
    void backToManager(Item item) {
        const std::lock_guard lock(mutex_);
        if (item.head.sender.id == client_) to_manager_.push_front(std::move(item));
    }
    bool empty() const {
        const std::lock_guard lock(mutex_);
        return to_manager_.empty() && to_client_.empty();
    }

  private:
    std::optional<Item> next(std::deque<Item>& from) {
        const std::lock_guard lock(mutex_);
        if (from.empty()) return std::nullopt;
        Item item = std::move(from.front());
        from.pop_front();
        return item;
    }

    mutable std::mutex mutex_;
    std::string client_;  // empty: there is no session
    std::deque<Item> to_manager_, to_client_;
};

/// The signal lanes of all paths: beats, acknowledgements, openings and ends, each direction in order and as
/// late as the driver likes. Threads: any; what is delivered runs on the driver's.
class Signals {
  public:
    using Deliver = std::function<void()>;
    void toManager(Deliver deliver) { put(to_manager_, std::move(deliver)); }
    void toClient(Deliver deliver) { put(to_client_, std::move(deliver)); }
    bool deliverToManager() { return deliverOne(to_manager_); }
    bool deliverToClient() { return deliverOne(to_client_); }
    void clear() {
        std::deque<Deliver> left;
        const std::lock_guard lock(mutex_);
        left.swap(to_manager_);
        for (auto& one : to_client_) left.push_back(std::move(one));
        to_client_.clear();
    }

  private:
    void put(std::deque<Deliver>& queue, Deliver deliver) {
        const std::lock_guard lock(mutex_);
        queue.push_back(std::move(deliver));
    }
    bool deliverOne(std::deque<Deliver>& queue) {
        Deliver deliver;
        {
            const std::lock_guard lock(mutex_);
            if (queue.empty()) return false;
            deliver = std::move(queue.front());
            queue.pop_front();
        }
        deliver();
        return true;
    }

    std::mutex mutex_;
    std::deque<Deliver> to_manager_, to_client_;
};

/// What happens to a connection.
enum class Break : std::uint8_t {
    ResetBoth,
    ResetClient,   ///< the Entity Manager's end hears nothing of it
    ResetManager,  ///< the client's end hears nothing of it
    CloseBoth,
    HalfToClient,  ///< no more comes to the client, and it is told so
    HalfToManager,
    Count
};

/// In the middle of the data lanes' connections: passes on as many bytes as the driver says, so that a frame
/// arrives in pieces, and breaks a connection at any byte. Threads: the driver's.
class Cable {
  public:
    /// `target` is "a.b.c.d:port"; `window`: what its sockets take before somebody reads, 0 for the kernel's
    /// choice.
    Cable(const std::string& target, int window) : window_(window) {
        const auto colon = target.rfind(':');
        host_ = target.substr(0, colon);
        target_.sin_family = AF_INET;
        target_.sin_port = htons(static_cast<std::uint16_t>(std::stoi(target.substr(colon + 1))));
        ::inet_pton(AF_INET, host_.c_str(), &target_.sin_addr);
        auto here = target_;
        here.sin_port = 0;
        narrow(listening_.get());
        if (::bind(listening_.get(), reinterpret_cast<const sockaddr*>(&here), sizeof here) != 0 ||
            ::listen(listening_.get(), 16) != 0)
            throw std::runtime_error("Cable: cannot listen at " + host_);
    }
    std::string address() const {
        sockaddr_in here{};
        socklen_t size = sizeof here;
        ::getsockname(listening_.get(), reinterpret_cast<sockaddr*>(&here), &size);
        return host_ + ":" + std::to_string(ntohs(here.sin_port));
    }

    /// Passes on at most so many bytes in each direction that is not paused. Whether anything happened.
    bool pump(std::size_t most) {
        bool some = admit();
        for (auto at = connections_.begin(); at != connections_.end();) {
            auto& one = *at;
            if (!to_manager_paused && pass(one, one.client, one.manager, one.to_manager, most)) some = true;
            if (!to_client_paused && pass(one, one.manager, one.client, one.to_client, most)) some = true;
            at = one.over ? connections_.erase(at) : std::next(at);
        }
        return some;
    }
    void breakAll(Break what) {
        for (auto& one : connections_) breakOne(one, what);
        connections_.remove_if([](const Connection& one) { return one.over; });
    }
    /// When so many more bytes have been passed on towards one of the ends.
    void breakAfter(std::size_t bytes, bool to_manager, Break what) {
        for (auto& one : connections_) (to_manager ? one.to_manager : one.to_client).due = {bytes, what};
    }
    bool to_manager_paused = false, to_client_paused = false;
    int broken_inside = 0;  ///< by breakAfter()

  private:
    struct Due {
        std::size_t bytes;
        Break what;
    };
    struct Way {
        std::string pending;
        std::optional<Due> due;
        bool ended = false;
    };
    struct Connection {
        Descriptor client, manager;
        Way to_client, to_manager;
        bool over = false;
    };

    void narrow(int socket) const {
        if (window_ == 0) return;
        ::setsockopt(socket, SOL_SOCKET, SO_RCVBUF, &window_, sizeof window_);
        ::setsockopt(socket, SOL_SOCKET, SO_SNDBUF, &window_, sizeof window_);
    }
    bool admit() {
        Descriptor near(::accept4(listening_.get(), nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK));
        if (!near.open()) return false;
        Descriptor far(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
        narrow(far.get());
        if (::connect(far.get(), reinterpret_cast<const sockaddr*>(&target_), sizeof target_) == 0)
            connections_.push_back({std::move(near), std::move(far), {}, {}});
        return true;
    }
    static void reset(Descriptor& socket) {
        const linger at_once{1, 0};
        ::setsockopt(socket.get(), SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
        socket.reset();
    }
    static void breakOne(Connection& one, Break what) {
        switch (what) {
            case Break::ResetBoth:
                reset(one.client);
                reset(one.manager);
                break;
            case Break::ResetClient:
                reset(one.client);
                break;
            case Break::ResetManager:
                reset(one.manager);
                break;
            case Break::HalfToClient:
                ::shutdown(one.client.get(), SHUT_WR);
                one.to_client.ended = true;
                break;
            case Break::HalfToManager:
                ::shutdown(one.manager.get(), SHUT_WR);
                one.to_manager.ended = true;
                break;
            case Break::CloseBoth:
            case Break::Count:
                one.client.reset();
                one.manager.reset();
                break;
        }
        one.over = !one.client.open() && !one.manager.open();
    }
    bool pass(Connection& one, Descriptor& from, Descriptor& to, Way& way, std::size_t most) {
        if (one.over) return false;
        bool some = false;
        static thread_local std::array<char, 65536> bytes;
        while (most > 0 && from.open() && !one.over) {
            if (way.pending.empty()) {
                const auto count =
                    ::recv(from.get(), bytes.data(), std::min(most, bytes.size()), MSG_DONTWAIT);
                if (count < 0 && (errno == EAGAIN || errno == EINTR)) break;
                if (count < 0) {  // as the network would
                    breakOne(one, Break::ResetBoth);
                    return true;
                }
                if (count == 0) {
                    from.reset();
                    if (to.open()) to.reset();  // an end closes, or has said all that it will
                    one.over = true;
                    return true;
                }
                some = true;
                if (!to.open() || way.ended) continue;  // into nothing
                way.pending.assign(bytes.data(), static_cast<std::size_t>(count));
            }
            auto size = std::min(way.pending.size(), most);
            if (way.due) size = std::min(size, way.due->bytes);
            const auto sent =
                size == 0 ? 0 : ::send(to.get(), way.pending.data(), size, MSG_NOSIGNAL | MSG_DONTWAIT);
            if (sent < 0 && (errno == EAGAIN || errno == EINTR)) break;
            if (sent < 0) {
                breakOne(one, Break::ResetBoth);
                return true;
            }
            some = some || sent > 0;
            most -= static_cast<std::size_t>(sent);
            way.pending.erase(0, static_cast<std::size_t>(sent));
            if (way.due && (way.due->bytes -= static_cast<std::size_t>(sent)) == 0) {
                ++broken_inside;
                const auto what = way.due->what;
                way.due.reset();
                breakOne(one, what);
                if (way.ended || !to.open()) way.pending.clear();  // it may be the other way that breaks
                return true;
            }
        }
        return some;
    }

    const int window_;
    std::string host_;
    sockaddr_in target_{};
    const Descriptor listening_{::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0)};
    std::list<Connection> connections_;
};

}  // namespace axon::schedules
