// SPDX-License-Identifier: GPL-2.0-or-later
#include <axon/messages.pb.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "client/core/content.hpp"
#include "client/testing/test_environment.hpp"
#include "collaboration/sub_lease.hpp"

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;
using ::testing::SizeIs;

/// Two steps: the first PeopleBot drives, then the arm grabs.
GlobalService fetchBall() {
    GlobalService service;
    service.name = "Fetch ball";
    service.on_failure = OnFailure::Compensate;
    GlobalStep drive;
    drive.role = 0;
    drive.category = "ROBOT";
    drive.type = "MOBILE";
    drive.service_global_id = "drive";
    drive.preced = 1;
    drive.name = "approach";
    drive.parameters = {{"Distance", {std::string("1000")}, "mm", true}};
    GlobalStep grab;
    grab.role = 1;
    grab.category = "ROBOT";
    grab.type = "STATIONARY";
    grab.service_global_id = "grab";
    grab.preced = 2;
    grab.sources = {{"Place", "approach", "Position"}};
    service.steps = {drive, grab};
    auto back = drive;
    back.name.clear();
    service.compensation = {back};
    return service;
}

class RunsTest : public ::testing::Test, public CoreWorld {
  protected:
    void SetUp() override { connect(); }

    /// PeopleBot#1 and the arm, under leases 4 and 5 of one root.
    void takeBoth(std::chrono::milliseconds grace = {}) {
        Answer<std::vector<Held>> answer;
        core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, answer.taker());
        for (const auto& asked : link.take()) answerCheckOut(asked);
        int lease = 4;
        for (const auto& asked : link.take()) grantWithRoot(asked, root, lease++, grace);
        ASSERT_TRUE(answer.refusal.ok()) << answer.refusal.message;
        link.sent.clear();
    }
    void grantWithRoot(const SentMessage& asked, const std::string& of_root, int lease,
                       std::chrono::milliseconds grace = {}) {
        answerCheckOut(asked, RefusalCode::Ok, lease, grace, of_root);
    }
    Result<Id128> launch(int master = 1, bool check_only = false) {
        const auto service = fetchBall();
        return core.runs().run({service, {{0, uuid(1)}, {1, uuid(3)}}, uuid(master), check_only, 1234});
    }
    proto::RunEvent event(const Id128& run, std::uint64_t sequence, proto::RunState state) {
        proto::RunEvent event;
        event.set_run_id(run.bytes());
        event.set_sequence(sequence);
        event.set_state(state);
        return event;
    }
    void tell(int entity, const proto::RunEvent& event) {
        proto::ToClient message;
        *message.mutable_run() = event;
        fromEntity(entity, message);
    }
    RunReport report() { return runs.back(); }
    /// The client gets the lease of its master back and asks for the history of its runs: an answer without
    /// any.
    proto::ToClient resumeMaster() {
        for (const auto& message : link.take()) {
            if (message.head.entity == uuid(1) && message.body.has_check_out())
                grantWithRoot(message, root, 4, 5s);
        }
        const auto asked = link.take();
        EXPECT_THAT(asked, SizeIs(1));
        EXPECT_TRUE(asked.at(0).body.has_run_history());
        proto::ToClient answer;
        answer.mutable_run_history()->set_request_id(asked.at(0).body.run_history().request_id());
        return answer;
    }

    const std::string key = "0123456789abcdef", root = "root of the test";
    std::vector<RunReport>& runs = observer.runs;
};

TEST_F(RunsTest, AllCheckOutsOfASessionHaveOneRoot) {
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut({"PeopleBot#1", "Cyton"}, answer.taker());
    const auto reserved = link.take();
    for (const auto& asked : reserved) answerCheckOut(asked);
    const auto committed = link.take();
    core.checkOuts().checkOut({"PeopleBot#2"}, answer.taker());
    const auto& first = reserved[0].body.check_out().root();
    EXPECT_THAT(first, SizeIs(16));
    for (const auto& message : {reserved[1], committed[0], committed[1], link.sent[0]})
        EXPECT_EQ(message.body.check_out().root(), first);
}

TEST_F(RunsTest, WhoResumesALeaseOfAnotherProcessGoesOnWithItsRoot) {
    const LeaseTicket ticket{uuid(1), {1, 7}, key};
    Answer<std::vector<Held>> answer;
    core.checkOuts().resume(ticket, answer.taker());
    EXPECT_THAT(link.sent[0].body.check_out().root(), IsEmpty());
    grantWithRoot(link.take()[0], root, 7);
    ASSERT_TRUE(answer.refusal.ok());
    core.checkOuts().checkOut({"Cyton"}, answer.taker());
    EXPECT_EQ(link.sent[0].body.check_out().root(), root);
}

TEST_F(RunsTest, EachParticipantGivesTheMasterASealedSubLease) {
    takeBoth();
    marks.raise(uuid(3), 9);
    const auto id = launch();
    ASSERT_TRUE(id.ok()) << id.refusal().message;
    ASSERT_THAT(link.sent, SizeIs(1));
    const auto& sent = link.sent[0];
    EXPECT_EQ(sent.kind, "entity");
    EXPECT_EQ(sent.head.entity, uuid(1));
    EXPECT_EQ(sent.head.msg_type, kMsgRun);
    EXPECT_EQ(sent.head.held, (LeaseNumber{1, 4}));
    const auto& request = sent.body.collaboration();
    EXPECT_EQ(request.run_id(), id->bytes());
    EXPECT_EQ(request.asked_at_ms(), 1234);
    EXPECT_EQ(request.service().on_failure(), proto::COMPENSATE);
    EXPECT_EQ(request.service().steps(0).params(0).values(0).str(), "1000");
    EXPECT_EQ(request.service().steps(0).params(0).units(), "mm");
    EXPECT_EQ(request.service().steps(1).sources(0).output(), "Position");
    EXPECT_EQ(request.service().compensation_size(), 1);
    ASSERT_EQ(request.participants_size(), 2);
    for (const auto& participant : request.participants()) {
        EXPECT_TRUE(collaboration::isSealed(participant.lease(),
                                            {request.run_id(), uuid(1), participant.entity()}, key));
        EXPECT_EQ(participant.lease().root(), root);
    }
    EXPECT_EQ(request.participants(1).entity(), uuid(3));
    EXPECT_EQ(request.participants(1).name(), "Cyton");
    EXPECT_EQ(request.participants(1).lease().number(), 5U);
    EXPECT_EQ(request.participants(1).lease().stop_generation(), 9U);
}

TEST_F(RunsTest, AServiceComesBackFromTheContractAsItWas) {
    const auto once = toProto(fetchBall());
    EXPECT_EQ(toProto(fromProto(once)).SerializeAsString(), once.SerializeAsString());
}

TEST_F(RunsTest, WhatIsNotHeldIsNamed) {
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut({"PeopleBot#1"}, answer.taker());
    grantWithRoot(link.take()[0], root, 4);
    const auto id = launch();
    ASSERT_FALSE(id.ok());
    EXPECT_EQ(id.refusal().code, RefusalCode::NotHolder);
    EXPECT_THAT(id.refusal().message, HasSubstr("Cyton"));
    EXPECT_THAT(link.sent, IsEmpty());
}

TEST_F(RunsTest, LeasesOfTwoRootsDoNotCollaborate) {
    Answer<std::vector<Held>> answer;
    core.checkOuts().checkOut({"PeopleBot#1"}, answer.taker());
    grantWithRoot(link.take()[0], root, 4);
    core.checkOuts().checkOut({"Cyton"}, answer.taker());
    grantWithRoot(link.take()[0], "another, 16 long", 4);
    EXPECT_EQ(launch().refusal().code, RefusalCode::WrongState);
    EXPECT_THAT(link.sent, IsEmpty());
}

TEST_F(RunsTest, RolesAndMasterMustFit) {
    takeBoth();
    const auto service = fetchBall();
    const auto refusal = [&](std::map<int, std::string> players, int master) {
        return core.runs().run({service, std::move(players), uuid(master), false, 0}).refusal().code;
    };
    EXPECT_EQ(refusal({{0, uuid(1)}}, 1), RefusalCode::Malformed) << "nobody plays role 1";
    EXPECT_EQ(refusal({{0, uuid(1)}, {1, uuid(3)}, {2, uuid(3)}}, 1), RefusalCode::Malformed) << "no role 2";
    EXPECT_EQ(refusal({{0, uuid(1)}, {1, uuid(1)}}, 1), RefusalCode::Duplicate);
    EXPECT_EQ(refusal({{0, uuid(1)}, {1, uuid(3)}}, 2), RefusalCode::Malformed) << "the master takes no part";
    EXPECT_THAT(link.sent, IsEmpty());
}

TEST_F(RunsTest, AnOutputThatTheNextInputCanNeverTakeIsNamedBeforeAnythingIsSent) {
    takeBoth();
    auto service = fetchBall();
    for (auto& step : service.steps) step.service_global_id = "Driving";
    const auto checked = [&](const std::string& output) {
        service.steps[1].sources = {{"Distance", "approach", output}};
        return core.runs().run({service, {{0, uuid(1)}, {1, uuid(3)}}, uuid(1), true, 0});
    };
    const auto text = checked("Found");
    ASSERT_FALSE(text.ok());
    EXPECT_EQ(text.refusal().code, RefusalCode::WrongType);
    EXPECT_EQ(text.refusal().message,
              "Cyton: 'Distance' of Driving cannot take 'Found' of the step 'approach': STR is not INT.");
    EXPECT_THAT(link.sent, IsEmpty());
    EXPECT_TRUE(checked("Distance").ok());
    EXPECT_TRUE(checked("nothing that is known").ok()) << "the participant will say so";
}

TEST_F(RunsTest, StepsAreThereBeforeTheFirstEventAndChangeByTheirPosition) {
    takeBoth();
    const auto id = launch().value();
    const auto first = *core.runs().report(id);
    ASSERT_THAT(first.steps, SizeIs(3));
    EXPECT_EQ(first.state, RunState::Checking);
    EXPECT_EQ(first.steps[1].name, "Cyton");
    EXPECT_EQ(first.steps[1].service, "grab");
    EXPECT_FALSE(first.steps[1].state);
    EXPECT_FALSE(first.steps[1].compensation);
    EXPECT_TRUE(first.steps[2].compensation);
    EXPECT_TRUE(core.busy()) << "its heartbeats are those of a client with something running";

    auto running = event(id, 1, proto::RUN_RUNNING);
    running.set_progress(0.25);
    running.set_at_s(1.5);
    auto& status = *running.add_steps();
    status.set_step(0);
    status.set_entity(uuid(1));
    status.set_name("PeopleBot#1");
    status.set_service("drive");
    status.set_state(proto::TASK_RUNNING);
    status.set_progress(0.5);
    status.set_began_s(0.25);
    status.set_ended_s(-1);
    tell(1, running);
    ASSERT_THAT(runs, SizeIs(1));
    EXPECT_EQ(report().state, RunState::Running);
    EXPECT_EQ(report().elapsed, Seconds(1.5));
    EXPECT_EQ(report().steps[0].state, TaskState::Running);
    EXPECT_EQ(report().steps[0].began, Seconds(0.25));
    EXPECT_FALSE(report().steps[0].ended);
    EXPECT_FALSE(report().steps[1].state) << "nothing was said of it";

    auto over = event(id, 2, proto::RUN_FAILED);
    over.mutable_reason()->set_code(proto::FAILED);
    over.mutable_reason()->set_message("the arm slipped");
    tell(1, over);
    EXPECT_EQ(report().state, RunState::Failed);
    EXPECT_EQ(report().reason.message, "the arm slipped");
    EXPECT_EQ(report().steps[0].progress, 0.5);
    EXPECT_FALSE(core.busy());
    tell(1, event(id, 3, proto::RUN_RUNNING));
    EXPECT_THAT(runs, SizeIs(2)) << "a final state is never left";
}

TEST_F(RunsTest, DuplicatesAndOthersThanTheMasterAreNotListenedTo) {
    takeBoth();
    const auto id = launch().value();
    tell(1, event(id, 2, proto::RUN_RUNNING));
    tell(1, event(id, 1, proto::RUN_CHECKING));
    tell(3, event(id, 9, proto::RUN_FAILED));
    EXPECT_THAT(runs, SizeIs(1));
    EXPECT_EQ(report().state, RunState::Running);
    auto odd = event(id, 3, proto::RUN_RUNNING);
    odd.add_steps()->set_step(-1);
    odd.add_steps()->set_step(1'000'000);
    tell(1, odd);
    EXPECT_THAT(report().steps, SizeIs(3));
    EXPECT_EQ(core.malformed(), 2U);
}

TEST_F(RunsTest, ARefusalSaysWhatIsInTheWay) {
    takeBoth();
    const auto id = launch(1, true).value();
    EXPECT_TRUE(link.sent[0].body.collaboration().check_only());
    auto refused = event(id, 1, proto::RUN_REFUSED);
    refused.add_problems()->set_step(2);
    auto& problem = *refused.add_problems();
    problem.set_step(1);
    problem.set_entity("Cyton");
    problem.mutable_refusal()->set_code(proto::INACTIVE_SERVICE);
    problem.mutable_refusal()->set_message("grab is not active");
    tell(1, refused);
    EXPECT_TRUE(report().check);
    ASSERT_THAT(report().problems, SizeIs(2));
    EXPECT_EQ(report().problems[0].step, 1) << "in the order of the steps";
    EXPECT_EQ(report().problems[0].refusal.code, RefusalCode::InactiveService);
}

TEST_F(RunsTest, TheMasterMayRefuseTheRequestAsSuch) {
    takeBoth();
    const auto id = launch().value();
    proto::ToClient message;
    message.mutable_reply()->set_request_id(id.bytes());
    message.mutable_reply()->mutable_refusal()->set_code(proto::LATCHED);
    fromEntity(3, message);
    EXPECT_THAT(runs, IsEmpty()) << "not from the slave";
    fromEntity(1, message);
    EXPECT_EQ(report().state, RunState::Refused);
    EXPECT_EQ(report().reason.code, RefusalCode::Latched);
    advance(10s);
    EXPECT_THAT(runs, SizeIs(1));
}

TEST_F(RunsTest, ARequestThatNobodyAnswersIsUnknownAndCancelled) {
    takeBoth();
    const auto id = launch().value();
    link.sent.clear();
    advance(4999ms);
    EXPECT_THAT(runs, IsEmpty());
    advance(1ms);
    EXPECT_EQ(report().state, RunState::Unknown);
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].body.task_control().task_id(), id.bytes());
    EXPECT_EQ(link.sent[0].body.task_control().action(), proto::CANCEL);
    tell(1, event(id, 1, proto::RUN_RUNNING));
    EXPECT_THAT(link.sent, SizeIs(2)) << "it runs all the same: cancelled again";
    EXPECT_THAT(runs, SizeIs(1));
}

TEST_F(RunsTest, ControlsAreDoneWhenTheRunIsWhereItWasToGo) {
    takeBoth();
    const auto id = launch().value();
    tell(1, event(id, 1, proto::RUN_RUNNING));
    link.sent.clear();
    Answer<void> pause, resume, cancel, late;
    core.runs().control(id, proto::PAUSE, pause.taker());
    EXPECT_EQ(link.sent[0].body.task_control().task_id(), id.bytes());
    EXPECT_EQ(link.sent[0].head.msg_type, kMsgTaskControl);
    EXPECT_EQ(pause.count, 0);
    tell(1, event(id, 2, proto::RUN_PAUSED));
    EXPECT_EQ(pause.count, 1);
    core.runs().control(id, proto::RESUME, resume.taker());
    tell(1, event(id, 3, proto::RUN_RUNNING));
    EXPECT_EQ(resume.count, 1);
    core.runs().control(id, proto::CANCEL, cancel.taker());
    tell(1, event(id, 4, proto::RUN_STOPPING));
    EXPECT_EQ(cancel.count, 0);
    tell(1, event(id, 5, proto::RUN_CANCELLED));
    EXPECT_EQ(cancel.count, 1);
    EXPECT_TRUE(cancel.refusal.ok());
    core.runs().control(id, proto::PAUSE, late.taker());
    EXPECT_EQ(late.refusal.code, RefusalCode::WrongState);
}

TEST_F(RunsTest, ARefusedPauseLeavesTheRunAsItIs) {
    takeBoth();
    const auto id = launch().value();
    tell(1, event(id, 1, proto::RUN_RUNNING));
    Answer<void> pause;
    core.runs().control(id, proto::PAUSE, pause.taker());
    proto::ToClient message;
    message.mutable_reply()->set_request_id(id.bytes());
    message.mutable_reply()->mutable_refusal()->set_code(proto::NOT_PAUSABLE);
    fromEntity(1, message);
    EXPECT_EQ(pause.refusal.code, RefusalCode::NotPausable);
    EXPECT_EQ(core.runs().report(id)->state, RunState::Running);
}

TEST_F(RunsTest, ARefusalIsNoEndOfARunThatHasBegun) {
    takeBoth();
    const auto id = launch().value();
    tell(1, event(id, 1, proto::RUN_RUNNING));
    Answer<void> first, second;
    core.runs().control(id, proto::PAUSE, first.taker());
    core.runs().control(id, proto::PAUSE, second.taker());
    proto::ToClient message;
    message.mutable_reply()->set_request_id(id.bytes());
    message.mutable_reply()->mutable_refusal()->set_code(proto::NOT_PAUSABLE);
    fromEntity(1, message);
    fromEntity(1, message);
    EXPECT_EQ(first.refusal.code, RefusalCode::Cancelled) << "the second took its place";
    EXPECT_EQ(second.refusal.code, RefusalCode::NotPausable);
    message.mutable_reply()->mutable_refusal()->set_code(proto::WRONG_STATE);  // to a copy of the request
    fromEntity(1, message);
    EXPECT_EQ(core.runs().report(id)->state, RunState::Running);
    Answer<void> released;
    core.leases().release({uuid(1), {1, 4}}, released.taker());
    fromEntity(1, message);
    EXPECT_EQ(core.runs().report(id)->state, RunState::Running) << "its end is still to come";
    tell(1, event(id, 2, proto::RUN_STOPPED));
    EXPECT_EQ(report().state, RunState::Stopped);
}

TEST_F(RunsTest, WithItsMasterTheRunIsLost) {
    takeBoth();
    const auto id = launch().value();
    auto running = event(id, 1, proto::RUN_RUNNING);
    running.add_steps()->set_state(proto::TASK_RUNNING);
    tell(1, running);
    proto::ToClient message;
    message.mutable_lease_ended()->mutable_lease()->set_epoch(1);
    message.mutable_lease_ended()->mutable_lease()->set_number(4);
    fromEntity(1, message);
    EXPECT_EQ(report().state, RunState::Unknown);
    EXPECT_EQ(report().id, id.toString());
    EXPECT_EQ(report().steps[0].state, TaskState::Unknown) << "it was under way";
    EXPECT_FALSE(report().steps[1].state) << "it was not";
    EXPECT_FALSE(core.busy());
}

TEST_F(RunsTest, TheLossOfASlaveIsTheMastersToTell) {
    takeBoth();
    const auto id = launch().value();
    tell(1, event(id, 1, proto::RUN_RUNNING));
    core.onProfile(Presence::Left, {uuid(3), "Cyton", "ROBOT", "MOBILE"}, {});
    EXPECT_THAT(runs, SizeIs(1));
    tell(1, event(id, 2, proto::RUN_STOPPED));
    EXPECT_EQ(report().state, RunState::Stopped);
}

TEST_F(RunsTest, AfterALostConnectionTheMasterSaysHowItEnded) {
    takeBoth(5s);
    const auto id = launch().value();
    tell(1, event(id, 1, proto::RUN_RUNNING));
    core.onDisconnected("cut");
    EXPECT_THAT(runs, SizeIs(1)) << "nobody knows yet";
    connect();
    auto answer = resumeMaster();
    fromEntity(1, answer);
    EXPECT_THAT(runs, SizeIs(1)) << "it may be ending at this moment";
    advance(1s);
    ASSERT_THAT(link.take(), SizeIs(1)) << "asked again";
    auto& record = *answer.mutable_run_history()->add_runs();
    record.set_run_id(id.bytes());
    record.set_state(proto::RUN_STOPPED);
    record.set_duration_s(2.5);
    record.mutable_reason()->set_code(proto::CLIENT_LOST);
    auto& step = *record.add_steps();
    step.set_step(0);
    step.set_state(proto::TASK_STOPPED);
    step.set_ended_s(2.25);
    fromEntity(1, answer);
    EXPECT_EQ(report().state, RunState::Stopped);
    EXPECT_EQ(report().reason.code, RefusalCode::ClientLost);
    EXPECT_EQ(report().elapsed, Seconds(2.5));
    EXPECT_EQ(report().steps[0].ended, Seconds(2.25));
    advance(20s);
    EXPECT_THAT(runs, SizeIs(2));
}

TEST_F(RunsTest, ARunThatIsStillUnderWayAfterALostConnectionStaysSoHoweverQuietItIs) {
    takeBoth(5s);
    const auto id = launch().value();
    auto running = event(id, 1, proto::RUN_RUNNING);
    auto& began = *running.add_steps();
    began.set_step(0);
    began.set_state(proto::TASK_RUNNING);
    began.add_params()->set_name("Distance");
    tell(1, running);
    core.onDisconnected("cut");
    connect();
    auto answer = resumeMaster();
    auto& record = *answer.mutable_run_history()->add_runs();
    record.set_run_id(id.bytes());
    record.set_state(proto::RUN_HELD);
    record.set_duration_s(2.5);
    record.mutable_reason()->set_code(proto::TIMED_OUT);
    auto& step = *record.add_steps();  // too large to have its parameters
    step.set_step(0);
    step.set_state(proto::TASK_SUCCEEDED);
    fromEntity(1, answer);
    EXPECT_EQ(report().state, RunState::Held) << "meanwhile";
    EXPECT_EQ(report().reason.code, RefusalCode::TimedOut);
    EXPECT_EQ(report().elapsed, Seconds(2.5));
    EXPECT_EQ(report().steps[0].state, TaskState::Succeeded) << "of which the master tells once";
    EXPECT_THAT(report().steps[0].parameters, SizeIs(1));
    for (int i = 0; i < 20; ++i) advance(1s);
    EXPECT_EQ(report().state, RunState::Held) << report().reason.message;
    for (const auto& message : link.take()) EXPECT_FALSE(message.body.has_run_history()) << "it has answered";
    tell(1, event(id, 2, proto::RUN_SUCCEEDED));
    EXPECT_EQ(report().state, RunState::Succeeded);
}

TEST_F(RunsTest, ARunThatLivesIsNotCancelledBecauseItsFirstEventWasLost) {
    takeBoth(5s);
    const auto id = launch().value();
    link.sent.clear();
    core.onProfile(Presence::Left, {uuid(1), "PeopleBot#1", "ROBOT", "MOBILE"}, {});
    join(1, "PeopleBot#1");
    auto answer = resumeMaster();
    auto& record = *answer.mutable_run_history()->add_runs();
    record.set_run_id(id.bytes());
    record.set_state(proto::RUN_RUNNING);
    fromEntity(1, answer);
    for (int i = 0; i < 20; ++i) advance(1s);
    EXPECT_EQ(report().state, RunState::Running) << report().reason.message;
    for (const auto& message : link.take()) EXPECT_FALSE(message.body.has_task_control());
}

TEST_F(RunsTest, AMasterThatDoesNotSayHowItEndedLeavesItUnknown) {
    takeBoth(5s);
    launch().value();
    core.onDisconnected("cut");
    connect();
    for (const auto& message : link.take()) {
        if (message.head.entity == uuid(1)) grantWithRoot(message, root, 4, 5s);
    }
    for (int i = 0; i < 5; ++i) advance(1s);
    EXPECT_EQ(report().state, RunState::Unknown);
    EXPECT_EQ(report().reason.code, RefusalCode::OutcomeUnknown);
}

TEST_F(RunsTest, ARunWhoseMasterIsReleasedIsToldToItsEnd) {
    takeBoth();
    const auto id = launch().value();
    tell(1, event(id, 1, proto::RUN_RUNNING));
    Answer<void> answer;
    core.leases().release({uuid(1), {1, 4}}, answer.taker());
    tell(1, event(id, 2, proto::RUN_STOPPED));
    EXPECT_EQ(report().state, RunState::Stopped);
}

TEST_F(RunsTest, TheServerIsAskedForItsGlobalServices) {
    Result<GlobalServices> answer = Refusal{RefusalCode::Internal, "none", {}};
    int count = 0;
    core.runs().fetchServices([&](Result<GlobalServices> services) {
        ++count;
        answer = std::move(services);
    });
    ASSERT_THAT(link.sent, SizeIs(1));
    EXPECT_EQ(link.sent[0].kind, "request");
    EXPECT_EQ(link.sent[0].head.msg_type, kMsgGlobalServices);
    proto::ToClient message;
    auto& services = *message.mutable_global_services();
    services.set_request_id(link.sent[0].body.global_services().request_id());
    auto& good = *services.add_files();
    good.set_name("ball.xml");
    *good.mutable_profile()->add_services() = toProto(fetchBall());
    good.add_findings("ball.xml:3: warning: a count that does not match");
    auto& bad = *services.add_files();
    bad.set_name("bad.xml");
    bad.set_bad(true);
    fromEntity(1, message);
    EXPECT_EQ(count, 0) << "an entity does not answer for the server";
    core.onEntityMsg(Header{}, message.SerializeAsString());
    ASSERT_EQ(count, 1);
    ASSERT_THAT(answer->services, SizeIs(1));
    EXPECT_EQ(answer->services[0].file, "ball.xml");
    EXPECT_EQ(answer->services[0].steps[1].sources[0].step, "approach");
    ASSERT_THAT(answer->files, SizeIs(2));
    EXPECT_THAT(answer->files[0].findings, SizeIs(1));
    EXPECT_TRUE(answer->files[1].bad);
}

TEST_F(RunsTest, AServerThatDoesNotAnswerIsATimeOut) {
    Answer<GlobalServices> answer;
    core.runs().fetchServices(answer.taker());
    advance(5s);
    EXPECT_EQ(answer.count, 1);
    EXPECT_EQ(answer.refusal.code, RefusalCode::TimedOut);
}

TEST_F(RunsTest, AnEntityTellsItsRuns) {
    Result<std::vector<RunRecord>> answer = Refusal{RefusalCode::Internal, "none", {}};
    core.runs().fetchRecords(uuid(2), 3,
                             [&](Result<std::vector<RunRecord>> records) { answer = std::move(records); });
    EXPECT_EQ(link.sent[0].body.run_history().most(), 3U);
    proto::ToClient message;
    message.mutable_run_history()->set_request_id(link.sent[0].body.run_history().request_id());
    auto& record = *message.mutable_run_history()->add_runs();
    record.set_run_id(std::string(16, 'x'));
    *record.mutable_service() = toProto(fetchBall());
    record.set_by("ana@lab");
    record.set_asked_at_ms(1500);
    record.set_state(proto::RUN_SUCCEEDED);
    for (const int step : {2, 0}) record.add_steps()->set_step(step);
    fromEntity(2, message);
    ASSERT_TRUE(answer.ok());
    const auto& got = answer->front();
    EXPECT_EQ(got.by, "ana@lab");
    EXPECT_EQ(got.service.name, "Fetch ball");
    EXPECT_EQ(got.asked_at.time_since_epoch(), 1500ms);
    EXPECT_EQ(got.state, RunState::Succeeded);
    ASSERT_THAT(got.steps, SizeIs(2));
    EXPECT_FALSE(got.steps[0].compensation);
    EXPECT_TRUE(got.steps[1].compensation);
}

TEST_F(RunsTest, RolesGatherWhatTheirStepsNeed) {
    const auto roles = rolesOf(fetchBall());
    ASSERT_THAT(roles, SizeIs(2));
    EXPECT_EQ(roles[0].category, "ROBOT");
    EXPECT_THAT(roles[0].needs, SizeIs(2)) << "the compensation's too";
    EXPECT_THAT(roles[1].needs[0].given, ElementsAre("Place"));
}

}  // namespace
}  // namespace axon::client::test
