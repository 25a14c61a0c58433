// SPDX-License-Identifier: GPL-2.0-or-later
#include "direct/lane/lane_socket.hpp"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>

#include <array>

namespace axon::direct::lane {
namespace {

using End = LaneSocket::Read::End;

/// Somebody who listens on loopback, and whether the other end is there.
struct Listener {
    Listener() {
        address.sin_family = AF_INET;
        address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
        socklen_t size = sizeof address;
        EXPECT_EQ(::bind(socket.get(), reinterpret_cast<const sockaddr*>(&address), size), 0);
        EXPECT_EQ(::listen(socket.get(), 1), 0);
        ::getsockname(socket.get(), reinterpret_cast<sockaddr*>(&address), &size);
    }
    std::string endpoint() const { return "127.0.0.1:" + std::to_string(ntohs(address.sin_port)); }
    Descriptor socket{::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)};
    sockaddr_in address{};
};

/// Why the connection could not be made; 0 when it was.
int failureOf(const LaneSocket& lane) {
    int error = 0;
    socklen_t size = sizeof error;
    ::getsockopt(lane.descriptor(), SOL_SOCKET, SO_ERROR, &error, &size);
    return error;
}

std::string peerOf(const LaneSocket& lane) {
    sockaddr_in address{};
    socklen_t size = sizeof address;
    ::getpeername(lane.descriptor(), reinterpret_cast<sockaddr*>(&address), &size);
    std::array<char, INET_ADDRSTRLEN> host{};
    ::inet_ntop(AF_INET, &address.sin_addr, host.data(), host.size());
    return std::string(host.data()) + ":" + std::to_string(ntohs(address.sin_port));
}

bool ready(int fd, short what) {
    pollfd one{fd, what, 0};
    return ::poll(&one, 1, 5000) == 1;
}

TEST(LaneSocketTest, ConnectsWithoutWaitingAndSaysWhatCameOfIt) {
    Listener listener;
    auto made = LaneSocket::connectTo(listener.endpoint());
    ASSERT_TRUE(made.ok()) << made.refusal().message;
    LaneSocket here(std::move(made).value());
    ASSERT_TRUE(ready(here.descriptor(), POLLOUT));
    EXPECT_EQ(failureOf(here), 0);
    EXPECT_EQ(peerOf(here), listener.endpoint());

    LaneSocket there(Descriptor(::accept(listener.socket.get(), nullptr, nullptr)));
    const std::array<std::string_view, 3> pieces{"ab", "", "cd"};
    EXPECT_EQ(here.write(pieces), 4U);
    ASSERT_TRUE(ready(there.descriptor(), POLLIN));
    std::array<char, 4> bytes{};
    const auto exact = there.read(bytes);
    EXPECT_EQ(exact.bytes, 4U);
    EXPECT_TRUE(exact.more) << "it may be";
    EXPECT_EQ(std::string(bytes.data(), 4), "abcd");
    const auto none = there.read(bytes);
    EXPECT_TRUE(none.bytes == 0 && !none.more && none.end == End::No);
    here.shut();
    ASSERT_TRUE(ready(there.descriptor(), POLLIN));
    EXPECT_EQ(there.read(bytes).end, End::Closed);
    EXPECT_FALSE(here.write(pieces).has_value());
}

int optionOf(const LaneSocket& lane, int level, int option) {
    int value = -1;
    socklen_t size = sizeof value;
    ::getsockopt(lane.descriptor(), level, option, &value, &size);
    return value;
}

// What the reference promises of a lane whose signal lane lives on; that such an end of the connection ends
// the path is the lane's to test.
TEST(LaneSocketTest, TheKernelGivesUpALaneThatIsSilentForHalfAMinute) {
    Listener listener;
    LaneSocket here(LaneSocket::connectTo(listener.endpoint()).value());
    EXPECT_EQ(optionOf(here, IPPROTO_TCP, TCP_NODELAY), 1);
    EXPECT_EQ(optionOf(here, IPPROTO_TCP, TCP_USER_TIMEOUT), 30'000) << "bytes that are not taken";
    EXPECT_EQ(optionOf(here, SOL_SOCKET, SO_KEEPALIVE), 1);
    EXPECT_EQ(optionOf(here, IPPROTO_TCP, TCP_KEEPIDLE) +
                  optionOf(here, IPPROTO_TCP, TCP_KEEPINTVL) * optionOf(here, IPPROTO_TCP, TCP_KEEPCNT),
              30)
        << "an idle lane";
}

TEST(LaneSocketTest, AFullConnectionTakesNothingAndDoesNotWait) {
    Listener listener;
    LaneSocket here(LaneSocket::connectTo(listener.endpoint()).value());
    ASSERT_TRUE(ready(here.descriptor(), POLLOUT));
    const std::string much(1'000'000, 'x');
    const std::array<std::string_view, 1> pieces{much};
    std::size_t all = 0;
    for (auto taken = here.write(pieces); taken && *taken > 0; taken = here.write(pieces)) all += *taken;
    EXPECT_GT(all, 0U);
    EXPECT_EQ(here.write(pieces), 0U);
}

TEST(LaneSocketTest, WhoDoesNotListenAndWhatIsNoAddressIsSaid) {
    std::string endpoint;
    {
        Listener listener;
        endpoint = listener.endpoint();
    }
    if (auto made = LaneSocket::connectTo(endpoint)) {
        LaneSocket here(std::move(made).value());
        ASSERT_TRUE(ready(here.descriptor(), POLLOUT));
        EXPECT_NE(failureOf(here), 0);
    }
    for (const auto* wrong : {"", ":", "1234", "127.0.0.1", "127.0.0.1:", ":80", "host.example:80",
                              "127.0.0.1:http", "127.0.0.1:99999999"}) {
        const auto made = LaneSocket::connectTo(wrong);
        EXPECT_FALSE(made.ok()) << wrong;
    }
}

}  // namespace
}  // namespace axon::direct::lane
