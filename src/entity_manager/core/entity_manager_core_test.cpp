// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/entity_manager_core.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <set>

#include "entity_manager/core/streams/stream_watches.hpp"
#include "messages/values.hpp"
#include "tests/support/core_rig.hpp"

namespace axon::entity_manager {
namespace {

using test::CoreRig;
using test::idOf;

/// The final state that was told of the task, and how many times one was.
std::pair<proto::TaskState, int> endOf(const CoreRig& rig, const std::string& task) {
    std::pair<proto::TaskState, int> end{proto::TASK_UNSPECIFIED, 0};
    for (const auto& record : rig.to_clients)
        if (record.message.has_task() && record.message.task().task_id() == idOf(task) &&
            record.message.task().state() >= proto::TASK_SUCCEEDED)
            end = {record.message.task().state(), end.second + 1};
    return end;
}

proto::RefusalCode refusalOf(const CoreRig& rig, const std::string& task) {
    for (const auto& record : rig.to_clients)
        if (record.message.has_task() && record.message.task().task_id() == idOf(task) &&
            record.message.task().state() == proto::TASK_REFUSED)
            return record.message.task().reason().code();
    return proto::OK;
}

int dispatches(const CoreRig& rig) {
    int count = 0;
    for (const auto& message : rig.to_application) count += message.has_task() ? 1 : 0;
    return count;
}

struct Held : testing::Test {
    Held() {
        rig.makeIdle();
        rig.take("client1", "r1");
    }
    CoreRig rig;
};

TEST(Granting, TheStorageHearsOfAHolderBeforeAnybodyIsTold) {
    CoreRig rig;
    rig.makeIdle();
    ASSERT_TRUE(rig.storage.values.contains("free"));
    int grants = 0;
    rig.on_client = [&](const CoreRig::ToClientRecord& record) {
        if (!record.message.check_out().has_lease()) return;
        ++grants;
        EXPECT_FALSE(rig.storage.values.contains("free")) << "a life that is cut off now comes up latched";
    };
    rig.take("client1", "r1");
    EXPECT_EQ(grants, 1);
}

struct NotReady : testing::Test {
    NotReady() {
        rig.core().start();
        rig.core().onServerUp();
    }
    /// What the application was told of its profiles, newest last.
    std::vector<std::pair<proto::RefusalCode, std::string>> toldOfProfiles() const {
        std::vector<std::pair<proto::RefusalCode, std::string>> told;
        for (const auto& message : rig.to_application)
            if (message.has_profile_error())
                told.emplace_back(message.profile_error().code(), message.profile_error().message());
        return told;
    }
    static bool has(const std::string& text, const std::string& part) {
        return text.find(part) != std::string::npos;
    }
    CoreRig rig;
};

TEST_F(NotReady, TheServerIsWantedAtOnceAndTheEntityIsRegisteredWithoutAProfile) {
    const auto lines = rig.takeLines();
    EXPECT_EQ(lines.at(0), "server: wanted");
    EXPECT_EQ(lines.at(1), "server: not ready rig");
    ASSERT_FALSE(rig.statuses.empty());
    EXPECT_EQ(rig.statuses.back().state, EntityState::UNAV);
    EXPECT_TRUE(has(rig.statuses.back().reason, "waiting for the robot application \"rig\""));
    rig.linkUp();
    EXPECT_EQ(rig.statuses.back().state, EntityState::INIT);
    EXPECT_EQ(rig.statuses.back().reason, "") << "all goes well";
    rig.uploadProfiles();
    EXPECT_EQ(rig.core().state(), EntityState::IDLE);
    EXPECT_EQ(rig.statuses.back().state, EntityState::IDLE);
    bool ready = false;
    for (const auto& line : rig.takeLines()) ready = ready || has(line, "server: profile Rig ROBOT/MOBILE");
    EXPECT_TRUE(ready);
}

TEST(NotReadyYet, AnApplicationThatIsCalledLikeAnotherEntityIsShownInQuotes) {
    CoreRig rig(1, {.application = "PeopleBot#2"});
    rig.core().start();
    rig.core().onServerUp();
    EXPECT_EQ(rig.takeLines().at(1), "server: not ready \"PeopleBot#2\"")
        << "the server would refuse the name itself";
}

TEST_F(NotReady, ACheckOutIsRefusedWithWhatTheSearchForTheApplicationHasFound) {
    rig.core().onApplicationSought("none is found; found there: \"other\" (port 5500)");
    EXPECT_TRUE(has(rig.statuses.back().reason, "found there: \"other\""));
    rig.take("client1", "r1");
    ASSERT_FALSE(rig.to_clients.empty());
    const auto& refusal = rig.to_clients.back().message.check_out().refusal();
    EXPECT_EQ(refusal.code(), proto::UNAVAILABLE);
    EXPECT_TRUE(has(refusal.message(), "found there: \"other\"")) << refusal.message();
    rig.linkUp();
    rig.core().onApplicationSought("late news");
    EXPECT_EQ(rig.core().status().reason, "");
    rig.core().onLinkDown("pulled");
    EXPECT_FALSE(has(rig.core().status().reason, "other"));
}

TEST_F(NotReady, AnApplicationThatUploadsOneProfileOnlyIsToldAfterThreeSeconds) {
    for (const bool services : {false, true}) {
        rig.to_application.clear();
        rig.linkUp();
        rig.upload(services, services ? test::kRigServicesProfile : test::kRigBasicProfile);
        rig.advance(std::chrono::milliseconds{2999});
        EXPECT_TRUE(toldOfProfiles().empty());
        EXPECT_EQ(rig.core().takeWarning(), "");
        rig.advance(std::chrono::milliseconds{1});
        EXPECT_EQ(rig.core().state(), EntityState::INIT);
        const std::string missing = services ? "no basic profile" : "no services profile";
        ASSERT_EQ(toldOfProfiles().size(), 1U);
        EXPECT_EQ(toldOfProfiles()[0].first, proto::MALFORMED);
        EXPECT_TRUE(has(toldOfProfiles()[0].second, missing)) << toldOfProfiles()[0].second;
        EXPECT_TRUE(has(toldOfProfiles()[0].second, "fix: "));
        EXPECT_TRUE(has(rig.core().takeWarning(), missing));
        EXPECT_TRUE(has(rig.statuses.back().reason, missing)) << rig.statuses.back().reason;
        rig.take("client1", "r1");
        EXPECT_TRUE(has(rig.to_clients.back().message.check_out().refusal().message(), missing));
        rig.advance(std::chrono::seconds{60});
        EXPECT_EQ(toldOfProfiles().size(), 1U);
        rig.upload(!services, services ? test::kRigBasicProfile : test::kRigServicesProfile);
        EXPECT_EQ(rig.core().state(), EntityState::IDLE);
        EXPECT_EQ(rig.core().status().reason, "");
        rig.core().onLinkDown("pulled");
    }
}

TEST_F(NotReady, AnApplicationWithoutAnyProfileIsTold) {
    rig.linkUp();
    rig.advance(std::chrono::seconds{3});
    EXPECT_TRUE(has(rig.statuses.back().reason, "has uploaded no profile"));
    EXPECT_EQ(rig.statuses.back().state, EntityState::INIT);
}

TEST_F(NotReady, ADiskThatDoesNotAnswerIsNamed) {
    rig.resources.slow = true;
    rig.linkUp();
    rig.upload(false, test::kRigBasicProfile);
    rig.upload(true, test::kRigServicesProfile);
    rig.advance(std::chrono::milliseconds{2999});
    EXPECT_EQ(rig.core().status().reason, "");
    rig.advance(std::chrono::milliseconds{1});
    EXPECT_EQ(rig.core().state(), EntityState::INIT);
    EXPECT_TRUE(has(rig.statuses.back().reason, "a disk of the robot's machine does not answer"))
        << rig.statuses.back().reason;
    EXPECT_TRUE(has(rig.core().takeWarning(), "a disk of the robot's machine does not answer"));
    EXPECT_TRUE(toldOfProfiles().empty()) << "nothing is wrong with them";
    rig.resources.answerAll();
    rig.core().onStored();
    EXPECT_EQ(rig.core().state(), EntityState::IDLE);
    EXPECT_EQ(rig.core().status().reason, "");
}

TEST_F(NotReady, ABrokenProfileAloneIsAnErrorThatAlsoNamesWhatIsMissing) {
    rig.linkUp();
    rig.upload(false, "<BasicProfile/>");
    rig.advance(std::chrono::seconds{3});
    EXPECT_EQ(rig.core().state(), EntityState::ERR);
    EXPECT_EQ(rig.statuses.back().state, EntityState::ERR);
    EXPECT_TRUE(has(rig.statuses.back().reason, "basic.xml:1: error"));
    EXPECT_TRUE(has(rig.statuses.back().reason, "no services profile"));
    ASSERT_EQ(toldOfProfiles().size(), 1U);
    EXPECT_EQ(toldOfProfiles()[0].second, rig.statuses.back().reason);
}

TEST_F(NotReady, ProfilesThatAreBrokenFromTheBeginningAreToldToEverybody) {
    rig.linkUp();
    rig.upload(false, "<BasicProfile/>");
    rig.upload(true, test::kRigServicesProfile);
    EXPECT_EQ(rig.statuses.back().state, EntityState::ERR);
    EXPECT_TRUE(has(rig.statuses.back().reason, "basic.xml:1: error"));
}

TEST_F(NotReady, APositionThatIsToldBeforeTheProfilesIsNotLostByTheRegistration) {
    rig.core().onServerDown("gone");
    rig.linkUp();
    proto::EiToEm moved;
    moved.mutable_position()->set_xpos(7);
    rig.fromApplication(moved);
    rig.core().onServerUp();
    rig.takeLines();
    rig.uploadProfiles();
    bool told = false;
    for (const auto& line : rig.takeLines())
        told = told || has(line, "server: profile Rig ROBOT/MOBILE (7, 0, 0)");
    EXPECT_TRUE(told);
}

TEST_F(NotReady, AStopLatchesAnEntityThatIsNotReady) {
    rig.stop("client1");
    EXPECT_TRUE(rig.statuses.back().latched);
    EXPECT_EQ(rig.to_clients.back().message.receipt().stage(), proto::StopReceipt::NO_APPLICATION);
    rig.linkUp();
    rig.uploadProfiles();
    EXPECT_TRUE(rig.core().latched());
}

std::string withName(const char* profile, const std::string& name) {
    std::string text = profile;
    text.replace(text.find("\"Rig\""), 5, '"' + name + '"');
    return text;
}

TEST_F(Held, AProfileThatChangesMeanwhileIsKeptAndUploadedAtTheRelease) {
    rig.to_application.clear();
    rig.upload(false, withName(test::kRigBasicProfile, "Second"));
    rig.upload(false, withName(test::kRigBasicProfile, "Third"));
    ASSERT_EQ(rig.to_application.size(), 2U);
    EXPECT_EQ(rig.to_application[0].profile_error().code(), proto::WRONG_STATE);
    EXPECT_NE(rig.to_application[0].profile_error().message().find("kept, and uploaded at its release"),
              std::string::npos);
    EXPECT_NE(rig.core().takeNews().find("basic.xml has changed while the entity is checked out"),
              std::string::npos);
    EXPECT_EQ(rig.core().state(), EntityState::REG);

    rig.to_application.clear();
    rig.takeLines();
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    EXPECT_EQ(rig.core().state(), EntityState::IDLE);
    ASSERT_EQ(rig.to_application.size(), 2U);
    EXPECT_TRUE(rig.to_application[1].has_configuration());
    EXPECT_EQ(rig.to_application[0].profile_error().code(), proto::OK);
    EXPECT_NE(rig.to_application[0].profile_error().message().find("uploaded now"), std::string::npos);
    EXPECT_NE(rig.core().takeNews().find("uploaded now"), std::string::npos);
    const auto lines = rig.takeLines();
    EXPECT_TRUE(std::any_of(lines.begin(), lines.end(),
                            [](const auto& line) { return line.starts_with("server: profile Third "); }));
    // Once.
    rig.stopDone(rig.stop_generations.generation());
    rig.to_application.clear();
    rig.take("client1", "r2");
    rig.send("client1", release);
    EXPECT_TRUE(rig.to_application.empty());
}

TEST_F(Held, TheNextInTheWaitListGetsTheEntityWithTheProfileThatWasKept) {
    proto::ToEntity waits;
    waits.mutable_check_out()->set_phase(proto::TAKE);
    waits.mutable_check_out()->set_request_id(idOf("r2"));
    waits.mutable_check_out()->set_wait(true);
    rig.send("client2", waits);
    rig.upload(true, R"(<ServiceProfile count="1"><Service name="Dancing" type="SMPL"/></ServiceProfile>)");
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    rig.stopDone(rig.stop_generations.generation());
    ASSERT_NE(rig.core().held(), nullptr);
    EXPECT_EQ(rig.core().held()->holder.id, "client2");
    const auto& grant = rig.to_clients.back().message.check_out();
    ASSERT_EQ(grant.services().services_size(), 1);
    EXPECT_EQ(grant.services().services(0).name(), "Dancing");
}

TEST_F(Held, ABrokenProfileIsToldAtOnceAndPutsTheEntityOutOfServiceOnlyAtTheRelease) {
    rig.to_application.clear();
    rig.upload(true, "<ServiceProfile");
    ASSERT_EQ(rig.to_application.size(), 1U);
    EXPECT_EQ(rig.to_application[0].profile_error().code(), proto::WRONG_STATE);
    EXPECT_NE(rig.to_application[0].profile_error().message().find("services.xml:1: error"),
              std::string::npos);
    EXPECT_EQ(rig.core().state(), EntityState::REG);
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    EXPECT_EQ(rig.core().state(), EntityState::ERR);
}

TEST_F(Held, AProfileThatWasKeptIsForgottenWithTheLink) {
    rig.upload(false, withName(test::kRigBasicProfile, "Second"));
    rig.core().onLinkDown("pulled");
    rig.linkUp();
    rig.uploadProfiles();  // what the application has now
    EXPECT_EQ(rig.core().state(), EntityState::IDLE);
    for (const auto& line : rig.takeLines()) EXPECT_FALSE(line.starts_with("server: profile Second")) << line;
}

TEST_F(Held, StopVoidsAFullQueueAndTheQueueTakesNoMoreThanItsBound) {
    rig.task("client1", "run", "Turning");
    rig.grant("run");
    for (int i = 0; i < 64; ++i) rig.task("client1", "w" + std::to_string(i), "Turning");
    rig.task("client1", "one-more", "Turning");
    EXPECT_EQ(refusalOf(rig, "one-more"), proto::QUEUE_FULL);
    rig.stop("client2");
    for (int i = 0; i < 64; ++i)
        EXPECT_EQ(endOf(rig, "w" + std::to_string(i)), std::pair(proto::TASK_STOPPED, 1));
    EXPECT_EQ(endOf(rig, "run"), std::pair(proto::TASK_STOPPED, 1));
    EXPECT_EQ(dispatches(rig), 1);
}

TEST_F(Held, ADrillOfTheServerIsAnsweredToItAloneAndItsEndHasItsOwnRoutingKey) {
    rig.task("client1", "run", "Turning");
    rig.grant("run");
    rig.to_clients.clear();
    auto head = rig.headOf("drill-1");
    head.msg_type = kMsgDrill;
    rig.core().onDrill(head, *rig.stop_generations.drill(head.sender.id, head.sequence));
    rig.drillDone(1);
    ASSERT_EQ(rig.to_clients.size(), 2U);
    for (const auto& told : rig.to_clients) {
        EXPECT_EQ(told.head.sender.id, "drill-1");
        EXPECT_EQ(told.lane, Lane::Signal);
    }
    EXPECT_EQ(rig.to_clients[0].head.msg_type, kMsgReceipt);
    EXPECT_EQ(rig.to_clients[1].head.msg_type, kMsgDrill);
    EXPECT_EQ(endOf(rig, "run").second, 0);
    // The holder has not heard of it, and may go on.
    rig.task("client1", "next", "Turning");
    EXPECT_EQ(refusalOf(rig, "next"), proto::OK);
}

TEST_F(Held, DrillsChangeNothingHoweverManyThereAre) {
    rig.task("client1", "run", "Turning");
    rig.grant("run");
    rig.stop("client2");  // remembered: the same stop by another path raises nothing
    const auto sequence = rig.clients["client2"].sequence;
    rig.update("run", proto::TASK_STOPPED);
    rig.stopDone(1);
    rig.rearm("client1", "r2");
    rig.task("client1", "again", "Turning");
    ASSERT_EQ(refusalOf(rig, "again"), proto::OK);
    rig.grant("again");
    ASSERT_EQ(rig.core().state(), EntityState::BUSY);
    const auto generation = rig.stop_generations.generation();
    const auto statuses = rig.statuses.size();
    const auto stops = rig.stops.size();
    const auto journaled = [&] {
        return std::count_if(
            rig.journal.records.begin(), rig.journal.records.end(),
            [](const JournalRecord& record) { return record.kind == JournalRecord::Kind::Stopped; });
    };
    const auto journal = journaled();
    for (std::uint32_t i = 1; i <= 1000; ++i) {
        rig.stop("client3", StopCause::Drill);
        EXPECT_EQ(rig.stop_generations.generation(), generation);
        // The holder's messages are those of the newest generation, whether it has heard of the drill or not.
        const auto told = rig.to_clients.size();
        rig.setParam("client1", "s" + std::to_string(i), "Driving", "Speed=300");
        for (auto at = told; at < rig.to_clients.size(); ++at)
            EXPECT_NE(rig.to_clients[at].message.reply().refusal().code(), proto::OLD_GENERATION);
        rig.drillDone(i);
    }
    EXPECT_EQ(rig.statuses.size(), statuses);
    EXPECT_EQ(rig.stops.size(), stops);
    EXPECT_EQ(journaled(), journal);
    EXPECT_EQ(rig.core().state(), EntityState::BUSY);
    rig.stop("client2", StopCause::Requested, sequence);
    EXPECT_EQ(rig.stop_generations.generation(), generation) << "drills do not push stops out of the memory";
}

TEST_F(Held, ADrillIsAnsweredOnceWhicheverOfNewsAndAnswerIsFirst) {
    const auto returned = [&] {
        return std::count_if(rig.to_clients.begin(), rig.to_clients.end(), [](const auto& told) {
            return told.head.sender.id == "client3" &&
                   told.message.receipt().stage() == proto::StopReceipt::CALLBACK_RETURNED;
        });
    };
    const auto head = rig.headOf("client3");
    const auto number = rig.stop_generations.drill(head.sender.id, head.sequence);
    ASSERT_TRUE(number);
    EXPECT_FALSE(rig.stop_generations.drill(head.sender.id, head.sequence)) << "the same by another path";
    rig.drillDone(*number);
    EXPECT_EQ(returned(), 0);
    rig.core().onDrill(head, *number);
    EXPECT_EQ(returned(), 1);
    rig.drillDone(*number);
    rig.drillDone(7);  // never given
    EXPECT_EQ(returned(), 1);
    // Without an application, and one on its way when the link comes.
    rig.core().onLinkDown("gone");
    rig.stop("client3", StopCause::Drill);
    EXPECT_EQ(rig.to_clients.back().message.receipt().stage(), proto::StopReceipt::NO_APPLICATION);
}

TEST_F(Held, TheAnswerToADrillIsNoReceiptOfTheStopBeforeIt) {
    const auto returned = [&] {
        int count = 0;
        for (const auto& told : rig.to_clients)
            count += told.head.sender.id == "client2" && told.message.has_receipt() &&
                             told.message.receipt().stage() == proto::StopReceipt::CALLBACK_RETURNED
                         ? 1
                         : 0;
        return count;
    };
    rig.stop("client2");
    const auto stop = rig.stop_generations.generation();
    rig.stop("client3", StopCause::Drill);
    rig.drillDone(1);  // as when the callback of the stop has thrown
    EXPECT_EQ(returned(), 0);
    rig.stopDone(stop);
    EXPECT_EQ(returned(), 1);
}

TEST_F(Held, AStopCallbackThatThrowsIsSaidInTheReceiptAndConfirmsNothing) {
    rig.stop("client2");
    proto::EiToEm done;
    done.mutable_stop_done()->set_stop_generation(1);
    done.mutable_stop_done()->set_fault("it threw: no brake");
    rig.to_clients.clear();
    rig.fromApplication(done);
    ASSERT_FALSE(rig.to_clients.empty());
    for (const auto& told : rig.to_clients) {
        EXPECT_EQ(told.message.receipt().stage(), proto::StopReceipt::MANAGER);
        EXPECT_EQ(told.message.receipt().fault(), "it threw: no brake");
    }
    EXPECT_NE(rig.core().takeWarning().find("no brake"), std::string::npos);
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    rig.take("client2", "r2");
    EXPECT_EQ(rig.core().held(), nullptr) << "a robot that has not stopped is handed over";
    rig.stopDone(2);
    EXPECT_NE(rig.core().held(), nullptr);
}

TEST_F(Held, TheAnswerToADrillDoesNotLetTheRobotBeGivenToTheNext) {
    rig.stop("client2");
    const auto stop = rig.stop_generations.generation();
    rig.stop("client3", StopCause::Drill);
    rig.drillDone(1);
    proto::ToEntity bye;
    bye.mutable_release();
    rig.send("client1", bye);
    const auto released = rig.stop_generations.generation();
    rig.stop("client3", StopCause::Drill);
    rig.drillDone(2);  // the application is still inside the callbacks of both stops
    rig.take("client2", "r2");
    EXPECT_EQ(rig.core().state(), EntityState::IDLE);
    rig.stopDone(stop);
    EXPECT_EQ(rig.core().state(), EntityState::IDLE);
    rig.stopDone(released);
    rig.stopDone(rig.stop_generations.generation());
    EXPECT_EQ(rig.core().state(), EntityState::REG);
}

TEST_F(Held, NothingIsDispatchedWhileAStopIsOnItsWayToTheStrand) {
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    rig.task("client1", "t2", "Turning");
    // The signal thread has raised the generation and told the robot; the strand does not know yet.
    auto head = rig.headOf("client2");
    const auto raised = rig.stop_generations.raise("client2", head.sequence);
    rig.update("t1", proto::TASK_SUCCEEDED);
    EXPECT_EQ(dispatches(rig), 1);
    rig.task("client1", "t3", "Turning");
    EXPECT_EQ(refusalOf(rig, "t3"), proto::OLD_GENERATION);
    rig.core().onStopSignal(head, StopCause::Requested, *raised);
    EXPECT_EQ(endOf(rig, "t2"), std::pair(proto::TASK_STOPPED, 1));
    EXPECT_TRUE(rig.core().latched());
}

TEST_F(Held, AResetDoesNotReviveWhatAStopUnderWayVoids) {
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    rig.task("client1", "t2", "Turning");
    auto head = rig.headOf("client2");
    const auto raised = rig.stop_generations.raise("client2", head.sequence);
    rig.reset("client1");  // its own stop is newer than the one that is under way
    rig.update("t1", proto::TASK_STOPPED);
    rig.stopDone(rig.stop_generations.generation());
    EXPECT_EQ(dispatches(rig), 1);
    rig.core().onStopSignal(head, StopCause::Requested, *raised);
    EXPECT_EQ(endOf(rig, "t2"), std::pair(proto::TASK_STOPPED, 1));
    EXPECT_EQ(dispatches(rig), 1);
    EXPECT_EQ(rig.core().status().stop_generation,
              static_cast<std::int32_t>(rig.stop_generations.generation()));
}

TEST_F(Held, AnAnswerThatIsFasterThanTheNewsOfItsStopIsToldAfterIt) {
    auto head = rig.headOf("client2");
    const auto raised = rig.stop_generations.raise("client2", head.sequence);
    rig.stopDone(*raised);
    rig.stopDone(*raised, proto::StopReceipt::STANDSTILL);
    rig.core().onStopSignal(head, StopCause::Requested, *raised);
    std::vector<proto::StopReceipt::Stage> stages;
    for (const auto& record : rig.to_clients)
        if (record.message.has_receipt() && record.head.sender.id == "client2")
            stages.push_back(record.message.receipt().stage());
    EXPECT_EQ(stages, (std::vector{proto::StopReceipt::MANAGER, proto::StopReceipt::CALLBACK_RETURNED,
                                   proto::StopReceipt::STANDSTILL}));
}

TEST_F(Held, StopsThatReachTheStrandInAnotherOrderAreAllHandled) {
    auto first = rig.headOf("client2");
    auto second = rig.headOf("client2");
    const auto one = rig.stop_generations.raise("client2", first.sequence);
    const auto two = rig.stop_generations.raise("client2", second.sequence);
    rig.core().onStopSignal(second, StopCause::Requested, *two);
    rig.core().onStopSignal(first, StopCause::Requested, *one);
    rig.stopDone(*two);
    rig.generation = static_cast<std::int32_t>(*two);
    rig.rearm("client1", "r2");
    EXPECT_FALSE(rig.core().latched());
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(dispatches(rig), 1);
}

TEST_F(Held, TheShortWatchdogRunsBeforeTheTaskDoes) {
    rig.takeLines();
    rig.task("client1", "t1", "Turning");
    const auto lines = rig.takeLines();
    ASSERT_GE(lines.size(), 2U);
    EXPECT_EQ(lines[0], "application: watchdog busy");
    EXPECT_EQ(lines[1].find("application: TaskDispatch"), 0U);
}

TEST_F(Held, HeadersNameTheRecipientTheEntityTheLeaseAndTheGeneration) {
    rig.stop("client2");
    rig.task("client1", "t1", "Turning");
    const auto& head = rig.to_clients.back().head;
    EXPECT_EQ(head.sender.id, "client1");
    EXPECT_EQ(head.entity, rig.core().uuid());
    EXPECT_EQ(head.msg_type, kMsgTask);
    EXPECT_EQ(head.held, (LeaseNumber{1, 1}));
    EXPECT_EQ(head.stop_generation, 1);
}

// The servers record who rearmed by the header.
TEST_F(Held, WhatIsNotWhatItsHeaderSaysIsRefusedAsWhatItIs) {
    rig.stop("client1");
    rig.stopDone(1);
    ASSERT_TRUE(rig.core().latched());
    auto head = rig.headOf("client1");
    head.msg_type = kMsgText;
    proto::ToEntity rearm;
    rearm.mutable_rearm()->set_request_id("r");
    rig.to_clients.clear();
    constexpr auto kMalformed = static_cast<int>(RefusalCode::Malformed);
    rig.core().onClientMsg(head, rearm.SerializeAsString());
    EXPECT_TRUE(rig.core().latched());
    ASSERT_EQ(rig.to_clients.size(), 1U);
    EXPECT_EQ(rig.to_clients[0].message.reply().request_id(), "r");
    EXPECT_EQ(rig.to_clients[0].message.reply().refusal().code(), kMalformed);

    proto::ToEntity check_out;
    check_out.mutable_check_out()->set_request_id("c");
    check_out.mutable_check_out()->set_phase(proto::TAKE);
    rig.core().onClientMsg(head, check_out.SerializeAsString());
    ASSERT_EQ(rig.to_clients.size(), 2U);
    EXPECT_EQ(rig.to_clients[1].message.check_out().request_id(), "c");
    EXPECT_EQ(rig.to_clients[1].message.check_out().refusal().code(), kMalformed);

    head.msg_type = kMsgRearm;
    proto::ToEntity text;
    text.mutable_text()->set_text("hello");
    rig.core().onClientMsg(head, text.SerializeAsString());
    ASSERT_EQ(rig.to_clients.size(), 3U);
    EXPECT_EQ(rig.to_clients[2].message.reply().refusal().code(), kMalformed);
    EXPECT_EQ(rig.core().counters().malformed, 3U);

    rig.core().onClientMsg(head, rearm.SerializeAsString());
    EXPECT_FALSE(rig.core().latched());
}

TEST_F(Held, AMessageWithoutASenderIsCountedAndAnsweredToNobody) {
    const auto before = rig.to_clients.size();
    Header nobody;
    nobody.msg_type = kMsgStatus;
    rig.core().onClientMsg(nobody, "not a message");
    proto::ToEntity status;
    status.mutable_status_request();
    rig.core().onClientMsg(nobody, status.SerializeAsString());
    EXPECT_EQ(rig.to_clients.size(), before);
    EXPECT_EQ(rig.core().counters().anonymous, 1U);
    EXPECT_EQ(rig.core().counters().malformed, 1U);
    rig.core().onPeerRefusal({}, {RefusalCode::UnknownEntity, "", {}});
    EXPECT_EQ(rig.core().counters().peer_refusals, 1U);
    EXPECT_EQ(rig.core().state(), EntityState::REG);
}

TEST_F(Held, ALargeMessageIsReadOnlyOfTheHolder) {
    proto::ToEntity message;
    message.mutable_text()->set_text(std::string(20'000, 'x'));
    rig.to_clients.clear();
    const auto sent = rig.to_application.size();
    rig.send("client2", message);
    ASSERT_EQ(rig.to_clients.size(), 1U);
    EXPECT_EQ(rig.to_clients[0].message.reply().refusal().code(), proto::NOT_HOLDER);
    EXPECT_NE(rig.to_clients[0].message.reply().refusal().message().find("is not read"), std::string::npos);
    rig.send("client1", message);
    EXPECT_EQ(rig.to_application.size(), sent + 1);
}

TEST_F(Held, RawDataIsMovedNotCopied) {
    proto::ToEntity message;
    const std::string bulk(60'000, 'x');
    message.mutable_raw()->add_data(bulk);
    rig.send("client1", message);
    ASSERT_TRUE(rig.to_application.back().has_raw());
    EXPECT_EQ(rig.to_application.back().raw().data(0), bulk);
    proto::EiToEm back;
    back.mutable_raw()->add_data(bulk);
    rig.core().onLinkMessage(std::move(back));
    EXPECT_EQ(rig.to_clients.back().message.raw().data(0), bulk);
    EXPECT_TRUE(rig.to_clients.back().droppable);
}

// Its owner need not look what has changed, and when the next time is due, after each message of a stream.
TEST_F(Held, OnlyAfterDataThatIsPassedOnIsEverythingAsItWas) {
    proto::ToEntity raw, text;
    raw.mutable_raw()->add_data("x");
    text.mutable_text()->set_text("x");
    const auto sent = [&](const std::string& client, const proto::ToEntity& message) {
        return rig.core().onClientMsg(rig.headOf(client, message), message.SerializeAsString());
    };
    const auto before = rig.core().nextDeadline();
    EXPECT_FALSE(sent("client1", raw));
    EXPECT_TRUE(rig.to_application.back().has_raw());
    EXPECT_EQ(rig.core().nextDeadline(), before);
    EXPECT_TRUE(sent("client2", raw)) << "a refusal is sent";
    EXPECT_TRUE(sent("client1", text));

    proto::EiToEm data, sample, position;
    data.mutable_raw()->add_data("x");
    sample.mutable_sample()->set_stream("s");
    position.mutable_position()->set_xpos(1);
    EXPECT_FALSE(rig.core().onLinkMessage(std::move(data)));
    EXPECT_FALSE(rig.core().onLinkMessage(std::move(sample)));
    EXPECT_TRUE(rig.core().onLinkMessage(std::move(position)));
}

TEST_F(Held, AnAnswerThatComesAfterTheLeaseSetsNothingForTheNextHolder) {
    rig.setParam("client1", "r2", "Driving", "Speed=555");
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    rig.stopDone(1);
    rig.take("client2", "r3");
    proto::EiToEm answer;
    answer.mutable_answer()->set_request(1);
    rig.fromApplication(answer);
    rig.task("client2", "t1", "Driving", {"Distance=1"});
    ASSERT_TRUE(rig.to_application.back().has_task());
    for (const auto& param : rig.to_application.back().task().params())
        EXPECT_EQ(param.values(0).int_(), param.name() == "Speed" ? 200 : 1);
}

TEST_F(Held, TheUuidSurvivesARestartAndTheEpochGrows) {
    const auto uuid = rig.core().uuid();
    rig.restart();
    EXPECT_EQ(rig.core().uuid(), uuid);
    rig.makeIdle();
    rig.take("client1", "r2");
    EXPECT_EQ(rig.core().status().held, (LeaseNumber{2, 1}));
}

TEST_F(Held, NoGenerationThatWasToldIsAboveWhereTheNextLifeBegins) {
    for (const int stops : {3, 2500}) {
        for (int i = 0; i < stops; ++i) rig.stop("client2");
        SeededRandom random(7);
        StopGenerations stop_generations;  // a new process, killed at any moment before
        auto disk = rig.storage;
        const EntityManagerCore next({.application = "rig"}, rig.clock, random, rig, rig, disk, rig.resources,
                                     stop_generations);
        EXPECT_GE(next.status().stop_generation, rig.core().status().stop_generation);
        EXPECT_EQ(static_cast<std::int32_t>(stop_generations.generation()), next.status().stop_generation);
    }
}

TEST(EntityManagerCore, ADamagedStopGenerationIsAMisconfiguration) {
    CoreRig rig;
    rig.storage.save("stop_generation", "12 monkeys");
    EXPECT_THROW(rig.restart(), std::runtime_error);
}

/// Every value that a life has left, each damaged in every way.
TEST(EntityManagerCore, NoDamageToItsStateUnlatchesARobot) {
    using Values = decltype(test::MemoryStorage::values);
    const auto afterLife = [](bool stopped) {
        CoreRig rig;
        rig.makeIdle();
        rig.take("client1", "r1");
        rig.task("client1", "t1", "Turning");
        if (stopped) rig.stop("client2");
        return rig.storage.values;
    };
    int refused = 0, latched = 0;
    const auto look = [&](const Values& values, const std::string& what) {
        CoreRig rig;
        rig.storage.values = values;
        try {
            rig.restart();
            EXPECT_TRUE(rig.core().latched()) << what;
            ++latched;
        } catch (const std::runtime_error& error) {
            EXPECT_THAT(error.what(), testing::HasSubstr("damaged")) << what;
            ++refused;
        }
    };
    for (const bool stopped : {true, false}) {  // held as it ended: that latches, too
        const auto values = afterLife(stopped);
        ASSERT_GE(values.size(), 4U);
        look(values, "nothing is damaged");
        for (const auto& [key, value] : values) {
            auto damaged = values;
            damaged.erase(key);
            look(damaged, key + " is missing");
            for (std::size_t size = 0; size < value.size(); ++size) {
                damaged[key] = value.substr(0, size);
                look(damaged, key + " has " + std::to_string(size) + " bytes");
            }
            for (std::size_t bit = 0; bit < 8 * value.size(); ++bit) {
                damaged[key] = value;
                damaged[key][bit / 8] = static_cast<char>(damaged[key][bit / 8] ^ (1 << (bit % 8)));
                look(damaged, key + " has another bit " + std::to_string(bit));
            }
        }
    }
    EXPECT_GT(refused, 100);
    EXPECT_GT(latched, 100);
}

TEST(EntityManagerCore, ARobotThatWasFreeAndUnlatchedComesUpLatchedWhenPartOfItsStateIsLost) {
    CoreRig rig;
    rig.makeIdle();
    const auto values = rig.storage.values;
    rig.restart();
    EXPECT_FALSE(rig.core().latched());
    for (const auto* key : {"uuid", "lease", "stop_generation", "rearmed", "free"}) {
        ASSERT_TRUE(values.contains(key)) << key;
        rig.storage.values = values;
        rig.storage.values.erase(key);
        rig.restart();
        EXPECT_TRUE(rig.core().latched()) << key;
    }
}

TEST(EntityManagerCore, AStopOnItsWayAsTheLinkComesUpHoldsUpNoCheckOut) {
    CoreRig rig;
    const auto head = rig.headOf("client2");
    const auto raised = rig.stop_generations.raise("client2", head.sequence);
    rig.linkUp();
    rig.core().onStopSignal(head, StopCause::Requested, *raised);
    rig.uploadProfiles();
    rig.core().onServerUp();
    rig.take("client1", "r1");
    EXPECT_EQ(rig.core().state(), EntityState::REG);
}

TEST(EntityManagerCore, AServiceThatWasSwitchedOffStaysSoWhenTheProfilesAreReadAnew) {
    CoreRig rig;
    rig.makeIdle();
    proto::EiToEm off;
    off.mutable_active()->set_service("Turning");
    off.mutable_active()->set_active(false);
    off.mutable_active()->set_reason("the battery is low");
    rig.fromApplication(off);
    rig.uploadProfiles();
    rig.take("client1", "r1");
    EXPECT_EQ(rig.to_clients.back().message.check_out().services().services(1).inactive_reason(),
              "the battery is low");
    rig.task("client1", "t1", "Turning");
    EXPECT_EQ(refusalOf(rig, "t1"), proto::INACTIVE_SERVICE);
    EXPECT_EQ(rig.to_clients.back().message.task().reason().message(),
              "Service \"Turning\" is switched off by the robot application: the battery is low.");
    off.mutable_active()->set_active(true);
    rig.fromApplication(off);
    EXPECT_EQ(rig.to_clients.back().message.service().inactive_reason(), "") << "it is on";
    rig.task("client1", "t2", "Turning");
    EXPECT_EQ(rig.to_clients.back().message.task().state(), proto::TASK_DISPATCHED);
}

TEST_F(Held, TheLinkIsNotLeftBusyWhenItIsLostInTheMiddleOfATask) {
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    ASSERT_TRUE(rig.busy);
    rig.core().onLinkDown("pulled");
    EXPECT_FALSE(rig.busy);
}

TEST_F(Held, ARepeatedStopIsAnsweredWithItsReceiptAndStopsNothingMore) {
    const auto head = rig.headOf("client2");
    const auto raised = rig.stop_generations.raise("client2", head.sequence);
    rig.core().onStopSignal(head, StopCause::Requested, *raised);
    rig.stopDone(*raised);
    EXPECT_FALSE(rig.stop_generations.raise("client2", head.sequence));
    ASSERT_EQ(rig.stop_generations.raisedBy("client2", head.sequence), raised);
    rig.takeLines();
    rig.core().onStopRepeated(head, StopCause::Requested, *raised);
    const auto lines = rig.takeLines();
    ASSERT_EQ(lines.size(), 1U);
    EXPECT_EQ(lines[0].find("client2 (signal): StopReceipt client2:1 CALLBACK_RETURNED gen=1"), 0U)
        << lines[0];
}

TEST_F(Held, ALateCopyOfAStopAfterTheRearmStopsAndLatchesNothing) {
    const auto head = rig.headOf("client2");
    const auto raised = rig.stop_generations.raise("client2", head.sequence);
    rig.core().onStopSignal(head, StopCause::Requested, *raised);
    rig.stopDone(*raised);
    rig.rearm("client1", "r2");
    ASSERT_FALSE(rig.core().latched());
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    rig.stop("client2", StopCause::Requested, head.sequence);
    EXPECT_FALSE(rig.core().latched());
    EXPECT_EQ(rig.core().state(), EntityState::BUSY);
    EXPECT_EQ(rig.stop_generations.generation(), *raised);
}

TEST_F(Held, ALateCopyOfAResetOrClearEndsNotTheNextTask) {
    for (const bool reset : {true, false}) {
        rig.task("client1", reset ? "t1" : "t3", "Turning");
        rig.grant(reset ? "t1" : "t3");
        const auto head = rig.headOf("client1");
        const auto signal = [&] { reset ? rig.core().onResetSignal(head) : rig.core().onClearSignal(head); };
        signal();
        rig.stopDone(rig.stop_generations.generation());
        rig.update(reset ? "t1" : "t3", proto::TASK_STOPPED);
        rig.task("client1", reset ? "t2" : "t4", "Turning");
        rig.grant(reset ? "t2" : "t4");
        ASSERT_EQ(rig.core().state(), EntityState::BUSY);
        const auto generation = rig.stop_generations.generation();
        signal();
        EXPECT_EQ(rig.core().state(), EntityState::BUSY);
        EXPECT_EQ(rig.stop_generations.generation(), generation);
        rig.update(reset ? "t2" : "t4", proto::TASK_SUCCEEDED);
    }
}

TEST_F(Held, ASilentServerIsGivenUpAndAnotherSessionIsSoughtThatNothingOfTheOldOneEnds) {
    EXPECT_TRUE(rig.core().serverUp());
    rig.advance(std::chrono::seconds{11}, false);
    EXPECT_FALSE(rig.core().serverUp());
    EXPECT_TRUE(rig.wanted);
    rig.core().onServerDown("its session has ended at last");
    EXPECT_TRUE(rig.wanted);
}

TEST_F(Held, ShortTasksOneAfterAnotherDoNotHideASilentServer) {
    rig.core().onServerHeartbeat();
    for (const char* task : {"t1", "t2", "t3", "t4"}) rig.task("client1", task, "Turning");
    rig.grant("t1");
    for (const auto& [ends, begins] : {std::pair{"t1", "t2"}, std::pair{"t2", "t3"}}) {
        rig.advance(std::chrono::milliseconds{100}, false);
        rig.update(ends, proto::TASK_SUCCEEDED);
        rig.grant(begins);
        ASSERT_EQ(rig.core().state(), EntityState::BUSY);
    }
    rig.advance(std::chrono::milliseconds{49}, false);
    EXPECT_TRUE(rig.core().serverUp());
    EXPECT_TRUE(rig.stops.empty());
    rig.advance(std::chrono::milliseconds{1}, false);
    EXPECT_FALSE(rig.core().serverUp());
    ASSERT_FALSE(rig.stops.empty());
    EXPECT_EQ(rig.stops.back().second, StopCause::ServerLost);
    rig.update("t3", proto::TASK_STOPPED);
    EXPECT_EQ(dispatches(rig), 3);
}

TEST_F(Held, AStopUnderANumberThatWasUsedBeforeIsCarriedOutAndNotConfirmedByTheOlderOne) {
    const auto head = rig.headOf("client2");
    const auto first = rig.stop_generations.raise("client2", head.sequence);
    rig.core().onStopSignal(head, StopCause::Requested, *first);
    rig.stopDone(*first);
    rig.rearm("client1", "r2");
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    rig.takeLines();
    EXPECT_FALSE(rig.stop_generations.raise("client2", head.sequence, 0))
        << "a copy that was on its way all the time";
    rig.core().onStopRepeated(head, StopCause::Requested, *first);
    EXPECT_TRUE(rig.takeLines().empty()) << "what runs has not been stopped by it";
    const auto second = rig.stop_generations.raise("client2", head.sequence, *first);
    ASSERT_TRUE(second) << "its sender knew of the first one";
    EXPECT_EQ(rig.stop_generations.raisedBy("client2", head.sequence), second);
    EXPECT_FALSE(rig.stop_generations.raise("client2", head.sequence, *first)) << "by the other path";
}

TEST(StopGenerations, AStopThatIsRepeatedBeforeARearmIsOneWhateverItsSenderKnows) {
    StopGenerations stop_generations;
    const auto first = stop_generations.raise("browser", 1, 0);
    EXPECT_FALSE(stop_generations.raise("browser", 1, *first));
}

TEST(StopGenerations, AStopWithoutASequenceNumberIsAlwaysNew) {
    StopGenerations stop_generations;
    for (const std::int64_t sequence : {0, 0, -1, -1})
        EXPECT_TRUE(stop_generations.raise("browser", sequence));
    EXPECT_TRUE(stop_generations.raise("browser", 1));
    EXPECT_FALSE(stop_generations.raise("browser", 1));
    EXPECT_EQ(stop_generations.generation(), 5U);
}

TEST_F(Held, ACommandSentWhileAStopIsCarriedOutIsToldSo) {
    const auto head = rig.headOf("client2");
    rig.stop_generations.raise("client2", head.sequence);
    rig.generation = 1;
    rig.task("client1", "t1", "Turning");
    const auto& reason = rig.to_clients.back().message.task().reason();
    EXPECT_EQ(reason.code(), proto::OLD_GENERATION);
    EXPECT_NE(reason.message().find("is being carried out"), std::string::npos) << reason.message();
}

TEST(EntityManagerCore, WhoWatchesByNameAndTheHolderGoOnWhenTheLastWhoWatchedAllEnds) {
    CoreRig rig;
    rig.makeIdle();
    const auto watch = [&](const std::string& client, const std::string& stream, bool on) {
        proto::ToEntity message;
        message.mutable_watch()->set_on(on);
        if (!stream.empty()) message.mutable_watch()->add_streams(stream);
        rig.send(client, message);
    };
    const auto last = [&] {
        const auto& control = rig.to_application.back().stream();
        return control.stream() + (control.on() ? " on" : " off");
    };
    watch("client2", "pose", true);
    watch("client3", "", true);
    rig.takeLines();
    watch("client3", "", false);
    EXPECT_EQ(rig.takeLines(), (std::vector<std::string>{"application: StreamControl \"\" off",
                                                         "application: StreamControl \"pose\" on"}));
    rig.take("client1", "r1");
    EXPECT_EQ(last(), " on");
    watch("client3", "", true);
    const auto before = rig.to_application.size();
    watch("client3", "", false);
    watch("client2", std::string(256, 'x'), true);
    EXPECT_EQ(rig.to_clients.back().message.reply().refusal().code(), proto::BAD_NAME);
    EXPECT_EQ(rig.to_application.size(), before);
}

TEST(StreamWatches, TheOldestWatcherButTheHolderMakesRoom) {
    StreamWatches watches;
    ASSERT_TRUE(watches.watch("holder", {"pose"}));
    ASSERT_TRUE(watches.watch("first", {"scan"}));
    for (std::size_t i = 2; i < StreamWatches::kMaxWatchers; ++i)
        ASSERT_TRUE(watches.watch("c" + std::to_string(i), {"pose"}));
    const auto switches = watches.watch("new", {"pose"}, "holder");
    ASSERT_TRUE(switches);
    ASSERT_EQ(switches->size(), 1U);
    EXPECT_EQ(switches->front().stream, "scan");
    EXPECT_FALSE(switches->front().on);
    EXPECT_EQ(watches.watchersOf("pose", "").size(), StreamWatches::kMaxWatchers);
}

TEST(EntityManagerCore, WhatIsLargerThanAFrameIsRefusedAndWedgesNothing) {
    CoreRig rig;
    rig.linkUp();
    rig.upload(false, test::kRigBasicProfile);
    rig.upload(true, R"(<ServiceProfile count="1">
  <Service name="Say" type="SMPL">
    <Parameters>
      <Param name="Words" type="INPUT" data_type="STR" multiple="true" required="true"/>
    </Parameters>
  </Service>
</ServiceProfile>
)");
    rig.core().onServerUp();
    rig.take("client1", "r1");
    ASSERT_EQ(rig.core().state(), EntityState::REG);
    proto::ToEntity message;
    message.mutable_task()->set_task_id(idOf("t1"));
    message.mutable_task()->set_service("Say");
    auto& words = *message.mutable_task()->add_params();
    words.set_name("Words");
    for (int i = 0; i < 20; ++i) words.add_values()->set_str(std::string(60'000, 'x'));
    proto::ToEntity set;
    set.mutable_set_param()->set_service("Say");
    *set.mutable_set_param()->mutable_param() = words;
    const auto before = rig.to_application.size();
    rig.send("client1", message);
    EXPECT_EQ(refusalOf(rig, "t1"), proto::TOO_LARGE);
    rig.send("client1", set);
    EXPECT_EQ(rig.to_clients.back().message.reply().refusal().code(), proto::TOO_LARGE);
    EXPECT_EQ(rig.to_application.size(), before);
    rig.task("client1", "t2", "Say", {"Words=hello"});
    EXPECT_EQ(dispatches(rig), 1);
}

proto::ToEntity mapOffer(const std::string& content) {
    proto::ToEntity offer;
    offer.mutable_resource_offer()->set_transfer_id(idOf("x"));
    offer.mutable_resource_offer()->set_service("Delivery");
    offer.mutable_resource_offer()->set_resource("Map");
    offer.mutable_resource_offer()->set_file_name("map");
    offer.mutable_resource_offer()->set_size(content.size());
    offer.mutable_resource_offer()->set_sha256(test::MemoryResources::fakeHash(content));
    return offer;
}

proto::ToEntity mapChunk(const std::string& content, std::size_t at, std::size_t size) {
    proto::ToEntity chunk;
    chunk.mutable_resource_chunk()->set_transfer_id(idOf("x"));
    chunk.mutable_resource_chunk()->set_offset(at);
    chunk.mutable_resource_chunk()->set_content(content.substr(at, size));
    return chunk;
}

TEST_F(Held, AnUploadStaysInItsWindowAndIsCreditedAsItIsConsumed) {
    const std::string content(900'000, 'm');
    rig.send("client1", mapOffer(content));
    std::uint64_t allowed = 0;
    std::size_t seen = 0;
    const auto readCredits = [&] {
        for (; seen < rig.to_clients.size(); ++seen)
            if (const auto& message = rig.to_clients[seen].message; message.has_resource_credit())
                allowed = message.resource_credit().offset() + message.resource_credit().window();
    };
    for (std::size_t at = 0; at < content.size();) {
        readCredits();
        const auto size = std::min<std::size_t>(50'000, content.size() - at);
        ASSERT_LE(at + size, allowed);
        rig.send("client1", mapChunk(content, at, size));
        at += size;
    }
    ASSERT_TRUE(rig.to_application.back().has_resource());
    EXPECT_EQ(rig.to_application.back().resource().size(), content.size());
}

TEST_F(Held, AnUploadIsCreditedAndDoneForWhatTheDiskHasTaken) {
    const std::string content(700'000, 'm');
    rig.send("client1", mapOffer(content));
    const auto creditOf = [&] { return rig.to_clients.back().message.resource_credit(); };
    const auto window = creditOf().window();
    ASSERT_LT(window, content.size());
    std::size_t at = 0;
    const auto sendUpTo = [&](std::size_t end) {
        for (; at < end;) {
            const auto size = std::min<std::size_t>(50'000, end - at);
            rig.resources.behind += size;
            rig.send("client1", mapChunk(content, at, size));
            at += size;
        }
    };
    const auto messages = rig.to_clients.size();
    sendUpTo(window);
    EXPECT_EQ(rig.to_clients.size(), messages) << "no credit for what waits";
    rig.resources.behind = 1000;
    rig.core().onStored();
    EXPECT_EQ(creditOf().offset(), window - 1000);
    EXPECT_EQ(creditOf().window(), window);
    rig.core().onStored();
    EXPECT_EQ(rig.to_clients.size(), messages + 1) << "and none twice";
    sendUpTo(content.size());
    const auto told = std::any_of(rig.to_application.begin(), rig.to_application.end(),
                                  [](const auto& message) { return message.has_resource(); });
    EXPECT_FALSE(told) << "the application would open half a file";
    rig.resources.behind = 0;
    rig.core().onStored();
    ASSERT_TRUE(rig.to_application.back().has_resource());
    EXPECT_EQ(rig.to_application.back().resource().size(), content.size());
}

/// The disk takes its time for everything but the bytes.
struct SlowStore : Held {
    SlowStore() { rig.resources.slow = true; }
    void answer() {
        rig.resources.answerAll();
        rig.core().onStored();
    }
    proto::ToClient last() const { return rig.to_clients.back().message; }
    void say(const Refusal& refusal) {
        proto::EiToEm message;
        message.mutable_answer()->set_request(rig.to_application.back().resource().request());
        if (!refusal.ok()) *message.mutable_answer()->mutable_refusal() = toProto(refusal);
        rig.fromApplication(std::move(message));
    }
    /// As far as the question to the application.
    void arrive(const std::string& content, const std::string& transfer = "x") {
        auto offer = mapOffer(content);
        offer.mutable_resource_offer()->set_transfer_id(idOf(transfer));
        rig.send("client1", offer);
        answer();
        auto chunk = mapChunk(content, 0, content.size());
        chunk.mutable_resource_chunk()->set_transfer_id(idOf(transfer));
        rig.send("client1", chunk);
        answer();
    }
};

TEST_F(SlowStore, AnUploadGoesOnAsTheDiskAnswersAndItsClientIsNotForgotten) {
    const std::string content = "a map";
    rig.to_application.clear();
    rig.send("client1", mapOffer(content));
    const auto messages = rig.to_clients.size();
    rig.advance(std::chrono::seconds{3});
    ASSERT_EQ(rig.to_clients.size(), messages + 3) << "a client gives up after five seconds of silence";
    EXPECT_EQ(last().resource_credit().window(), 0U) << "nothing may be sent yet";
    rig.send("client1", mapChunk(content, 0, 1));
    EXPECT_EQ(last().resource_done().refusal().code(), proto::MALFORMED);
    answer();

    rig.send("client1", mapOffer(content));
    answer();
    EXPECT_GT(last().resource_credit().window(), 0U);
    rig.send("client1", mapChunk(content, 0, content.size()));
    EXPECT_TRUE(rig.to_application.empty()) << "it is being checked";
    rig.advance(std::chrono::milliseconds{1000});
    EXPECT_EQ(last().resource_credit().window(), 0U);
    answer();
    ASSERT_TRUE(rig.to_application.back().has_resource());
    rig.advance(std::chrono::milliseconds{1000});
    EXPECT_EQ(last().resource_credit().window(), 0U)
        << "the application may think for longer than a client waits";
    say({});
    EXPECT_FALSE(last().has_resource_done()) << "it is not in its place yet";
    rig.advance(std::chrono::milliseconds{1000});
    EXPECT_EQ(last().resource_credit().window(), 0U);
    answer();
    const auto done = rig.to_clients[rig.to_clients.size() - 2].message;
    ASSERT_TRUE(done.has_resource_done());
    EXPECT_FALSE(done.resource_done().has_refusal());
    EXPECT_EQ(rig.resources.complete["Delivery/Map"], content);
}

TEST_F(SlowStore, ADeniedFileLeavesTheOldOneAndSoDoesOneThatIsNotAnsweredFor) {
    arrive("old map");
    say({});
    answer();
    ASSERT_EQ(rig.resources.complete["Delivery/Map"], "old map");
    arrive("no map", "y");
    EXPECT_EQ(rig.resources.complete["Delivery/Map"], "old map")
        << "while the application looks at the new one";
    say({RefusalCode::Denied, "Not a map.", {}});
    EXPECT_EQ(last().resource_done().refusal().code(), proto::DENIED);
    EXPECT_EQ(rig.resources.complete["Delivery/Map"], "old map");
    arrive("no answer", "z");
    rig.advance(std::chrono::seconds{11});
    EXPECT_EQ(last().resource_done().refusal().code(), proto::TIMED_OUT);
    EXPECT_EQ(rig.resources.complete["Delivery/Map"], "old map");
    rig.task("client1", "t1", "Delivery", {"Room=Lab"});
    answer();
    ASSERT_TRUE(rig.to_application.back().has_task());
    EXPECT_EQ(rig.to_application.back().task().resources(0).url(), "/store/Delivery/Map");
}

TEST_F(SlowStore, ATaskWhoseFileIsGoneIsRefusedAndTheResourceIsShownAsMissing) {
    arrive("map");
    say({});
    answer();
    rig.resources.complete.clear();  // by hand
    rig.task("client1", "t1", "Delivery", {"Room=Lab"});
    EXPECT_FALSE(rig.to_application.back().has_task())
        << "nobody waits for the look at the disk, but the task";
    answer();
    EXPECT_FALSE(rig.to_application.back().has_task());
    ASSERT_TRUE(last().has_task());
    EXPECT_EQ(last().task().state(), proto::TASK_REFUSED);
    EXPECT_EQ(last().task().reason().code(), proto::MISSING_DEPENDENCY);
    EXPECT_EQ(last().task().reason().message(),
              "The file of a resource is no longer on the robot's machine: \"Map\" of \"Delivery\" "
              "(/store/Delivery/Map). Upload it again, then send the task again.");
    const auto& record = rig.to_clients[rig.to_clients.size() - 2].message.service();
    EXPECT_EQ(record.name(), "Delivery");
    EXPECT_FALSE(record.resources(0).ready());
}

TEST_F(SlowStore, TheEndOfTheLeaseEndsAnUploadThatWaitsAndNotOneThatIsAccepted) {
    arrive("map");
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    answer();
    const auto told = [&](const std::string& transfer) {
        std::vector<proto::RefusalCode> codes;
        for (const auto& record : rig.to_clients)
            if (record.message.has_resource_done() &&
                record.message.resource_done().transfer_id() == idOf(transfer))
                codes.push_back(record.message.resource_done().refusal().code());
        return codes;
    };
    EXPECT_EQ(told("x"), std::vector{proto::STOPPED});
    const auto unexpected = rig.core().counters().unexpected;
    say({});
    EXPECT_EQ(rig.core().counters().unexpected, unexpected + 1) << "nobody asks any more";

    rig.stopDone(rig.stop_generations.generation());
    rig.take("client1", "r2");
    rig.send("client1", [&] {
        auto again = mapOffer("map");
        again.mutable_resource_offer()->set_transfer_id(idOf("y"));
        return again;
    }());
    answer();  // all of it is there
    answer();
    ASSERT_EQ(rig.to_application.back().resource().size(), 3U);
    say({});
    rig.send("client1", release);
    answer();
    EXPECT_EQ(told("y"), std::vector{proto::OK}) << "the application has it";
    EXPECT_EQ(rig.resources.complete["Delivery/Map"], "map");
}

TEST_F(Held, AnUploadEndsWithTheReasonWhenTheDiskTakesNoMore) {
    const std::string content(200'000, 'm');
    rig.send("client1", mapOffer(content));
    rig.resources.behind = 50'000;
    rig.send("client1", mapChunk(content, 0, 50'000));
    rig.resources.failure = {RefusalCode::Overloaded, "no space left", {}};
    rig.core().onStored();
    EXPECT_EQ(rig.to_clients.back().message.resource_done().refusal().code(), proto::OVERLOADED);
    EXPECT_EQ(rig.to_clients.back().message.resource_done().resource(), "Map");
    const auto messages = rig.to_clients.size();
    rig.send("client1", mapChunk(content, 50'000, 50'000));
    EXPECT_EQ(rig.to_clients.size(), messages) << "it has been told";
}

TEST(EntityManagerCore, AllClientsThatAskAreToldWhyItIsUnavailable) {
    CoreRig rig;
    rig.makeIdle();
    rig.core().onLinkDown("gone");
    proto::ToEntity request;
    request.mutable_status_request()->set_request_id(idOf("q"));
    rig.send("client2", request);
    const auto& status = rig.to_clients.back().message.status();
    EXPECT_EQ(status.request_id(), idOf("q"));
    EXPECT_EQ(status.state(), proto::UNAV);
    EXPECT_NE(status.reason().find("gone"), std::string::npos);
}

}  // namespace
}  // namespace axon::entity_manager
