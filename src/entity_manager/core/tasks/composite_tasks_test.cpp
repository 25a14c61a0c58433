// SPDX-License-Identifier: GPL-2.0-or-later
// Tasks of composite services; tests/scenarios/composite*.txt tell the ordinary ones as stories.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "tests/support/core_rig.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using test::CoreRig;
using test::idOf;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using Kind = JournalRecord::Kind;

constexpr const char* kServices = R"(<ServiceProfile>
  <Service name="Drive" type="SMPL" pausable="true" on_client_loss="finish" max_duration="10">
    <Parameters>
      <Param name="Distance" type="INPUT" data_type="INT" required="true" maximum="500"/>
      <Param name="Speed" type="CONFIG" data_type="INT" value="200" savable="true"/>
      <Param name="Travelled" type="OUTPUT" data_type="INT"/>
      <Param name="Pace" type="FEEDBACK" data_type="INT"/>
    </Parameters>
    <Resources><Resource name="Map" required="true"/></Resources>
  </Service>
  <Service name="Turn" type="SMPL" pausable="true" on_client_loss="finish" max_duration="10"/>
  <Service name="Wait" type="SMPL" pausable="true" on_client_loss="hold"/>
  <Service name="Halt" type="SMPL"/>
  <Service name="Ping" type="SMPL" blocking="false"/>
  <Service name="Look" type="SMPL" blocking="false"/>
  <Service name="Tour" type="CMPLX" pausable="true" on_client_loss="finish" max_duration="15">
    <Services><ServiceRef name="Turn"/><ServiceRef name="Turn"/><ServiceRef name="Turn"/></Services>
  </Service>
  <Service name="Leg" type="CMPLX">
    <Parameters><Param name="Distance" type="INPUT" data_type="INT"/></Parameters>
    <Services><ServiceRef name="Drive"/><ServiceRef name="Turn"/></Services>
  </Service>
  <Service name="Patrol" type="CMPLX">
    <Services><ServiceRef name="Drive"/><ServiceRef name="Leg"/></Services>
  </Service>
  <Service name="Scan" type="CMPLX" blocking="false">
    <Services><ServiceRef name="Ping"/><ServiceRef name="Look"/></Services>
  </Service>
  <Service name="Careful" type="CMPLX" pausable="true" on_client_loss="finish" max_duration="15">
    <Services><ServiceRef name="Turn"/><ServiceRef name="Wait"/></Services>
  </Service>
  <Service name="Mixed" type="CMPLX" blocking="false" pausable="true" on_client_loss="finish" max_duration="15">
    <Services><ServiceRef name="Turn"/><ServiceRef name="Halt"/></Services>
  </Service>
  <Service name="Route" type="CMPLX">
    <Parameters>
      <Param name="Speed" type="CONFIG" data_type="INT"/>
      <Param name="Distance" type="CONFIG" data_type="INT" value="10"/>
    </Parameters>
    <Services><ServiceRef name="Drive"/><ServiceRef name="Drive"/></Services>
  </Service>
</ServiceProfile>
)";

struct CompositeTasks : testing::Test {
    CompositeTasks() {
        rig.linkUp();
        rig.upload(false, test::kRigBasicProfile);
        rig.upload(true, kServices);
        rig.core().onServerUp();
        rig.take("client1", "r1");
    }
    void uploadMap(const std::string& service) {
        proto::ToEntity offer;
        offer.mutable_resource_offer()->set_transfer_id(idOf("x"));
        offer.mutable_resource_offer()->set_service(service);
        offer.mutable_resource_offer()->set_resource(service == "Drive" ? "Map" : "Drive.Map");
        offer.mutable_resource_offer()->set_file_name("map");
        offer.mutable_resource_offer()->set_size(1);
        offer.mutable_resource_offer()->set_sha256(test::MemoryResources::fakeHash("m"));
        rig.send("client1", offer);
        proto::ToEntity chunk;
        chunk.mutable_resource_chunk()->set_transfer_id(idOf("x"));
        chunk.mutable_resource_chunk()->set_content("m");
        rig.send("client1", chunk);
        answer();
    }
    void answer() {
        proto::EiToEm message;
        const auto& asked = rig.to_application.back();
        message.mutable_answer()->set_request(asked.has_param() ? asked.param().request()
                                                                : asked.resource().request());
        rig.fromApplication(message);
    }
    void set(const std::string& service, const std::string& param) {
        rig.setParam("client1", "p", service, param);
        answer();
    }
    void control(const std::string& task, proto::TaskAction action) {
        proto::ToEntity message;
        message.mutable_task_control()->set_task_id(idOf(task));
        message.mutable_task_control()->set_action(action);
        rig.send("client1", message);
    }
    void lose() {
        rig.stop("client1", StopCause::ClientLost);
        rig.core().onClientUpdate(rig.headOf("client1"), ClientChange::Lost);
    }
    /// The services that the application has been given, with its parameters.
    std::vector<std::string> dispatched() const {
        std::vector<std::string> all;
        for (const auto& message : rig.to_application) {
            if (!message.has_task()) continue;
            auto text = message.task().service();
            for (const auto& param : message.task().params())
                text += ' ' + param.name() + '=' + std::to_string(param.values(0).int_());
            all.push_back(text);
        }
        return all;
    }
    /// "Service.Name=value", and the task that takes it too.
    std::string lastConfigured() const {
        for (auto at = rig.to_application.rbegin(); at != rig.to_application.rend(); ++at) {
            if (!at->has_configuration()) continue;
            const auto& one = at->configuration().params(0);
            return one.service() + '.' + one.param().name() + '=' +
                   std::to_string(one.param().values(0).int_()) +
                   (at->configuration().task_id().empty()
                        ? ""
                        : " for " + rig.nameOfSent(at->configuration().task_id()));
        }
        return "nothing";
    }
    proto::TaskEvent lastOf(const std::string& task) const {
        for (auto at = rig.to_clients.rbegin(); at != rig.to_clients.rend(); ++at)
            if (at->message.has_task() && at->message.task().task_id() == idOf(task))
                return at->message.task();
        return {};
    }
    proto::RefusalCode lastReply() const {
        for (auto at = rig.to_clients.rbegin(); at != rig.to_clients.rend(); ++at)
            if (at->message.has_reply()) return at->message.reply().refusal().code();
        return proto::INTERNAL;
    }
    proto::Service record(const std::string& name) {
        proto::ToEntity message;
        message.mutable_status_request()->set_request_id(idOf("status"));
        message.mutable_status_request()->set_with_services(true);
        rig.send("client1", message);
        for (const auto& service : rig.to_clients.back().message.status().services())
            if (service.name() == name) return service;
        return {};
    }
    EntityStatus status() { return rig.core().status(); }
    CoreRig rig;
};

std::vector<std::string> missing(const proto::Service& service) {
    return {service.missing().begin(), service.missing().end()};
}

TEST_F(CompositeTasks, WhatIsGivenIsAskedForBeforeTheFirstPartUnderTheServiceThatDeclaresIt) {
    uploadMap("Drive");
    rig.task("client1", "t1", "Leg", {"Distance=100", "Drive.Speed=50"});
    const auto& first = rig.to_application.back().task();
    ASSERT_EQ(first.service(), "Drive");
    ASSERT_EQ(first.given_size(), 2);
    EXPECT_EQ(first.given(0).service(), "Leg");
    EXPECT_EQ(first.given(0).param().name(), "Distance");
    EXPECT_EQ(first.given(0).param().values(0).int_(), 100);
    EXPECT_EQ(first.given(1).service(), "Drive");
    EXPECT_EQ(first.given(1).param().name(), "Speed");
    EXPECT_EQ(first.given(1).param().values(0).int_(), 50);
    rig.grant("part1");
    rig.update("part1", proto::TASK_SUCCEEDED);
    ASSERT_EQ(rig.to_application.back().task().service(), "Turn");
    EXPECT_EQ(rig.to_application.back().task().given_size(), 0);
}

TEST_F(CompositeTasks, AreReadyWhenTheirPartsAre) {
    EXPECT_THAT(missing(record("Patrol")), ElementsAre("Drive.Distance", "Drive.Map", "Leg.Distance"));
    EXPECT_THAT(missing(record("Leg")), ElementsAre("Distance", "Drive.Map"));
    set("Patrol", "Drive.Distance=100");
    EXPECT_THAT(missing(record("Drive")), ElementsAre("Map"));
    EXPECT_THAT(missing(record("Patrol")), ElementsAre("Drive.Map")) << "Leg has its part's";
    uploadMap("Patrol");
    EXPECT_THAT(missing(record("Patrol")), IsEmpty());
    EXPECT_THAT(missing(record("Leg")), IsEmpty());
}

TEST_F(CompositeTasks, AParameterOfAPartIsAskedOfThePart) {
    rig.setParam("client1", "p", "Patrol", "drive.distance=100");
    EXPECT_EQ(rig.to_application.back().param().service(), "Drive");
    EXPECT_EQ(rig.to_application.back().param().param().name(), "Distance");
    rig.setParam("client1", "p", "Patrol", "Drive.Distance=501");
    EXPECT_EQ(lastReply(), proto::OUT_OF_RANGE);
    rig.setParam("client1", "p", "Patrol", "Drive.Travelled=1");
    EXPECT_EQ(lastReply(), proto::WRONG_TYPE);
    rig.setParam("client1", "p", "Leg", "Distance=501");
    EXPECT_EQ(lastReply(), proto::OUT_OF_RANGE) << "its part does not take it";
}

TEST_F(CompositeTasks, ACONFIGIsTakenByTheRunningPartAndTheNextUnlessACompositeAroundHasItsOwn) {
    uploadMap("Drive");
    rig.task("client1", "t1", "Route");
    rig.grant("part1");
    set("Drive", "Speed=100");
    EXPECT_EQ(lastConfigured(), "Drive.Speed=100 for part1");
    set("Route", "Speed=50");
    EXPECT_EQ(lastConfigured(), "Route.Speed=50 for part1");
    set("Drive", "Speed=120");
    EXPECT_EQ(lastConfigured(), "Drive.Speed=120") << "the composite's counts";
    rig.update("part1", proto::TASK_SUCCEEDED);
    EXPECT_THAT(dispatched(), ElementsAre("Drive Distance=10 Speed=200", "Drive Distance=10 Speed=50"));
    rig.update("part2", proto::TASK_SUCCEEDED);
    EXPECT_EQ(record("Route").params(0).initial(0).int_(), 50);
    EXPECT_EQ(record("Drive").params(1).initial(0).int_(), 120);
}

TEST_F(CompositeTasks, ACONFIGThatIsAnINPUTOfThePartIsTakenByTheNextTask) {
    uploadMap("Drive");
    rig.task("client1", "t1", "Route");
    rig.grant("part1");
    set("Route", "Distance=20");
    EXPECT_EQ(lastConfigured(), "Route.Distance=20");
    rig.update("part1", proto::TASK_SUCCEEDED);
    EXPECT_EQ(dispatched().back(), "Drive Distance=10 Speed=200");
    rig.update("part2", proto::TASK_SUCCEEDED);
    uploadMap("Drive");
    rig.task("client1", "t2", "Route");
    EXPECT_EQ(dispatched().back(), "Drive Distance=20 Speed=200");
}

TEST_F(CompositeTasks, OfWhatWasGivenAndHasBeenSetSinceTheApplicationIsAskedTheNewValue) {
    uploadMap("Drive");
    rig.task("client1", "t1", "Halt");
    rig.task("client1", "t2", "Leg", {"Distance=1", "Drive.Speed=50"});
    set("Drive", "Speed=60");
    rig.grant("t1");
    rig.update("t1", proto::TASK_SUCCEEDED);
    EXPECT_EQ(dispatched().back(), "Drive Distance=1 Speed=60");
    ASSERT_EQ(rig.to_application.back().task().given_size(), 2);
    EXPECT_EQ(rig.to_application.back().task().given(0).param().values(0).int_(), 1);
    EXPECT_EQ(rig.to_application.back().task().given(1).param().values(0).int_(), 60);
}

TEST_F(CompositeTasks, TheValueOfTheOutermostCompositeCounts) {
    uploadMap("Drive");
    set("Drive", "Distance=1");
    set("Leg", "Distance=2");
    rig.task("client1", "t1", "Patrol", {"Drive.Speed=7"});
    rig.update("part1", proto::TASK_SUCCEEDED);
    EXPECT_THAT(dispatched(), ElementsAre("Drive Distance=1 Speed=7", "Drive Distance=2 Speed=7"));
    rig.update("part2", proto::TASK_FAILED);
    EXPECT_THAT(missing(record("Patrol")), ElementsAre("Drive.Distance", "Drive.Map", "Leg.Distance"))
        << "what is not savable has served one task";
    EXPECT_EQ(record("Patrol").params(1).initial(0).int_(), 200)
        << "what came with the task was for the task";
    uploadMap("Drive");
    rig.task("client1", "t2", "Patrol", {"Drive.Distance=3", "Leg.Distance=4"});
    rig.update("part3", proto::TASK_SUCCEEDED);
    EXPECT_EQ(dispatched().back(), "Drive Distance=4 Speed=200");
}

TEST_F(CompositeTasks, AValueOfAPartThatTheWholeDidNotUseServesALaterTask) {
    uploadMap("Drive");
    set("Drive", "Distance=1");
    rig.task("client1", "t1", "Leg", {"Distance=2"});
    rig.update("part1", proto::TASK_SUCCEEDED);
    rig.update("part2", proto::TASK_SUCCEEDED);
    uploadMap("Drive");
    rig.task("client1", "t2", "Drive");
    EXPECT_THAT(dispatched(),
                ElementsAre("Drive Distance=2 Speed=200", "Turn", "Drive Distance=1 Speed=200"));
    rig.update("t2", proto::TASK_SUCCEEDED);
    EXPECT_THAT(missing(record("Drive")), ElementsAre("Distance", "Map")) << "it has served one task";
}

TEST_F(CompositeTasks, AreActivePausableAndBlockingAsAWhole) {
    EXPECT_TRUE(record("Tour").is_pausable());
    EXPECT_FALSE(record("Mixed").is_pausable()) << "one part is not";
    EXPECT_TRUE(record("Mixed").is_blocking()) << "its parts are";
    EXPECT_FALSE(record("Scan").is_blocking());
    proto::EiToEm message;
    message.mutable_active()->set_service("Drive");
    message.mutable_active()->set_active(false);
    rig.fromApplication(message);
    EXPECT_FALSE(record("Patrol").is_active());
    EXPECT_EQ(record("Patrol").inactive_reason(), "its part \"Drive\" is switched off");
    rig.task("client1", "t1", "Patrol");
    EXPECT_EQ(lastOf("t1").reason().code(), proto::INACTIVE_SERVICE);
    EXPECT_THAT(lastOf("t1").reason().message(), HasSubstr("\"Drive\""));
    message.mutable_active()->set_reason("Battery low");
    rig.fromApplication(message);
    EXPECT_EQ(record("Patrol").inactive_reason(), "its part \"Drive\" is switched off: Battery low");
    rig.task("client1", "t2", "Patrol");
    EXPECT_EQ(lastOf("t2").reason().message(),
              "Service \"Patrol\" cannot run: its part \"Drive\" is switched off by the robot application: "
              "Battery low.");
    message.mutable_active()->clear_reason();
    message.mutable_active()->set_service("Patrol");
    rig.fromApplication(message);
    message.mutable_active()->set_service("Drive");
    message.mutable_active()->set_active(true);
    rig.fromApplication(message);
    EXPECT_FALSE(record("Patrol").is_active()) << "it is off itself";
    EXPECT_TRUE(record("Leg").is_active());
}

TEST_F(CompositeTasks, ProgressAndResultsAreOfTheWhole) {
    uploadMap("Drive");
    rig.task("client1", "t1", "Leg", {"Distance=100"});
    rig.grant("part1");
    proto::EiToEm message;
    auto& update = *message.mutable_task()->mutable_event();
    update.set_task_id(rig.idOfSent("part1"));
    update.set_state(proto::TASK_RUNNING);
    update.set_progress(0.5);
    update.set_feedback("half");
    *update.add_results() = test::paramOf("Pace=7");
    rig.fromApplication(message);
    EXPECT_DOUBLE_EQ(lastOf("t1").progress(), 0.25);
    EXPECT_EQ(lastOf("t1").feedback(), "part 1 of 2, Drive: half");
    EXPECT_EQ(lastOf("t1").results(0).name(), "Drive.Pace") << "while it runs";
    update.clear_results();
    *update.add_results() = test::paramOf("Travelled=99");
    update.set_state(proto::TASK_SUCCEEDED);
    update.clear_feedback();
    rig.fromApplication(message);
    EXPECT_DOUBLE_EQ(lastOf("t1").progress(), 0.5);
    EXPECT_EQ(lastOf("t1").results(0).name(), "Drive.Travelled");
    EXPECT_EQ(status().state, EntityState::BUSY) << "between the parts too";
    rig.grant("part2");
    rig.update("part2", proto::TASK_SUCCEEDED);
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_SUCCEEDED);
    EXPECT_DOUBLE_EQ(lastOf("t1").progress(), 1);
    ASSERT_EQ(lastOf("t1").results_size(), 1) << "FEEDBACK is no result";
    EXPECT_EQ(lastOf("t1").results(0).name(), "Drive.Travelled");
    EXPECT_EQ(lastOf("t1").results(0).values(0).int_(), 99);
}

TEST_F(CompositeTasks, TheApplicationIsNeverGivenAnIdTwice) {
    rig.task("client1", "t1", "Tour");
    for (const auto* part : {"part1", "part2", "part3"}) rig.update(part, proto::TASK_SUCCEEDED);
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_SUCCEEDED);
    std::set<std::string> ids;
    for (const auto& message : rig.to_application) {
        if (message.has_task()) {
            EXPECT_TRUE(ids.insert(message.task().task_id()).second);
        }
    }
    EXPECT_EQ(ids.size(), 3U);
    EXPECT_FALSE(ids.contains(idOf("t1")));
}

TEST_F(CompositeTasks, NothingOfTheQueueComesBetweenTheParts) {
    rig.task("client1", "t1", "Tour");
    rig.task("client1", "t2", "Halt");
    for (const auto* part : {"part1", "part2", "part3"}) rig.update(part, proto::TASK_SUCCEEDED);
    EXPECT_THAT(dispatched(), ElementsAre("Turn", "Turn", "Turn", "Halt"));
}

TEST_F(CompositeTasks, OneServiceIsNotRunTwiceAtATimeBesideAComposite) {
    rig.task("client1", "t1", "Scan");
    rig.task("client1", "t2", "Look");
    EXPECT_THAT(dispatched(), ElementsAre("Ping")) << "Look is a part of Scan";
    rig.update("part1", proto::TASK_SUCCEEDED);
    rig.update("part2", proto::TASK_SUCCEEDED);
    EXPECT_THAT(dispatched(), ElementsAre("Ping", "Look", "Look"));
}

TEST_F(CompositeTasks, APartThatEndsOtherwiseEndsTheWhole) {
    rig.task("client1", "t1", "Tour");
    rig.deny("part1", "Not now.");
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_REFUSED);
    EXPECT_EQ(lastOf("t1").reason().message(), "part 1 of 3, Turn: Not now.");
    rig.task("client1", "t2", "Tour");
    rig.update("part2", proto::TASK_SUCCEEDED);
    rig.deny("part3", "Not now.");
    EXPECT_EQ(lastOf("t2").state(), proto::TASK_FAILED) << "REFUSED would say that nothing has run";
    EXPECT_EQ(lastOf("t2").reason().code(), proto::DENIED);
    EXPECT_EQ(lastOf("t2").reason().message(), "part 2 of 3, Turn: Not now.");
    EXPECT_EQ(status().state, EntityState::REG);
    rig.task("client1", "t3", "Tour");
    rig.update("part4", proto::TASK_SUCCEEDED);
    rig.update("part5", proto::TASK_STOPPED);
    EXPECT_EQ(lastOf("t3").state(), proto::TASK_STOPPED);
    EXPECT_EQ(rig.journal.records.back().kind, Kind::TaskEnded);
    EXPECT_THAT(rig.journal.records.back().text, HasSubstr("part 2 of 3, Turn: "));
    EXPECT_EQ(dispatched().size(), 5U);
}

TEST_F(CompositeTasks, AnApplicationThatDoesNotAnswerAPartIsNotWaitedFor) {
    rig.task("client1", "t1", "Tour");
    rig.update("part1", proto::TASK_SUCCEEDED);
    rig.advance(60s);
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_UNKNOWN);
    EXPECT_THAT(lastOf("t1").reason().message(),
                HasSubstr("part 2 of 3, Turn: The robot application has neither"));
    EXPECT_EQ(rig.to_application.back().cancel().task_id(), rig.idOfSent("part2"));
    EXPECT_EQ(status().state, EntityState::REG);
}

TEST_F(CompositeTasks, AStopInTheMiddleEndsTheWhole) {
    rig.task("client1", "t1", "Tour");
    rig.update("part1", proto::TASK_SUCCEEDED);
    rig.grant("part2");
    rig.stop("client2");
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_STOPPED);
    EXPECT_THAT(lastOf("t1").reason().message(), HasSubstr("part 2 of 3, Turn: Stopped by client2@lab"));
    rig.update("part2", proto::TASK_SUCCEEDED);
    rig.stopDone(1);
    rig.rearm("client1", "r2");
    EXPECT_THAT(dispatched(), ElementsAre("Turn", "Turn"));
}

TEST_F(CompositeTasks, AStopOnItsWayHereIsBeforeTheNextPart) {
    rig.task("client1", "t1", "Tour");
    rig.grant("part1");
    const auto head = rig.headOf("client2");
    const auto raised = rig.stop_generations.raise(head.sender.id, head.sequence);  // by the signal thread
    rig.update("part1", proto::TASK_SUCCEEDED);
    EXPECT_EQ(dispatched().size(), 1U);
    rig.core().onStopSignal(head, StopCause::Requested, *raised);
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_STOPPED);
    EXPECT_THAT(lastOf("t1").reason().message(), HasSubstr("before part 2 of 3, Turn: "));
    rig.stopDone(*raised);
    EXPECT_EQ(dispatched().size(), 1U);
}

TEST_F(CompositeTasks, APauseHoldsThePartAndTheOnesAfterIt) {
    rig.task("client1", "t1", "Tour");
    control("t1", proto::PAUSE);
    EXPECT_EQ(lastReply(), proto::WRONG_STATE);
    rig.grant("part1");
    control("t1", proto::PAUSE);
    EXPECT_EQ(rig.to_application.back().pause().task_id(), rig.idOfSent("part1"));
    rig.update("part1", proto::TASK_PAUSED);
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_PAUSED);
    control("t1", proto::RESUME);
    rig.update("part1", proto::TASK_SUCCEEDED);
    EXPECT_EQ(dispatched().size(), 2U) << "resumed, whether the application has said so or not";
    rig.grant("part2");
    control("t1", proto::PAUSE);
    rig.update("part2", proto::TASK_SUCCEEDED);  // before it could pause
    EXPECT_EQ(dispatched().size(), 2U);
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_PAUSED);
    rig.advance(60s);
    EXPECT_EQ(dispatched().size(), 2U);
    control("t1", proto::RESUME);
    EXPECT_EQ(lastReply(), proto::OK);
    EXPECT_EQ(dispatched().size(), 3U);
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_RUNNING);
    rig.update("part3", proto::TASK_SUCCEEDED);
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_SUCCEEDED);
}

TEST_F(CompositeTasks, ACancelEndsItWhereverItIs) {
    rig.task("client1", "t1", "Tour");
    rig.grant("part1");
    control("t1", proto::CANCEL);
    EXPECT_EQ(rig.to_application.back().cancel().task_id(), rig.idOfSent("part1"));
    rig.update("part1", proto::TASK_SUCCEEDED);  // before the cancel was there
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_CANCELLED);
    EXPECT_EQ(dispatched().size(), 1U);
    rig.task("client1", "t2", "Tour");
    rig.grant("part2");
    control("t2", proto::PAUSE);
    rig.update("part2", proto::TASK_SUCCEEDED);
    const auto sent = rig.to_application.size();
    control("t2", proto::CANCEL);
    EXPECT_EQ(lastOf("t2").state(), proto::TASK_CANCELLED);
    EXPECT_EQ(lastOf("t2").reason().message(), "before part 2 of 3, Turn: Cancelled.");
    EXPECT_EQ(rig.to_application.size(), sent) << "the application has nothing to cancel";
    EXPECT_EQ(status().state, EntityState::REG);
}

TEST_F(CompositeTasks, AResetEndsTheWholeAndTheNextTaskBegins) {
    rig.task("client1", "t1", "Tour");
    rig.grant("part1");
    rig.task("client1", "t2", "Halt");
    rig.reset("client1");
    rig.update("part1", proto::TASK_SUCCEEDED);  // before the reset was there
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_STOPPED);
    EXPECT_EQ(dispatched().size(), 1U);
    rig.stopDone(1);
    EXPECT_THAT(dispatched(), ElementsAre("Turn", "Halt"));
    rig.update("t2", proto::TASK_SUCCEEDED);
    rig.task("client1", "t3", "Tour");
    rig.task("client1", "t4", "Halt");
    rig.grant("part2");
    control("t3", proto::PAUSE);
    rig.update("part2", proto::TASK_SUCCEEDED);
    rig.reset("client1");
    EXPECT_EQ(lastOf("t3").state(), proto::TASK_STOPPED) << "between two parts";
    EXPECT_EQ(dispatched().size(), 3U);
    rig.stopDone(2);
    EXPECT_EQ(dispatched().back(), "Halt");
}

TEST_F(CompositeTasks, TheNextPartWaitsForAnApplicationThatIsBusy) {
    rig.task("client1", "t1", "Tour");
    rig.grant("part1");
    proto::EiToEm message;
    message.mutable_status()->set_busy(true);
    rig.fromApplication(message);
    rig.update("part1", proto::TASK_SUCCEEDED);
    EXPECT_EQ(dispatched().size(), 1U);
    message.mutable_status()->set_busy(false);
    rig.fromApplication(message);
    EXPECT_EQ(dispatched().size(), 2U);
    EXPECT_EQ(status().state, EntityState::BUSY);
}

TEST_F(CompositeTasks, TheJournalHasTheDispatchOnceAndEachPart) {
    rig.task("client1", "t1", "Tour");
    EXPECT_EQ(rig.journal.records.back().kind, Kind::Dispatched);
    EXPECT_EQ(rig.journal.records.back().task.bytes(), idOf("t1"));
    EXPECT_EQ(rig.journal.records.back().text, "part 1 of 3, Turn");
    rig.update("part1", proto::TASK_SUCCEEDED);
    EXPECT_EQ(rig.journal.records.back().kind, Kind::Part);
    EXPECT_EQ(rig.journal.records.back().task.bytes(), idOf("t1"));
    EXPECT_EQ(rig.journal.records.back().text, "part 2 of 3, Turn");
}

TEST_F(CompositeTasks, ANextLifeDoesNotGoOn) {
    rig.task("client1", "t1", "Tour");
    rig.update("part1", proto::TASK_SUCCEEDED);
    rig.restart();
    rig.linkUp();
    rig.upload(false, test::kRigBasicProfile);
    rig.upload(true, kServices);
    rig.core().onServerUp();
    rig.take("client1", "r2");
    rig.task("client1", "t1", "Tour");
    EXPECT_EQ(lastOf("t1").state(), proto::TASK_UNKNOWN);
    EXPECT_EQ(lastOf("t1").reason().code(), proto::OUTCOME_UNKNOWN);
    EXPECT_EQ(dispatched().size(), 2U);
}

TEST_F(CompositeTasks, FinishesWithoutItsClientWhereItAndItsPartsMay) {
    rig.task("client1", "t1", "Tour");
    rig.grant("part1");
    lose();
    EXPECT_TRUE(rig.stops.empty());
    rig.advance(6s);  // beyond the grace
    rig.update("part1", proto::TASK_SUCCEEDED);
    EXPECT_EQ(dispatched().size(), 2U);
    rig.advance(100ms);
    EXPECT_TRUE(rig.stops.empty()) << "in doubt for a moment, but not without a term";
    rig.grant("part2");
    rig.advance(8900ms);
    EXPECT_FALSE(rig.stops.empty()) << "15 s of the whole, though the part might go on for 10";
    EXPECT_EQ(dispatched().size(), 2U);
    EXPECT_TRUE(rig.core().latched());
}

TEST_F(CompositeTasks, APartWithoutItsClientIsHeldToItsOwnTerm) {
    rig.task("client1", "t1", "Tour");
    rig.grant("part1");
    lose();
    rig.advance(9999ms);
    EXPECT_TRUE(rig.stops.empty());
    rig.advance(1ms);
    EXPECT_FALSE(rig.stops.empty());
}

TEST_F(CompositeTasks, APartThatMayNotGoOnAloneDoesNotBegin) {
    rig.task("client1", "t1", "Careful");
    rig.grant("part1");
    lose();
    EXPECT_TRUE(rig.stops.empty());
    rig.update("part1", proto::TASK_SUCCEEDED);
    EXPECT_THAT(dispatched(), ElementsAre("Turn")) << "the next part holds";
    EXPECT_TRUE(rig.stops.empty());
    rig.resumeLease("client1b", "r2", "client1");
    EXPECT_THAT(dispatched(), ElementsAre("Turn"));
    proto::ToEntity resume;
    resume.mutable_task_control()->set_task_id(idOf("t1"));
    resume.mutable_task_control()->set_action(proto::RESUME);
    rig.send("client1b", resume);
    EXPECT_THAT(dispatched(), ElementsAre("Turn", "Wait"));
}

TEST_F(CompositeTasks, WhatIsHeldBetweenTwoPartsEndsWithTheGrace) {
    rig.task("client1", "t1", "Careful");
    rig.grant("part1");
    lose();
    rig.update("part1", proto::TASK_SUCCEEDED);
    rig.advance(6s);
    EXPECT_EQ(status().state, EntityState::IDLE);
    EXPECT_THAT(dispatched(), ElementsAre("Turn"));
    EXPECT_FALSE(rig.stops.empty());
}

TEST_F(CompositeTasks, APartThatMustStopStopsTheWholeWhenItsTurnComes) {
    rig.task("client1", "t1", "Mixed");
    rig.grant("part1");
    lose();
    EXPECT_TRUE(rig.stops.empty());
    rig.update("part1", proto::TASK_SUCCEEDED);
    EXPECT_THAT(dispatched(), ElementsAre("Turn"));
    EXPECT_FALSE(rig.stops.empty());
    EXPECT_TRUE(rig.core().latched());
    EXPECT_EQ(status().state, EntityState::REG);
}

}  // namespace
}  // namespace axon::entity_manager
