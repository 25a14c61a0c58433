// SPDX-License-Identifier: MIT
// Who is welcome as our Entity Manager, over real sockets and on a clock of the test. How a link comes about
// between the two real ends is claimed in tests/component/link_test.cpp.
#include "entity_interfacer/handshakes.hpp"

#include <arpa/inet.h>
#include <axon/link.pb.h>
#include <gtest/gtest.h>
#include <sys/socket.h>

#include <array>
#include <deque>
#include <memory>
#include <utility>

#include "common/release.hpp"
#include "entity_interfacer/axon/entity_interfacer.hpp"
#include "support/loopback.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;

/// One connection of an Entity Manager.
class Peer {
  public:
    explicit Peer(std::uint16_t port) : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
        sockaddr_in at{};
        at.sin_family = AF_INET;
        at.sin_port = htons(port);
        inet_pton(AF_INET, test::loopbackAddress().c_str(), &at.sin_addr);
        EXPECT_EQ(::connect(socket_.get(), reinterpret_cast<const sockaddr*>(&at), sizeof at), 0);
    }
    void send(const std::string& bytes) {
        EXPECT_EQ(::send(socket_.get(), bytes.data(), bytes.size(), 0), static_cast<ssize_t>(bytes.size()));
    }
    void send(const proto::EmToEi& message) {
        std::string frame;
        appendFrame(frame, message.SerializeAsString());
        send(frame);
    }
    /// The code of the Welcome that comes, Ok where it refuses nothing; none where the connection is closed.
    std::optional<RefusalCode> answered() {
        std::array<char, 4096> buffer;
        const auto got = ::recv(socket_.get(), buffer.data(), buffer.size(), 0);
        if (got <= 0) return std::nullopt;
        FrameReader reader;
        reader.feed({buffer.data(), static_cast<std::size_t>(got)});
        std::string payload;
        proto::EiToEm message;
        EXPECT_TRUE(reader.next(payload) && message.ParseFromString(payload) && message.has_welcome());
        welcome = message.welcome();
        return static_cast<RefusalCode>(message.welcome().refusal().code());
    }
    /// Whether it is closed, soon.
    bool closed() const {
        pollfd wait{socket_.get(), POLLIN, 0};
        char byte = 0;
        return ::poll(&wait, 1, 10'000) == 1 && ::recv(socket_.get(), &byte, 1, MSG_PEEK) == 0;
    }
    bool open() const {
        char byte = 0;
        return ::recv(socket_.get(), &byte, 1, MSG_DONTWAIT | MSG_PEEK) < 0;
    }

    proto::Welcome welcome;  // that has come

  private:
    Descriptor socket_;
};

struct TheHandshakes : testing::Test, Handshakes::Others {
    TheHandshakes() { port = handshakes.listen(where()); }
    static LinkPorts where(std::uint16_t first = 5500, std::uint16_t last = 5600) {
        return {{first, last}, test::loopbackAddress(), {}};
    }
    bool stopFailed() const override { return stop_failed; }
    std::optional<std::string> linkedWith() const override {
        return pairs.empty() ? std::nullopt : std::optional(pairs.back().manager);
    }
    void linkWith(Handshakes::Pair pair) override { pairs.push_back(std::move(pair)); }

    static proto::EmToEi hello(proto::LinkLane lane, const std::string& nonce = "12345678") {
        proto::EmToEi message;
        auto& said = *message.mutable_hello();
        said.set_protocol(1);
        said.set_application("pilot");
        said.set_lane(lane);
        said.set_nonce(nonce);
        said.set_manager("manager of " + nonce);
        return message;
    }
    /// As the watch thread: waits for something to come, if it is to come, and handles all that is there.
    void step(bool comes = false) {
        for (bool again = true; again;) {
            std::vector<pollfd> wait;
            handshakes.awaitAt(clock.now(), wait);
            again = ::poll(wait.data(), wait.size(), std::exchange(comes, false) ? 10'000 : 0) > 0;
            handshakes.handle(wait);
        }
        std::vector<pollfd> rest;
        due = handshakes.awaitAt(clock.now(), rest);
    }
    Peer& connect() {
        peers.push_back(std::make_unique<Peer>(port));
        step(true);
        return *peers.back();
    }
    /// What somebody is answered who says this first.
    std::optional<RefusalCode> answerTo(const proto::EmToEi& message) {
        auto& peer = connect();
        peer.send(message);
        step(true);
        return peer.answered();
    }

    ManualClock clock;
    bool stop_failed = false;
    std::vector<Handshakes::Pair> pairs;
    std::deque<std::unique_ptr<Peer>> peers;
    TimePoint due{};
    Handshakes handshakes{clock, *this, "pilot", "left"};
    std::uint16_t port = 0;
};

TEST_F(TheHandshakes, BothLanesOfOneEntityManagerBecomeALink) {
    auto signal = hello(proto::LANE_SIGNAL);
    signal.mutable_hello()->set_watchdog_busy_ms(5);
    EXPECT_EQ(answerTo(signal), RefusalCode::Ok);
    EXPECT_TRUE(pairs.empty());
    EXPECT_EQ(answerTo(hello(proto::LANE_DATA)), RefusalCode::Ok);
    ASSERT_EQ(pairs.size(), 1U);
    EXPECT_EQ(pairs[0].manager, "manager of 12345678");
    EXPECT_TRUE(pairs[0].signal.open() && pairs[0].data.open());
    EXPECT_EQ(pairs[0].watchdog_busy, 20ms) << "not less";
    EXPECT_EQ(pairs[0].watchdog_idle, 500ms) << "the usual one";
    step();
    EXPECT_EQ(due, TimePoint::max()) << "nothing is left of it here";
}

TEST_F(TheHandshakes, BothTellTheirRelease) {
    auto signal = hello(proto::LANE_SIGNAL);
    signal.mutable_hello()->set_release("7.1");
    answerTo(signal);
    EXPECT_EQ(peers.back()->welcome.release(), kRelease);
    answerTo(hello(proto::LANE_DATA));
    ASSERT_EQ(pairs.size(), 1U);
    EXPECT_EQ(pairs[0].release, "7.1");
}

TEST_F(TheHandshakes, ARefusalForTheProtocolNamesTheReleasesWhereTheyAreSome) {
    auto message = hello(proto::LANE_SIGNAL);
    message.mutable_hello()->set_protocol(2);
    const auto refusal = [&](const std::string& release) {
        message.mutable_hello()->set_release(release);
        EXPECT_EQ(answerTo(message), RefusalCode::NotSupported);
        return peers.back()->welcome.refusal().message();
    };
    const auto rest =
        std::string(": expected 1; fix: use an Entity Manager of this version (") + kRelease + ")";
    EXPECT_EQ(refusal("7.1"), "protocol 2 of release 7.1" + rest);
    EXPECT_EQ(refusal(""), "protocol 2" + rest);
    EXPECT_EQ(refusal("7\n"), "protocol 2" + rest);
    EXPECT_EQ(refusal(std::string(kReleaseMax + 1, 'x')), "protocol 2" + rest);
}

TEST_F(TheHandshakes, TheSignalLaneComesFirst) {
    EXPECT_EQ(answerTo(hello(proto::LANE_DATA)), RefusalCode::WrongState);
    EXPECT_EQ(answerTo(hello(proto::LANE_UNSPECIFIED)), RefusalCode::Malformed);
}

TEST_F(TheHandshakes, WhileOneIsLinkingOthersAreRefusedOnBothLanes) {
    answerTo(hello(proto::LANE_SIGNAL));
    EXPECT_EQ(answerTo(hello(proto::LANE_SIGNAL, "abcdefgh")), RefusalCode::AlreadyHeld);
    EXPECT_EQ(answerTo(hello(proto::LANE_DATA, "abcdefgh")), RefusalCode::AlreadyHeld);
    EXPECT_EQ(answerTo(hello(proto::LANE_DATA)), RefusalCode::Ok);
    ASSERT_EQ(pairs.size(), 1U);
    EXPECT_EQ(answerTo(hello(proto::LANE_SIGNAL, "abcdefgh")), RefusalCode::AlreadyHeld) << "it is linked";
    pairs.clear();
    EXPECT_EQ(answerTo(hello(proto::LANE_SIGNAL, "abcdefgh")), RefusalCode::Ok);
}

TEST_F(TheHandshakes, NobodyLinksWhoseStopsWouldNotBeCarriedOut) {
    stop_failed = true;
    EXPECT_EQ(answerTo(hello(proto::LANE_SIGNAL)), RefusalCode::WrongState);
    stop_failed = false;
    EXPECT_EQ(answerTo(hello(proto::LANE_SIGNAL)), RefusalCode::Ok);
}

TEST_F(TheHandshakes, AHelloMustNameThisApplicationAndMayLeaveOutItsInstance) {
    auto message = hello(proto::LANE_SIGNAL);
    message.mutable_hello()->set_application("another");
    EXPECT_EQ(answerTo(message), RefusalCode::UnknownEntity);
    message = hello(proto::LANE_SIGNAL);
    message.mutable_hello()->set_instance("right");
    EXPECT_EQ(answerTo(message), RefusalCode::UnknownEntity);
    message.mutable_hello()->set_instance("left");
    EXPECT_EQ(answerTo(message), RefusalCode::Ok);
}

TEST_F(TheHandshakes, WhatIsNoHelloOfThisProtocolIsRefusedAndClosed) {
    auto message = hello(proto::LANE_SIGNAL);
    message.mutable_hello()->set_protocol(2);
    EXPECT_EQ(answerTo(message), RefusalCode::NotSupported);
    EXPECT_EQ(answerTo(hello(proto::LANE_SIGNAL, "short")), RefusalCode::Malformed);
    proto::EmToEi other;
    other.mutable_beat();
    EXPECT_EQ(answerTo(other), RefusalCode::Malformed);
    auto& peer = connect();
    peer.send(std::string(8, '\0'));
    step(true);
    EXPECT_EQ(peer.answered(), RefusalCode::Malformed);
    EXPECT_TRUE(peer.closed());
}

TEST_F(TheHandshakes, AConnectionThatSaysNothingIsDroppedAfterASecond) {
    auto& peer = connect();
    EXPECT_EQ(due, clock.now() + 1s);
    clock.advance(999ms);
    step();
    EXPECT_TRUE(peer.open());
    clock.advance(1ms);
    step();
    EXPECT_TRUE(peer.closed());
    EXPECT_EQ(due, TimePoint::max());
}

TEST_F(TheHandshakes, AHalfThatIsNotCompletedInASecondLeavesTheWayToOthers) {
    answerTo(hello(proto::LANE_SIGNAL));
    clock.advance(1s);
    step();
    EXPECT_TRUE(peers.back()->closed());
    EXPECT_EQ(answerTo(hello(proto::LANE_DATA)), RefusalCode::WrongState);
    EXPECT_EQ(answerTo(hello(proto::LANE_SIGNAL, "abcdefgh")), RefusalCode::Ok);
}

TEST_F(TheHandshakes, AHalfThatSaysMoreBeforeItsDataLaneIsDropped) {
    answerTo(hello(proto::LANE_SIGNAL));
    peers.back()->send("more");
    step(true);
    EXPECT_TRUE(peers.back()->closed());
}

TEST_F(TheHandshakes, AStrangerTooManyTakesThePlaceOfTheOldestSilentOneAndNeverOfTheHalf) {
    answerTo(hello(proto::LANE_SIGNAL));
    for (std::size_t i = 1; i < Handshakes::kMax; ++i) connect();
    EXPECT_TRUE(peers[1]->open());
    connect();
    EXPECT_TRUE(peers[0]->open());
    EXPECT_TRUE(peers[1]->closed());
    EXPECT_TRUE(peers[2]->open());
    EXPECT_EQ(answerTo(hello(proto::LANE_DATA)), RefusalCode::Ok);
    EXPECT_EQ(pairs.size(), 1U);
}

TEST_F(TheHandshakes, TheFirstFreePortIsTakenAndARangeWithoutOneIsAMisconfiguration) {
    Handshakes second(clock, *this, "pilot", {});
    EXPECT_GT(second.listen(where(port)), port);
    Handshakes third(clock, *this, "pilot", {});
    EXPECT_THROW(third.listen(where(port, port)), Misconfiguration);
}

TEST_F(TheHandshakes, WhoIsClosedListensNoLonger) {
    auto& peer = connect();
    handshakes.close();
    EXPECT_TRUE(peer.closed());
    Handshakes next(clock, *this, "pilot", {});
    EXPECT_EQ(next.listen(where(port, port)), port);
}

}  // namespace
}  // namespace axon
