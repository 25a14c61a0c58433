// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/socket_owner.hpp"

#include <gtest/gtest.h>

namespace axon::server {
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

}  // namespace
}  // namespace axon::server
