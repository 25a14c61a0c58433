// SPDX-License-Identifier: GPL-2.0-or-later
// Which request a message is, and what is refused before the state table is asked, without the rest of the
// Entity Manager. Who may send which kind is claimed in rights_test.cpp.
#include "entity_manager/core/request_reader.hpp"

#include <gtest/gtest.h>

#include "tests/support/core_rig.hpp"
#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

struct RequestReaders : testing::Test {
    RequestReaders() { head.sender = {"client", "Ada", Role::Operator}; }
    void hold() {
        turn.lease.emplace().number = {1, 2};
        turn.lease->holder = head.sender;
        head.held = {1, 2};
    }
    std::optional<RequestReader::Request> read(const char* type, const proto::ToEntity& message,
                                               bool partner = false) {
        head.msg_type = type;
        bytes = message.SerializeAsString();
        return reader.read(head, bytes, partner);
    }
    static proto::ToEntity text(std::size_t size) {
        proto::ToEntity message;
        message.mutable_text()->set_text(std::string(size, 'x'));
        return message;
    }

    Header head;
    std::string bytes;
    test::FakeTurn turn;
    test::MemoryJournal journal;
    JournalWriter writer{turn, &journal};
    RequestReader reader{turn, writer};
};

TEST_F(RequestReaders, AMessageIsTheRequestOfItsBody) {
    const auto request = read(kMsgText, text(5));
    ASSERT_TRUE(request);
    EXPECT_EQ(request->event, Event::Text);
    EXPECT_EQ(request->right->who, Who::Holder);
    EXPECT_EQ(request->body->text().text(), "xxxxx");
    EXPECT_TRUE(turn.replies.empty() && turn.refused.empty());
}

TEST_F(RequestReaders, ActionsOfATaskAreThreeRequestsAndAnUnknownOneIsNone) {
    proto::ToEntity control;
    const auto eventOf = [&](proto::TaskAction action) {
        control.mutable_task_control()->set_action(action);
        const auto request = read(kMsgTaskControl, control);
        return request ? request->event : Event::LinkUp;
    };
    EXPECT_EQ(eventOf(proto::PAUSE), Event::Pause);
    EXPECT_EQ(eventOf(proto::RESUME), Event::Resume);
    EXPECT_EQ(eventOf(proto::CANCEL), Event::Cancel);
    EXPECT_EQ(eventOf(static_cast<proto::TaskAction>(77)), Event::Quit);
}

TEST_F(RequestReaders, WhatCannotBeReadIsRefusedAndCounted) {
    head.msg_type = kMsgText;
    EXPECT_FALSE(reader.read(head, "\xff\xff\xff", false));
    ASSERT_EQ(turn.replies.size(), 1U);
    EXPECT_EQ(turn.replies[0].code, RefusalCode::Malformed);
    EXPECT_EQ(turn.counted.malformed, 1U);
    ASSERT_EQ(journal.mentioned.size(), 1U);
    EXPECT_EQ(journal.mentioned[0].kind, JournalRecord::Kind::Refused);
    EXPECT_EQ(journal.mentioned[0].client, "client");
    EXPECT_EQ(journal.mentioned[0].code, "MALFORMED");
}

TEST_F(RequestReaders, AKindThatThisEditionDoesNotKnowIsRefusedAndNotMalformed) {
    EXPECT_FALSE(read("OF_THE_FUTURE", {}));
    ASSERT_EQ(turn.replies.size(), 1U);
    EXPECT_EQ(turn.replies[0].code, RefusalCode::NotSupported);
    EXPECT_EQ(turn.counted.malformed, 0U);
}

TEST_F(RequestReaders, AHeaderThatSaysAnotherKindIsRefusedInTheKindOfTheRequest) {
    EXPECT_FALSE(read(kMsgRearm, text(5)));
    EXPECT_TRUE(turn.replies.empty());
    ASSERT_EQ(turn.refused.size(), 1U);
    EXPECT_EQ(turn.refused[0].code, RefusalCode::Malformed);
    EXPECT_EQ(turn.counted.malformed, 1U);
}

TEST_F(RequestReaders, AMessageOfARunIsReadUnlessItIsTheHolders) {
    proto::ToEntity message;
    message.mutable_from_master()->set_run_id("run");
    EXPECT_TRUE(read(kMsgCollaboration, message));
    hold();
    EXPECT_FALSE(read(kMsgCollaboration, message));
    ASSERT_EQ(turn.replies.size(), 1U);
    EXPECT_EQ(turn.replies[0].code, RefusalCode::Malformed);
}

TEST_F(RequestReaders, ALargeMessageIsReadOfTheHolderAndOfItsPartnersOnly) {
    EXPECT_FALSE(read(kMsgText, text(16 * 1024)));
    ASSERT_EQ(turn.replies.size(), 1U);
    EXPECT_EQ(turn.replies[0].code, RefusalCode::NotHolder);
    EXPECT_TRUE(read(kMsgText, text(16 * 1024), true)) << "a partner in a run";
    EXPECT_TRUE(read(kMsgText, text(16 * 1000))) << "not large";
    hold();
    EXPECT_TRUE(read(kMsgText, text(16 * 1024)));
    head.held = {1, 1};
    EXPECT_FALSE(read(kMsgText, text(16 * 1024))) << "under an earlier lease";
    EXPECT_EQ(turn.counted.malformed, 0U);
}

TEST_F(RequestReaders, AnUnknownActionIsMalformedToTheHolderAndToOthersTheirOwnFault) {
    proto::ToEntity control;
    control.mutable_task_control()->set_action(static_cast<proto::TaskAction>(77));
    auto request = read(kMsgTaskControl, control);
    ASSERT_TRUE(request);
    reader.refuseOther(head, *request);
    hold();
    request = read(kMsgTaskControl, control);
    ASSERT_TRUE(request);
    reader.refuseOther(head, *request);
    ASSERT_EQ(turn.replies.size(), 2U);
    EXPECT_EQ(turn.replies[0].code, RefusalCode::NotHolder);
    EXPECT_EQ(turn.replies[1].code, RefusalCode::Malformed);
}

TEST_F(RequestReaders, AMessageThatIsNoRequestToAnEntityManagerIsNotSupported) {
    proto::ToEntity services;
    services.mutable_global_services();
    const auto request = read(kMsgGlobalServices, services);
    ASSERT_TRUE(request);
    EXPECT_EQ(request->event, Event::Quit);
    reader.refuseOther(head, *request);
    ASSERT_EQ(turn.replies.size(), 1U);
    EXPECT_EQ(turn.replies[0].code, RefusalCode::NotSupported);
}

}  // namespace
}  // namespace axon::entity_manager
