// SPDX-License-Identifier: GPL-2.0-or-later
// The headers of what is sent, and what is not sent at all, without the rest of the Entity Manager.
#include "entity_manager/core/outgoing_messages.hpp"

#include <gtest/gtest.h>

#include <utility>
#include <vector>

#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;

struct NotingServer final : ServerPort {
    enum class Way { Client, Droppable, Peer };
    struct Sent {
        Way way;
        Lane lane;
        Header head;
        proto::ToClient message;
    };
    void wantConnection(bool) override {}
    void sendBasicPrfl(const Registration&, const proto::BasicProfile&) override {}
    void sendStatus(const EntityStatus&) override {}
    void sendToClient(Lane lane, const Header& head, const proto::ToClient& message) override {
        sent.push_back({Way::Client, lane, head, message});
    }
    void sendToPeer(Lane lane, const Header& head, const proto::ToEntity&) override {
        sent.push_back({Way::Peer, lane, head, {}});
    }
    void sendToClientDataSeq(const Header& head, const proto::ToClient& message) override {
        sent.push_back({Way::Droppable, Lane::Data, head, message});
    }
    std::vector<Sent> sent;
};

using Way = NotingServer::Way;

struct TheOutgoingMessages : testing::Test {
    const Sender client{"client", "Ada", Role::Operator};
    const Sender self{"u", "This robot", Role::Operator};
    proto::ToClient text;
    test::FakeTurn turn;
    NotingServer server;
    OutgoingMessages outgoing{turn, server, "u"};
};

TEST_F(TheOutgoingMessages, AHeaderHasTheEntityTheLeaseTheStopGenerationAndTheTime) {
    turn.lease.emplace().number = {1, 2};
    turn.stopped.generation = 5;
    turn.clock.advance(3s);
    outgoing.tell(client, kMsgText, text, Lane::Signal);
    ASSERT_EQ(server.sent.size(), 1U);
    EXPECT_EQ(server.sent[0].lane, Lane::Signal);
    const auto& head = server.sent[0].head;
    EXPECT_EQ(head.sender.id, "client");
    EXPECT_EQ(head.entity, "u");
    EXPECT_EQ(head.msg_type, kMsgText);
    EXPECT_EQ(head.held, (LeaseNumber{1, 2}));
    EXPECT_EQ(head.stop_generation, 5);
    EXPECT_EQ(head.sent_at_us, toMicroseconds(turn.now()));
}

TEST_F(TheOutgoingMessages, MessagesOfEveryKindAreNumberedInOneSequence) {
    outgoing.tell(client, kMsgText, text, Lane::Data);
    outgoing.tellDroppable(client, kMsgRaw, text);
    outgoing.tellPeer(Lane::Data, self, "v", kMsgCollaboration, {});
    outgoing.reply(client, "r", {}, Lane::Data);
    ASSERT_EQ(server.sent.size(), 4U);
    for (std::size_t i = 0; i < server.sent.size(); ++i)
        EXPECT_EQ(server.sent[i].head.sequence, static_cast<std::int64_t>(i + 1));
    EXPECT_EQ(server.sent[1].way, Way::Droppable);
}

TEST_F(TheOutgoingMessages, WithoutASessionNothingIsSentAndNoNumberIsUsed) {
    turn.session = false;
    outgoing.tell(client, kMsgText, text, Lane::Data);
    outgoing.tellPeer(Lane::Data, self, "v", kMsgCollaboration, {});
    outgoing.reply(client, "r", {}, Lane::Data);
    EXPECT_TRUE(server.sent.empty());
    turn.session = true;
    outgoing.tell(client, kMsgText, text, Lane::Data);
    ASSERT_EQ(server.sent.size(), 1U);
    EXPECT_EQ(server.sent[0].head.sequence, 1);
}

TEST_F(TheOutgoingMessages, WhatWouldGoToEverybodyIsNotSent) {
    outgoing.tell({}, kMsgText, text, Lane::Data);
    outgoing.reply({}, "r", {}, Lane::Data);
    EXPECT_TRUE(server.sent.empty());
}

TEST_F(TheOutgoingMessages, ToAnotherEntityTheHeaderNamesThatOneAndThisOneAsTheSender) {
    outgoing.tellPeer(Lane::Signal, self, "v", kMsgCollaboration, {});
    ASSERT_EQ(server.sent.size(), 1U);
    EXPECT_EQ(server.sent[0].way, Way::Peer);
    EXPECT_EQ(server.sent[0].lane, Lane::Signal);
    EXPECT_EQ(server.sent[0].head.entity, "v");
    EXPECT_EQ(server.sent[0].head.sender.id, "u");
}

TEST_F(TheOutgoingMessages, AReplyThatGrantsHasNoRefusal) {
    outgoing.reply(client, "r1", {}, Lane::Data);
    outgoing.reply(client, "r2", {RefusalCode::NotHolder, "why", {}}, Lane::Data);
    ASSERT_EQ(server.sent.size(), 2U);
    EXPECT_EQ(server.sent[0].message.reply().request_id(), "r1");
    EXPECT_FALSE(server.sent[0].message.reply().has_refusal());
    EXPECT_EQ(server.sent[0].head.msg_type, kMsgReply);
    EXPECT_EQ(server.sent[1].message.reply().refusal().message(), "why");
}

}  // namespace
}  // namespace axon::entity_manager
