// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/lane_socket.hpp"

#include <gtest/gtest.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <sys/socket.h>
#include <sys/utsname.h>
#include <unistd.h>

#include <future>
#include <vector>

#include "common/descriptor.hpp"
#include "datagrams/signal_socket.hpp"
#include "support/loopback.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/communicator.hpp"

namespace axon::transport {
namespace {

/// Answers ice_ping, and shows the connection that it came over.
class Shown final : public Ice::Object {
  public:
    void ice_ping(const Ice::Current& current) const override { connection.set_value(current.con); }
    mutable std::promise<std::shared_ptr<Ice::Connection>> connection;
};

/// A real connection of Ice, seen from both ends.
class LaneSocketTest : public ::testing::Test {
  protected:
    void SetUp() override {
        server_ = makeCommunicator({.name = "server", .lane = Lane::Data});
        client_ = makeCommunicator({.name = "client", .lane = Lane::Data});
        adapter_ = listen(*server_.communicator(), "Gate", tcpEndpoint(test::loopbackAddress() + ":0"));
        const auto shown = std::make_shared<Shown>();
        adapter_->add(shown, Ice::stringToIdentity("shown"));
        adapter_->activate();
        const auto proxy =
            client_->stringToProxy("shown:" + tcpEndpoint(addressOf(*adapter_)))->ice_invocationTimeout(5000);
        proxy->ice_ping();
        near_ = proxy->ice_getCachedConnection();
        far_ = shown->connection.get_future().get();
    }
    static int option(int fd, int level, int number) {
        int value = -1;
        socklen_t size = sizeof value;
        EXPECT_EQ(::getsockopt(fd, level, number, &value, &size), 0) << level << ' ' << number;
        return value;
    }

    Ice::CommunicatorHolder server_, client_;
    std::shared_ptr<Ice::ObjectAdapter> adapter_;
    std::shared_ptr<Ice::Connection> near_, far_;
};

TEST_F(LaneSocketTest, BothEndsOfAConnectionAreFoundAndNotTakenForEachOther) {
    const int near = socketOf(*near_), far = socketOf(*far_);
    ASSERT_GE(near, 0);
    ASSERT_GE(far, 0);
    EXPECT_NE(near, far);
    sockaddr_in peer{};
    socklen_t size = sizeof peer;
    ASSERT_EQ(::getpeername(near, reinterpret_cast<sockaddr*>(&peer), &size), 0);
    EXPECT_EQ(ntohs(peer.sin_port), publishedEndpoints(*adapter_).front().port);
}

TEST_F(LaneSocketTest, AConnectionIsFoundBehindAHundredYoungerDescriptors) {
    std::vector<Descriptor> younger;
    for (int i = 0; i < 100; ++i) younger.emplace_back(::socket(AF_INET, SOCK_STREAM, 0));
    EXPECT_GE(socketOf(*near_), 0);
    EXPECT_GE(socketOf(*far_), 0);
}

TEST_F(LaneSocketTest, OptionsOfTheSignalLaneAreSetOnBothEnds) {
    for (const auto& connection : {near_, far_}) {
        ASSERT_TRUE(prepareSignalLane(*connection));
        const int fd = socketOf(*connection);
        EXPECT_EQ(option(fd, IPPROTO_TCP, TCP_NODELAY), 1);
        EXPECT_EQ(option(fd, IPPROTO_TCP, TCP_USER_TIMEOUT), 10'000);
        EXPECT_EQ(option(fd, IPPROTO_IP, IP_TOS), 46 << 2);
        EXPECT_EQ(option(fd, SOL_SOCKET, SO_PRIORITY), 6);
        const auto missing = datagrams::prepareSignalSocket(fd);
        const bool has_minimum = std::find(missing.begin(), missing.end(), "TCP_RTO_MIN_US") == missing.end();
        EXPECT_TRUE(!has_minimum || option(fd, IPPROTO_TCP, 45) <= 20'000)
            << "rounded up to the kernel's ticks";
    }
}

TEST_F(LaneSocketTest, AClosedConnectionHasNoSocketAndHurtsNobody) {
    near_->close(Ice::ConnectionClose::Forcefully);
    EXPECT_EQ(socketOf(*near_), -1);
    EXPECT_FALSE(prepareSignalLane(*near_));
}

}  // namespace
}  // namespace axon::transport
