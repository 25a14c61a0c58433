// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/clients/admission.hpp"

#include <gtest/gtest.h>

#include "front_end_server/clients/deaf_outbox.hpp"

namespace axon::front_end_server {
namespace {

using namespace std::chrono_literals;

class AdmissionTest : public testing::Test {
  protected:
    std::shared_ptr<Client> client(Role role = Role::Operator) {
        return std::make_shared<Client>(Sender{"c1", "ann", role}, "token", std::make_shared<DeafOutbox>(),
                                        FrontEndCoreSettings{}, clock.now());
    }
    Result<bool> may(Client& of, const char* msg_type, std::size_t bytes = 1, const std::string& to = "a") {
        Header head;
        head.entity = to;
        head.msg_type = msg_type;
        return admit(of, head, bytes, entities, clock);
    }

    ManualClock clock;
    SeededRandom random{1};
    OtherServers others{"", random, [](const std::string&) {}, [](Lane) {}};
    Entities entities{true, others.add({.name = "entity server", .timeouts = {}}), clock};
};

TEST_F(AdmissionTest, ClientsSayNeitherWhatEntitiesDoNorWhatIsForTheServer) {
    const auto ann = client();
    EXPECT_EQ(may(*ann, kMsgCollaboration).refusal().code, RefusalCode::PermissionDenied);
    EXPECT_EQ(may(*ann, kMsgGlobalServices).refusal().code, RefusalCode::PermissionDenied);
    EXPECT_TRUE(may(*ann, kMsgTask).ok());
    EXPECT_TRUE(may(*ann, "OF_A_LATER_EDITION").ok()) << "the Entity Manager's business";
}

TEST_F(AdmissionTest, OnlyTheHolderSendsMuch) {
    const auto ann = client();
    constexpr std::size_t kChunk = 128 * 1024;
    EXPECT_EQ(may(*ann, kMsgResource, kChunk + 1).refusal().code, RefusalCode::TooLarge);
    for (int i = 0; i < 8; ++i) EXPECT_TRUE(may(*ann, kMsgResource, kChunk).ok());
    EXPECT_EQ(may(*ann, kMsgResource, 1).refusal().code, RefusalCode::Overloaded);
    ann->entities.setHeld("a", true);
    EXPECT_TRUE(may(*ann, kMsgResource, 10 * kChunk).ok());
    EXPECT_EQ(may(*ann, kMsgResource, 1, "b").refusal().code, RefusalCode::Overloaded) << "of another one";
    clock.advance(1s);
    EXPECT_TRUE(may(*ann, kMsgResource, 1, "b").ok());
    EXPECT_EQ(may(*ann, kMsgResource, kChunk + 1, "b").refusal().code, RefusalCode::TooLarge);
}

TEST_F(AdmissionTest, OneThatHasAskedMaySendALargeMessageBeforeItsGrantIsKnownHere) {
    const auto ann = client();
    EXPECT_TRUE(may(*ann, kMsgCheckOut).value());
    EXPECT_TRUE(may(*ann, kMsgResource, 512 * 1024).ok());
}

TEST_F(AdmissionTest, TheFirstCheckOutOfAnEntityIsTheFirstAndNoObserversIsOne) {
    const auto ann = client();
    EXPECT_FALSE(may(*ann, kMsgWatch).value());
    EXPECT_TRUE(may(*ann, kMsgCheckOut).value());
    EXPECT_FALSE(may(*ann, kMsgCheckOut).value());
    EXPECT_TRUE(may(*ann, kMsgCheckOut, 1, "b").value());
    const auto guest = client(Role::Observer);
    EXPECT_FALSE(may(*guest, kMsgCheckOut).value());
    EXPECT_TRUE(guest->entities.asked("a")) << "it is told of the guest's end, too";
}

TEST_F(AdmissionTest, OneThatHasLeftAsksNobody) {
    const auto ann = client();
    ann->entities.take();
    EXPECT_EQ(may(*ann, kMsgCheckOut).refusal().code, RefusalCode::NotConnected);
    EXPECT_FALSE(ann->entities.asked("a"));
}

}  // namespace
}  // namespace axon::front_end_server
