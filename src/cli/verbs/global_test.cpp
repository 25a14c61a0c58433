// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>

#include <sstream>
#include <thread>

#include "cli/command_line.hpp"
#include "cli/fake_station.hpp"
#include "cli/view.hpp"
#include "common/clock.hpp"

using namespace axon;
using namespace axon::cli;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::Not;

namespace {

GlobalService fetchBall() {
    GlobalService service;
    service.name = "Fetch ball";
    service.descr = "The arm gets the ball";
    service.file = "ball.xml";
    client::GlobalStep drive;
    drive.category = "ROBOT";
    drive.type = "MOBILE";
    drive.service_global_id = "drive";
    drive.preced = 1;
    drive.name = "approach";
    drive.parameters = {{"Distance", {std::string("1000")}, "mm", true}};
    client::GlobalStep grab;
    grab.role = 1;
    grab.category = "ROBOT";
    grab.type = "STATIONARY";
    grab.service_global_id = "grab";
    grab.preced = 2;
    grab.sources = {{"Place", "approach", "Position"}};
    service.steps = {drive, grab};
    return service;
}

void running(RunReport& report) {
    report.state = RunState::Running;
    report.steps[0].state = TaskState::Running;
    report.steps[0].began = Seconds(0);
    report.steps[0].progress = 0.5;
    report.elapsed = Seconds(2);
}

void succeeded(RunReport& report) {
    report.state = RunState::Succeeded;
    report.progress = 1;
    report.elapsed = Seconds(5);
    for (auto& step : report.steps) {
        step.state = TaskState::Succeeded;
        step.began = Seconds(0);
        step.ended = Seconds(4);
    }
    report.steps[0].results = {{"Position", {std::int64_t{998}}}};
}

struct Global : testing::Test {
    std::shared_ptr<FakeStation> station = std::make_shared<FakeStation>();
    std::shared_ptr<Mailbox> mailbox = std::make_shared<Mailbox>();
    Recorded seen;
    Settings settings;
    bool kept = false;

    Global() {
        station->global_services.services = {fetchBall()};
        station->global_services.files = {{"ball.xml", {"ball.xml:1: warning: count"}, false},
                                          {"bad.xml", {}, true}};
        station->run_script = {running, succeeded};
    }
    int perform(const std::string& verb, Json args) {
        Session session{std::move(args), seen, mailbox, station, settings, kept};
        return findVerb("global " + verb)->perform(session);
    }
    std::string peopleBot() { return station->entities_[0].id; }
    std::string cyton() { return station->entities_[2].id; }
    std::string shown(Terminal terminal = {}) {
        std::ostringstream out;
        ManualClock clock;
        {
            PersonView view(out, out, terminal, clock);
            for (const auto& event : seen.events) view.emit(event);
        }
        return out.str();
    }
};

}  // namespace

TEST_F(Global, RunSaysWhoPlaysChecksOutFollowsAndReleases) {
    EXPECT_EQ(perform("run", {{"name", "fetch_ball"}}), kDone);
    EXPECT_THAT(station->journalNow(), ElementsAre("checkOut", "run", "release", "release"));
    EXPECT_EQ(station->run_bindings, (Bindings{{0, peopleBot()}, {1, cyton()}}));
    EXPECT_EQ(station->run_master, peopleBot()) << "who plays the first role";
    EXPECT_EQ(seen.events.front()["event"], "binding");
    EXPECT_EQ(seen.events.front()["roles"][0]["entity"], "PeopleBot#1");
    EXPECT_EQ(seen.events.front()["roles"][0]["chosen"], false);
    const auto& last = seen.events.back();
    EXPECT_EQ(last["event"], "run");
    EXPECT_EQ(last["state"], "SUCCEEDED");
    EXPECT_EQ(last["steps"].size(), 2U);
    EXPECT_FALSE(last.contains("exit"));
}

TEST_F(Global, OnlyStepsThatHaveChangedAreToldBetweenTheFirstAndTheLast) {
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kDone);
    std::vector<std::size_t> told;
    for (const auto& event : seen.events) {
        if (event["event"] == "run") told.push_back(event["steps"].size());
    }
    EXPECT_THAT(told, ElementsAre(2, 1, 2));
}

TEST_F(Global, ResultsHaveUnitsAndWhatWasReportedOnTheWayIsNone) {
    client::Parameter position;
    position.name = "Position";
    position.kind = client::ParameterKind::Output;
    position.units = "mm";
    auto speed = position;
    speed.name = "Speed";
    speed.kind = client::ParameterKind::Feedback;
    client::Service drive;
    drive.name = "Driving";
    drive.global_id = "drive";
    drive.parameters = {position, speed};
    station->services_ = {drive};
    station->run_script = {[](RunReport& report) {
        succeeded(report);
        report.steps[0].results["Speed"] = {std::int64_t{200}};
    }};
    EXPECT_EQ(perform("global run", {{"name", "Fetch ball"}}), kDone);
    const auto& step = seen.last("run")->at("steps").at(0);
    EXPECT_EQ(step.at("units").at("Position"), "mm");
    EXPECT_EQ(step.at("live"), Json::array({"Speed"}));
    EXPECT_EQ(seen.last("run")->at("steps").at(1).at("units"), Json::object()) << "nobody offers it";
    std::ostringstream out;
    std::ostringstream err;
    ManualClock clock;
    PersonView view(out, err, Terminal{}, clock);
    view.emit(*seen.last("run"));
    EXPECT_THAT(out.str(), HasSubstr(": Position = 998 mm\n"));
}

TEST_F(Global, BindingsAndMasterAreAsTheUserSays) {
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"bind", {"0=2222"}}, {"master", "Cyton"}}), kDone);
    EXPECT_EQ(station->run_bindings.at(0), station->entities_[1].id);
    EXPECT_EQ(station->run_master, cyton());
    EXPECT_EQ(seen.events.front()["roles"][0]["chosen"], true);
    EXPECT_EQ(seen.events.front()["master"], "Cyton");
}

TEST_F(Global, WrongBindingsMoveNothing) {
    for (const auto* word : {"Cyton", "=Cyton", "x=Cyton", "-1=Cyton", "1x=Cyton"})
        EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"bind", {word}}}), kUsage) << word;
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"bind", {"0=Cyton", "0=2222"}}}), kUsage);
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"bind", {"7=Cyton"}}}), kUsage);
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"bind", {"0=Citon"}}}), kRefused);
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"master", "2222"}}), kUsage) << "it plays no role";
    EXPECT_THAT(station->journalNow(), ElementsAre());
}

TEST_F(Global, WhatIsHeldHereIsNotReleased) {
    kept = true;
    ASSERT_TRUE(station->checkOut({cyton()}));
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kDone);
    EXPECT_EQ(station->held().size(), 1U);
    EXPECT_EQ(seen.last("checked_out")->at("entities").size(), 1U);
}

TEST_F(Global, ARoleThatNobodyCanPlayIsSaidAndNothingIsCheckedOut) {
    station->in_the_way = {{RefusalCode::AlreadyHeld, "role 1 (ROBOT): Cyton is held by cl2@lab", "cl2@lab"}};
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kRefused);
    EXPECT_THAT(station->journalNow(), ElementsAre());
    EXPECT_THAT(seen.last("error")->at("message").get<std::string>(), HasSubstr("role 1"));
    EXPECT_THAT(seen.last("error")->at("fix").get<std::string>(), HasSubstr("--wait"));
}

TEST_F(Global, WhoIsNamedForEveryRoleIsAskedWhateverSeemsToBeInTheWay) {
    station->in_the_way = {{RefusalCode::UnknownService, "role 1: Cyton does not offer fly", {}}};
    station->run_script = {[](RunReport& report) { report.state = RunState::Refused; }};
    EXPECT_EQ(perform("check", {{"name", "Fetch ball"}, {"bind", {"0=1111", "1=Cyton"}}}), kRefused);
    EXPECT_THAT(station->journalNow(), ElementsAre("checkOut", "check", "release", "release"));
    EXPECT_EQ(seen.events.front()["roles"][1]["entity"], "Cyton");
}

TEST_F(Global, WaitLooksAgainUntilOthersHaveReleased) {
    station->in_the_way = {{RefusalCode::AlreadyHeld, "role 1: Cyton is held", "cl2@lab"}};
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"wait", 60.0}}), kDone);
    EXPECT_EQ(station->proposed, 2);
    EXPECT_NE(seen.last("waiting"), nullptr);
    // What no waiting fixes is said at once.
    station->in_the_way = {{}, {}, {RefusalCode::UnknownService, "nobody offers fly", {}}};
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"wait", true}}), kRefused);
}

TEST_F(Global, WaitingIsGivenUpByCtrlC) {
    station->in_the_way.assign(100, {RefusalCode::AlreadyHeld, "role 1: Cyton is held", "cl2@lab"});
    mailbox->interrupt();
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"wait", true}}), kInterrupted);
    EXPECT_THAT(station->journalNow(), ElementsAre());
}

TEST_F(Global, RunExitsByWhatBecameOfIt) {
    for (const auto& [state, exit] :
         std::vector<std::pair<RunState, int>>{{RunState::Failed, kRefused},
                                               {RunState::Refused, kRefused},
                                               {RunState::Stopped, kStopped},
                                               {RunState::Cancelled, kStopped},
                                               {RunState::Unknown, kNotConfirmed}}) {
        station->run_script = {[state = state](RunReport& report) { report.state = state; }};
        EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), exit) << client::toString(state);
    }
    station->run_refusal = {RefusalCode::WrongState, "two roots", {}};
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kRefused);
    EXPECT_TRUE(station->held().empty());
}

TEST_F(Global, CtrlCCancelsTheRun) {
    station->run_script = {running};
    mailbox->interrupt();
    // The check-out comes first: it is the run that is interrupted.
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kInterrupted);
    EXPECT_TRUE(station->held().empty());
}

TEST_F(Global, CtrlCWhileItRunsCancelsAndSaysSo) {
    station->run_script = {running};
    std::thread user([this] {
        while (station->journalNow().size() < 2) std::this_thread::yield();
        mailbox->interrupt();
    });
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kInterrupted);
    user.join();
    EXPECT_THAT(station->journalNow(), ElementsAre("checkOut", "run", "cancel run", "release", "release"));
    EXPECT_EQ(seen.events.back()["state"], "CANCELLED");
    EXPECT_THAT(seen.last("notice")->at("message").get<std::string>(), HasSubstr("Ctrl-C again"));
}

TEST_F(Global, CtrlCTwiceStopsEverybodyWhoTakesPart) {
    station->run_script = {running};
    station->cancel_is_heard = false;
    std::thread user([this] {
        while (station->journalNow().size() < 2) std::this_thread::yield();
        mailbox->interrupt();
        mailbox->interrupt();
    });
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kInterrupted);
    user.join();
    EXPECT_THAT(station->stopped, ElementsAre(peopleBot(), cyton()));
    EXPECT_NE(seen.last("receipts"), nullptr);
    EXPECT_EQ(findVerb("global run")->interrupts, 2U) << "main lets the second one pass";
}

TEST_F(Global, TheTimeIsUpCancels) {
    station->run_script = {running};
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"at-most", 0.0}}), kNotConfirmed);
    EXPECT_EQ(seen.events.back()["state"], "CANCELLED");
}

TEST_F(Global, DetachNeedsCheckOutsThatOutliveIt) {
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"detach", true}}), kUsage);
    kept = true;
    ASSERT_TRUE(station->checkOut({cyton()}));
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"detach", true}}), kUsage);
    EXPECT_EQ(seen.last("error")->at("fix"), "axon checkout PeopleBot#1");
    ASSERT_TRUE(station->checkOut({peopleBot()}));
    station->run_script = {running};
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}, {"detach", true}}), kDone);
    EXPECT_EQ(seen.last("run_begun")->at("id"), "fedcba00-0000-4000-8000-00000000000b");
    EXPECT_EQ(seen.last("run"), nullptr) << "nobody follows it";
    EXPECT_EQ(perform("pause", {{"run", "fedc"}}), kDone);
    EXPECT_EQ(perform("resume", {{"run", "fetch ball"}}), kDone);
    EXPECT_EQ(seen.last("done")->at("run"), "fedcba00-0000-4000-8000-00000000000b");
    EXPECT_EQ(perform("cancel", Json::object()), kDone);
    EXPECT_EQ(perform("cancel", Json::object()), kRefused) << "it is over";
    EXPECT_THAT(seen.last("error")->at("message").get<std::string>(),
                HasSubstr("has already ended: CANCELLED"));
}

TEST_F(Global, WhoOnlyNeedsARearmIsNamed) {
    station->in_the_way = {{RefusalCode::Latched, "was stopped", {}}};
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kRefused);
    EXPECT_EQ(seen.last("error")->at("fix"), "rearm it when it is safe to move again: axon rearm Cyton");
}

TEST_F(Global, CheckPrintsEveryProblemWithItsFix) {
    station->run_script = {[](RunReport& report) {
        report.state = RunState::Refused;
        report.problems = {{1, "Cyton", {RefusalCode::InactiveService, "grab is not active", {}}},
                           {-1, "", {RefusalCode::Malformed, "role 3 has no step", {}}}};
    }};
    EXPECT_EQ(perform("check", {{"name", "Fetch ball"}}), kRefused);
    EXPECT_THAT(station->journalNow(), ElementsAre("checkOut", "check", "release", "release"));
    const auto& problems = seen.events.back()["problems"];
    EXPECT_EQ(problems[0]["service"], "grab");
    EXPECT_EQ(problems[0]["fix"], "wait until it is active again; see why it is not: axon info Cyton");
    EXPECT_EQ(problems[1]["step"], nullptr);
    const auto text = shown();
    EXPECT_THAT(text, HasSubstr("✗ Fetch ball cannot run now\n"));
    EXPECT_THAT(text,
                HasSubstr("  ✗ step 2 (grab) Cyton: grab is not active (INACTIVE_SERVICE)\n"
                          "      fix: wait until it is active again; see why it is not: axon info Cyton"));
    EXPECT_THAT(text, HasSubstr("  ✗ role 3 has no step (MALFORMED)"));
}

TEST_F(Global, ACheckThatPassesIsDone) {
    station->run_script = {[](RunReport& report) { report.state = RunState::Succeeded; }};
    EXPECT_EQ(perform("check", {{"name", "Fetch ball"}}), kDone);
    EXPECT_THAT(shown(), HasSubstr("✓ Fetch ball can run: every robot agrees"));
}

TEST_F(Global, StopStopsThoseWhoTakePartAndNobodyElse) {
    EXPECT_EQ(perform("stop", Json::object()), kNotConfirmed) << "nobody works together";
    EXPECT_TRUE(station->stopped.empty());
    station->entities_[1].state = EntityState::SLAVE;
    station->entities_[2].state = EntityState::COLLAB;
    EXPECT_EQ(perform("stop", Json::object()), kDone);
    EXPECT_THAT(station->stopped, ElementsAre(station->entities_[1].id, cyton()));
}

TEST_F(Global, StopCountsThoseInWhoAreInTheMiddleOfAStep) {
    station->entities_[0].state = EntityState::BUSY;
    station->entities_[2].state = EntityState::BUSY;
    EXPECT_EQ(perform("stop", Json::object()), kDone);
    EXPECT_THAT(station->stopped, ElementsAre(peopleBot(), cyton()));
    EXPECT_THAT(seen.last("notice")->at("message").get<std::string>(), HasSubstr("PeopleBot#1, Cyton"));
    EXPECT_EQ(station->histories_asked, 0) << "nobody is asked first";
}

TEST_F(Global, StopByNameStopsWhatIsKnownBeforeAnybodyIsAsked) {
    kept = true;
    ASSERT_TRUE(station->checkOut({peopleBot(), cyton()}));
    station->run_script = {running};
    ASSERT_EQ(perform("run", {{"name", "Fetch ball"}, {"detach", true}}), kDone);
    station->entities_[1].state = EntityState::BUSY;
    station->history.silent = {{"PeopleBot#2", {RefusalCode::TimedOut, "No answer.", {}}}};
    std::vector<std::string> before;
    station->on_history = [&] { before = station->stopped; };
    EXPECT_EQ(perform("stop", {{"run", "fetch ball"}}), kDone);
    EXPECT_THAT(before, ElementsAre(peopleBot(), cyton()));
    EXPECT_THAT(station->stopped, ElementsAre(station->entities_[1].id))
        << "it works and does not say with whom";
    station->on_history = nullptr;
    station->history.silent.clear();
    EXPECT_EQ(perform("stop", {{"run", "fedc"}}), kDone);
    EXPECT_THAT(station->stopped, ElementsAre(peopleBot(), cyton()));
    EXPECT_EQ(station->histories_asked, 1) << "the id of one's own run is nobody else's";
}

TEST_F(Global, StopByNameStopsAllThatWorkWhenNobodyCanBeAsked) {
    station->history_refusal = {RefusalCode::TimedOut, "No answer.", {}};
    station->entities_[1].state = EntityState::BUSY;
    EXPECT_EQ(perform("stop", {{"run", "Fetch ball"}}), kDone);
    EXPECT_THAT(station->stopped, ElementsAre(station->entities_[1].id));
}

TEST_F(Global, StopFindsARunOfSomebodyElseByItsNameOrId) {
    RunRecord record;
    record.id = "0a0a0a0a-0000-4000-8000-00000000000c";
    record.service = fetchBall();
    record.state = RunState::Running;
    record.participants = {{0, peopleBot(), "PeopleBot"}, {1, cyton(), "Cyton"}};
    auto old = record;
    old.id = "0b0b0b0b-0000-4000-8000-00000000000d";
    old.state = RunState::Succeeded;
    old.participants = {{0, station->entities_[1].id, "PeopleBot#2"}};
    station->history.runs = {record, old};
    for (const auto* word : {"0a0a", "fetch_ball"}) {
        station->stopped.clear();
        EXPECT_EQ(perform("stop", {{"run", word}}), kDone);
        EXPECT_THAT(station->stopped, ElementsAre(peopleBot(), cyton()));
    }
    station->stopped.clear();
    EXPECT_EQ(perform("stop", {{"run", "0b0b"}}), kNotConfirmed) << "it is over";
    EXPECT_TRUE(station->stopped.empty());
}

TEST_F(Global, LsShowsServicesAndFindings) {
    EXPECT_EQ(perform("ls", Json::object()), kDone);
    const auto text = shown();
    EXPECT_THAT(text, HasSubstr("NAME        STEPS  ROLES  ON FAILURE  FILE      DESCRIPTION\n"
                                "Fetch ball  2      2      stop-all    ball.xml  The arm gets the ball\n"));
    EXPECT_THAT(text, HasSubstr("! ball.xml:1: warning: count"));
    EXPECT_THAT(text, HasSubstr("✗ bad.xml has errors"));
}

TEST_F(Global, AnUnknownServiceNamesNearOnesAndFilesWithErrors) {
    EXPECT_EQ(perform("run", {{"name", "Fetch bell"}}), kRefused);
    const auto message = seen.last("error")->at("message").get<std::string>();
    EXPECT_THAT(message, HasSubstr("did you mean \"Fetch ball\"?"));
    EXPECT_THAT(message, HasSubstr("bad.xml"));
    EXPECT_THAT(seen.last("error")->at("fix").get<std::string>(), HasSubstr("axon global ls"));
}

TEST_F(Global, InfoShowsStepsByTheirOrderAndWhatIsInTheWay) {
    EXPECT_EQ(perform("info", {{"name", "Fetch ball"}}), kDone);
    auto event = seen.events.back();
    event["roles"][1]["able"] = Json::array();
    event["roles"][1]["unfit"] = {
        {{"entity", "Cyton"}, {"code", "LATCHED"}, {"why", "was stopped"}},
        {{"entity", "PeopleBot#1"}, {"code", "WRONG_TYPE"}, {"why", "is ROBOT/MOBILE"}}};
    event["nobody_offers"] = {"grab"};
    event["possible"] = false;
    seen.events = {event};
    const auto text = shown();
    EXPECT_THAT(text, HasSubstr("1      approach  0     drive    Distance=1000 mm\n"
                                "2                1     grab     Place=approach.Position\n"));
    EXPECT_THAT(text, HasSubstr("  role 1: Cyton was stopped\n"));
    EXPECT_THAT(text, Not(HasSubstr("is ROBOT/MOBILE"))) << "the wrong kind is no news";
    EXPECT_THAT(text, HasSubstr("✗ no entity offers grab\n"));
}

TEST_F(Global, HistoryIsATableAndOneRunItsSteps) {
    RunRecord record;
    record.id = "0a0a0a0a-0000-4000-8000-00000000000c";
    record.service = fetchBall();
    record.by = "ana@lab";
    record.master = cyton();
    record.participants = {{1, cyton(), "Cyton"}};
    record.state = RunState::Failed;
    record.reason = {RefusalCode::Failed, "the ball rolled away", {}};
    record.duration = Seconds(12.5);
    StepReport step;
    step.called = "approach";
    step.name = "PeopleBot";
    step.service = "drive";
    step.preced = 1;
    step.state = TaskState::Failed;
    step.began = Seconds(0.5);
    step.ended = Seconds(12.5);
    step.parameters = {{"Distance", {std::string("1000")}}};
    record.steps = {step};
    auto other = record;
    other.id = "0a0b0a0a-0000-4000-8000-00000000000c";
    station->history.runs = {record, other};
    station->history.silent = {{"PeopleBot#2", {RefusalCode::TimedOut, "No answer.", {}}}};
    EXPECT_EQ(perform("history", Json::object()), kDone);
    auto text = shown();
    EXPECT_THAT(text, HasSubstr("0a0a0a0a  "));
    EXPECT_THAT(text, HasSubstr("Fetch ball  failed   12.5 s  Cyton   ana@lab  the ball rolled away\n"));
    EXPECT_THAT(text, HasSubstr("! PeopleBot#2 does not answer"));
    EXPECT_EQ(perform("history", {{"run", "0a0"}}), kRefused) << "two begin so";
    EXPECT_EQ(perform("history", {{"run", "ff"}}), kRefused);
    EXPECT_EQ(perform("history", {{"run", "0a0a"}}), kDone);
    seen.events = {seen.events.back()};
    text = shown();
    EXPECT_THAT(text,
                HasSubstr("1      approach  PeopleBot  drive    failed  500 ms  12.0 s  Distance = 1000\n"));
}

TEST_F(Global, LinesWhereNothingCanBeRedrawn) {
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kDone);
    EXPECT_THAT(shown(), HasSubstr("2.0 s  PeopleBot#1 drive (approach)  running 50 %\n"
                                   "5.0 s  PeopleBot#1 drive (approach)  succeeded\n"
                                   "5.0 s  Cyton grab  succeeded\n"
                                   "✓ Fetch ball succeeded after 5.0 s\n"
                                   "  PeopleBot#1 drive (approach): Position = 998\n"));
}

TEST_F(Global, ATableThatIsDrawnAnewOnATerminal) {
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kDone);
    const auto text = shown({true, false, 100, 24});
    EXPECT_THAT(
        text, HasSubstr("1      approach  PeopleBot#1  drive    running  [#####-----]  50 %  2.0 s\x1b[K\n"));
    EXPECT_THAT(text, HasSubstr("\x1b[4F")) << "four lines up: the whole, the heads, two steps";
    EXPECT_THAT(
        text,
        HasSubstr("2                Cyton        grab     succeeded  [##########] 100 %  4.0 s\x1b[K\n"));
}

TEST_F(Global, NoLineOfTheTableIsWiderThanTheTerminal) {
    station->run_script = {[](RunReport& report) {
                               running(report);
                               report.steps[0].feedback =
                                   "a remark that goes on and on and on and on and on and on";
                               report.steps[0].called = "a step with a long name";
                               report.steps[0].service = "a_service_with_a_very_long_global_id";
                           },
                           succeeded};
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kDone);
    for (const std::size_t width : {60U, 80U, 100U, 140U}) {
        std::istringstream lines(shown({true, false, width, 24}));
        for (std::string line; std::getline(lines, line);) {
            if (line.find("\x1b[K") == std::string::npos) continue;  // not of the table
            while (line.find('\x1b') != std::string::npos) {
                const auto at = line.find('\x1b');
                line.erase(at, line.find_first_of("FJK", at) - at + 1);
            }
            EXPECT_LT(columns(line), width) << line;
        }
    }
}

TEST_F(Global, MoreStepsThanLinesShowWhatIsUnderWay) {
    station->run_script = {[](RunReport& report) {
                               for (int i = 2; i < 64; ++i) {
                                   auto step = report.steps[0];
                                   step.step = i;
                                   step.preced = i;
                                   step.state.reset();
                                   report.steps.push_back(step);
                               }
                               for (std::size_t i = 0; i < 40; ++i)
                                   report.steps[i].state = TaskState::Succeeded;
                               report.steps[40].state = TaskState::Running;
                               report.steps[40].service = "the_one_that_runs";
                               report.state = RunState::Running;
                           },
                           succeeded};
    EXPECT_EQ(perform("run", {{"name", "Fetch ball"}}), kDone);
    seen.events.pop_back();
    const auto text = shown({true, false, 100, 24});
    EXPECT_THAT(text, HasSubstr("the_one_that_runs"));
    EXPECT_THAT(text, HasSubstr("… and 40 done, 6 to come"));
    EXPECT_THAT(text, Not(HasSubstr("\x1b[24F"))) << "never more lines than there are";
}

TEST(GlobalCommandLine, TwoWordsAreOneVerb) {
    const auto nothing = [](const char*) -> const char* { return nullptr; };
    const auto parsed = parseCommandLine(
        {"global", "run", "--bind", "0=PeopleBot", "--bind", "1=Cyton", "Fetch ball", "--wait", "--json"},
        nothing);
    ASSERT_TRUE(parsed.line) << parsed.err;
    EXPECT_STREQ(parsed.line->verb->name, "global run");
    EXPECT_EQ(parsed.line->args["bind"], (Json{"0=PeopleBot", "1=Cyton"}));
    EXPECT_EQ(parsed.line->args["name"], "Fetch ball");
    EXPECT_EQ(parsed.line->args["wait"], true);
    EXPECT_TRUE(parsed.line->settings.json);
    const auto plain = parseCommandLine({"run", "Cyton", "grab"}, nothing);
    ASSERT_TRUE(plain.line) << plain.err;
    EXPECT_STREQ(plain.line->verb->name, "run");
    EXPECT_STREQ(parseCommandLine({"global", "info", "run"}, nothing).line->verb->name, "global info");
}

TEST(GlobalCommandLine, MistakesAndHelpAtBothLevels) {
    const auto nothing = [](const char*) -> const char* { return nullptr; };
    auto parsed = parseCommandLine({"global", "rum"}, nothing);
    EXPECT_EQ(parsed.exit, kUsage);
    EXPECT_THAT(parsed.err, HasSubstr("unknown verb \"global rum\"\nfix: did you mean \"run\"?"));
    parsed = parseCommandLine({"global", "run"}, nothing);
    EXPECT_THAT(parsed.err, HasSubstr("fix: axon global run NAME"));
    parsed = parseCommandLine({"--server", "lab:1", "--json", "global", "--timeout", "2", "rum"}, nothing);
    EXPECT_THAT(parsed.err, HasSubstr("unknown verb \"global rum\""));
    parsed = parseCommandLine({"--server", "lab:1", "globul"}, nothing);
    EXPECT_THAT(parsed.err, HasSubstr("unknown verb \"globul\""));
    parsed = parseCommandLine({"globul"}, nothing);
    EXPECT_THAT(parsed.err, HasSubstr("\"global\""));
    for (const auto& words : std::vector<std::vector<std::string>>{{"global"}, {"global", "--help"}}) {
        parsed = parseCommandLine(words, nothing);
        EXPECT_THAT(parsed.out, HasSubstr("Usage: axon global VERB [OPTIONS]"));
        EXPECT_THAT(parsed.out, HasSubstr("history"));
    }
    parsed = parseCommandLine({"global", "run", "--help"}, nothing);
    EXPECT_THAT(parsed.out, HasSubstr("Usage: axon global run NAME [OPTIONS]"));
    EXPECT_THAT(parsed.out, HasSubstr("--bind ROLE=ENTITY"));
}

TEST_F(Global, CompletionKnowsGroupsServicesRolesAndEntities) {
    const auto offered = [&](std::vector<std::string> words) {
        Recorded told;
        words.insert(words.begin(), std::to_string(words.size() - 1));
        Session session{{{"words", words}}, told, std::make_shared<Mailbox>(), nullptr, settings};
        session.perform = [&](const std::string& verb, const Json& args, Events& sink) {
            Session inner{args, sink, std::make_shared<Mailbox>(), station, settings};
            return findVerb(verb)->perform(inner);
        };
        EXPECT_EQ(findVerb("__complete")->perform(session), kDone);
        return told.events.empty() ? std::string() : told.events.back()["text"].get<std::string>();
    };
    EXPECT_EQ(offered({"axon", "glo"}), "global");
    EXPECT_EQ(offered({"axon", "global", "r"}), "run\nresume");
    EXPECT_EQ(offered({"axon", "global", "run", ""}), "Fetch ball");
    EXPECT_EQ(offered({"axon", "global", "run", "Fetch ball", "--bind", ""}), "0=\n1=");
    EXPECT_EQ(offered({"axon", "global", "run", "Fetch ball", "--bind", "0", "=", "Cy"}), "Cyton");
    EXPECT_EQ(offered({"axon", "global", "run", "Fetch ball", "--master", "Cy"}), "Cyton");
    EXPECT_EQ(offered({"axon", "global", "run", "--bi"}), "--bind");
    EXPECT_EQ(offered({"axon", "global", "nonsense", ""}), "");
}
