// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/connection_limits.hpp"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>

#include <algorithm>
#include <condition_variable>
#include <future>
#include <mutex>
#include <optional>
#include <vector>

#include "common/descriptor.hpp"
#include "support/loopback.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/ice/known_connections.hpp"

namespace axon::transport {
namespace {

using namespace std::chrono_literals;

/// Answers ice_ping.
class Pinged final : public Ice::Object {};

/// Real connections to a real adapter, which anybody who has a proxy's connection has a session over.
class ConnectionLimitsTest : public testing::Test {
  protected:
    void start(ConnectionBounds bounds) {
        adapter_ = listen(*server_.communicator(), "Gate", tcpEndpoint(test::loopbackAddress() + ":0"), 0,
                          Idle::Watched);
        adapter_->add(std::make_shared<Pinged>(), Ice::stringToIdentity("pinged"));
        adapter_->activate();
        const auto endpoint = publishedEndpoints(*adapter_).front();
        address_.sin_family = AF_INET;
        address_.sin_port = htons(endpoint.port);
        ASSERT_EQ(::inet_pton(AF_INET, endpoint.host.c_str(), &address_.sin_addr), 1);
        proxy_ = client_->stringToProxy("pinged:" + tcpEndpoint(addressOf(*adapter_)))
                     ->ice_invocationTimeout(5000);
        proxy_->ice_ping();
        const auto info =
            std::dynamic_pointer_cast<Ice::IPConnectionInfo>(proxy_->ice_getCachedConnection()->getInfo());
        const auto session = bothEnds(info->localAddress + ":" + std::to_string(info->localPort),
                                      info->remoteAddress + ":" + std::to_string(info->remotePort));
        limits_.emplace(
            clock_,
            [this](const std::string& line) {
                {
                    const std::lock_guard lock(mutex_);
                    notes_.push_back(line);
                }
                noted_.notify_all();
            },
            bounds);
        watch_ = limits_->watch(listenedEndpoints(*adapter_), {[session](const std::string& ends) {
                                    return ends == session ? ConnectionLimits::Peer::HasSession
                                                           : ConnectionLimits::Peer::Stranger;
                                }});
    }
    Descriptor connect() {
        Descriptor socket(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
        EXPECT_EQ(::connect(socket.get(), reinterpret_cast<const sockaddr*>(&address_), sizeof address_), 0);
        return socket;
    }
    /// Whether the other end closes it within the time.
    static bool ends(const Descriptor& socket, std::chrono::milliseconds within) {
        const auto until = std::chrono::steady_clock::now() + within;
        while (true) {
            const auto left = std::chrono::duration_cast<std::chrono::milliseconds>(
                until - std::chrono::steady_clock::now());
            pollfd waits{socket.get(), POLLIN, 0};
            if (left.count() <= 0 || ::poll(&waits, 1, static_cast<int>(left.count())) != 1) return false;
            char bytes[256];
            if (::recv(socket.get(), bytes, sizeof bytes, 0) <= 0) return true;  // Ice says something first
        }
    }
    /// Whether a line with this text comes; connections are closed before their lines are written.
    bool noted(const std::string& text) {
        std::unique_lock lock(mutex_);
        return noted_.wait_for(lock, 20s, [&] {
            return std::any_of(notes_.begin(), notes_.end(),
                               [&](const auto& line) { return line.find(text) != std::string::npos; });
        });
    }

    const SteadyClock clock_{};
    Ice::CommunicatorHolder server_ = makeCommunicator({.name = "server", .lane = Lane::Data});
    Ice::CommunicatorHolder client_ = makeCommunicator({.name = "client", .lane = Lane::Data});
    std::shared_ptr<Ice::ObjectAdapter> adapter_;
    std::shared_ptr<Ice::ObjectPrx> proxy_;
    sockaddr_in address_{};
    std::mutex mutex_;
    std::condition_variable noted_;
    std::vector<std::string> notes_;  // guarded by mutex_
    std::optional<ConnectionLimits> limits_;
    std::shared_ptr<void> watch_;
};

TEST_F(ConnectionLimitsTest, WhoIsSilentIsClosedAndWhoHasASessionIsNot) {
    start({.to_log_in = 100ms});
    const auto stranger = connect();
    EXPECT_TRUE(ends(stranger, 10s));
    EXPECT_NO_THROW(proxy_->ice_ping());
    EXPECT_TRUE(noted("closed: no session in"));
}

TEST_F(ConnectionLimitsTest, OfTooManyFromOneAddressSomeAreClosedAtOnce) {
    start({.strangers_of_one_address = 3, .to_log_in = 1h});
    std::vector<Descriptor> strangers;
    for (int i = 0; i < 5; ++i) strangers.push_back(connect());
    const auto left = [&] {
        return std::count_if(strangers.begin(), strangers.end(),
                             [](const auto& one) { return !ends(one, 20ms); });
    };
    const auto until = std::chrono::steady_clock::now() + 20s;
    while (left() > 3 && std::chrono::steady_clock::now() < until) ends(strangers.back(), 50ms);
    EXPECT_EQ(left(), 3);
    EXPECT_NO_THROW(proxy_->ice_ping());
    EXPECT_TRUE(noted("more than 3 of one address without a session"));
}

TEST_F(ConnectionLimitsTest, ASessionsConnectionIsClosedWhenNothingComesOverIt) {
    start({.silence = 50ms});
    const auto connection = proxy_->ice_getCachedConnection();
    std::promise<void> closed;
    connection->setCloseCallback([&](const std::shared_ptr<Ice::Connection>&) { closed.set_value(); });
    EXPECT_EQ(closed.get_future().wait_for(20s), std::future_status::ready);
    EXPECT_TRUE(noted("nothing has come over a session's connection"));
}

TEST_F(ConnectionLimitsTest, AProcessWithoutAFreeDescriptorGetsThoseOfStrangersBack) {
    start({.to_log_in = 100ms});
    std::vector<Descriptor> strangers;
    for (int i = 0; i < 3; ++i) strangers.push_back(connect());
    rlimit allowed{};
    ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &allowed), 0);
    const rlimit few{256, allowed.rlim_max};
    ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &few), 0);
    std::vector<Descriptor> rest;
    for (Descriptor one(::dup(0)); one.open(); one = Descriptor(::dup(0))) rest.push_back(std::move(one));
    EXPECT_LT(rest.size(), 256U) << "there is none left";
    for (const auto& stranger : strangers) EXPECT_TRUE(ends(stranger, 10s));
    rest.clear();
    ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &allowed), 0);
    EXPECT_NO_THROW(proxy_->ice_ping());
}

TEST_F(ConnectionLimitsTest, AtTheEndOfTheProcessNobodyWhoIsSilentIsWaitedFor) {
    start({});
    const auto stranger = connect();
    limits_->close();
    EXPECT_TRUE(ends(stranger, 10s));
}

TEST_F(ConnectionLimitsTest, WhatIsNotWatchedAnyMoreIsLeftAlone) {
    start({.to_log_in = 1ms});
    watch_.reset();
    const auto stranger = connect();
    EXPECT_FALSE(ends(stranger, 1500ms));
}

}  // namespace
}  // namespace axon::transport
