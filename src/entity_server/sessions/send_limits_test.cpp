// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/sessions/send_limits.hpp"

#include <gtest/gtest.h>

#include <string>

namespace axon::entity_server {
namespace {

using namespace std::chrono_literals;

constexpr auto kKiB = std::size_t{1024};

class SendLimitsTest : public testing::Test {
  protected:
    /// kGoesOn, or why it does not.
    RefusalCode toPeer(Lane lane, const char* msg_type, std::size_t bytes) {
        Header head;
        head.msg_type = msg_type;
        const auto may = limits.toPeer(lane, head, std::string(bytes, 'x'), clock);
        return may.ok() ? kGoesOn : may.refusal().code;
    }
    static constexpr auto kGoesOn = RefusalCode{};

    ManualClock clock;
    SendLimits limits{10};
};

TEST_F(SendLimitsTest, AnEntityThatFloodsIsTurnedAwayUntilTheNextSecond) {
    for (int i = 0; i < 10; ++i) EXPECT_TRUE(limits.admit(clock.now()));
    EXPECT_FALSE(limits.admit(clock.now()));
    clock.advance(1s);
    EXPECT_TRUE(limits.admit(clock.now()));
}

TEST_F(SendLimitsTest, EntitiesCommandNoOther) {
    EXPECT_EQ(toPeer(Lane::Data, kMsgTask, 1), RefusalCode::PermissionDenied);
    EXPECT_EQ(toPeer(Lane::Data, "", 1), RefusalCode::PermissionDenied);
    EXPECT_EQ(toPeer(Lane::Data, kMsgCollaboration, 1), kGoesOn);
    EXPECT_EQ(toPeer(Lane::Data, kMsgRaw, 1), kGoesOn);
}

TEST_F(SendLimitsTest, MessagesOfRunsAreBoundedInOneAndInASecondAndRawDataInOne) {
    EXPECT_EQ(toPeer(Lane::Data, kMsgCollaboration, 1088 * kKiB + 1), RefusalCode::TooLarge);
    EXPECT_EQ(toPeer(Lane::Data, kMsgRaw, 1088 * kKiB + 1), RefusalCode::TooLarge);
    for (int i = 0; i < 8; ++i) EXPECT_EQ(toPeer(Lane::Data, kMsgCollaboration, 1024 * kKiB), kGoesOn);
    EXPECT_EQ(toPeer(Lane::Data, kMsgCollaboration, 1), RefusalCode::Overloaded);
    EXPECT_EQ(toPeer(Lane::Data, kMsgRaw, 1024 * kKiB), kGoesOn) << "it gives way by itself";
    clock.advance(1s);
    EXPECT_EQ(toPeer(Lane::Data, kMsgCollaboration, 1), kGoesOn);
}

TEST_F(SendLimitsTest, ASignalLaneTakesLittleOfAnEntityWhoeverItIsFor) {
    EXPECT_EQ(toPeer(Lane::Signal, kMsgRaw, 1), RefusalCode::Overloaded);
    EXPECT_EQ(toPeer(Lane::Signal, kMsgCollaboration, 16 * kKiB + 1), RefusalCode::Overloaded);
    const std::string large(16 * kKiB, 'x');
    int taken = 0;
    while (limits.toClient(Lane::Signal, large, clock).ok()) ++taken;
    EXPECT_EQ(taken, 64) << "a mebibyte in a second";
    EXPECT_EQ(toPeer(Lane::Signal, kMsgCollaboration, 0), RefusalCode::Overloaded) << "and no more";
    EXPECT_TRUE(limits.toClient(Lane::Data, std::string(2048 * kKiB, 'x'), clock).ok());
}

}  // namespace
}  // namespace axon::entity_server
