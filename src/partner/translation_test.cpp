// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/translation.hpp"

#include <gmock/gmock.h>

namespace axon::partner {
namespace {

TEST(TranslationTest, AnEntityIsCalledAfterItsLaboratory) {
    EXPECT_EQ(nameAtHome("b", "PeopleBot"), "b/PeopleBot");
}

TEST(TranslationTest, WhatALaboratoryShowsForItsOwnPartnersIsNotShownAgain) {
    EXPECT_EQ(nameAtHome("b", "a/PeopleBot"), std::nullopt);
    EXPECT_EQ(nameAtHome("b", "/"), std::nullopt);
}

TEST(TranslationTest, ANameThatNoServerTakesIsNotShown) {
    EXPECT_EQ(nameAtHome("b", ""), std::nullopt);
    EXPECT_EQ(nameAtHome("b", "PeopleBot#2"), std::nullopt) << "the second of those that are called so";
    EXPECT_EQ(nameAtHome("b", std::string(1023, 'x')), std::nullopt);
    EXPECT_NE(nameAtHome("b", std::string(1022, 'x')), std::nullopt);
}

TEST(TranslationTest, ALaboratoryHasAPlainName) {
    EXPECT_TRUE(isLaboratoryName("lab-b_2"));
    for (const auto* wrong : {"", "a/b", "a b", "a@b", "an-extraordinarily-long-laboratory-name"})
        EXPECT_FALSE(isLaboratoryName(wrong)) << wrong;
}

TEST(TranslationTest, TheWholeNameOfAClientIsBehindTheLastAt) {
    EXPECT_EQ(displayName("a", "client1@desk"), "a@client1 at desk");
    EXPECT_EQ(displayName("a", "x"), "a@x");
}

TEST(TranslationTest, ASignalIsCalledByItsSenderAndNumber) {
    const auto id = SignalId::parse("fe1:start:uuid:17");
    ASSERT_TRUE(id);
    EXPECT_EQ(id->sender, "fe1:start:uuid");
    EXPECT_EQ(id->sequence, 17);
    EXPECT_EQ(id->text(), "fe1:start:uuid:17");
    for (const auto* wrong : {"", ":", ":1", "uuid", "uuid:", "uuid:1x", "uuid:99999999999999999999"})
        EXPECT_EQ(SignalId::parse(wrong), std::nullopt) << wrong;
}

TEST(TranslationTest, ARefusalNamesTheRequestAsItsEntityManagerWould) {
    proto::ToEntity message;
    message.mutable_check_out()->set_request_id("r");
    message.mutable_check_out()->set_phase(proto::COMMIT);
    auto answer = refused(message, {RefusalCode::UnknownEntity, "gone", {}});
    EXPECT_EQ(answer.check_out().request_id(), "r");
    EXPECT_EQ(answer.check_out().phase(), proto::COMMIT);
    EXPECT_EQ(answer.check_out().refusal().code(), proto::UNKNOWN_ENTITY);
    message.mutable_task()->set_task_id("t");
    answer = refused(message, {RefusalCode::Overloaded, "much", {}});
    EXPECT_EQ(answer.reply().request_id(), "t");
    EXPECT_EQ(answer.reply().refusal().message(), "much");
}

TEST(TranslationTest, AnObserverOfHomeIsOneThereWhateverTheAccountMay) {
    proto::ToEntity message;
    message.mutable_check_out();
    EXPECT_EQ(mayNotPass(message, Role::Observer, Role::Admin, false).code, RefusalCode::PermissionDenied);
    EXPECT_TRUE(mayNotPass(message, Role::Operator, Role::Operator, false).ok());
    message.mutable_watch();
    EXPECT_TRUE(mayNotPass(message, Role::Observer, Role::Operator, false).ok());
}

TEST(TranslationTest, OnlyAnAdministratorOfHomeForces) {
    proto::ToEntity message;
    message.mutable_check_out()->set_force(true);
    EXPECT_EQ(mayNotPass(message, Role::Operator, Role::Admin, false).code, RefusalCode::PermissionDenied);
    EXPECT_TRUE(mayNotPass(message, Role::Admin, Role::Admin, false).ok());
}

TEST(TranslationTest, TheAccountOfAnAdministratorRearmsForNoStranger) {
    proto::ToEntity message;
    message.mutable_rearm();
    EXPECT_EQ(mayNotPass(message, Role::Operator, Role::Admin, false).code, RefusalCode::NotHolder);
    EXPECT_TRUE(mayNotPass(message, Role::Operator, Role::Admin, true).ok()) << "who holds it";
    EXPECT_TRUE(mayNotPass(message, Role::Operator, Role::Operator, false).ok())
        << "the Entity Manager says no";
}

TEST(TranslationTest, RunsAndDirectPathsAreRefused) {
    proto::ToEntity message;
    message.mutable_collaboration();
    EXPECT_EQ(mayNotPass(message, Role::Admin, Role::Admin, true).code, RefusalCode::NotSupported);
    message.mutable_from_master();
    EXPECT_EQ(mayNotPass(message, Role::Admin, Role::Admin, true).code, RefusalCode::PermissionDenied);
    message.mutable_way();
    EXPECT_EQ(mayNotPass(message, Role::Admin, Role::Admin, true).code, RefusalCode::NotSupported);
    EXPECT_EQ(mayNotPass({}, Role::Admin, Role::Admin, true).code, RefusalCode::NotSupported);
}

}  // namespace
}  // namespace axon::partner
