// SPDX-License-Identifier: GPL-2.0-or-later
// What is wrong with a request before anybody is asked. How runs go:
// entity_manager/core/collaboration/collaborations_test.cpp.
#include "collaboration/collaboration.hpp"

#include <gtest/gtest.h>

namespace axon::collaboration {
namespace {

const std::string kRoot(16, 'o');

struct Request {
    Request() {
        request.set_run_id(std::string(16, 'r'));
        for (const int role : {0, 1}) {
            auto& participant = *request.add_participants();
            participant.set_role(role);
            participant.set_entity("entity" + std::to_string(role));
            participant.set_name("Robot " + std::to_string(role));
            participant.mutable_lease()->set_root(kRoot);
            auto& step = *request.mutable_service()->add_steps();
            step.set_role(role);
            step.set_name("step" + std::to_string(role));
            step.set_preced(role);
            step.set_service_global_id("work");
        }
    }
    proto::GlobalStep& step(int index) { return *request.mutable_service()->mutable_steps(index); }
    std::string problems() const {
        std::string all;
        for (const auto& problem : Collaboration::problemsOf(request, "entity0", kRoot))
            all += problem.refusal().message() + '\n';
        return all;
    }
    proto::CollaborationRequest request;
};

TEST(CollaborationRequest, IsGoodAsItIs) {
    EXPECT_EQ(Request().problems(), "");
}

TEST(CollaborationRequest, NeedsEachRoleOnceAndEachEntityOnce) {
    Request twice;
    twice.request.mutable_participants(1)->set_role(0);
    EXPECT_NE(twice.problems().find("Role 0 is given to two entities"), std::string::npos);
    EXPECT_NE(twice.problems().find("Nobody has role 1"), std::string::npos);
    Request same;
    same.request.mutable_participants(1)->set_entity("entity0");
    EXPECT_NE(same.problems().find("has two roles"), std::string::npos);
    Request idle;
    idle.step(1).set_role(0);
    EXPECT_NE(idle.problems().find("Role 1 has no step"), std::string::npos);
}

TEST(CollaborationRequest, NeedsAMasterThatTakesPartAndOneRoot) {
    Request request;
    EXPECT_EQ(Collaboration::problemsOf(request.request, "entity1", kRoot).size(), 0U);
    EXPECT_EQ(Collaboration::problemsOf(request.request, "entity9", kRoot).size(), 1U);
    request.request.mutable_participants(1)->mutable_lease()->set_root(std::string(16, 'x'));
    const auto problems = Collaboration::problemsOf(request.request, "entity0", kRoot);
    ASSERT_EQ(problems.size(), 1U);
    EXPECT_EQ(problems[0].refusal().code(), proto::NOT_HOLDER);
    EXPECT_EQ(problems[0].entity(), "Robot 1");
    EXPECT_EQ(Collaboration::problemsOf(Request().request, "entity0", "").size(), 2U);
}

TEST(CollaborationRequest, TakesInputsOnlyOfEarlierSteps) {
    Request request;
    auto& source = *request.step(1).add_sources();
    source.set_param("Target");
    source.set_step("step0");
    source.set_output("Position");
    EXPECT_EQ(request.problems(), "");
    request.step(1).set_preced(0);
    EXPECT_NE(request.problems().find("which has not ended by then"), std::string::npos);
    source.set_step("nothing");
    EXPECT_NE(request.problems().find("which does not exist"), std::string::npos);
}

TEST(CollaborationRequest, HasABound) {
    Request request;
    request.request.mutable_service()->clear_steps();
    EXPECT_NE(request.problems().find("has no steps"), std::string::npos);
    for (int i = 0; i <= kStepsMax; ++i) request.request.mutable_service()->add_steps();
    EXPECT_NE(request.problems().find("at most 1000"), std::string::npos);
}

}  // namespace
}  // namespace axon::collaboration
