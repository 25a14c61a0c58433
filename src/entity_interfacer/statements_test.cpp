// SPDX-License-Identifier: MIT
#include "entity_interfacer/statements.hpp"

#include <axon/link.pb.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <vector>

namespace axon {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

struct TheStatements : testing::Test {
    void say(const std::string& service, bool active, const std::string& reason = {}) {
        statements.activeIs(service, active, reason, send);
    }
    void taken(const std::string& service, const std::string& parameter,
               const std::optional<std::string>& why_not = std::nullopt) {
        statements.valueTaken(service, parameter, why_not, send);
    }
    void linkBegins() {
        statements.repeat(send, [this] { sent.emplace_back("published"); });
    }
    /// What has been sent since it was asked last: "service on", "service off: why", "at x y z".
    std::vector<std::string> takeSent() { return std::exchange(sent, {}); }

    std::vector<std::string> sent;
    const Statements::Send send = [this](const proto::EiToEm& message) {
        const auto number = [](double value) { return ' ' + std::to_string(static_cast<int>(value)); };
        const auto& active = message.active();
        const auto& at = message.position();
        sent.push_back(message.has_position()
                           ? "at" + number(at.xpos()) + number(at.ypos()) + number(at.zpos())
                           : active.service() + (active.active() ? " on" : " off: " + active.reason()));
    };
    Statements statements;
};

TEST_F(TheStatements, ALinkHearsWhatWasSaidBeforeItAndOnlyThenDoOthersSend) {
    statements.positionIs(1, 2, 3);
    say("Driving", false, "charging");
    say("Looking", true);
    EXPECT_THAT(takeSent(), ElementsAre("Driving off: charging", "Looking on"));
    linkBegins();
    EXPECT_THAT(takeSent(), ElementsAre("at 1 2 3", "Driving off: charging", "Looking on", "published"));
}

TEST_F(TheStatements, OfWhatWasSaidTheNewestIsRepeated) {
    statements.positionIs(1, 2, 3);
    statements.positionIs(4, 5, 6);
    say("Driving", false, "charging");
    say("Driving", true);
    takeSent();
    linkBegins();
    EXPECT_THAT(takeSent(), ElementsAre("at 4 5 6", "Driving on", "published"));
}

TEST_F(TheStatements, AnApplicationThatHasSaidNothingRepeatsNothing) {
    linkBegins();
    EXPECT_THAT(takeSent(), ElementsAre("published"));
}

TEST_F(TheStatements, AServiceIsInactiveWhileAValueIsNotTakenWhateverTheApplicationSays) {
    taken("Driving", "speed", "too fast");
    EXPECT_THAT(takeSent(), ElementsAre("Driving off: too fast"));
    EXPECT_EQ(statements.whyNotTaken("Driving"), "too fast");
    say("Driving", true);
    EXPECT_THAT(takeSent(), ElementsAre("Driving off: too fast"));
    taken("Driving", "speed");
    EXPECT_THAT(takeSent(), ElementsAre("Driving on"));
    EXPECT_EQ(statements.whyNotTaken("Driving"), std::nullopt);
}

TEST_F(TheStatements, AServiceIsActiveAgainWhenTheLastOfItsValuesIsTaken) {
    taken("Driving", "speed", "too fast");
    taken("Driving", "turn", "too sharp");
    takeSent();
    taken("Driving", "speed");
    EXPECT_THAT(takeSent(), ElementsAre("Driving off: too sharp"));
    taken("Driving", "turn");
    EXPECT_THAT(takeSent(), ElementsAre("Driving on"));
}

TEST_F(TheStatements, AValueThatWasTakenBeforeChangesNothing) {
    taken("Driving", "speed");
    EXPECT_THAT(takeSent(), IsEmpty());
}

TEST_F(TheStatements, TheReasonOfTheApplicationComesFirst) {
    say("Driving", false, "charging");
    taken("Driving", "speed", "too fast");
    EXPECT_THAT(takeSent(), ElementsAre("Driving off: charging", "Driving off: charging"));
    EXPECT_EQ(statements.whyNotTaken("Driving"), "too fast");
}

TEST_F(TheStatements, ServicesThatWereSwitchedOffAreSaidAgainAfterAValueIsTaken) {
    say("drive", false, "charging");
    taken("Driving", "speed", "too fast");
    takeSent();
    taken("Driving", "speed");
    EXPECT_THAT(takeSent(), ElementsAre("Driving on", "drive off: charging"));
}

TEST_F(TheStatements, WhatTheLastLinkCouldNotTakeIsForgottenWithIt) {
    taken("Driving", "speed", "too fast");
    say("Driving", true);
    takeSent();
    linkBegins();
    EXPECT_THAT(takeSent(), ElementsAre("Driving on", "published"));
    EXPECT_EQ(statements.whyNotTaken("Driving"), std::nullopt);
}

TEST_F(TheStatements, AServiceWhoseNameBeginsLikeAnotherIsItsOwn) {
    taken("Driving fast", "speed", "too fast");
    EXPECT_EQ(statements.whyNotTaken("Driving"), std::nullopt);
}

}  // namespace
}  // namespace axon
