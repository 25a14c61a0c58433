// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/endings/settlement.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <utility>

namespace axon::front_end_server {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

class FakeTopic final : public EntityTopic {
  public:
    Result<void> clientMsg(const std::string&, const Header&, std::string_view) override { return {}; }
    void clientMsgDataSeq(const std::string&, const Header&, std::string_view) override {}
    void clientRequest(const Header&) override {}
    void clientUpdate(const Header& head, ClientChange change) override {
        lines.push_back((change == ClientChange::Lost ? "lost to " : "ended to ") + head.entity);
    }
    void stopSignal(const Header& head, StopCause cause) override { stopSignals(head, {head.entity}, cause); }
    void stopSignals(const Header& head, const std::vector<std::string>& entities, StopCause cause) override {
        std::string line = std::string(toString(cause)) + " to";
        for (const auto& entity : entities) line += " " + entity;
        lines.push_back(line);
        numbers.push_back(head.sequence);
    }
    void resetSignal(const Header&) override {}
    void clearSignal(const Header&) override {}
    std::vector<std::string> take() { return std::exchange(lines, {}); }

    std::vector<std::string> lines;
    std::vector<std::int64_t> numbers;  // of stops
};

class SettlementTest : public testing::Test {
  protected:
    ManualClock clock;
    FakeTopic topic;
    Settlement settlement{clock, topic};
    const Sender client{"c1", "ann", Role::Operator};
};

TEST_F(SettlementTest, WhatAClientHeldIsStoppedByOneMessage) {
    settlement.stop(client, Ending::Lost, {{"a", false}, {"b", true}});
    EXPECT_THAT(topic.take(), ElementsAre("client lost to a b"));
    settlement.stop(client, Ending::Improper, {{"a", false}});
    EXPECT_THAT(topic.take(), ElementsAre("improper client to a"));
}

TEST_F(SettlementTest, AnOrderlyEndStopsOnlyWhereATaskRuns) {
    settlement.stop(client, Ending::Ended, {{"a", false}, {"b", true}});
    EXPECT_THAT(topic.take(), ElementsAre("released to b"));
    settlement.stop(client, Ending::Ended, {{"a", false}});
    EXPECT_THAT(topic.take(), IsEmpty());
}

TEST_F(SettlementTest, OneThatHeldNothingStopsNothing) {
    settlement.stop(client, Ending::Lost, {});
    EXPECT_THAT(topic.take(), IsEmpty());
}

TEST_F(SettlementTest, OneThatKnowsOfTheClientHearsHowItEnded) {
    settlement.tellGone(client, "a", Ending::Lost);
    settlement.tellGone(client, Ending::Ended, {{"b", true}, {"c", false}});
    EXPECT_THAT(topic.take(), ElementsAre("lost to a", "ended to b", "ended to c"));
}

TEST_F(SettlementTest, EachStopHasANumberThatNoClientGives) {
    for (int i = 0; i < 2; ++i) settlement.stop(client, Ending::Lost, {{"a", true}});
    EXPECT_THAT(topic.numbers, ElementsAre(kServerSequences + 1, kServerSequences + 2));
}

}  // namespace
}  // namespace axon::front_end_server
