// SPDX-License-Identifier: GPL-2.0-or-later
// Stops as datagrams: the client's sender and the real Entity Manager, with a relay between them that drops,
// duplicates and reorders, while nothing passes over TCP; and the whole client library, where both ways are
// open.
#include <axon/messages.pb.h>
#include <gtest/gtest.h>

#include <axon/client.hpp>

#include "client/connection/datagram_sender.hpp"
#include "component/raw_check_out.hpp"
#include "component/raw_peers.hpp"
#include "component/with_manager.hpp"
#include "support/loopback.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;
using client::DatagramSender;
using datagrams::DatagramLane;
using datagrams::Endpoint;
using test::RawClient;
using test::waitUntil;

/// Between client and Entity Manager: loses, doubles and holds back datagrams of either direction, from a
/// seed.
class Relay {
  public:
    Relay(Endpoint manager, std::uint32_t address, unsigned loss_percent)
        : manager_(manager),
          loss_percent_(loss_percent),
          back_(
              "relay-back", {address, 0}, clock_,
              [this](const DatagramLane&, const Endpoint&, std::string_view bytes) {
                  const std::lock_guard lock(mutex_);
                  pass(bytes, false);
                  return true;
              },
              nullptr),
          front_(
              "relay-front", {address, 0}, clock_,
              [this](const DatagramLane&, const Endpoint& from, std::string_view bytes) {
                  const std::lock_guard lock(mutex_);
                  client_ = from;
                  recorded_.emplace_back(bytes);
                  pass(bytes, true);
                  return true;
              },
              nullptr) {}
    ~Relay() { swallow(true); }  // a thread of one lane sends through the other
    /// While it does, what comes is not passed on.
    void swallow(bool does) {
        const std::lock_guard lock(mutex_);
        swallows_ = does;
    }
    const Endpoint& endpoint() const { return front_.local(); }
    std::vector<std::string> recorded() {
        const std::lock_guard lock(mutex_);
        return recorded_;
    }
    /// As somebody who has listened would.
    void inject(std::string_view bytes) { back_.send(manager_, bytes); }

  private:
    void pass(std::string_view bytes, bool to_manager) {
        if (swallows_ || random_.next() % 100 < loss_percent_) return;
        held_.emplace_back(bytes, to_manager);
        if (random_.next() % 3 == 0) return;  // behind what comes next
        while (!held_.empty()) {
            const auto [its_bytes, its_way] = held_.back();  // the newest first
            held_.pop_back();
            for (int copies = random_.next() % 4 == 0 ? 2 : 1; copies > 0; --copies)
                its_way ? back_.send(manager_, its_bytes) : front_.send(client_, its_bytes);
        }
    }
    const SteadyClock clock_{};
    const Endpoint manager_;
    const unsigned loss_percent_;
    std::mutex mutex_;
    bool swallows_ = false;
    SeededRandom random_{11};
    Endpoint client_;
    std::vector<std::string> recorded_;
    std::vector<std::pair<std::string, bool>> held_;
    DatagramLane back_, front_;
};

class DatagramsTest : public test::WithManager {
  protected:
    void SetUp() override {
        startServer();
        createManagerOfMemoryRobot();
        manager_->receiveDatagrams({true, "", 0}, clock_);
        manager_->start();
        ASSERT_TRUE(waitUntil([&] { return manager_->state() == EntityState::IDLE; }));
    }
    static LeaseNumber numberOf(const proto::CheckOutReply& reply) {
        return {static_cast<std::int32_t>(reply.lease().epoch()),
                static_cast<std::int32_t>(reply.lease().number())};
    }
    datagrams::StopSentry::Counters counters() const { return manager_->datagrams()->counters(); }
};

TEST_F(DatagramsTest, AStopArrivesByDatagramAloneThoughHalfOfThemAreLost) {
    RawClient raw(server_->clientAddress(Lane::Data));
    const auto granted = test::checkOut(raw, manager_->uuid(), random_);
    const auto to = Endpoint::parse(granted.datagram_endpoint());
    ASSERT_TRUE(to) << granted.datagram_endpoint();
    EXPECT_EQ(to->address, datagrams::parseAddress("127.0.0.1")) << "the way to the server begins there";
    Relay relay(*to, to->address, 50);
    std::atomic<int> acknowledged{0};
    std::atomic<std::uint32_t> generation{0};
    DatagramSender sender(clock_, [&](const datagrams::StopRepeater::Acknowledged& its) {
        generation = its.generation;
        ++acknowledged;
    });
    sender.admit(manager_->uuid(), numberOf(granted), relay.endpoint().toString(), granted.lease().key(),
                 raw.facts.me.id);

    constexpr int kStops = 40;
    for (int i = 1; i <= kStops; ++i) {
        // Sent anew when a row of copies has ended, as StopDesk does.
        EXPECT_TRUE(waitUntil([&] {
            sender.stop(manager_->uuid(), i, 0);
            return acknowledged == i;
        }));
        EXPECT_EQ(seen_.stops, i) << "each once, however many copies there are";
    }
    EXPECT_EQ(counters().accepted, static_cast<std::uint64_t>(kStops));
    EXPECT_GT(counters().again, 0U);
    EXPECT_EQ(counters().foreign + counters().unreadable + counters().old, 0U);
    EXPECT_GT(generation, granted.stop_generation());
    // The receipts of the ordinary way name the same stop.
    EXPECT_TRUE(waitUntil([&] { return raw.log.count("signal msg " + manager_->uuid()) >= kStops; }));
}

TEST_F(DatagramsTest, ReplayedForgedAndForeignDatagramsAreNotExecuted) {
    RawClient raw(server_->clientAddress(Lane::Data));
    const auto granted = test::checkOut(raw, manager_->uuid(), random_);
    const auto to = Endpoint::parse(granted.datagram_endpoint()).value();
    Relay relay(to, to.address, 0);
    std::atomic<int> acknowledged{0};
    DatagramSender sender(clock_, [&](const datagrams::StopRepeater::Acknowledged&) { ++acknowledged; });
    sender.admit(manager_->uuid(), numberOf(granted), relay.endpoint().toString(), granted.lease().key(),
                 raw.facts.me.id);
    constexpr int kStops = 70;  // more than a StopGenerations remembers, and than the sentry's window
    for (int i = 1; i <= kStops; ++i) {
        EXPECT_TRUE(waitUntil([&] {
            sender.stop(manager_->uuid(), i, 0);
            return acknowledged == i;
        }));
    }
    ASSERT_EQ(seen_.stops, kStops);

    const auto recorded = relay.recorded();
    // Copies of the last stop may still be on their way: what comes behind them says when they have been
    // counted.
    relay.swallow(true);
    relay.inject("no datagram of a stop");
    ASSERT_TRUE(waitUntil([&] { return counters().unreadable == 1; }));
    const auto before = counters();
    const auto refused = [&] {
        const auto now = counters();
        return now.again + now.foreign + now.unreadable + now.old - before.again - before.unreadable;
    };
    std::uint64_t injected = 0;
    const auto give = [&](std::string_view bytes) {
        relay.inject(bytes);
        if (++injected % 16 != 0) return;  // never more than the socket holds
        EXPECT_TRUE(waitUntil([&] { return refused() == injected; })) << refused() << " of " << injected;
    };
    for (const auto& bytes : recorded) give(bytes);  // replayed
    for (std::size_t i = 0; i < 600; ++i) {          // forged: a bit turned
        auto forged = recorded[i % recorded.size()];
        forged[i % forged.size()] ^= static_cast<char>(1U << i % 8);
        give(forged);
    }
    datagrams::StopDatagram foreign;  // of another lease, and of this one under another key or sender
    foreign.lease = numberOf(granted);
    foreign.sequence = kStops + 1;
    foreign.sender = Id128::uuid(random_);
    const auto inject = [&](const datagrams::StopDatagram& datagram, const std::string& key) {
        const auto bytes = datagrams::encode(datagram, key);
        give({bytes.data(), bytes.size()});
    };
    inject(foreign, granted.lease().key());
    foreign.sender = Id128::parse(raw.facts.me.id).value();
    inject(foreign, Id128::random(random_).bytes());
    ++foreign.lease.number;
    inject(foreign, granted.lease().key());
    EXPECT_TRUE(waitUntil([&] { return refused() == injected; })) << refused() << " of " << injected;
    EXPECT_EQ(seen_.stops, kStops);
    EXPECT_EQ(counters().accepted, before.accepted);

    // And the holder is still heard.
    relay.swallow(false);
    sender.stop(manager_->uuid(), kStops + 1, 0);
    EXPECT_TRUE(waitUntil([&] { return seen_.stops == kStops + 1; }));
}

TEST_F(DatagramsTest, TheEndOfTheLeaseEndsItsDatagrams) {
    RawClient raw(server_->clientAddress(Lane::Data));
    const auto granted = test::checkOut(raw, manager_->uuid(), random_);
    const auto to = Endpoint::parse(granted.datagram_endpoint()).value();
    proto::ToEntity body;
    body.mutable_release();
    auto head = raw.headTo(manager_->uuid(), 2);
    head.msg_type = kMsgRelease;
    head.held = numberOf(granted);
    const auto bytes = body.SerializeAsString();
    raw.data()->sendToEntity(transport::toIce(head), transport::toRange(bytes));
    ASSERT_TRUE(waitUntil([&] { return manager_->state() == EntityState::IDLE; }));

    DatagramLane lane(
        "test", {to.address, 0}, clock_,
        [](const DatagramLane&, const Endpoint&, std::string_view) { return true; }, nullptr);
    datagrams::StopDatagram stop;
    stop.lease = numberOf(granted);
    stop.sequence = 1;
    stop.sender = Id128::parse(raw.facts.me.id).value();
    const auto datagram = datagrams::encode(stop, granted.lease().key());
    const auto refused = counters().foreign;
    lane.send(to, {datagram.data(), datagram.size()});
    EXPECT_TRUE(waitUntil([&] { return counters().foreign > refused; }));
    EXPECT_EQ(counters().accepted, 0U);
    EXPECT_EQ(seen_.stops, 0);
}

TEST_F(DatagramsTest, TheClientLibrarySendsBothWaysAndTheRobotIsStoppedOnce) {
    client_ = connected({.display_name = "client1@lab"});
    ASSERT_TRUE(client_);
    auto& client = *client_;
    ASSERT_TRUE(client.waitFor("PeopleBot", client::Seconds{5}).ok());
    const auto held = client.checkOut("PeopleBot");
    ASSERT_TRUE(held.ok()) << held.refusal().message;
    for (int i = 1; i <= 20; ++i) {
        const auto receipts = i % 2 == 0 ? client.stop({"PeopleBot"}) : client.stop({});
        ASSERT_TRUE(receipts.ok()) << receipts.refusal().message;
        ASSERT_EQ(receipts.value().size(), 1U);
        EXPECT_TRUE(receipts.value().front().confirmed());
        EXPECT_TRUE(receipts.value().front().manager);
        EXPECT_EQ(seen_.stops, i);
    }
    EXPECT_TRUE(waitUntil([&] { return counters().accepted == 20; })) << counters().accepted;
    EXPECT_EQ(seen_.stops, 20);
}

}  // namespace
}  // namespace axon
