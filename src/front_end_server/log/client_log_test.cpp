// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/log/client_log.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

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

}  // namespace
}  // namespace axon::front_end_server
