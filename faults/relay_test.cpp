// SPDX-License-Identifier: GPL-2.0-or-later
#include "relay.hpp"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

#include "common/descriptor.hpp"
#include "support/loopback.hpp"

namespace axon::faults {
namespace {

using namespace std::chrono_literals;

sockaddr_in at(std::uint16_t port) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(port);
    ::inet_pton(AF_INET, test::loopbackAddress().c_str(), &address.sin_addr);
    return address;
}

bool readable(int fd, std::chrono::milliseconds time) {
    pollfd wait{fd, POLLIN, 0};
    return ::poll(&wait, 1, static_cast<int>(time.count())) == 1;
}

/// What arrives within the time: bytes, "" for the orderly end, "reset", "nothing".
std::string heard(int fd, std::chrono::milliseconds time = 2000ms) {
    if (!readable(fd, time)) return "nothing";
    char bytes[64];
    const auto got = ::recv(fd, bytes, sizeof bytes, 0);
    if (got < 0) return errno == ECONNRESET ? "reset" : "error";
    return {bytes, static_cast<std::size_t>(got)};
}

class RelayTest : public ::testing::Test {
  protected:
    RelayTest() : listener(::socket(AF_INET, SOCK_STREAM, 0)) {
        auto address = at(0);
        ::bind(listener.get(), reinterpret_cast<sockaddr*>(&address), sizeof address);
        ::listen(listener.get(), 8);
        socklen_t size = sizeof address;
        ::getsockname(listener.get(), reinterpret_cast<sockaddr*>(&address), &size);
        port = relay.open(Hop::Link, test::loopbackAddress(), 0, test::loopbackAddress(),
                          ntohs(address.sin_port));
    }
    Descriptor connect() const {
        Descriptor near(::socket(AF_INET, SOCK_STREAM, 0));
        const auto address = at(port);
        EXPECT_EQ(::connect(near.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
        return near;
    }
    Descriptor accept() const {
        EXPECT_TRUE(readable(listener.get(), 2000ms));
        return Descriptor(::accept(listener.get(), nullptr, nullptr));
    }
    static void say(const Descriptor& from, const std::string& words) {
        EXPECT_EQ(::send(from.get(), words.data(), words.size(), MSG_NOSIGNAL),
                  static_cast<ssize_t>(words.size()));
    }

    Descriptor listener;
    Relay relay;
    std::uint16_t port = 0;
};

TEST_F(RelayTest, PassesBothWaysAndPassesTheEndOn) {
    auto near = connect();
    const auto far = accept();
    say(near, "there");
    EXPECT_EQ(heard(far.get()), "there");
    say(far, "back");
    EXPECT_EQ(heard(near.get()), "back");
    say(near, "last words");
    ::shutdown(near.get(), SHUT_WR);
    EXPECT_EQ(heard(far.get()), "last words");
    EXPECT_EQ(heard(far.get()), "");
    say(far, "still heard");
    EXPECT_EQ(heard(near.get()), "still heard");
}

TEST_F(RelayTest, ACutSwallowsBytesAndHidesTheEnd) {
    auto near = connect();
    const auto far = accept();
    say(near, "before");
    EXPECT_EQ(heard(far.get()), "before");
    relay.cut(Hop::Link);
    say(near, "lost");
    EXPECT_EQ(heard(far.get(), 100ms), "nothing");
    near.reset();
    EXPECT_EQ(heard(far.get(), 100ms), "nothing") << "neither FIN nor RST";
    relay.heal(Hop::Link);
    EXPECT_EQ(heard(far.get()), "reset") << "what lost bytes does not go on";
    const auto again = connect();
    const auto there = accept();
    say(again, "healed");
    EXPECT_EQ(heard(there.get()), "healed");
}

TEST_F(RelayTest, AConnectionThatBeginsInACutHearsNothing) {
    relay.cut(Hop::Link);
    const auto near = connect();
    say(near, "hello");
    EXPECT_EQ(heard(near.get(), 100ms), "nothing");
}

TEST_F(RelayTest, AStallLosesNothing) {
    const auto near = connect();
    const auto far = accept();
    relay.stall(Hop::Link);
    say(near, "late");
    EXPECT_EQ(heard(far.get(), 100ms), "nothing");
    relay.heal(Hop::Link);
    EXPECT_EQ(heard(far.get()), "late");
}

TEST_F(RelayTest, ADelayIsAtLeastSoLongAndKeepsTheOrder) {
    const auto near = connect();
    const auto far = accept();
    relay.delay(Hop::Link, 60ms);
    const auto begin = std::chrono::steady_clock::now();
    say(near, "a");
    ASSERT_EQ(heard(far.get()), "a");
    EXPECT_GE(std::chrono::steady_clock::now() - begin, 60ms);
    say(near, "b");
    relay.delay(Hop::Link, 0ms);
    say(near, "c");
    std::string both;
    while (both.size() < 2) both += heard(far.get());
    EXPECT_EQ(both, "bc");
}

/// All that arrives until nothing has for a while, or so many bytes have.
std::string all(int fd, std::size_t bytes) {
    std::string got;
    while (got.size() < bytes) {
        const auto more = heard(fd);
        if (more.empty() || more == "nothing") break;
        got += more;
    }
    return got;
}

TEST_F(RelayTest, ALostPieceIsRepeatedAndEverythingBehindItWaits) {
    const auto near = connect();
    const auto far = accept();
    Impairment lossy;
    lossy.lost = 1;
    lossy.retry = 60ms;
    relay.impair(Hop::Link, lossy);
    const auto begin = std::chrono::steady_clock::now();
    say(near, "first");
    EXPECT_EQ(heard(far.get(), 25ms), "nothing");
    relay.impair(Hop::Link, {});
    say(near, "second");
    EXPECT_EQ(all(far.get(), 11), "firstsecond");
    EXPECT_GE(std::chrono::steady_clock::now() - begin, 30ms);
}

TEST_F(RelayTest, WhatIsSplitAndLateIsWholeAndInOrder) {
    const auto near = connect();
    const auto far = accept();
    Impairment crooked;
    crooked.piece = 3;
    crooked.late = 5ms;
    relay.impair(Hop::Link, crooked);
    std::string words;
    for (int i = 0; i < 200; ++i) words += std::to_string(i) + " ";
    say(near, words.substr(0, 300));
    say(near, words.substr(300));
    EXPECT_EQ(all(far.get(), words.size()), words);
}

TEST_F(RelayTest, AResetReachesBothSides) {
    const auto near = connect();
    const auto far = accept();
    say(near, "x");
    EXPECT_EQ(heard(far.get()), "x");
    relay.reset(Hop::Link);
    EXPECT_EQ(heard(near.get()), "reset");
    EXPECT_EQ(heard(far.get()), "reset");
    EXPECT_EQ(relay.connections(Hop::Link), 0U);
}

TEST_F(RelayTest, OtherHopsAreNotDisturbed) {
    const auto near = connect();
    const auto far = accept();
    relay.cut(Hop::Client);
    relay.reset(Hop::Manager);
    say(near, "fine");
    EXPECT_EQ(heard(far.get()), "fine");
}

TEST_F(RelayTest, AConnectionFromADivertedAddressIsOnACableOfItsOwn) {
    relay.divert("127.99.99.99", Hop::Master);
    Descriptor other(::socket(AF_INET, SOCK_STREAM, 0));
    sockaddr_in source{};
    source.sin_family = AF_INET;
    ::inet_pton(AF_INET, "127.99.99.99", &source.sin_addr);
    ASSERT_EQ(::bind(other.get(), reinterpret_cast<sockaddr*>(&source), sizeof source), 0);
    const auto address = at(port);
    ASSERT_EQ(::connect(other.get(), reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
    const auto its_far = accept();
    const auto near = connect();
    const auto far = accept();
    relay.cut(Hop::Master);
    say(other, "lost");
    say(near, "passed on");
    EXPECT_EQ(heard(far.get()), "passed on");
    EXPECT_EQ(heard(its_far.get(), 100ms), "nothing");
}

TEST_F(RelayTest, ManyBytesArriveWholeAtASlowReader) {
    const auto near = connect();
    const auto far = accept();
    const std::string piece(60'000, 'x');
    std::size_t sent = 0, got = 0;
    for (int i = 0; i < 400; ++i) {
        const auto n = ::send(near.get(), piece.data(), piece.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
        if (n > 0) sent += static_cast<std::size_t>(n);
        if (n <= 0 && readable(far.get(), 100ms)) {
            std::string bytes(30'000, ' ');
            got += static_cast<std::size_t>(::recv(far.get(), bytes.data(), bytes.size(), 0));
        }
    }
    while (got < sent && readable(far.get(), 2000ms)) {
        std::string bytes(65'536, ' ');
        got += static_cast<std::size_t>(::recv(far.get(), bytes.data(), bytes.size(), 0));
    }
    EXPECT_EQ(got, sent);
}

}  // namespace
}  // namespace axon::faults
