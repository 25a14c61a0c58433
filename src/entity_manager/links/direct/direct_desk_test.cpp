// SPDX-License-Identifier: GPL-2.0-or-later
#include <axon/messages.pb.h>
#include <gtest/gtest.h>

#include <optional>
#include <string>
#include <vector>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "entity_manager/links/direct/direct_desk.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using direct::Keeping;

const std::string kHolder = "11111111-1111-4111-8111-111111111111";

struct NotedServers final : RelayedWay {
    void wantConnection(bool) override {}
    void sendBasicPrfl(const Registration&, const proto::BasicProfile&) override {}
    void sendStatus(const EntityStatus&) override {}
    void sendToClient(Lane, const Header& head, const proto::ToClient&) override {
        sent.push_back(head.msg_type == kMsgWay ? 0 : head.sequence);
    }
    void sendToPeer(Lane, const Header&, const proto::ToEntity&) override {}
    void sendToClientDataSeq(const Header&, const proto::ToClient&) override {}
    void sendToClientBytes(Lane, const Header& head, const std::string&) override {
        sent.push_back(head.sequence);
    }
    std::vector<std::int64_t> sent;  // 0 is a mark
};

struct NotedLane final : DirectLane {
    void send(Keeping, const Header& head, std::shared_ptr<const std::string>) override {
        sent.push_back(head.sequence);
    }
    void beat(std::int64_t passed, bool asks) override { beats.emplace_back(passed, asks); }
    void close(const std::string& why) override { closed = why; }
    std::string peer() const override { return "there"; }
    std::vector<std::int64_t> sent;
    std::vector<std::pair<std::int64_t, bool>> beats;
    std::string closed;
};

struct DirectDeskTest : testing::Test {
    DirectDeskTest() {
        held.number = {3, 7};
        held.key = Id128::random(random);
        held.holder = {kHolder, "client1", Role::Operator};
        desk.setEntity("robot");
        claim = {Lane::Data, held.number, Id128::parse(kHolder).value(), Id128::random(random),
                 Id128::random(random)};
    }
    /// Whether it was let in.
    bool open(Lane lane, const LeaseBook::Held* holder, std::optional<std::string> proof = {}) {
        claim.lane = lane;
        bool admitted = false;
        DirectOpening opening;
        opening.claim = claim;
        opening.proof = proof ? *proof : direct::proofOf(claim, direct::Prover::Client, held.key.bytes());
        opening.admit = [&](const Sender& sender, std::shared_ptr<DirectSigns> its,
                            const std::string& answer) {
            EXPECT_EQ(sender.id, held.holder.id);
            EXPECT_TRUE(direct::proves(answer, claim, direct::Prover::EntityManager, held.key.bytes()));
            admitted = true;
            signs = std::move(its);
            return lane == Lane::Data ? data = std::make_shared<NotedLane>()
                                      : signal = std::make_shared<NotedLane>();
        };
        opening.refuse = [&](const Refusal& refusal) { refused = refusal.code; };
        desk.onOpening(opening, holder);
        return admitted;
    }
    void stand() {
        ASSERT_TRUE(open(Lane::Data, &held));
        ASSERT_TRUE(open(Lane::Signal, &held));
        ASSERT_TRUE(desk.direct());
        servers.sent.clear();
    }
    bool comes(std::int64_t sequence, const char* type = kMsgText) {
        Header head;
        head.sender = held.holder;
        head.msg_type = type;
        head.sequence = sequence;
        std::string bytes = "x";
        return desk.arrived(claim.path, Keeping::Kept, head, bytes);
    }
    bool relayed(std::int64_t sequence, const char* type = kMsgText, const std::string& message = "x",
                 const std::string& by = kHolder) {
        Header head;
        head.sender = {by, "somebody", Role::Operator};
        head.msg_type = type;
        head.sequence = sequence;
        return desk.relayed(Keeping::Kept, head, message,
                            [this](const Header& its, const std::string&) { heard.push_back(its.sequence); });
    }
    static std::string markOf(const Id128& path) {
        proto::ToEntity mark;
        mark.mutable_way()->set_path(path.bytes());
        return mark.SerializeAsString();
    }
    void tell(std::int64_t sequence) {
        Header head;
        head.sender = held.holder;
        head.msg_type = kMsgReply;
        head.sequence = sequence;
        desk.sendToClient(Lane::Data, head, {});
    }
    void wait(Duration time) {
        for (const auto end = clock.now() + time; clock.now() < end;) {
            clock.set(std::min(end, std::max(clock.now() + 1ms, desk.nextDeadline())));
            desk.onTimer();
        }
    }

    ManualClock clock;
    SeededRandom random{1};
    NotedServers servers;
    std::vector<std::string> warnings;
    DirectDesk desk{clock, servers, [this](bool warning, const std::string& line) {
                        if (warning) warnings.push_back(line);
                    }};
    LeaseBook::Held held{};
    direct::Claim claim;
    std::shared_ptr<DirectSigns> signs;
    std::shared_ptr<NotedLane> data, signal;
    RefusalCode refused = RefusalCode::Ok;
    std::vector<std::int64_t> heard;
};

TEST_F(DirectDeskTest, OnlyThePresentHolderWithTheKeyIsLetIn) {
    EXPECT_FALSE(open(Lane::Data, nullptr));
    EXPECT_FALSE(open(Lane::Data, &held, std::string()));
    EXPECT_FALSE(open(Lane::Data, &held,
                      direct::proofOf(claim, direct::Prover::Client, Id128::random(random).bytes())));
    auto another = held;
    another.number.number = 8;
    EXPECT_FALSE(open(Lane::Data, &another)) << "the lease has ended, and the key is its own";
    another = held;
    another.holder.id = "22222222-2222-4222-8222-222222222222";
    EXPECT_FALSE(open(Lane::Data, &another));
    another = held;
    another.grace_until = clock.now() + 1s;
    EXPECT_FALSE(open(Lane::Data, &another)) << "its holder is lost";
    EXPECT_EQ(refused, RefusalCode::PermissionDenied);
    EXPECT_EQ(warnings.size(), 1U) << "once a minute";
    EXPECT_FALSE(open(Lane::Signal, &held)) << "without the data lane";
    EXPECT_EQ(refused, RefusalCode::WrongState);
    EXPECT_TRUE(open(Lane::Data, &held));
}

TEST_F(DirectDeskTest, AProofOfAnotherNonceIsNone) {
    const auto proof = direct::proofOf(claim, direct::Prover::Client, held.key.bytes());
    claim.nonce = Id128::random(random);
    EXPECT_FALSE(open(Lane::Data, &held, proof));
}

TEST_F(DirectDeskTest, AMarkOfAStrangerOrOfAnotherPathOpensNothing) {
    stand();
    EXPECT_FALSE(comes(2)) << "held back";
    EXPECT_TRUE(relayed(0, kMsgWay, markOf(claim.path), "22222222-2222-4222-8222-222222222222"))
        << "which is the core's to refuse";
    EXPECT_FALSE(relayed(0, kMsgWay, markOf(Id128::random(random))));
    EXPECT_FALSE(relayed(0, kMsgWay, "not a message"));
    EXPECT_TRUE(heard.empty());
    EXPECT_FALSE(relayed(1, kMsgWay, markOf(claim.path)));
    EXPECT_EQ(heard, (std::vector<std::int64_t>{2}));
}

TEST_F(DirectDeskTest, AfterTheMarkEachMessagePassesOnceByWhicheverWay) {
    stand();
    relayed(1, kMsgWay, markOf(claim.path));
    EXPECT_TRUE(comes(2));
    EXPECT_FALSE(relayed(2)) << "sent again";
    EXPECT_FALSE(comes(1));
    EXPECT_TRUE(relayed(3));
    EXPECT_FALSE(comes(3));
    desk.onClosed(claim.path, "cut");
    EXPECT_FALSE(relayed(3)) << "nor when the path is over";
    EXPECT_TRUE(relayed(4));
    EXPECT_FALSE(comes(5)) << "of a path that is over";
}

TEST_F(DirectDeskTest, WhatTheServersMustSeeEndsThePathThatBringsIt) {
    stand();
    relayed(1, kMsgWay, markOf(claim.path));
    EXPECT_FALSE(comes(2, kMsgRearm));
    EXPECT_FALSE(desk.direct());
    EXPECT_NE(data->closed, "");
    EXPECT_NE(signal->closed, "");
}

TEST_F(DirectDeskTest, AClientThatFallsSilentGetsWhatItHasNotAcknowledgedByTheServersAndInOrder) {
    stand();
    clock.advance(1ms);  // whoever was heard at this moment need not answer
    tell(1);
    tell(2);
    tell(3);
    EXPECT_EQ(data->sent, (std::vector<std::int64_t>{1, 2, 3}));
    EXPECT_TRUE(signal->beats.back().second) << "it is asked for a sign of life";
    signs->acknowledged = 1;
    wait(direct::kAsks - 1ms);
    EXPECT_TRUE(desk.direct());
    wait(2ms);
    EXPECT_FALSE(desk.direct());
    tell(4);
    EXPECT_EQ(servers.sent, (std::vector<std::int64_t>{2, 3, 4}));
    EXPECT_EQ(desk.nextDeadline(), TimePoint::max());
}

TEST_F(DirectDeskTest, AnAcknowledgementOfWhatWasNeverSentCostsItsSenderOnly) {
    stand();
    signs->acknowledged = std::int64_t{1} << 52U;
    tell(1);
    tell(2);  // the first counts as acknowledged
    signs->acknowledged = -5;
    desk.onClosed(claim.path, "cut");
    tell(3);
    EXPECT_EQ(servers.sent, (std::vector<std::int64_t>{2, 3}));
}

TEST_F(DirectDeskTest, TheEndOfTheLeaseEndsThePathAndTheLossOfTheHolderForgetsWhatIsUnderWay) {
    stand();
    tell(1);
    desk.hold(&held);
    EXPECT_TRUE(desk.direct());
    desk.hold(nullptr);
    EXPECT_FALSE(desk.direct());
    EXPECT_EQ(servers.sent, (std::vector<std::int64_t>{1}));

    claim.path = Id128::random(random);
    stand();
    tell(2);
    held.grace_until = clock.now() + 1s;
    desk.hold(&held);
    EXPECT_FALSE(desk.direct());
    EXPECT_TRUE(servers.sent.empty()) << "it has no session";
}

TEST_F(DirectDeskTest, SilenceEndsAPathAfterTenSecondsOrWhileItIsBusyAfterAQuarterOfOne) {
    stand();
    wait(direct::kWatchdogIdle - 1ms);
    EXPECT_TRUE(desk.direct());
    EXPECT_TRUE(signs->heard(clock.now(), 0, true)) << "its beats come faster from now on";
    EXPECT_FALSE(signs->heard(clock.now(), 0, true));
    wait(direct::kWatchdogBusy - 1ms);
    EXPECT_TRUE(desk.direct());
    wait(2ms);
    EXPECT_FALSE(desk.direct());
}

// Its answer to a hand-over came by its path, and was carried out before it was acknowledged.
TEST_F(DirectDeskTest, WhatAFormerHolderSendsAgainIsLeftOutThoughAnotherHasAPathByThen) {
    stand();
    relayed(1, kMsgWay, markOf(claim.path));
    EXPECT_TRUE(comes(2, kMsgHandOver));
    const auto first = held.holder.id;
    held.number.number = 8;
    held.key = Id128::random(random);
    held.holder.id = "22222222-2222-4222-8222-222222222222";
    desk.hold(&held);
    claim = {Lane::Data, held.number, Id128::parse(held.holder.id).value(), Id128::random(random),
             Id128::random(random)};
    stand();
    relayed(1, kMsgWay, markOf(claim.path), held.holder.id);
    EXPECT_TRUE(comes(2)) << "whose numbers are its own";
    EXPECT_FALSE(relayed(2, kMsgHandOver, "x", first));
    EXPECT_TRUE(relayed(3, kMsgText, "x", first));
    EXPECT_FALSE(relayed(2, kMsgText, "x", held.holder.id));
}

TEST_F(DirectDeskTest, AnotherPathOfTheHolderTakesThePlaceOfTheFirst) {
    stand();
    tell(1);
    const auto first = data;
    claim.path = Id128::random(random);
    EXPECT_TRUE(open(Lane::Data, &held));
    EXPECT_NE(first->closed, "");
    EXPECT_EQ(servers.sent, (std::vector<std::int64_t>{1}));
    EXPECT_FALSE(desk.direct()) << "half a path is none";
    EXPECT_FALSE(open(Lane::Data, nullptr));
}

}  // namespace
}  // namespace axon::entity_manager
