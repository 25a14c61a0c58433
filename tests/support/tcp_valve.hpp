// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/eventfd.h>
#include <sys/socket.h>
#include <unistd.h>

#include <atomic>
#include <cstdint>
#include <map>
#include <mutex>
#include <stdexcept>
#include <string>
#include <thread>
#include <utility>
#include <vector>

#include "common/descriptor.hpp"

namespace axon::test {

/// A relay between a test's peers, which cuts their connections, or falls silent, when it is told to.
///
/// Threads: one of its own; the rest any. Ownership: of its sockets. Failure: throws where there is no
/// socket.
class TcpValve {
  public:
    /// `target` is "a.b.c.d:port", and the valve is at the same address and another port.
    explicit TcpValve(const std::string& target) {
        const auto colon = target.rfind(':');
        host_ = target.substr(0, colon);
        target_.sin_family = AF_INET;
        target_.sin_port = htons(static_cast<std::uint16_t>(std::stoi(target.substr(colon + 1))));
        ::inet_pton(AF_INET, host_.c_str(), &target_.sin_addr);
        auto here = target_;
        here.sin_port = 0;
        if (::bind(listening_.get(), reinterpret_cast<const sockaddr*>(&here), sizeof here) != 0 ||
            ::listen(listening_.get(), 16) != 0)
            throw std::runtime_error("TcpValve: cannot listen at " + host_);
        relay_ = std::thread([this] { run(); });
    }
    ~TcpValve() {
        ending_ = true;
        wake();
        relay_.join();
    }
    TcpValve(const TcpValve&) = delete;
    TcpValve& operator=(const TcpValve&) = delete;

    std::string address() const {
        sockaddr_in here{};
        socklen_t size = sizeof here;
        ::getsockname(listening_.get(), reinterpret_cast<sockaddr*>(&here), &size);
        return host_ + ":" + std::to_string(ntohs(here.sin_port));
    }
    /// Resets every connection through it, and refuses new ones until open().
    void cut() {
        cut_ = true;
        wake();
    }
    void open() { cut_ = false; }
    /// Reads nothing, so that whoever sends meets full buffers, until it is told to go on.
    void hold(bool held) {
        held_ = held;
        wake();
    }
    /// That it has passed on.
    std::uint64_t bytes() const { return bytes_; }

  private:
    void wake() const {
        const std::uint64_t one = 1;
        static_cast<void>(::write(wake_.get(), &one, sizeof one) == sizeof one);
    }
    struct End {
        Descriptor socket;
        int other;
    };
    static void endWithReset(const Descriptor& socket) {
        const linger at_once{1, 0};
        ::setsockopt(socket.get(), SOL_SOCKET, SO_LINGER, &at_once, sizeof at_once);
    }
    void drop(int fd) {
        const auto found = peers_.find(fd);
        if (found == peers_.end()) return;
        for (const int end : {found->second.other, fd}) {
            endWithReset(peers_.at(end).socket);
            peers_.erase(end);
        }
    }
    void admit() {
        Descriptor near(::accept4(listening_.get(), nullptr, nullptr, SOCK_CLOEXEC));
        if (!near.open()) return;
        Descriptor far(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
        if (cut_ || ::connect(far.get(), reinterpret_cast<const sockaddr*>(&target_), sizeof target_) != 0)
            return endWithReset(near);
        const int yes = 1;
        const int fds[] = {near.get(), far.get()};
        for (const int fd : fds) ::setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
        peers_[fds[0]] = {std::move(near), fds[1]};
        peers_[fds[1]] = {std::move(far), fds[0]};
    }
    void relay(int from) {
        char bytes[65536];
        const auto found = peers_.find(from);
        if (found == peers_.end()) return;
        const auto count = ::recv(from, bytes, sizeof bytes, 0);
        if (count <= 0) return drop(from);
        bytes_ += static_cast<std::uint64_t>(count);
        for (ssize_t sent = 0; sent < count;) {
            const auto part = ::send(found->second.other, bytes + sent,
                                     static_cast<std::size_t>(count - sent), MSG_NOSIGNAL);
            if (part <= 0) return drop(from);
            sent += part;
        }
    }
    void run() {
        while (!ending_) {
            std::vector<pollfd> watched{{wake_.get(), POLLIN, 0}, {listening_.get(), POLLIN, 0}};
            if (!held_)
                for (const auto& [fd, end] : peers_) watched.push_back({fd, POLLIN, 0});
            if (::poll(watched.data(), watched.size(), -1) <= 0) continue;
            if (watched[0].revents != 0) {
                std::uint64_t count = 0;
                static_cast<void>(::read(wake_.get(), &count, sizeof count) == sizeof count);
                if (cut_) {
                    while (!peers_.empty()) drop(peers_.begin()->first);
                    continue;
                }
            }
            if (watched[1].revents != 0) admit();
            for (std::size_t i = 2; i < watched.size(); ++i) {
                if (watched[i].revents != 0) relay(watched[i].fd);
            }
        }
        while (!peers_.empty()) drop(peers_.begin()->first);
    }

    std::string host_;
    sockaddr_in target_{};
    const Descriptor listening_{::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)};
    const Descriptor wake_{::eventfd(0, EFD_CLOEXEC)};
    std::atomic<bool> cut_{false}, held_{false}, ending_{false};
    std::atomic<std::uint64_t> bytes_{0};
    std::map<int, End> peers_;  // by their descriptors; confined to relay_
    std::thread relay_;
};

}  // namespace axon::test
