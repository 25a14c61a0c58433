// SPDX-License-Identifier: GPL-2.0-or-later
// Runs of global services over several Entity Managers (thesis 3.3.1, 4.3; ADR 0019).
#include <gtest/gtest.h>

#include <algorithm>

#include "collaboration/sub_lease.hpp"
#include "entity_manager/core/services/service_profiler.hpp"
#include "tests/support/fleet.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using test::Fleet;
using test::globalService;
using test::idOf;
using What = Fleet::Happened::What;
using Order = std::vector<std::pair<std::size_t, std::string>>;

void expectAllAtRest(Fleet& fleet, EntityState state = EntityState::REG) {
    for (std::size_t i = 0; i < fleet.size(); ++i) {
        EXPECT_EQ(fleet.state(i), state) << "robot " << i;
        EXPECT_FALSE(fleet.moves(i)) << "robot " << i;
    }
}

Fleet::Outcome failing() {
    return {.lasts = 50ms, .verdict = proto::TASK_FAILED};
}

const std::vector<std::string> kDemo{"0 Driving 1", "1 Turning 1", "2 Sonar 2", "0 Light 3", "1 Turning 3"};

proto::GlobalService demo(proto::OnFailure on_failure = proto::STOP_ALL) {
    auto service = globalService(kDemo, on_failure);
    auto& distance = *service.mutable_steps(0)->add_params();
    distance.set_name("Distance");
    distance.add_values()->set_str("1000 mm");
    return service;
}

TEST(Collaboration, MakesNoDifferenceWhoTheMasterIs) {
    std::vector<Order> orders;
    for (std::size_t master = 0; master < 3; ++master) {
        Fleet fleet(3);
        fleet.launch(demo(), master);
        fleet.advance(2s);
        EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED) << fleet.told.reason.message();
        EXPECT_TRUE(fleet.told.in_order);
        EXPECT_EQ(fleet.told.steps.size(), 5U);
        for (const auto& [number, step] : fleet.told.steps)
            EXPECT_EQ(step.state(), proto::TASK_SUCCEEDED) << number;
        expectAllAtRest(fleet);
        auto order = fleet.order();
        ASSERT_EQ(order.size(), 5U);
        std::sort(order.begin(), order.begin() + 2);  // equal places: at the same time
        std::sort(order.begin() + 3, order.end());
        orders.push_back(order);
    }
    EXPECT_EQ(orders[0], orders[1]);
    EXPECT_EQ(orders[0], orders[2]);
    EXPECT_EQ(orders[0], (Order{{0, "Driving"}, {1, "Turning"}, {2, "Sonar"}, {0, "Light"}, {1, "Turning"}}));
}

TEST(Collaboration, ShowsTheStatesOfTheThesis) {
    Fleet fleet(3);
    fleet.launch(demo(), 2);
    fleet.advance(10ms);
    EXPECT_EQ(fleet.state(2), EntityState::COLLAB);
    EXPECT_EQ(fleet.state(0), EntityState::BUSY);
    fleet.advance(110ms);  // level 2: the master's own step
    EXPECT_EQ(fleet.state(2), EntityState::BUSY);
    EXPECT_EQ(fleet.state(0), EntityState::SLAVE);
    fleet.advance(100ms);
    EXPECT_EQ(fleet.state(2), EntityState::COLLAB);
}

/// Two robots, of which the master's journal lies on a disk that takes its time.
struct SlowJournalOfARun : testing::Test {
    Fleet fleet{2};
    SlowJournalOfARun() {
        journal().slow = true;
        fleet.launch(globalService({"0 Turning 1", "1 Turning 2"}), 0);
    }
    test::MemoryJournal& journal() { return fleet.rig(0).journal; }
    void answer() {
        journal().answerAll();
        fleet.rig(0).core().onStored();
    }
    /// The next life of the master takes the same run as one that it does not know, or refuses it.
    RefusalCode askedAgain() {
        journal().slow = false;
        auto& rig = fleet.rig(0);
        rig.restart();
        rig.makeIdle();
        rig.take("client1", "r2", std::string(16, 'o'));
        rig.rearm("client1", "again");
        fleet.launch(globalService({"0 Turning 1", "1 Turning 2"}), 0);
        fleet.advance(1s);
        return fleet.told.refused.code;
    }
};

TEST_F(SlowJournalOfARun, NobodyHearsOfARunBeforeItsEntryIsWritten) {
    fleet.advance(20s);
    EXPECT_EQ(fleet.state(0), EntityState::COLLAB);
    EXPECT_EQ(fleet.told.state, proto::RUN_CHECKING);
    EXPECT_EQ(fleet.state(1), EntityState::REG);
    EXPECT_TRUE(fleet.log.empty());
    proto::EiToEm works;
    works.mutable_status()->set_busy(true);
    fleet.rig(0).fromApplication(works);
    EXPECT_EQ(fleet.state(0), EntityState::BUSY) << "in which tasks are taken otherwise";
    fleet.rig(0).task("client1", "t1", "Turning");
    fleet.advance(10ms);
    EXPECT_TRUE(fleet.log.empty()) << "and nothing beside it";
    works.mutable_status()->set_busy(false);
    fleet.rig(0).fromApplication(works);
    journal().slow = false;  // the entries of its steps
    answer();
    fleet.advance(1s);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED) << fleet.told.reason.message();
    EXPECT_EQ(fleet.order().size(), 2U);
    EXPECT_EQ(askedAgain(), RefusalCode::Duplicate);
}

TEST_F(SlowJournalOfARun, ALifeThatEndsBeforeItHasBegunNothing) {
    EXPECT_EQ(askedAgain(), RefusalCode::Ok);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED) << fleet.told.reason.message();
    EXPECT_EQ(fleet.order().size(), 2U) << "once";
}

TEST_F(SlowJournalOfARun, WhatIsStoppedOrCancelledMeanwhileDoesNotBegin) {
    for (const bool stop : {true, false}) {
        Fleet one{2};
        one.rig(0).journal.slow = true;
        one.launch(globalService({"0 Turning 1", "1 Turning 2"}), 0);
        if (stop)
            one.stop(0);
        else
            one.control(0, "run", proto::CANCEL);
        one.advance(10ms);
        EXPECT_EQ(one.told.state, stop ? proto::RUN_STOPPED : proto::RUN_CANCELLED);
        EXPECT_EQ(one.state(0), EntityState::REG);
        one.rig(0).journal.answerAll();
        one.rig(0).core().onStored();
        one.advance(1s);
        EXPECT_TRUE(one.log.empty());
        EXPECT_EQ(one.state(1), EntityState::REG);
    }
}

TEST_F(SlowJournalOfARun, WhatCannotBeWrittenIsRefusedWithTheMend) {
    journal().full = true;
    answer();
    fleet.advance(10ms);
    EXPECT_EQ(fleet.told.state, proto::RUN_REFUSED);
    EXPECT_EQ(fleet.told.reason.code(), proto::OVERLOADED);
    EXPECT_EQ(fleet.state(0), EntityState::REG);
    fleet.advance(1s);
    EXPECT_TRUE(fleet.log.empty());
}

TEST(Collaboration, StepsOfOnePlaceRunAtTheSameTime) {
    Fleet fleet(3);
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1", "2 Turning 1"}), 0);
    fleet.advance(1s);
    ASSERT_EQ(fleet.log.size(), 6U);
    for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(fleet.log[i].what, What::Began);
}

TEST(Collaboration, AShortStepIsOneReportAndALongOneTwo) {
    for (const bool is_short : {true, false}) {
        Fleet fleet(2);
        fleet.behave = [&](auto, const auto&) { return Fleet::Outcome{.lasts = is_short ? 0ms : 100ms}; };
        std::vector<proto::StepReport> reports;
        fleet.lose = [&](auto, auto, const proto::ToEntity& message) {
            if (message.from_slave().has_report()) reports.push_back(message.from_slave().report());
            return false;
        };
        fleet.launch(globalService({"0 Turning 1", "1 Turning 2"}), 0);
        fleet.advance(500ms);
        EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED);
        ASSERT_EQ(reports.size(), is_short ? 1U : 2U);
        EXPECT_EQ(reports.front().event().state(), is_short ? proto::TASK_SUCCEEDED : proto::TASK_RUNNING);
        EXPECT_EQ(reports.back().event().state(), proto::TASK_SUCCEEDED);
        EXPECT_NEAR(reports.back().running_s(), is_short ? 0 : 0.1, 0.006);
        const auto& step = fleet.told.steps[1];
        EXPECT_NEAR(step.ended_s() - step.began_s(), is_short ? 0 : 0.1, 0.006) << "though it is told later";
    }
}

TEST(Collaboration, ARestBetweenTwoStepsIsToldOnlyIfItLasts) {
    Fleet fleet(2);
    fleet.behave = [](std::size_t robot, const auto&) {
        return Fleet::Outcome{.lasts = robot == 0 ? 100ms : 10ms};
    };
    std::vector<EntityState> told;
    const auto look = [&] {
        told.clear();
        for (const auto& status : std::exchange(fleet.rig(1).statuses, {})) told.push_back(status.state);
        return told;
    };
    using S = EntityState;
    look();
    fleet.launch(globalService({"1 Turning 1", "1 Turning 2", "0 Turning 3", "1 Turning 4"}), 0);
    fleet.advance(15ms);
    EXPECT_EQ(look(), (std::vector{S::SLAVE, S::BUSY}));
    fleet.advance(20ms);
    EXPECT_EQ(look(), (std::vector<S>{})) << "from the first step to the second, and 15 ms of a rest";
    EXPECT_EQ(fleet.state(1), S::SLAVE);
    fleet.advance(10ms);
    EXPECT_EQ(look(), (std::vector{S::SLAVE})) << "while the other's step lasts";
    fleet.advance(200ms);
    EXPECT_EQ(look(), (std::vector{S::BUSY, S::REG})) << "the run's end is told at once";
}

TEST(Collaboration, EventsOfStepsAloneAreTenMillisecondsApartAndThoseOfTheRunAtOnce) {
    Fleet fleet(8);
    std::vector<std::string> steps;
    for (int i = 0; i < 8; ++i) steps.push_back(std::to_string(i) + " Turning 1");
    fleet.behave = [](std::size_t robot, const auto&) {
        return Fleet::Outcome{.lasts = 5ms * static_cast<int>(robot + 1)};
    };
    fleet.launch(globalService(steps), 0);
    fleet.advance(500ms);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED);
    EXPECT_TRUE(fleet.told.in_order);
    EXPECT_EQ(fleet.told.events.back().second, fleet.log.back().at);
    const auto& events = fleet.told.events;
    EXPECT_GT(events.size(), 4U);
    for (std::size_t i = 1; i < events.size(); ++i)
        EXPECT_TRUE(events[i].first != events[i - 1].first || events[i].second >= events[i - 1].second + 10ms)
            << i;
    for (const auto& [number, step] : fleet.told.steps)
        EXPECT_EQ(step.state(), proto::TASK_SUCCEEDED) << number;
}

TEST(Collaboration, ThoseWithVeryDifferentWatchdogsWorkTogether) {
    for (const std::size_t master : {0U, 1U}) {
        Fleet fleet(2, 1, {50ms, 2s});
        fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 3s}; };
        fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), master);
        fleet.advance(3100ms);
        EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED) << fleet.told.reason.message();
        expectAllAtRest(fleet);
    }
}

TEST(Collaboration, CarriesAResultToALaterStep) {
    Fleet fleet(2);
    auto service = globalService({"0 Driving 1", "1 Driving 2"});
    auto& given = *service.mutable_steps(0)->add_params();
    given.set_name("Distance");
    given.add_values()->set_str("300");
    service.mutable_steps(0)->set_name("first");
    auto& source = *service.mutable_steps(1)->add_sources();
    source.set_param("Distance");
    source.set_step("first");
    source.set_output("Travelled");
    std::vector<proto::TaskDispatch> dispatched;
    fleet.behave = [&](std::size_t, const proto::TaskDispatch& dispatch) {
        dispatched.push_back(dispatch);
        return Fleet::Outcome{.results = {test::paramOf("Travelled=277")}};
    };
    fleet.launch(service, 1);
    fleet.advance(1s);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED);
    ASSERT_EQ(dispatched.size(), 2U);
    EXPECT_EQ(dispatched[0].params(0).values(0).int_(), 300);
    EXPECT_EQ(dispatched[1].params(0).values(0).int_(), 277);
    EXPECT_EQ(fleet.record(1).steps(1).params(0).values(0).int_(), 277);
}

TEST(Collaboration, AResultThatIsNotThereFailsTheStepThatNeedsIt) {
    Fleet fleet(2);
    auto service = globalService({"0 Driving 1", "1 Driving 2"});
    *service.mutable_steps(0)->add_params() = test::paramOf("Distance=300");
    service.mutable_steps(0)->set_name("first");
    auto& source = *service.mutable_steps(1)->add_sources();
    source.set_param("Distance");
    source.set_step("first");
    source.set_output("Travelled");
    fleet.launch(service, 0);  // it tells no result
    fleet.advance(1s);
    EXPECT_EQ(fleet.told.state, proto::RUN_FAILED);
    EXPECT_EQ(fleet.told.reason.code(), proto::MISSING_DEPENDENCY);
    expectAllAtRest(fleet);
}

TEST(Collaboration, AResultThatNoStepCanTellIsNamedBeforeAnythingMoves) {
    for (const auto& [output, code] :
         {std::pair("Height", proto::UNKNOWN_PARAMETER), {"Distance", proto::WRONG_TYPE}}) {
        Fleet fleet(2);
        auto service = globalService({"0 Driving 1", "1 Driving 2"});
        *service.mutable_steps(0)->add_params() = test::paramOf("Distance=300");
        service.mutable_steps(0)->set_name("first");
        auto& source = *service.mutable_steps(1)->add_sources();
        source.set_param("Distance");
        source.set_step("first");
        source.set_output(output);
        fleet.launch(service, 1);
        fleet.advance(1s);
        EXPECT_EQ(fleet.told.state, proto::RUN_REFUSED) << output;
        ASSERT_EQ(fleet.told.problems.size(), 1U) << output;
        EXPECT_EQ(fleet.told.problems[0].step(), 0);
        EXPECT_EQ(fleet.told.problems[0].refusal().code(), code)
            << fleet.told.problems[0].refusal().message();
        EXPECT_TRUE(fleet.log.empty()) << "nothing has moved";
    }
}

TEST(Collaboration, ATextThatAStepHasToldIsOneValueWhateverStandsInIt) {
    proto::ServicesProfile profile;
    auto& way = *profile.add_services()->add_params();
    profile.mutable_services(0)->set_name("Follow");
    way.set_name("Way");
    way.set_type(proto::INPUT);
    way.set_data_type(proto::STR);
    way.set_multiple(true);
    ServiceProfiler profiler;
    profiler.load(profile, "uuid", {});
    ServiceProfiler::Params given;
    given.Add()->set_name("Way");
    given.Mutable(0)->add_values()->set_str("7,3");
    EXPECT_EQ(profiler.typed("Follow", given).value().Get(0).values_size(), 2);
    EXPECT_EQ(profiler.typed("Follow", given, {"Way"}).value().Get(0).values_size(), 1);
}

TEST(Collaboration, NothingMovesBeforeEverythingIsPossibleAndAllThatIsNotIsNamed) {
    Fleet fleet(3);
    auto service =
        globalService({"0 Driving 1", "0 Turning 1", "1 Dancing 1", "1 Delivery 2", "2 Turning 1"});
    auto& wrong = *service.mutable_steps(0)->add_params();
    wrong.set_name("Distance");
    wrong.add_values()->set_str("far");
    for (const bool check_only : {true, false}) {
        auto request = fleet.request(service, 2, check_only ? "check" : "run");
        request.set_check_only(check_only);
        fleet.launch(request, 2);
        fleet.advance(100ms);
        EXPECT_EQ(fleet.told.state, proto::RUN_REFUSED);
        std::multiset<std::pair<int, proto::RefusalCode>> found;
        for (const auto& problem : fleet.told.problems)
            found.emplace(problem.step(), problem.refusal().code());
        EXPECT_EQ(found, (std::multiset<std::pair<int, proto::RefusalCode>>{{0, proto::WRONG_TYPE},
                                                                            {1, proto::BLOCKED},
                                                                            {2, proto::UNKNOWN_SERVICE},
                                                                            {3, proto::MISSING_DEPENDENCY}}));
        EXPECT_TRUE(fleet.log.empty());
        expectAllAtRest(fleet);
    }
}

TEST(Collaboration, OfMorePossibleProblemsThanAnybodyReadsTheFirstAreNamed) {
    Fleet fleet(1);
    std::vector<std::string> steps(20, "0 Turning 1");
    fleet.launch(globalService(steps), 0);
    EXPECT_EQ(fleet.told.problems.size(), 19U) << "one for each step that cannot run beside an earlier one";
    steps.assign(300, "0 Dancing 1");
    fleet.launch(globalService(steps), 0, "next");
    EXPECT_EQ(fleet.told.state, proto::RUN_REFUSED);
    ASSERT_LE(fleet.told.problems.size(), 51U);
    EXPECT_NE(fleet.told.problems.back().refusal().message().find("more"), std::string::npos);
}

TEST(Collaboration, OfALargeRunNoEventAndNoRecordIsTooLarge) {
    Fleet fleet(1);
    std::size_t largest = 0;
    const auto deliver = fleet.rig(0).on_client;
    fleet.rig(0).on_client = [&](const test::CoreRig::ToClientRecord& record) {
        largest = std::max(largest, record.message.ByteSizeLong());
        deliver(record);
    };
    fleet.behave = [](std::size_t, const proto::TaskDispatch& dispatch) {
        proto::Param large;
        large.set_name("Travelled");
        large.add_values()->set_str(std::string(dispatch.service() == "Sonar" ? 700'000 : 300'000, 'x'));
        return Fleet::Outcome{.results = {large}};
    };
    fleet.launch(globalService({"0 Sonar 1", "0 Light 1", "0 Turning 2", "0 Turning 3", "0 Sonar 4"}), 0);
    fleet.advance(350ms);
    EXPECT_EQ(fleet.told.state, proto::RUN_RUNNING);
    EXPECT_EQ(fleet.told.steps[0].results_size(), 0) << "left out";
    EXPECT_EQ(fleet.told.steps[0].state(), proto::TASK_SUCCEEDED);
    EXPECT_EQ(fleet.told.steps[1].results_size(), 1);
    EXPECT_LT(fleet.record(0).ByteSizeLong(), 128U * 1024);
    fleet.stop(0);
    EXPECT_EQ(fleet.told.state, proto::RUN_STOPPED);
    EXPECT_LT(largest, 768U * 1024);
}

TEST(Collaboration, ACheckMovesNothingAndLeavesNoTrace) {
    Fleet fleet(3);
    auto request = fleet.request(demo(), 0, "check");
    request.set_check_only(true);
    fleet.launch(request, 0);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED);
    EXPECT_TRUE(fleet.log.empty());
    EXPECT_TRUE(fleet.record(0).run_id().empty());
    expectAllAtRest(fleet);
    fleet.launch(demo(), 0, "check");  // the same id: a check has not used it up
    fleet.advance(1s);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED);
}

TEST(Collaboration, ARunIsBegunOnceHoweverOftenItIsAskedFor) {
    Fleet fleet(3);
    const auto request = fleet.request(demo(), 0, "run");
    fleet.launch(request, 0);
    proto::ToEntity copy;
    *copy.mutable_collaboration() = request;
    fleet.rig(0).send("client1", copy);
    EXPECT_TRUE(fleet.told.refused.ok()) << "it is being carried out";
    fleet.advance(2s);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED);
    fleet.launch(request, 0);
    fleet.advance(1s);
    EXPECT_EQ(fleet.told.refused.code, RefusalCode::Duplicate);
    EXPECT_TRUE(fleet.log.empty());
    fleet.rig(0).restart();
    fleet.rig(0).makeIdle();
    fleet.rig(0).take("client1", "r2", std::string(16, 'o'));
    fleet.rig(0).rearm("client1", "again");
    fleet.launch(request, 0);
    EXPECT_EQ(fleet.told.refused.code, RefusalCode::Duplicate);
}

TEST(Collaboration, AnEntityThatDoesNotAnswerIsNamed) {
    Fleet fleet(3);
    fleet.cut(1);
    fleet.launch(demo(), 0);
    fleet.advance(6s);
    EXPECT_EQ(fleet.told.state, proto::RUN_REFUSED);
    ASSERT_EQ(fleet.told.problems.size(), 1U);
    EXPECT_EQ(fleet.told.problems[0].entity(), "Robot 1");
    EXPECT_EQ(fleet.told.problems[0].refusal().code(), proto::TIMED_OUT);
    EXPECT_TRUE(fleet.log.empty());
    EXPECT_EQ(fleet.state(2), EntityState::REG);
}

struct SubLeases : testing::Test {
    /// The refusal of robot 1 when its sub-lease is changed so.
    Refusal refusalOf(const std::function<void(proto::SubLease&, proto::CollaborationRequest&)>& change) {
        auto request = fleet.request(demo(), 0, "run" + std::to_string(++runs));
        change(*request.mutable_participants(1)->mutable_lease(), request);
        fleet.launch(request, 0);
        fleet.advance(100ms);
        EXPECT_EQ(fleet.told.state, proto::RUN_REFUSED);
        EXPECT_TRUE(fleet.log.empty());
        if (fleet.told.problems.empty()) return {};
        EXPECT_EQ(fleet.told.problems[0].entity(), "Robot 1");
        return {static_cast<RefusalCode>(fleet.told.problems[0].refusal().code()), {}, {}};
    }
    void reseal(proto::SubLease& lease, const proto::CollaborationRequest& request, const std::string& key) {
        collaboration::seal(lease, {request.run_id(), fleet.uuid(0), fleet.uuid(1)}, key);
    }
    std::string key() { return fleet.rig(1).clients["client1"].key; }
    Fleet fleet{3};
    int runs = 0;
};

TEST_F(SubLeases, OfAnotherRootAreRefused) {
    proto::ToEntity release;
    release.mutable_release();
    fleet.rig(1).send("client1", release);
    fleet.rig(1).take("client1", "r9", std::string(16, 'x'));
    fleet.advance(10ms);
    EXPECT_EQ(refusalOf([](auto&, auto&) {}).code, RefusalCode::NotHolder);
}

TEST_F(SubLeases, OfAnOlderLeaseAreRefused) {
    const auto old = fleet.request(demo(), 0, "run");
    proto::ToEntity release;
    release.mutable_release();
    fleet.rig(1).send("client1", release);
    fleet.rig(1).take("client1", "r9", std::string(16, 'o'));
    fleet.advance(10ms);
    EXPECT_EQ(refusalOf([&](proto::SubLease& lease, auto& request) {
                  lease = old.participants(1).lease();
                  reseal(lease, request, key());
              }).code,
              RefusalCode::OlderLease);
}

TEST_F(SubLeases, ForAnotherMasterOrRunOrUnderAnotherKeyAreRefused) {
    EXPECT_EQ(refusalOf([&](proto::SubLease& lease, auto& request) {
                  collaboration::seal(lease, {request.run_id(), fleet.uuid(2), fleet.uuid(1)}, key());
              }).code,
              RefusalCode::NotHolder);
    EXPECT_EQ(refusalOf([&](proto::SubLease& lease, auto&) {
                  collaboration::seal(lease, {idOf("other"), fleet.uuid(0), fleet.uuid(1)}, key());
              }).code,
              RefusalCode::NotHolder);
    EXPECT_EQ(refusalOf([&](proto::SubLease& lease, auto& request) {
                  reseal(lease, request, std::string(16, '?'));
              }).code,
              RefusalCode::NotHolder);
}

TEST_F(SubLeases, FromBeforeAStopAreRefused) {
    const auto old = fleet.request(demo(), 0, "run");
    fleet.stop(1);
    fleet.rig(1).rearm("client1", "rearm");
    EXPECT_EQ(refusalOf([&](proto::SubLease& lease, auto& request) {
                  lease = old.participants(1).lease();
                  reseal(lease, request, key());
              }).code,
              RefusalCode::OldGeneration);
}

TEST_F(SubLeases, OfARunThatIsOverAreRefused) {
    proto::ToEntity invitation;
    fleet.lose = [&](std::size_t, std::size_t to, const proto::ToEntity& message) {
        if (to == 1 && message.from_master().has_invitation()) invitation = message;
        return false;
    };
    fleet.launch(demo(), 0);
    fleet.advance(2s);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED);
    proto::FromSlave answer;
    fleet.lose = [&](std::size_t from, std::size_t, const proto::ToEntity& message) {
        if (from == 1 && message.from_slave().has_answer()) answer = message.from_slave();
        return false;
    };
    Header head;
    head.entity = fleet.uuid(1);
    head.sender = {fleet.uuid(0), "Robot 0", Role::Operator};
    head.msg_type = kMsgCollaboration;
    fleet.rig(1).core().onClientMsg(head, invitation.SerializeAsString());
    ASSERT_EQ(answer.answer().problems_size(), 1);
    EXPECT_EQ(answer.answer().problems(0).refusal().code(), proto::DUPLICATE);
    EXPECT_EQ(fleet.state(1), EntityState::REG);
}

TEST_F(SubLeases, OfALatchedEntityAreRefused) {
    fleet.stop(1);
    EXPECT_EQ(refusalOf([](auto&, auto&) {}).code, RefusalCode::Latched);
}

TEST_F(SubLeases, AStrangerGivesNoOrders) {
    fleet.launch(demo(), 0);
    fleet.advance(10ms);
    fleet.log.clear();
    proto::ToEntity message;
    auto& from = *message.mutable_from_master();
    from.set_run_id(idOf("run"));
    from.mutable_order()->set_step(4);
    from.mutable_order()->mutable_task()->set_task_id(idOf("step"));
    from.mutable_order()->mutable_task()->set_service("Light");
    Header head;
    head.entity = fleet.uuid(1);
    head.msg_type = kMsgCollaboration;
    for (const auto& who : {fleet.uuid(2), std::string("client1"), std::string("stranger")}) {
        head.sender = {who, who, Role::Operator};
        fleet.rig(1).core().onClientMsg(head, message.SerializeAsString());
    }
    fleet.rig(1).task("client1", "own", "Light");
    for (const auto& event : fleet.log) EXPECT_NE(event.service, "Light");
    EXPECT_EQ(fleet.rig(1).to_clients.back().message.task().reason().code(), proto::WRONG_STATE);
}

TEST(Collaboration, AFailedStepStopsEverybody) {
    for (std::size_t master = 0; master < 3; ++master) {
        Fleet fleet(3);
        fleet.behave = [](std::size_t robot, const proto::TaskDispatch&) {
            return robot == 1 ? failing() : Fleet::Outcome{.lasts = 10s};
        };
        fleet.launch(globalService({"0 Turning 1", "1 Turning 1", "2 Turning 1", "0 Turning 2"}), master);
        fleet.advance(200ms);
        EXPECT_EQ(fleet.told.state, proto::RUN_FAILED);
        EXPECT_NE(fleet.told.reason.message().find("Robot 1"), std::string::npos);
        EXPECT_EQ(fleet.order().size(), 3U);
        expectAllAtRest(fleet);
        for (std::size_t i = 0; i < 3; ++i) EXPECT_FALSE(fleet.rig(i).core().latched());
    }
}

TEST(Collaboration, HeldOthersWaitAndTheFailedStepIsTriedAgain) {
    Fleet fleet(3);
    int tries = 0;
    fleet.behave = [&](std::size_t robot, const proto::TaskDispatch&) {
        if (robot == 1) return ++tries == 1 ? failing() : Fleet::Outcome{};
        return Fleet::Outcome{.lasts = 500ms};
    };
    auto service =
        globalService({"0 Driving 1", "1 Turning 1", "2 Turning 1", "1 Light 2"}, proto::HOLD_OTHERS);
    auto& distance = *service.mutable_steps(0)->add_params();
    distance.set_name("Distance");
    distance.add_values()->set_int_(100);
    fleet.launch(service, 2);
    fleet.advance(5s);
    EXPECT_EQ(fleet.told.state, proto::RUN_HELD);
    EXPECT_EQ(fleet.told.steps[0].state(), proto::TASK_PAUSED);     // Driving can be paused,
    EXPECT_EQ(fleet.told.steps[2].state(), proto::TASK_CANCELLED);  // Turning cannot
    EXPECT_EQ(fleet.told.steps[1].state(), proto::TASK_FAILED);
    fleet.control(2, "run", proto::RESUME);
    fleet.advance(2s);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED) << fleet.told.reason.message();
    EXPECT_EQ(fleet.told.steps[0].tries(), 1U);
    EXPECT_EQ(fleet.told.steps[1].tries(), 2U);
    EXPECT_EQ(fleet.told.steps[2].tries(), 2U);
    expectAllAtRest(fleet);
}

TEST(Collaboration, CompensationRunsOnceEverythingHasEnded) {
    Fleet fleet(3);
    fleet.behave = [](std::size_t robot, const proto::TaskDispatch& dispatch) {
        if (dispatch.service() == "Light") return Fleet::Outcome{};
        return robot == 1 ? failing() : Fleet::Outcome{.lasts = 10s};
    };
    auto service = globalService({"0 Turning 1", "1 Turning 1", "2 Turning 2"}, proto::COMPENSATE);
    for (const int role : {0, 2}) {
        auto& step = *service.add_compensation();
        step.set_role(role);
        step.set_service_global_id("Light");
    }
    fleet.launch(service, 0);
    fleet.advance(2s);
    EXPECT_EQ(fleet.told.state, proto::RUN_FAILED);
    EXPECT_EQ(fleet.told.steps[0].state(), proto::TASK_CANCELLED);
    EXPECT_EQ(fleet.told.steps[3].state(), proto::TASK_SUCCEEDED);
    EXPECT_EQ(fleet.told.steps[4].state(), proto::TASK_SUCCEEDED);
    EXPECT_EQ(fleet.told.steps[2].state(), proto::TASK_UNSPECIFIED);
    expectAllAtRest(fleet);
}

TEST(Collaboration, AStopOfAnyStopsAllAndLatchesThatOne) {
    for (const auto policy : {proto::STOP_ALL, proto::HOLD_OTHERS, proto::COMPENSATE})
        for (std::size_t stopped = 0; stopped < 3; ++stopped) {
            Fleet fleet(3);
            fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 10s}; };
            fleet.launch(globalService({"0 Turning 1", "1 Turning 1", "2 Turning 1"}, policy), 0);
            fleet.advance(100ms);
            fleet.stop(stopped);
            EXPECT_EQ(fleet.told.state, proto::RUN_STOPPED) << stopped;
            expectAllAtRest(fleet);
            for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(fleet.rig(i).core().latched(), i == stopped);
            EXPECT_EQ(fleet.record(0).state(), proto::RUN_STOPPED);
        }
}

TEST(Collaboration, AStepThatSomebodyStoppedStopsAllWhateverThePolicy) {
    for (const auto policy : {proto::STOP_ALL, proto::HOLD_OTHERS, proto::COMPENSATE})
        for (const bool reset : {false, true}) {
            Fleet fleet(2);
            fleet.behave = [&](std::size_t robot, const proto::TaskDispatch&) {
                if (robot == 1 && !reset)
                    return Fleet::Outcome{.lasts = 50ms, .verdict = proto::TASK_STOPPED};
                return Fleet::Outcome{.lasts = 10s};
            };
            auto service = globalService({"0 Turning 1", "1 Turning 1"}, policy);
            service.add_compensation()->set_role(0);
            service.mutable_compensation(0)->set_service_global_id("Light");
            fleet.launch(service, 0);
            fleet.advance(30ms);
            if (reset) fleet.rig(1).reset("client1");
            fleet.advance(100ms);
            EXPECT_EQ(fleet.told.state, proto::RUN_STOPPED) << policy << reset << fleet.told.reason.message();
            for (const auto& [robot, name] : fleet.order()) EXPECT_NE(name, "Light");
            expectAllAtRest(fleet);
        }
}

TEST(Collaboration, AStopIsAStopThoughTheWordOfItWasLost) {
    for (const bool forgotten : {false, true}) {
        Fleet fleet(2);
        fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 10s}; };
        int lost = 0;
        fleet.lose = [&](std::size_t from, std::size_t, const proto::ToEntity& message) {
            return from == 1 && message.from_slave().has_departure() && ++lost == 1;
        };
        auto service = globalService({"0 Turning 1", "1 Turning 1"}, proto::COMPENSATE);
        service.add_compensation()->set_role(0);
        service.mutable_compensation(0)->set_service_global_id("Light");
        fleet.launch(service, 0);
        fleet.advance(100ms);
        if (forgotten) {
            fleet.rig(1).restart();
            fleet.rig(1).makeIdle();
            lost = 1;
        } else {
            fleet.stop(1);
        }
        fleet.advance(100ms);
        EXPECT_EQ(fleet.told.state, proto::RUN_STOPPED) << forgotten;
        EXPECT_EQ(fleet.told.reason.code(), forgotten ? proto::NOT_HOLDER : proto::STOPPED);
        EXPECT_FALSE(fleet.moves(0));
        EXPECT_EQ(fleet.state(0), EntityState::REG);
    }
}

TEST(Collaboration, ReleaseClearAndALostApplicationEndItForAll) {
    for (const int way : {0, 1, 2, 3})
        for (std::size_t robot = 0; robot < 2; ++robot) {
            Fleet fleet(2);
            fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 10s}; };
            fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), 0);
            fleet.advance(100ms);
            auto& rig = fleet.rig(robot);
            if (way == 0) {
                proto::ToEntity release;
                release.mutable_release();
                rig.send("client1", release);
            }
            if (way == 1) rig.clear("client1");
            if (way == 2) rig.core().onLinkDown("it has crashed");
            if (way == 3) rig.core().onServerDown("it has crashed");
            fleet.advance(300ms);
            const auto other = 1 - robot;
            EXPECT_FALSE(fleet.moves(other)) << way << robot;
            EXPECT_EQ(fleet.state(other), EntityState::REG) << way << robot;
            if (way == 3) fleet.rig(robot).core().onServerUp();
            EXPECT_GE(fleet.record(0).state(), proto::RUN_FAILED) << way << robot;
        }
}

TEST(Collaboration, TheClientIsToldHowItEndsHoweverTheMasterGoes) {
    for (const int way : {0, 1, 2, 3}) {
        Fleet fleet(2);
        fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 10s}; };
        fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), 0);
        fleet.advance(100ms);
        auto& rig = fleet.rig(0);
        if (way == 0) {
            proto::ToEntity release;
            release.mutable_release();
            rig.send("client1", release);
        }
        if (way == 1) rig.core().onLinkDown("it has crashed");
        if (way == 2) rig.core().shutDown();
        if (way == 3) {
            proto::ToEntity force;
            force.mutable_check_out()->set_request_id(idOf("force"));
            force.mutable_check_out()->set_phase(proto::TAKE);
            force.mutable_check_out()->set_force(true);
            rig.send("admin", force);
        }
        EXPECT_EQ(fleet.told.state, way == 1 || way == 2 ? proto::RUN_FAILED : proto::RUN_STOPPED) << way;
        EXPECT_TRUE(fleet.told.in_order);
        fleet.advance(10ms);
        EXPECT_FALSE(fleet.moves(1)) << way << ": the others hear of it at once";
    }
}

TEST(Collaboration, ALostMasterIsMissedByEverySlave) {
    for (const bool frozen : {false, true}) {
        Fleet fleet(3);
        fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 10s}; };
        fleet.launch(globalService({"0 Turning 1", "1 Turning 1", "2 Turning 2"}), 0);
        fleet.advance(100ms);
        frozen ? fleet.freeze(0) : fleet.cut(0);
        fleet.advance(200ms);
        EXPECT_TRUE(fleet.moves(1));
        fleet.advance(100ms);
        EXPECT_FALSE(fleet.moves(1));
        EXPECT_EQ(fleet.state(1), EntityState::REG);
        EXPECT_EQ(fleet.state(2), EntityState::REG);
        EXPECT_TRUE(fleet.rig(1).core().latched());
        EXPECT_TRUE(fleet.rig(2).core().latched());
        if (!frozen) {
            EXPECT_FALSE(fleet.moves(0));  // the master misses them as well
            EXPECT_EQ(fleet.told.state, proto::RUN_FAILED);
        }
    }
}

/// Keeps the first message of a kind back, until it is given up.
struct Late {
    Late(Fleet& robots, std::function<bool(const proto::ToEntity&)> which) : fleet(robots) {
        fleet.lose = [this, which = std::move(which)](std::size_t from, std::size_t to,
                                                      const proto::ToEntity& message) {
            if (kept || !which(message)) return false;
            kept = message.SerializeAsString();
            head.sender = {fleet.uuid(from), "Robot " + std::to_string(from), Role::Operator};
            head.msg_type = kMsgCollaboration;
            head.entity = fleet.uuid(to);
            robot = to;
            return true;
        };
    }
    void arrive() { fleet.rig(robot).core().onClientMsg(head, kept.value()); }
    Fleet& fleet;
    std::optional<std::string> kept;
    Header head;
    std::size_t robot = 0;
};

TEST(Collaboration, AnAnswerThatIsLateStopsNobody) {
    Fleet fleet(2);
    Late answer(fleet, [](const auto& message) { return message.from_slave().has_answer(); });
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), 0);
    fleet.advance(600ms);
    EXPECT_EQ(fleet.told.state, proto::RUN_CHECKING);
    EXPECT_EQ(fleet.state(1), EntityState::SLAVE);
    answer.arrive();
    fleet.advance(300ms);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED) << fleet.told.reason.message();
    expectAllAtRest(fleet);
}

TEST(Collaboration, AMasterThatIsNeverHeardIsLostToo) {
    Fleet fleet(2);
    fleet.lose = [](std::size_t from, std::size_t, const proto::ToEntity& message) {
        return from == 1 || !message.from_master().has_invitation();
    };
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), 0);
    fleet.advance(5100ms);
    EXPECT_EQ(fleet.told.state, proto::RUN_REFUSED);
    expectAllAtRest(fleet);
}

TEST(Collaboration, AnEndThatIsLateStopsNobody) {
    Fleet fleet(2);
    Late end(fleet, [](const auto& message) { return message.from_master().has_end(); });
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), 0);
    const auto stops = fleet.rig(1).core().status().stop_generation;
    fleet.advance(1s);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED);
    EXPECT_EQ(fleet.state(0), EntityState::REG);
    EXPECT_EQ(fleet.state(1), EntityState::SLAVE);
    end.arrive();
    EXPECT_EQ(fleet.state(1), EntityState::REG);
    EXPECT_EQ(fleet.rig(1).core().status().stop_generation, stops);
    fleet.advance(100ms);
    int beats = 0;
    fleet.lose = [&](auto, auto, const auto&) { return ++beats > 0; };
    fleet.advance(1s);
    EXPECT_EQ(beats, 0) << "it is known that it has arrived";
}

TEST(Collaboration, AnEndThatNeverArrivesIsMissedAndALostStopIsSaidAgain) {
    Fleet fleet(2);
    fleet.lose = [](auto, auto, const proto::ToEntity& message) { return message.from_master().has_end(); };
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), 0);
    fleet.advance(6s);
    expectAllAtRest(fleet);
    fleet.rig(1).rearm("client1", "again");  // it has missed its master
    fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 10s}; };
    Late stop(fleet, [](const auto& message) { return message.from_master().end().stop(); });
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), 0, "next");
    fleet.advance(100ms);
    fleet.stop(0);
    EXPECT_TRUE(fleet.moves(1));
    fleet.advance(60ms);
    EXPECT_FALSE(fleet.moves(1));
}

TEST(Collaboration, ALostSlaveEndsItOrIsCompensated) {
    for (const auto policy : {proto::STOP_ALL, proto::COMPENSATE}) {
        Fleet fleet(3);
        fleet.behave = [](std::size_t, const proto::TaskDispatch& dispatch) {
            return Fleet::Outcome{.lasts = dispatch.service() == "Light" ? Duration{100ms} : Duration{10s}};
        };
        auto service = globalService({"0 Turning 1", "1 Turning 1", "2 Turning 1"}, policy);
        for (const int role : {0, 1}) {
            auto& step = *service.add_compensation();
            step.set_role(role);
            step.set_service_global_id("Light");
        }
        fleet.launch(service, 2);
        fleet.advance(100ms);
        fleet.cut(1);
        fleet.advance(1s);
        EXPECT_EQ(fleet.told.state, proto::RUN_FAILED);
        EXPECT_EQ(fleet.told.steps[1].state(), proto::TASK_UNKNOWN);
        expectAllAtRest(fleet);
        if (policy != proto::COMPENSATE) continue;
        EXPECT_EQ(fleet.told.steps[3].state(), proto::TASK_SUCCEEDED);
        EXPECT_EQ(fleet.told.steps[4].state(), proto::TASK_REFUSED);
    }
}

TEST(Collaboration, AStepOfWhichNothingIsHeardIsCancelledAndLeavesNobodyMoving) {
    Fleet fleet(2);
    fleet.behave = [](std::size_t, const proto::TaskDispatch& dispatch) {
        return Fleet::Outcome{.lasts = dispatch.service() == "Light" ? Duration{100ms} : Duration{60s}};
    };
    fleet.lose = [](std::size_t from, std::size_t, const proto::ToEntity& message) {
        return from == 1 && message.from_slave().has_report();
    };
    auto service = globalService({"0 Turning 1", "1 Turning 1"}, proto::COMPENSATE);
    service.add_compensation()->set_role(0);
    service.mutable_compensation(0)->set_service_global_id("Light");
    fleet.launch(service, 0);
    fleet.advance(4900ms);
    EXPECT_TRUE(fleet.moves(1));
    fleet.advance(200ms);
    EXPECT_EQ(fleet.told.steps[1].state(), proto::TASK_UNKNOWN);
    EXPECT_FALSE(fleet.moves(1)) << "cancelled";
    EXPECT_EQ(fleet.told.state, proto::RUN_STOPPING) << "nobody knows that it has ended";
    fleet.advance(11s);
    EXPECT_EQ(fleet.told.state, proto::RUN_FAILED);
    for (const auto& [robot, name] : fleet.order())
        EXPECT_NE(name, "Light") << "no compensation beside the unknown";
    expectAllAtRest(fleet);
}

TEST(Collaboration, TheLateReportOfAStepThatWasGivenUpTellsHowItEnded) {
    Fleet fleet(2);
    bool mute = true;
    fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 60s}; };
    fleet.lose = [&](std::size_t from, std::size_t to, const proto::ToEntity& message) {
        return mute && ((from == 1 && message.from_slave().has_report()) ||
                        (to == 1 && message.from_master().has_control()));
    };
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}, proto::HOLD_OTHERS), 0);
    fleet.advance(5100ms);
    EXPECT_EQ(fleet.told.state, proto::RUN_HELD);
    EXPECT_TRUE(fleet.moves(1));
    fleet.control(0, "run", proto::RESUME);
    EXPECT_EQ(fleet.told.refused.code, RefusalCode::WrongState) << "it may be doing it still";
    mute = false;
    proto::EiToEm update;  // it says something at last
    auto& event = *update.mutable_task()->mutable_event();
    for (const auto& message : fleet.rig(1).to_application)
        if (message.has_task()) event.set_task_id(message.task().task_id());
    event.set_state(proto::TASK_RUNNING);
    event.set_progress(0.5);
    fleet.rig(1).fromApplication(update);
    fleet.advance(100ms);
    EXPECT_FALSE(fleet.moves(1));
    EXPECT_EQ(fleet.told.steps[1].state(), proto::TASK_CANCELLED);
    fleet.control(0, "run", proto::RESUME);
    EXPECT_EQ(fleet.told.state, proto::RUN_RUNNING);
}

TEST(Collaboration, AnEndThatComesWhileAStepGoesOnStopsIt) {
    Fleet fleet(2);
    fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 60s}; };
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), 0);
    fleet.advance(100ms);
    proto::ToEntity message;
    message.mutable_from_master()->set_run_id(idOf("run"));
    message.mutable_from_master()->mutable_end();
    Header head;
    head.entity = fleet.uuid(1);
    head.sender = {fleet.uuid(0), "Robot 0", Role::Operator};
    head.msg_type = kMsgCollaboration;
    fleet.rig(1).core().onClientMsg(head, message.SerializeAsString());
    fleet.advance(10ms);
    EXPECT_FALSE(fleet.moves(1));
    EXPECT_EQ(fleet.state(1), EntityState::REG);
    EXPECT_FALSE(fleet.rig(1).core().latched());
}

TEST(Collaboration, WhoDoesNotPauseOrEndInTimeIsStopped) {
    for (const bool held : {false, true}) {
        Fleet fleet(2);
        fleet.behave = [&](std::size_t robot, const proto::TaskDispatch&) {
            if (held && robot == 0) return failing();
            return Fleet::Outcome{.lasts = 60s, .deaf = true};
        };
        auto service =
            globalService({"0 Driving 1", "1 Driving 1"}, held ? proto::HOLD_OTHERS : proto::STOP_ALL);
        for (const int i : {0, 1}) *service.mutable_steps(i)->add_params() = test::paramOf("Distance=100");
        fleet.launch(service, 0);
        fleet.advance(100ms);
        if (!held) fleet.control(0, "run", proto::PAUSE);
        EXPECT_EQ(fleet.told.state, held ? proto::RUN_HELD : proto::RUN_PAUSED);
        fleet.advance(9800ms);
        EXPECT_TRUE(fleet.moves(1)) << held;
        fleet.advance(300ms);
        EXPECT_EQ(fleet.told.state, proto::RUN_FAILED) << held;
        EXPECT_EQ(fleet.told.reason.code(), proto::TIMED_OUT);
        EXPECT_NE(fleet.told.reason.message().find("Robot"), std::string::npos)
            << fleet.told.reason.message();
        expectAllAtRest(fleet);
    }
}

TEST(Collaboration, ToCancelAgainGivesNoMoreTime) {
    Fleet fleet(2);
    fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 60s, .deaf = true}; };
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), 0);
    fleet.advance(100ms);
    for (int i = 0; i < 3; ++i) {
        fleet.control(0, "run", proto::CANCEL);
        fleet.advance(3s);
    }
    EXPECT_TRUE(fleet.moves(1));
    fleet.advance(1100ms);
    EXPECT_EQ(fleet.told.state, proto::RUN_CANCELLED);
    expectAllAtRest(fleet);
}

TEST(Collaboration, ACompensationWaitsForItsParticipantForATime) {
    Fleet fleet(2);
    fleet.behave = [](std::size_t robot, const proto::TaskDispatch& dispatch) {
        if (dispatch.service() == "Light") return Fleet::Outcome{.lasts = 30s};
        return robot == 0 ? failing() : Fleet::Outcome{.lasts = 60s};
    };
    auto service = globalService({"0 Turning 1", "1 Turning 1"}, proto::COMPENSATE);
    for (const int role : {0, 1}) {
        auto& step = *service.add_compensation();
        step.set_role(role);
        step.set_service_global_id("Light");
    }
    for (const bool occupied : {false, true}) {
        const std::string run = occupied ? "second" : "first";
        fleet.launch(service, 0, run);
        if (occupied) {  // by its own account, so that nothing else begins
            proto::EiToEm status;
            status.mutable_status()->set_busy(true);
            fleet.advance(20ms);
            fleet.rig(1).fromApplication(status);
        }
        fleet.advance(9900ms);
        EXPECT_EQ(fleet.told.state, proto::RUN_COMPENSATING);
        fleet.advance(1s);
        EXPECT_EQ(fleet.told.state, occupied ? proto::RUN_FAILED : proto::RUN_COMPENSATING)
            << "what runs may last";
        fleet.advance(20s);
        EXPECT_EQ(fleet.told.state, proto::RUN_FAILED);
        expectAllAtRest(fleet);
    }
}

TEST(Collaboration, IsPausedWhereEveryStepCanBeAndGoesOn) {
    Fleet fleet(2);
    fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 500ms}; };
    auto service = globalService({"0 Driving 1", "1 Driving 1", "0 Turning 2"});
    for (const int i : {0, 1}) {
        auto& distance = *service.mutable_steps(i)->add_params();
        distance.set_name("Distance");
        distance.add_values()->set_int_(100);
    }
    fleet.launch(service, 0);
    fleet.advance(100ms);
    fleet.control(0, "run", proto::PAUSE);
    fleet.advance(5s);
    EXPECT_EQ(fleet.told.state, proto::RUN_PAUSED);
    EXPECT_EQ(fleet.told.steps[1].state(), proto::TASK_PAUSED);
    fleet.control(0, "run", proto::RESUME);
    fleet.advance(450ms);
    EXPECT_EQ(fleet.told.steps[2].state(), proto::TASK_RUNNING);
    fleet.control(0, "run", proto::PAUSE);
    EXPECT_EQ(fleet.told.refused.code, RefusalCode::NotPausable);
    EXPECT_NE(fleet.told.refused.message.find("Turning"), std::string::npos);
    fleet.advance(1s);
    EXPECT_EQ(fleet.told.state, proto::RUN_SUCCEEDED);
}

TEST(Collaboration, IsCancelledWithoutALatch) {
    Fleet fleet(3);
    fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 10s}; };
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1", "2 Turning 2"}), 1);
    fleet.advance(100ms);
    fleet.control(1, "run", proto::CANCEL);
    fleet.advance(100ms);
    EXPECT_EQ(fleet.told.state, proto::RUN_CANCELLED);
    expectAllAtRest(fleet);
    fleet.launch(globalService({"0 Turning 1"}), 0, "next");
    fleet.advance(100ms);
    EXPECT_EQ(fleet.state(0), EntityState::BUSY);
}

TEST(Collaboration, TheMastersNextLifeSaysThatTheOutcomeIsUnknown) {
    Fleet fleet(2);
    fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 10s}; };
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), 0);
    fleet.advance(100ms);
    EXPECT_EQ(fleet.record(0).state(), proto::RUN_RUNNING);
    fleet.rig(0).restart();
    fleet.rig(0).makeIdle();
    EXPECT_EQ(fleet.record(0).state(), proto::RUN_UNKNOWN);
    EXPECT_EQ(fleet.record(0).by(), "client1@lab");
    EXPECT_EQ(fleet.record(0).participants_size(), 2);
    EXPECT_FALSE(fleet.record(0).participants(0).has_lease());
}

TEST(Collaboration, RawDataGoesFromRobotToRobotOfARunAlone) {
    Fleet fleet(3);
    fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 10s}; };
    proto::EiToEm raw;
    raw.mutable_raw()->add_data("scan");
    raw.mutable_raw()->set_to("Robot 1");
    const auto arrived = [&](std::size_t robot) {
        const auto& sent = fleet.rig(robot).to_application;
        return std::count_if(sent.begin(), sent.end(), [](const proto::EmToEi& message) {
            return message.has_raw() && message.raw().data(0) == "scan" && message.raw().from() == "Robot 0";
        });
    };
    const auto refusal = [&] {
        const auto& sent = fleet.rig(0).to_application;
        return !sent.empty() && sent.back().has_not_sent() ? sent.back().not_sent().reason().code()
                                                           : proto::OK;
    };
    fleet.rig(0).fromApplication(raw);
    EXPECT_EQ(refusal(), proto::WRONG_STATE) << "there is no run";
    EXPECT_EQ(fleet.rig(0).to_application.back().not_sent().to(), "Robot 1");
    const auto told = fleet.rig(0).to_application.size();
    for (int i = 0; i < 100; ++i) fleet.rig(0).fromApplication(raw);
    EXPECT_EQ(fleet.rig(0).to_application.size(), told) << "a stream is not answered with a stream";
    fleet.advance(300ms);
    EXPECT_EQ(arrived(1), 0);
    fleet.launch(globalService({"0 Turning 1", "1 Turning 1"}), 1);
    fleet.advance(10ms);
    fleet.rig(0).fromApplication(raw);
    fleet.advance(10ms);
    EXPECT_EQ(arrived(1), 1);
    EXPECT_EQ(arrived(2), 0);
    auto astray = raw;
    astray.mutable_raw()->set_to("Robot 2");
    fleet.rig(0).fromApplication(astray);
    EXPECT_EQ(refusal(), proto::UNKNOWN_ENTITY) << "it takes no part";
    fleet.stop(1);
    fleet.rig(0).fromApplication(raw);
    fleet.advance(10ms);
    EXPECT_EQ(arrived(1), 1);
}

TEST(Collaboration, AResetOfAParticipantThatRunsNoStepIsRefusedWithWhatToDo) {
    Fleet fleet(2);
    fleet.behave = [](auto, const auto&) { return Fleet::Outcome{.lasts = 10s}; };
    fleet.launch(globalService({"0 Turning 1", "1 Turning 2"}), 0);
    fleet.advance(100ms);
    ASSERT_EQ(fleet.state(1), EntityState::SLAVE);
    fleet.rig(1).reset("client1");
    const auto& told = fleet.rig(1).to_clients.back();
    EXPECT_EQ(told.lane, Lane::Signal);
    EXPECT_EQ(told.message.reply().refusal().code(), proto::WRONG_STATE);
    EXPECT_NE(told.message.reply().refusal().message().find("Cancel the run"), std::string::npos);
    EXPECT_EQ(fleet.state(1), EntityState::SLAVE);
}

}  // namespace
}  // namespace axon::entity_manager
