// SPDX-License-Identifier: GPL-2.0-or-later
#include "host/socket_owner.hpp"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <cstdio>
#include <cstring>
#include <fstream>
#include <iterator>
#include <memory>
#include <utility>
#include <vector>

#include "common/descriptor.hpp"

namespace axon {
namespace {

constexpr const char* kHead =
    "  sl  local_address rem_address   st tx_queue rx_queue tr tm->when retrnsmt   uid  timeout inode\n";

std::string line(const std::string& local, const std::string& remote, const std::string& state,
                 const std::string& uid, const std::string& inode = "4711") {
    return "   0: " + local + " " + remote + " " + state + " 00000000:00000000 00:00000000 00000000 " + uid +
           "        0 " + inode + " 1 0000000000000000 20 4 30 10 -1\n";
}

// As a little-endian machine writes them, which all are that Axon is built for.
const std::string kPeer = "0100007F:C3CA";    // 127.0.0.1:50122
const std::string kServer = "0100007F:28AA";  // 127.0.0.1:10410
constexpr const char* kFrom = "127.0.0.1:50122";
constexpr const char* kTo = "127.0.0.1:10410";

TEST(SocketOwner, IsTheUidOfTheOtherEndNotOfOurs) {
    const auto table = kHead + line(kServer, "00000000:0000", "0A", "7") + line(kServer, kPeer, "01", "7") +
                       line(kPeer, kServer, "01", "1000");
    EXPECT_EQ(socketOwner(table, kFrom, kTo), 1000U);
}

TEST(SocketOwner, IsUnknownWhenTheConnectionIsNotEstablished) {
    // The kernel shows root for a socket that no process has any more.
    for (const char* state : {"06", "04", "08", "0A"})
        EXPECT_FALSE(socketOwner(kHead + line(kPeer, kServer, state, "0"), kFrom, kTo)) << state;
    EXPECT_FALSE(socketOwner(kHead + line(kPeer, kServer, "01", "0", "0"), kFrom, kTo));
}

TEST(SocketOwner, FindsAnIpv4PeerThatHasAnIpv6Socket) {
    const std::string mapped = "0000000000000000FFFF0000";
    const auto table = kHead + line(mapped + kPeer, mapped + kServer, "01", "1001");
    EXPECT_EQ(socketOwner(table, kFrom, kTo), 1001U);
}

TEST(SocketOwner, FindsAnIpv6Peer) {
    const std::string loopback = "00000000000000000000000001000000";
    const auto table = kHead + line(loopback + ":C3CA", loopback + ":28AA", "01", "1002");
    EXPECT_EQ(socketOwner(table, "::1:50122", "::1:10410"), 1002U);
}

TEST(SocketOwner, TakesAnyTextAndAnyAddress) {
    const auto good = line(kPeer, kServer, "01", "1000");
    EXPECT_FALSE(socketOwner("", kFrom, kTo));
    EXPECT_FALSE(socketOwner(kHead, kFrom, kTo));
    EXPECT_FALSE(socketOwner(good.substr(0, 40), kFrom, kTo));
    EXPECT_FALSE(socketOwner(line(kPeer, kServer, "01", "99999999999999"), kFrom, kTo));
    EXPECT_FALSE(socketOwner(line(kPeer, kServer, "01", "-1"), kFrom, kTo));
    EXPECT_FALSE(socketOwner(std::string(1000, '\0') + "\n\n\xff", kFrom, kTo));
    for (const char* from :
         {"", ":", "127.0.0.1", "127.0.0.1:", "127.0.0.1:99999", "localhost:50122", "an unknown address"})
        EXPECT_FALSE(socketOwner(good, from, kTo)) << from;
    EXPECT_EQ(socketOwner(good.substr(0, good.size() - 1), kFrom, kTo), 1000U);
}

/// A connection of this process with itself over loopback; the peer's socket may be one of IPv6 that speaks
/// IPv4.
class Connection {
  public:
    enum class Kind { V4, V6, V4ByV6 };
    explicit Connection(Kind kind) {
        listener_ = Descriptor(::socket(kind == Kind::V6 ? AF_INET6 : AF_INET, SOCK_STREAM, 0));
        peer_ = Descriptor(::socket(kind == Kind::V4 ? AF_INET : AF_INET6, SOCK_STREAM, 0));
        sockaddr_storage address{};
        socklen_t size = 0;
        if (kind == Kind::V6) {
            auto& six = reinterpret_cast<sockaddr_in6&>(address);
            six.sin6_family = AF_INET6;
            six.sin6_addr = in6addr_loopback;
            size = sizeof six;
        } else {
            auto& four = reinterpret_cast<sockaddr_in&>(address);
            four.sin_family = AF_INET;
            four.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
            size = sizeof four;
        }
        usable = ::bind(listener_.get(), reinterpret_cast<sockaddr*>(&address), size) == 0 &&
                 ::listen(listener_.get(), 1) == 0 &&
                 ::getsockname(listener_.get(), reinterpret_cast<sockaddr*>(&address), &size) == 0;
        if (kind == Kind::V4ByV6) {
            const auto port = reinterpret_cast<sockaddr_in&>(address).sin_port;
            auto& six = reinterpret_cast<sockaddr_in6&>(address);
            six = {};
            six.sin6_family = AF_INET6;
            six.sin6_port = port;
            ::inet_pton(AF_INET6, "::ffff:127.0.0.1", &six.sin6_addr);
            size = sizeof six;
        }
        usable = usable && ::connect(peer_.get(), reinterpret_cast<sockaddr*>(&address), size) == 0;
        if (!usable) return;
        server_ = Descriptor(::accept(listener_.get(), nullptr, nullptr));
        from = nameOf(server_.get(), true);
        to = nameOf(server_.get(), false);
    }
    bool accepted() const { return server_.open(); }
    void closePeer() { peer_.reset(); }

    bool usable = false;
    std::string from, to;  // as the server sees them

  private:
    static std::string nameOf(int fd, bool of_peer) {
        sockaddr_storage address{};
        socklen_t size = sizeof address;
        (of_peer ? ::getpeername : ::getsockname)(fd, reinterpret_cast<sockaddr*>(&address), &size);
        std::array<char, 64> text{};
        const auto& four = reinterpret_cast<const sockaddr_in&>(address);
        const auto& six = reinterpret_cast<const sockaddr_in6&>(address);
        const bool is_six = address.ss_family == AF_INET6;
        ::inet_ntop(address.ss_family, is_six ? static_cast<const void*>(&six.sin6_addr) : &four.sin_addr,
                    text.data(), text.size());
        return std::string(text.data()) + ":" + std::to_string(ntohs(is_six ? six.sin6_port : four.sin_port));
    }
    Descriptor listener_, peer_, server_;
};

std::string tables() {
    std::string all;
    for (const char* file : {"/proc/net/tcp", "/proc/net/tcp6"}) {
        std::ifstream stream(file);
        all.append(std::istreambuf_iterator<char>(stream), {});
    }
    return all;
}

TEST(SocketOwner, OfARealConnectionIsTheSameByNetlinkAndByTheTable) {
    for (const auto kind : {Connection::Kind::V4, Connection::Kind::V6, Connection::Kind::V4ByV6}) {
        Connection connection(kind);
        if (!connection.usable && kind != Connection::Kind::V4) continue;  // a machine without IPv6
        ASSERT_TRUE(connection.usable);
        EXPECT_EQ(socketOwner(connection.from, connection.to), ::geteuid()) << connection.from;
        EXPECT_EQ(socketOwner(tables(), connection.from, connection.to), ::geteuid());
        if (const auto answer = askKernel(connection.from, connection.to); answer.heard)
            EXPECT_EQ(answer.uid, ::geteuid());
        // Its ends the other way round are another connection, which is there too; the listener is none.
        EXPECT_EQ(socketOwner(connection.to, connection.from), ::geteuid());
        EXPECT_FALSE(
            socketOwner(connection.to, connection.from.substr(0, connection.from.rfind(':')) + ":1"));
    }
}

TEST(SocketOwner, OfARealConnectionIsUnknownAsSoonAsItsPeerHasClosedIt) {
    Connection connection(Connection::Kind::V4);
    ASSERT_TRUE(connection.usable);
    connection.closePeer();
    EXPECT_FALSE(socketOwner(connection.from, connection.to));
    EXPECT_FALSE(socketOwner("127.0.0.1:1", connection.to));
    EXPECT_FALSE(socketOwner("10.99.99.99:50122", "10.99.99.98:10410")) << "another machine's";
}

TEST(SocketOwner, IsFoundAsFastAmongThousandsOfSockets) {
    Connection connection(Connection::Kind::V4);
    ASSERT_TRUE(connection.usable);
    if (!askKernel(connection.from, connection.to).heard) GTEST_SKIP() << "netlink is not permitted here";
    rlimit files{};
    ::getrlimit(RLIMIT_NOFILE, &files);
    files.rlim_cur = files.rlim_max;
    ::setrlimit(RLIMIT_NOFILE, &files);
    std::vector<std::unique_ptr<Connection>> others;
    while (others.size() < 2000) {
        auto other = std::make_unique<Connection>(Connection::Kind::V4);
        if (!other->usable || !other->accepted()) break;
        others.push_back(std::move(other));
    }
    const auto timeOf = [](const auto& look) {
        auto best = std::chrono::nanoseconds::max();
        for (int i = 0; i < 5; ++i) {
            const auto begun = std::chrono::steady_clock::now();
            EXPECT_TRUE(look());
            best = std::min<std::chrono::nanoseconds>(best, std::chrono::steady_clock::now() - begun);
        }
        return best;
    };
    const auto by_netlink = timeOf([&] { return socketOwner(connection.from, connection.to).has_value(); });
    const auto by_table =
        timeOf([&] { return socketOwner(tables(), connection.from, connection.to).has_value(); });
    RecordProperty("sockets", static_cast<int>(3 * others.size() + 3));
    RecordProperty("netlink_us", static_cast<int>(by_netlink.count() / 1000));
    RecordProperty("table_us", static_cast<int>(by_table.count() / 1000));
    std::printf("%zu sockets: %.0f us by netlink, %.0f us by the table\n", 3 * others.size() + 3,
                static_cast<double>(by_netlink.count()) / 1e3, static_cast<double>(by_table.count()) / 1e3);
    if (others.size() >= 1000) EXPECT_LT(by_netlink * 5, by_table);
}

}  // namespace
}  // namespace axon
