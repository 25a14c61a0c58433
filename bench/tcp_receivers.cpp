// SPDX-License-Identifier: GPL-2.0-or-later
#include "tcp_receivers.hpp"

#include <sys/epoll.h>
#include <unistd.h>

#include <array>
#include <deque>
#include <vector>

namespace axon::bench {

namespace {

struct Receiver {
    tcp::Connection connection;
    tcp::Inbox inbox;
    Slot* slot = nullptr;
};

/// As much as is read at once: several of chapter 5's messages.
constexpr std::size_t kBuffer = 256 * 1024;

}  // namespace

int runTcpReceivers(const ReceiverProtocol& protocol, const std::string& board_file, std::size_t count,
                    std::uint16_t port) {
    Board board(board_file, count, false);
    const int epoll = ::epoll_create1(0);
    std::deque<Receiver> receivers;
    for (std::size_t i = 0; i < count; ++i) {
        auto& receiver = receivers.emplace_back(Receiver{tcp::Connection(port), {}, &board[i]});
        receiver.connection.write({protocol.hello(i)});
        epoll_event wish{};
        wish.events = EPOLLIN;
        wish.data.ptr = &receiver;
        ::epoll_ctl(epoll, EPOLL_CTL_ADD, receiver.connection.fd(), &wish);
    }
    const auto parent = ::getppid();
    std::array<epoll_event, 256> events{};
    std::vector<char> buffer(kBuffer);
    while (::getppid() == parent) {
        const int ready = ::epoll_wait(epoll, events.data(), events.size(), 500);
        for (int i = 0; i < ready; ++i) {
            auto& receiver = *static_cast<Receiver*>(events[static_cast<std::size_t>(i)].data.ptr);
            receiver.inbox.take(receiver.connection, buffer, [&](std::string_view received) {
                return protocol.consume(receiver.connection, received, nowNs(), *receiver.slot,
                                        [&board] { ++board.ready(); });
            });
        }
    }
    return 0;
}

}  // namespace axon::bench
