// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/log/client_log.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "support/recorded_audit.hpp"

namespace axon::front_end_server {
namespace {

using namespace std::chrono_literals;
using testing::EndsWith;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

class ClientLogTest : public testing::Test {
  protected:
    ManualClock clock;
    std::vector<std::string> lines;
    ClientLog log{clock, [this](const std::string& line) { lines.push_back(line); }};
    const Sender ann{"c1", "ann", Role::Operator};
};

TEST_F(ClientLogTest, AnAuditNamesWhoDidWhatToWhich) {
    log.audit("stop", ann, {"a"}, 7);
    EXPECT_EQ(lines.back(), "audit: stop by ann (operator, c1) to a");
    log.audit("stop", ann, {""}, 7);
    EXPECT_THAT(lines.back(), EndsWith("to all 7 entities"));
    log.audit("drill", ann, std::vector<std::string>(18, std::string(100, 'x')), 7);
    EXPECT_THAT(lines.back(), EndsWith(std::string(64, 'x') + " and 2 more"));
    log.audit("drill", ann, {}, 7);
    EXPECT_THAT(lines.back(), EndsWith(" to "));
}

TEST_F(ClientLogTest, NoAuditIsLeftOut) {
    for (int i = 0; i < 1000; ++i) log.audit("stop", ann, {"a"}, 7);
    EXPECT_THAT(lines, SizeIs(1000));
}

TEST_F(ClientLogTest, WhatHappensOftenDoesNotFillTheLogAndHidesNothingOfAnotherKind) {
    for (int i = 0; i < 1000; ++i) log.excess(ann, {RefusalCode::Overloaded, "too many", {}});
    EXPECT_THAT(lines, SizeIs(8));
    EXPECT_THAT(lines.back(), HasSubstr("ann (c1) is refused: too many"));
    for (int i = 0; i < 1000; ++i) log.slowClient(ann, "a");
    log.unaskedHolder("a", "ann");
    EXPECT_THAT(lines, SizeIs(16));
    clock.advance(1s);
    log.unaskedHolder("a", "ann");
    EXPECT_THAT(lines.back(), HasSubstr("entity a is not believed"));
}

TEST_F(ClientLogTest, ARefusalThatIsNoExcessGetsNoLine) {
    log.excess(ann, {RefusalCode::PermissionDenied, "no", {}});
    EXPECT_THAT(lines, IsEmpty());
}

TEST_F(ClientLogTest, TheTrailGetsWhatTheLogLeavesOut) {
    test::RecordedAudit trail;
    const ClientLog its(
        clock, [](const std::string&) {}, &trail);
    its.joined(ann, "anna");
    EXPECT_EQ(trail.last(), "anna@|session|ann|c1||joined as operator|OK");
    its.audit("stop", ann, {"e1"}, 7);
    EXPECT_EQ(trail.last(), "stop|ann|c1|e1|stop|OK");
    its.audit("stop", ann, {""}, 7);
    EXPECT_EQ(trail.last(), "stop|ann|c1||stop to all 7 entities|OK");
    its.audit("rearm", ann, {"e1"}, 7);
    EXPECT_EQ(trail.last(), "rearm|ann|c1|e1|rearm|OK");
    its.audit("drill", ann, {"e1", "e2"}, 7);
    EXPECT_EQ(trail.last(), "command|ann|c1||drill of 2 entities: e1, e2|OK");
    Header head;
    head.sender = ann;
    head.entity = "e1";
    for (const auto* type : {kMsgParam, kMsgText, kMsgRaw, kMsgResource, kMsgWatch, kMsgStatus}) {
        head.msg_type = type;
        its.command(head);
    }
    EXPECT_THAT(trail.notes(), SizeIs(5)) << "what orders nothing is recorded";
    for (const auto* type : {kMsgCheckOut, kMsgRelease, kMsgHandOver, kMsgTask, kMsgTaskControl, kMsgRun}) {
        head.msg_type = type;
        its.command(head);
        EXPECT_EQ(trail.last(), "command|ann|c1|e1|" + std::string(type) + "|OK");
    }
    its.refused(head, {RefusalCode::NotHolder, "bob holds it", {}});
    EXPECT_EQ(trail.last(), "refusal|ann|c1|e1|RUN: bob holds it|NOT_HOLDER");
    EntityStatus status;
    status.entity = "e1";
    status.holder = ann;
    its.holder(status);
    EXPECT_EQ(trail.last(), "ownership|ann|c1|e1|checked out|");
    status.holder = {};
    its.holder(status);
    EXPECT_EQ(trail.last(), "ownership|||e1|free|");
    its.left(ann, "is lost", "nothing was heard");
    EXPECT_EQ(trail.last(), "session|ann|c1||is lost: nothing was heard|");
}

}  // namespace
}  // namespace axon::front_end_server
