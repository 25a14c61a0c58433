// SPDX-License-Identifier: GPL-2.0-or-later
#include "collaboration/bindings.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <random>

namespace axon::collaboration {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::Not;

Candidate robot(const std::string& name, std::vector<std::string> services = {"drive"}) {
    Candidate candidate;
    candidate.entity = "uuid of " + name;
    candidate.name = name;
    candidate.category = "ROBOT";
    candidate.type = "MOBILE";
    candidate.state = EntityState::IDLE;
    for (auto& service : services) candidate.offers.push_back({service, service, true, {}});
    return candidate;
}

Role role(int number, std::vector<std::string> services = {"drive"}) {
    Role wanted{number, "ROBOT", "MOBILE", {}};
    for (auto& service : services) wanted.needs.push_back({service, {}});
    return wanted;
}

std::vector<std::string> players(const Proposal& proposal) {
    std::vector<std::string> names;
    for (const auto& outlook : proposal.roles) names.push_back(outlook.name);
    return names;
}

}  // namespace

TEST(Bindings, EachRoleHasAnEntityOfItsOwnInOrder) {
    const auto proposal = propose({role(1), role(0)}, {robot("B"), robot("A")});
    EXPECT_TRUE(proposal.complete());
    EXPECT_THAT(players(proposal), ElementsAre("A", "B"));
    EXPECT_EQ(proposal.roles[0].role, 0);
    EXPECT_EQ(proposal.roles[0].entity, "uuid of A");
    EXPECT_EQ(proposal.roles[0].wanted, "ROBOT/MOBILE with drive");
}

TEST(Bindings, WhatIsHeldAlreadyComesFirst) {
    auto held = robot("Z");
    held.held_here = true;
    held.holder = "me";
    held.state = EntityState::REG;
    EXPECT_THAT(players(propose({role(0)}, {robot("A"), held})), ElementsAre("Z"));
    EXPECT_THAT(players(propose({role(0), role(1)}, {robot("A"), held})), ElementsAre("Z", "A"));
}

TEST(Bindings, TheOnlyOneForARoleIsNotSpentOnAnother) {
    // A can do both, B only drives: A must not drive.
    const auto proposal = propose({role(0), role(1, {"look"})}, {robot("A", {"drive", "look"}), robot("B")});
    EXPECT_THAT(players(proposal), ElementsAre("B", "A"));
}

TEST(Bindings, AChoiceIsKeptTo) {
    const std::map<int, std::string> chosen{{1, "uuid of A"}};
    EXPECT_THAT(players(propose({role(0), role(1)}, {robot("A"), robot("B")}, chosen)),
                ElementsAre("B", "A"));
}

TEST(Bindings, AChoiceIsCheckedLikeAnythingElse) {
    auto taken = robot("A");
    taken.holder = "ana@lab";
    taken.state = EntityState::REG;
    const auto proposal = propose({role(0)}, {taken, robot("B")}, {{0, "uuid of A"}});
    EXPECT_FALSE(proposal.complete());
    EXPECT_EQ(proposal.why.code, RefusalCode::AlreadyHeld);
    EXPECT_EQ(proposal.why.holder, "ana@lab");
    EXPECT_EQ(proposal.why.message, "role 0 (ROBOT/MOBILE): A is held by ana@lab");
}

TEST(Bindings, OneEntityChosenForTwoRolesIsSaid) {
    const auto proposal =
        propose({role(0), role(1)}, {robot("A"), robot("B")}, {{0, "uuid of A"}, {1, "uuid of A"}});
    EXPECT_EQ(proposal.why.message, "role 1 (ROBOT/MOBILE): A was chosen for another role as well");
}

TEST(Bindings, TheReasonSaysRoleByRoleWhatTheNearestLack) {
    auto latched = robot("A");
    latched.latched = true;
    auto away = robot("B");
    away.state = EntityState::UNAV;
    auto inactive = robot("C");
    inactive.offers[0].active = false;
    auto incomplete = robot("D");
    incomplete.offers[0].missing = {"Distance", "Map"};
    auto arm = robot("E", {"grab"});
    arm.type = "STATIONARY";
    const auto proposal = propose({role(0), role(1, {"fly"})}, {arm, incomplete, inactive, away, latched});
    EXPECT_THAT(players(proposal), ElementsAre("", ""));
    EXPECT_EQ(proposal.why.code, RefusalCode::Latched);
    EXPECT_EQ(
        proposal.why.message,
        "role 0 (ROBOT/MOBILE): A was stopped and is not rearmed; B is UNAV; D lacks Distance and Map of "
        "drive; and 1 more\n"
        "role 1 (ROBOT/MOBILE): nobody offers fly; A does not offer fly, and was stopped and is not "
        "rearmed; B does not offer fly, and is UNAV; C does not offer fly; and 1 more");
    EXPECT_THAT(proposal.nobody_offers, ElementsAre("fly"));
    EXPECT_EQ(proposal.roles[0].unfit.back().name, "E");
    EXPECT_EQ(proposal.roles[0].unfit.back().why.message, "is ROBOT/STATIONARY, and does not offer drive");
}

TEST(Bindings, WhatAStepGivesIsNotMissing) {
    auto incomplete = robot("A");
    incomplete.offers[0].missing = {"Distance"};
    auto wanted = role(0);
    wanted.needs[0].given = {"Distance"};
    EXPECT_TRUE(propose({wanted}, {incomplete}).complete());
    incomplete.offers[0].missing.push_back("Map");
    EXPECT_THAT(propose({wanted}, {incomplete}).why.message, HasSubstr("A lacks Map of drive"));
}

TEST(Bindings, TooFewAreToldAsSuch) {
    const auto proposal = propose({role(0), role(1)}, {robot("A")});
    EXPECT_THAT(players(proposal), ElementsAre("A", ""));
    EXPECT_EQ(proposal.why.code, RefusalCode::Unavailable);
    EXPECT_EQ(
        proposal.why.message,
        "role 1 (ROBOT/MOBILE): A plays other roles that nobody else can; one more such entity is missing");
    EXPECT_THAT(propose({role(0)}, {}).why.message, HasSubstr("there is no entity at all"));
}

/// Against every way of giving entities to roles: as many roles are played as can be, by who can, and as many
/// that are held as can be; and the order of what comes in makes no difference.
TEST(Bindings, NoOtherWayPlaysMoreRolesOrUsesMoreOfWhatIsHeld) {
    std::mt19937 dice(20);
    const auto chance = [&](int percent) { return static_cast<int>(dice() % 100) < percent; };
    for (int round = 0; round < 300; ++round) {
        const int services = 4;
        std::vector<Candidate> candidates;
        for (int c = 0; c < 5; ++c) {
            std::vector<std::string> offers;
            for (int s = 0; s < services; ++s) {
                if (chance(45)) offers.push_back("s" + std::to_string(s));
            }
            candidates.push_back(robot(std::string(1, static_cast<char>('A' + c)), offers));
            candidates.back().held_here = chance(40);
        }
        std::vector<Role> roles;
        for (int r = 0; r < 4; ++r) roles.push_back(role(r, {"s" + std::to_string(dice() % services)}));

        const auto can = [&](std::size_t r, std::size_t c) {
            return std::any_of(candidates[c].offers.begin(), candidates[c].offers.end(),
                               [&](const Offer& offer) { return offer.name == roles[r].needs[0].service; });
        };
        std::pair<int, int> best{0, 0};
        std::vector<bool> used(candidates.size(), false);
        const std::function<void(std::size_t, int, int)> tryAll = [&](std::size_t r, int played, int held) {
            if (r == roles.size()) {
                best = std::max(best, {played, held});
                return;
            }
            tryAll(r + 1, played, held);
            for (std::size_t c = 0; c < candidates.size(); ++c) {
                if (used[c] || !can(r, c)) continue;
                used[c] = true;
                tryAll(r + 1, played + 1, held + (candidates[c].held_here ? 1 : 0));
                used[c] = false;
            }
        };
        tryAll(0, 0, 0);

        const auto proposal = propose(roles, candidates);
        std::pair<int, int> got{0, 0};
        std::vector<std::string> names;
        for (std::size_t r = 0; r < roles.size(); ++r) {
            const auto& name = proposal.roles[r].name;
            if (name.empty()) continue;
            const auto c = static_cast<std::size_t>(name[0] - 'A');
            EXPECT_TRUE(can(r, c));
            EXPECT_THAT(names, Not(testing::Contains(name)));
            names.push_back(name);
            ++got.first;
            got.second += candidates[c].held_here ? 1 : 0;
        }
        EXPECT_EQ(got, best) << "round " << round;
        EXPECT_EQ(proposal.complete(), got.first == 4);
        std::shuffle(candidates.begin(), candidates.end(), dice);
        EXPECT_EQ(players(propose(roles, candidates)), players(proposal));
    }
}

}  // namespace axon::collaboration
