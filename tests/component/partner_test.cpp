// SPDX-License-Identifier: GPL-2.0-or-later
// Two laboratories' servers and the gateway between them, with a client of one and an entity of the other
// that speak the contracts without any library: what arrives there, in whose name and on which lane.
#include <axon/messages.pb.h>
#include <gtest/gtest.h>

#include "component/any_ports.hpp"
#include "component/raw_peers.hpp"
#include "partner/gateway.hpp"
#include "transport/ice/endpoint.hpp"

namespace axon::test {
namespace {

constexpr const char* kTheirs = "00000001-1111-4111-8111-111111111111";

partner::GatewaySettings settingsFor(const server::Server& home, const server::Server& there) {
    partner::GatewaySettings settings;
    settings.core.laboratory = "b";
    settings.core.home = "a";
    settings.there.server = there.clientAddress(Lane::Data);
    const auto called = transport::parseEndpoint(home.entityAddress(Lane::Data));
    settings.home.host = called.host;
    settings.home.port = called.port;
    settings.secret = std::string(32, 's');
    return settings;
}

/// Its first entity registers without a profile: it is not ready, and is shown all the same.
class PartnerTest : public ::testing::Test {
  protected:
    void SetUp() override {
        entity_.data()->sendBasicPrfl(transport::toIce(entity_.registration), toRange(""), {});
        entity_.status(EntityState::IDLE);
        gateway_->start();
        ASSERT_TRUE(
            waitUntil([&] { return ann_.log.has("joined b/Robot ") && bob_.log.has("joined b/Robot "); }));
        for (const auto& line : ann_.log.lines())
            if (line.starts_with("joined b/Robot ")) shown_ = line.substr(15, 36);
    }
    void TearDown() override {
        entity_.resume();
        if (gateway_) gateway_->stop();
    }

    template <class Fill>
    void say(RawClient& client, const char* type, Fill fill, LeaseNumber held = {},
             std::int64_t sequence = 1) {
        proto::ToEntity body;
        fill(body);
        auto head = client.headTo(shown_, sequence);
        head.msg_type = type;
        head.held = held;
        const auto bytes = body.SerializeAsString();
        client.dataOneway()->sendToEntity(transport::toIce(head), toRange(bytes));
    }
    void checkOut(RawClient& client) {
        say(client, kMsgCheckOut, [](proto::ToEntity& body) {
            body.mutable_check_out()->set_request_id("0123456789abcdef");
            body.mutable_check_out()->set_phase(proto::TAKE);
        });
    }
    static bool refused(const RawClient& client, proto::RefusalCode code) {
        for (const auto& line : client.log.lines()) {
            const auto at = line.find(" msg ");
            proto::ToClient message;
            if (at != std::string::npos && message.ParseFromString(line.substr(at + 5 + 37)) &&
                message.reply().refusal().code() == code)
                return true;
        }
        return false;
    }

    const SteadyClock clock_{};
    server::Server home_{onLoopback()};
    server::Server there_{onLoopback()};
    RawEntity entity_{there_.entityAddress(Lane::Data), kTheirs};
    RawClient ann_{home_.clientAddress(Lane::Data), "ann@desk"};
    RawClient bob_{home_.clientAddress(Lane::Data), "bob@desk"};
    std::shared_ptr<partner::Gateway> gateway_ = partner::Gateway::create(settingsFor(home_, there_), clock_);
    std::string shown_;
};

TEST_F(PartnerTest, TheEntityHasAUuidOfItsOwnThatTheServerAccepts) {
    EXPECT_NE(shown_, kTheirs);
    EXPECT_EQ(shown_[14], '8') << "bound to a secret";
}

TEST_F(PartnerTest, EachClientSpeaksInItsOwnNameWhateverItWritesAndWhoseverLeaseItNames) {
    checkOut(ann_);
    ASSERT_TRUE(waitUntil([&] { return entity_.log.has("msg a@ann at desk CHECKOUT"); }));
    // Not a session in the name of the other one, and none at all for whoever holds nothing.
    const auto text = [](proto::ToEntity& body) { body.mutable_text()->set_text("forged"); };
    say(bob_, kMsgText, text, {3, 5});
    EXPECT_TRUE(waitUntil([&] { return refused(bob_, proto::NOT_HOLDER); }));
    checkOut(bob_);
    ASSERT_TRUE(waitUntil([&] { return entity_.log.has("msg a@bob at desk CHECKOUT"); }));
    say(bob_, kMsgText, text, {3, 5}, 2);
    ASSERT_TRUE(waitUntil([&] { return entity_.log.has("msg a@bob at desk TEXT"); }));
    EXPECT_FALSE(entity_.log.has("msg a@ann at desk TEXT"));
    EXPECT_FALSE(entity_.log.has("msg forged"));
}

TEST_F(PartnerTest, WhatCannotBeReadIsRefusedAtTheGateway) {
    auto head = ann_.headTo(shown_);
    ann_.dataOneway()->sendToEntity(transport::toIce(head), toRange("\xff\xff"));
    EXPECT_TRUE(waitUntil([&] { return refused(ann_, proto::MALFORMED); }));
    EXPECT_EQ(entity_.messages_received.load(), 0U);
}

TEST_F(PartnerTest, WhomOfItsOwnPeopleHoldsItIsNotStoppedByTheGateway) {
    RawClient carol{there_.clientAddress(Lane::Data), "carol@there"};
    // Held and driven by somebody whom the servers at home have never seen.
    entity_.status(EntityState::BUSY, carol.facts.me.id);
    ASSERT_TRUE(waitUntil([&] { return ann_.log.has("status " + shown_ + " BUSY"); }));
    ann_.stop(shown_);  // goes the way on which another would have come before
    EXPECT_TRUE(waitUntil([&] { return entity_.log.has("signal stop requested a"); }));
    EXPECT_EQ(entity_.log.count("signal stop "), 1U);
}

TEST_F(PartnerTest, AStopOfAClientWithoutASessionArrivesWhileDataStandsStill) {
    checkOut(bob_);
    ASSERT_TRUE(waitUntil([&] { return entity_.log.has("msg a@bob at desk CHECKOUT"); }));
    entity_.stalled = true;
    for (int i = 2; i < 200; ++i)
        say(
            bob_, kMsgText,
            [](proto::ToEntity& body) { body.mutable_text()->set_text(std::string(4096, 'x')); }, {}, i);
    ann_.stop(shown_);
    EXPECT_TRUE(waitUntil([&] { return entity_.log.has("signal stop requested a"); }));
    EXPECT_LT(entity_.log.count("msg a@bob at desk TEXT"), 198U);
}

TEST_F(PartnerTest, AStopOfEverythingReachesIt) {
    ann_.stop("");
    EXPECT_TRUE(waitUntil([&] { return entity_.log.has("signal stop requested a"); }));
}

TEST_F(PartnerTest, WithoutTheGatewayTheEntityHasLeftAndItsClientsHaveEnded) {
    checkOut(ann_);
    ASSERT_TRUE(waitUntil([&] { return entity_.log.has("msg a@ann at desk CHECKOUT"); }));
    gateway_->stop();
    gateway_ = nullptr;
    EXPECT_TRUE(waitUntil([&] { return ann_.log.has("left b/Robot "); }));
    EXPECT_TRUE(waitUntil([&] { return entity_.log.has("signal client ended "); }));
}

TEST_F(PartnerTest, AClientThatIsLostAtHomeIsLostThere) {
    checkOut(ann_);
    ASSERT_TRUE(waitUntil([&] { return entity_.log.has("msg a@ann at desk CHECKOUT"); }));
    ann_.cutData();
    EXPECT_TRUE(waitUntil([&] { return entity_.log.has("signal client lost "); }));
}

TEST_F(PartnerTest, AnEntityThatLeavesThereLeavesHome) {
    entity_.data()->leave();
    EXPECT_TRUE(waitUntil([&] { return ann_.log.has("left b/Robot "); }));
}

}  // namespace
}  // namespace axon::test
