// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/signal_relay.hpp"

#include <gmock/gmock.h>

#include <vector>

namespace axon::partner {
namespace {

/// Both lanes of one session there.
class Lanes final : public client::StopLanes, public client::DataLane {
  public:
    void sendStopSignal(Lane lane, const Header& head, StopCause cause) const override {
        EXPECT_EQ(lane, Lane::Signal);
        stops.push_back(head);
        causes.push_back(cause);
    }
    void sendStopSignals(Lane, const Header&, const std::vector<std::string>&, StopCause) const override {}
    void send(client::Operation kind, const Header& head, std::string) const override {
        commands.emplace_back(kind, head);
    }
    void add(client::Operation, const Header&, std::string) const override {}
    void write() const override {}
    std::size_t waiting() const override { return 0; }
    std::size_t waitingBytes() const override { return 0; }
    void awaitRoom(Duration) const override {}

    mutable std::vector<Header> stops;
    mutable std::vector<StopCause> causes;
    mutable std::vector<std::pair<client::Operation, Header>> commands;
};

const Sender kAnn{"ann", "ann@desk", Role::Operator};
const Sender kBob{"bob", "bob@desk", Role::Operator};

Header of(const Sender& who, std::int64_t number) {
    Header head;
    head.sender = who;
    head.entity = "home-uuid";
    head.sequence = number;
    head.stop_generation = 4;
    return head;
}

proto::StopReceipt receiptOf(const std::string& stop) {
    proto::StopReceipt receipt;
    receipt.set_stop_id(stop);
    receipt.set_by("somebody there");
    return receipt;
}

struct SignalRelayTest : testing::Test {
    ManualClock clock;
    SignalRelay relay{clock};
    std::shared_ptr<Lanes> watch = std::make_shared<Lanes>();  // of the session for strangers' stops
    std::shared_ptr<Lanes> own = std::make_shared<Lanes>();
    void SetUp() override { relay.stopBy(1, {"w", "a", Role::Operator}, watch); }
};

TEST_F(SignalRelayTest, AStopOfSomebodyWithoutASessionGoesByTheOneForSuchStops) {
    ASSERT_EQ(relay.stop("there-uuid", of(kAnn, 7), StopCause::Requested), SignalRelay::Passed::Sent);
    ASSERT_EQ(watch->stops.size(), 1U);
    EXPECT_EQ(watch->stops[0].entity, "there-uuid");
    EXPECT_EQ(watch->stops[0].stop_generation, 4);
    EXPECT_TRUE(watch->stops[0].sender.id.empty());
}

TEST_F(SignalRelayTest, TwoClientsWithTheSameNumberGiveTwoStops) {
    relay.stop("e", of(kAnn, 7), StopCause::Requested);
    relay.stop("e", of(kBob, 7), StopCause::Requested);
    EXPECT_NE(watch->stops[0].sequence, watch->stops[1].sequence);
}

TEST_F(SignalRelayTest, AStopThatIsSentAgainKeepsItsNumber) {
    relay.stop("e", of(kAnn, 7), StopCause::Requested);
    relay.stop("f", of(kAnn, 7), StopCause::Requested);
    relay.visit(kAnn, {"ann-there", "a@ann", Role::Operator}, {own, own});
    clock.advance(SignalRelay::kRepeat);
    relay.stop("e", of(kAnn, 7), StopCause::Requested);
    ASSERT_EQ(watch->stops.size(), 3U) << "also when a session has been opened meanwhile";
    EXPECT_EQ(watch->stops[0].sequence, watch->stops[1].sequence);
    EXPECT_EQ(watch->stops[0].sequence, watch->stops[2].sequence);
}

TEST_F(SignalRelayTest, WithoutANumberItIsAlwaysANewStop) {
    relay.stop("e", of(kAnn, 0), StopCause::Requested);
    relay.stop("e", of(kAnn, 0), StopCause::Requested);
    EXPECT_NE(watch->stops[0].sequence, watch->stops[1].sequence);
}

TEST_F(SignalRelayTest, AVisitorStopsByItsOwnSessionAndUnderItsOwnNumber) {
    relay.visit(kAnn, {"ann-there", "a@ann", Role::Operator}, {own, own});
    relay.stop("e", of(kAnn, 9), StopCause::Drill);
    EXPECT_TRUE(watch->stops.empty());
    ASSERT_EQ(own->stops.size(), 1U);
    EXPECT_EQ(own->stops[0].sequence, 9);
    EXPECT_EQ(own->causes[0], StopCause::Drill);
    relay.end("ann");
    relay.stop("e", of(kAnn, 10), StopCause::ClientLost);
    ASSERT_EQ(watch->stops.size(), 1U);
    EXPECT_EQ(watch->causes[0], StopCause::Requested) << "a client may say no other cause";
}

TEST_F(SignalRelayTest, WithoutAnySessionNothingIsSentAndThatIsSaid) {
    relay.noStopBy(1);
    EXPECT_EQ(relay.stop("e", of(kAnn, 7), StopCause::Requested), SignalRelay::Passed::NoSession);
}

TEST_F(SignalRelayTest, AReceiptNamesTheStopAndItsGiverAsAtHome) {
    relay.stop("e", of(kAnn, 7), StopCause::Requested);
    auto receipt = receiptOf("w:" + std::to_string(watch->stops[0].sequence));
    const auto to = relay.translate(receipt);
    ASSERT_TRUE(to);
    EXPECT_EQ(to->id, "ann");
    EXPECT_EQ(receipt.stop_id(), "ann:7");
    EXPECT_EQ(receipt.by(), "ann@desk");
    relay.visit(kBob, {"fe:1:bob-there", "a@bob", Role::Operator}, {own, own});
    relay.end("bob");
    receipt = receiptOf("fe:1:bob-there:3");
    ASSERT_TRUE(relay.translate(receipt)) << "also when its session has ended";
    EXPECT_EQ(receipt.stop_id(), "bob:3");
}

TEST_F(SignalRelayTest, AReceiptOfSomebodyElsesStopIsLeftAsItIs) {
    for (const auto* stop : {"stranger:3", "w:99", "w:x", "", ":"}) {
        auto receipt = receiptOf(stop);
        EXPECT_FALSE(relay.translate(receipt)) << stop;
        EXPECT_EQ(receipt.stop_id(), stop);
        EXPECT_EQ(receipt.by(), "somebody there");
    }
}

TEST_F(SignalRelayTest, TheNumbersOfAnEarlierSessionMeanNothingInTheNext) {
    relay.stop("e", of(kAnn, 7), StopCause::Requested);
    auto receipt = receiptOf("w:" + std::to_string(watch->stops[0].sequence));
    relay.stopBy(2, {"w2", "a", Role::Operator}, watch);
    EXPECT_FALSE(relay.translate(receipt));
}

TEST_F(SignalRelayTest, OnlySoManyStopsAreRemembered) {
    relay.stop("e", of(kAnn, 1), StopCause::Requested);
    const auto first = watch->stops[0].sequence;
    for (std::size_t i = 0; i < SignalRelay::kRemembered; ++i)
        relay.stop("e", of({"bob-" + std::to_string(i), "bob", Role::Operator}, 1), StopCause::Requested);
    EXPECT_FALSE(relay.originOf("w:" + std::to_string(first)));
    relay.stop("e", of(kAnn, 1), StopCause::Requested);
    EXPECT_NE(watch->stops.back().sequence, first);
}

TEST_F(SignalRelayTest, WhoeverStopsVeryOftenLosesReceiptsOfItsOwnOnly) {
    relay.stop("e", of(kAnn, 1), StopCause::Requested);
    const auto first = watch->stops[0].sequence;
    for (std::size_t i = 0; i < SignalRelay::kRemembered; ++i)
        relay.stop("e", of(kBob, static_cast<std::int64_t>(i) + 1), StopCause::Requested);
    EXPECT_TRUE(relay.originOf("w:" + std::to_string(first)));
    EXPECT_FALSE(relay.originOf("w:" + std::to_string(watch->stops[1].sequence)));
    EXPECT_TRUE(relay.originOf("w:" + std::to_string(watch->stops.back().sequence)));
}

TEST_F(SignalRelayTest, AStopThatIsRepeatedAtOnceIsOnItsWayAlready) {
    relay.stop("e", of(kAnn, 1), StopCause::Requested);
    EXPECT_EQ(relay.stop("e", of(kAnn, 1), StopCause::Requested), SignalRelay::Passed::Sent);
    EXPECT_EQ(watch->stops.size(), 1U);
    relay.stop("f", of(kAnn, 1), StopCause::Requested);
    relay.stop("e", of(kAnn, 2), StopCause::Requested);
    relay.stop("e", of(kBob, 1), StopCause::Requested);
    EXPECT_EQ(watch->stops.size(), 4U) << "none of them is the same";
    clock.advance(SignalRelay::kRepeat);
    relay.stop("e", of(kAnn, 1), StopCause::Requested);
    EXPECT_EQ(watch->stops.size(), 5U) << "its receipt may have been lost";
    // Another session has not carried it.
    relay.stopBy(2, {"w2", "a", Role::Operator}, watch);
    relay.stop("e", of(kAnn, 1), StopCause::Requested);
    EXPECT_EQ(watch->stops.size(), 6U);
}

TEST_F(SignalRelayTest, ByASharedSessionOnlySoManyPassOfEachClientAndOfAll) {
    auto shared = std::make_shared<Lanes>();
    relay.stopBy(3, {"v", "a", Role::Operator}, shared, true);
    relay.noStopBy(1);
    const auto stops = [&](const std::string& who, std::size_t count) {
        std::size_t refused = 0;
        for (std::size_t i = 1; i <= count; ++i)
            if (relay.stop("robot", of({who, who, Role::Operator}, static_cast<std::int64_t>(i)),
                           StopCause::Requested) == SignalRelay::Passed::TooMany)
                ++refused;
        return refused;
    };
    EXPECT_EQ(stops("eve", SignalRelay::kSharedOfOne + 10), 10U);
    EXPECT_EQ(stops("ann", 1), 0U) << "others are unharmed";
    constexpr auto kFlooders =
        SignalRelay::kSharedCommon / (SignalRelay::kSharedOfOne - SignalRelay::kSharedLeast) + 1;
    for (std::size_t flooder = 0; flooder < kFlooders; ++flooder)
        stops("flooder" + std::to_string(flooder), SignalRelay::kSharedOfOne);
    EXPECT_EQ(stops("bob", 1), 0U) << "something is set aside for each";
    EXPECT_EQ(stops("carol", SignalRelay::kSharedLeast + 1), 1U) << "but no more";
    // However many there are, no more than the connection bears.
    for (std::size_t flooder = 0; flooder < SignalRelay::kShared; ++flooder)
        stops("more" + std::to_string(flooder), 2);
    EXPECT_EQ(shared->stops.size(), SignalRelay::kShared);
    clock.advance(std::chrono::seconds{1});
    EXPECT_EQ(stops("late", 1), 0U) << "who repeats it";
    relay.stopBy(2, {"w2", "a", Role::Operator}, watch);
    EXPECT_EQ(stops("eve", SignalRelay::kSharedOfOne + 10), 0U) << "its own session may end";
}

TEST_F(SignalRelayTest, WhatIsOnItsWayAlreadyCostsNothingOfWhatPassesByASharedSession) {
    auto shared = std::make_shared<Lanes>();
    relay.stopBy(3, {"v", "a", Role::Operator}, shared, true);
    relay.noStopBy(1);
    relay.stop("e", of(kAnn, 1), StopCause::Requested);
    for (std::size_t i = 0; i < 2 * SignalRelay::kShared; ++i)
        ASSERT_EQ(relay.stop("e", of(kAnn, 1), StopCause::Requested), SignalRelay::Passed::Sent);
    EXPECT_EQ(shared->stops.size(), 1U);
    for (std::int64_t number = 2; number <= static_cast<std::int64_t>(SignalRelay::kSharedOfOne); ++number)
        ASSERT_EQ(relay.stop("e", of(kAnn, number), StopCause::Requested), SignalRelay::Passed::Sent);
    EXPECT_EQ(relay.stop("e", of(kAnn, SignalRelay::kSharedOfOne + 1), StopCause::Requested),
              SignalRelay::Passed::TooMany);
}

TEST_F(SignalRelayTest, WhenTheSessionForThemEndsTheNextStopGoesByTheSharedOneAndBackWhenThereIsAnother) {
    auto shared = std::make_shared<Lanes>(), next = std::make_shared<Lanes>();
    relay.stopBy(3, {"v", "a", Role::Operator}, shared, true);
    relay.stop("e", of(kAnn, 1), StopCause::Requested);
    EXPECT_THAT(shared->stops, testing::IsEmpty());
    EXPECT_TRUE(relay.originOf("w:" + std::to_string(watch->stops.at(0).sequence)));
    relay.noStopBy(77);  // some other one
    relay.noStopBy(1);
    relay.stop("e", of(kAnn, 1), StopCause::Requested);
    ASSERT_EQ(shared->stops.size(), 1U) << "also one that the ended session has lost";
    EXPECT_TRUE(relay.originOf("v:" + std::to_string(shared->stops[0].sequence)));
    relay.stopBy(4, {"w2", "a", Role::Operator}, next);
    relay.stop("e", of(kAnn, 2), StopCause::Requested);
    EXPECT_EQ(next->stops.size(), 1U);
    relay.noStopBy(3);
    relay.stop("e", of(kAnn, 3), StopCause::Requested);
    EXPECT_EQ(next->stops.size(), 2U) << "it does not need the shared one";
    relay.noStopBy(4);
    EXPECT_EQ(relay.stop("e", of(kAnn, 4), StopCause::Requested), SignalRelay::Passed::NoSession);
    EXPECT_FALSE(relay.originOf(":1"));
    EXPECT_EQ(watch->stops.size() + shared->stops.size(), 2U);
}

TEST_F(SignalRelayTest, AResetIsForWhoHasASession) {
    EXPECT_FALSE(relay.command(client::Operation::Reset, "e", of(kAnn, 2)));
    EXPECT_TRUE(watch->commands.empty()) << "nobody is reset in the gateway's own name";
    relay.visit(kAnn, {"ann-there", "a@ann", Role::Operator}, {own, own});
    ASSERT_TRUE(relay.command(client::Operation::Reset, "e", of(kAnn, 2)));
    EXPECT_EQ(own->commands[0].second.entity, "e");
    EXPECT_EQ(own->commands[0].second.sequence, 2);
}

}  // namespace
}  // namespace axon::partner
