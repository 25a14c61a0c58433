// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/view.hpp"

#include <gmock/gmock.h>

#include <sstream>

#include "cli/fake_station.hpp"
#include "cli/words.hpp"

using namespace axon;
using namespace axon::cli;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

namespace {

struct View : testing::Test {
    std::ostringstream out, err;
    ManualClock clock;
    std::string shown(const std::vector<Json>& events, Terminal terminal = {}) {
        {
            PersonView view(out, err, terminal, clock);
            for (const auto& event : events) {
                view.emit(event);
                clock.advance(std::chrono::milliseconds(100));
            }
        }
        return out.str();
    }
};

Json taskEvent(TaskState state, double progress, const std::string& feedback, double elapsed) {
    TaskReport report;
    report.id = "t";
    report.entity = "PeopleBot";
    report.service = "Driving";
    report.state = state;
    report.progress = progress;
    report.feedback = feedback;
    auto json = toJson(report);
    json["elapsed_s"] = elapsed;
    json["units"] = {{"Distance", "mm"}};
    return json;
}

}  // namespace

TEST(Table, AlignsColumnsAndLeavesEmptyOnesOut) {
    Table table({"NAME", "NOTHING", "STATE"});
    table.add({{"Ünïcödé"}, {""}, {"IDLE", Tint::Green}});
    table.add({{"a"}, {""}, {""}});
    EXPECT_EQ(table.text(false), "NAME     STATE\nÜnïcödé  IDLE\na\n");
    EXPECT_EQ(table.text(true),
              "\x1b[2mNAME\x1b[0m     \x1b[2mSTATE\x1b[0m\nÜnïcödé  \x1b[32mIDLE\x1b[0m\na\n");
}

TEST(Printable, LetsNoRobotSteerTheTerminal) {
    EXPECT_EQ(printable("\x1b]0;owned\x07 \xc2\x9b"
                        "2J ok\xff\r\n"),
              "?]0;owned? ?2J ok?? ");
    EXPECT_EQ(printable("grün 你好"), "grün 你好");
    EXPECT_EQ(printable("a\nb", true), "a\nb");
}

TEST(Columns, CountsWhatATerminalShows) {
    EXPECT_EQ(columns("grün"), 4U);
    EXPECT_EQ(columns("你好"), 4U);
    EXPECT_EQ(shortened("Driving to the door", 10), "Driving t…");
    EXPECT_EQ(shortened("你好你好", 6), "你好…");
    EXPECT_EQ(shortened("ok", 2), "ok");
}

TEST(Durations, ReadNaturally) {
    EXPECT_EQ(duration(0.00042), "0.4 ms");
    EXPECT_EQ(duration(0.212), "212 ms");
    EXPECT_EQ(duration(12.34), "12.3 s");
    EXPECT_EQ(duration(125), "2 min 05 s");
    EXPECT_EQ(progressBar(0.5, 12), "[#####-----]");
    EXPECT_EQ(progressBar(7, 4), "[##]");
    EXPECT_EQ(byteCount(1500), "1.5 KB");
}

TEST_F(View, ListsEntitiesWithHolderAndLatch) {
    FakeStation station;
    auto& all = station.entities_;
    all[0].state = EntityState::BUSY;
    all[1].state = EntityState::REG;
    all[1].latched = true;
    all[1].holder = {"x", "cl2@lab", Role::Operator};
    auto list = Json::array();
    for (const auto& entity : all) {
        list.push_back(toJson(entity, &entity == &all[0]));
        list.back()["call"] = callName(entity, all);
    }
    EXPECT_EQ(shown({{{"event", "entities"}, {"server", "s"}, {"entities", list}}}),
              "NAME         CATEGORY  TYPE        STATE  HOLDER   LATCH\n"
              "PeopleBot#1  ROBOT     MOBILE      BUSY   you\n"
              "PeopleBot#2  ROBOT     MOBILE      REG    cl2@lab  stopped\n"
              "Cyton        ROBOT     STATIONARY  IDLE   -\n");
}

TEST_F(View, SaysThatEntitiesAreNotReady) {
    EXPECT_EQ(
        shown({{{"event", "entities"}, {"server", "s"}, {"entities", Json::array()}, {"not_ready", 2}}}),
        "no entities at s yet: start a robot's application and its axon-entity-manager\n"
        "2 entities are not ready: axon ls --all shows why\n");
    out.str("");
    auto entity = FakeStation::entity("44444444-0000-4000-8000-000000000004", "greeter");
    entity.ready = false;
    entity.category = entity.type = "";
    entity.state = EntityState::UNAV;
    entity.reason = "waiting";
    auto json = toJson(entity, false);
    json["call"] = "greeter";
    EXPECT_EQ(shown({{{"event", "entities"}, {"server", "s"}, {"entities", {json}}, {"not_ready", 0}}}),
              "NAME     STATE  HOLDER  REASON\n"
              "greeter  UNAV   -       waiting\n");
    out.str("");
    EXPECT_THAT(shown({{{"event", "entity"}, {"entity", json}, {"services", Json::array()}}}),
                testing::StartsWith("greeter  not ready  UNAV\n  waiting\n"));
}

TEST_F(View, ShowsWhatAServiceTakesAndWhatIsMissing) {
    const FakeStation station;
    auto entity = toJson(station.entities_[2], false);
    entity["call"] = "Cyton";
    shown({{{"event", "entity"}, {"entity", entity}, {"services", {toJson(station.services_[0])}}}});
    EXPECT_EQ(out.str(),
              "Cyton  ROBOT STATIONARY  IDLE  free\n"
              "\n"
              "Driving (peoplebot_drive)  needs Distance, Map; pausable\n"
              "  Drives straight ahead\n"
              "  PARAMETER        KIND    TYPE    VALUE    ALLOWED\n"
              "  Distance         input   INT mm  missing  -5000 to 5000  required\n"
              "  Range Threshold  config  DBL mm  500                     kept\n"
              "  Colours          input   STR              red, green     several\n"
              "  RESOURCE  SIZE\n"
              "  Map       missing  required\n"
              "\n"
              "at 0, 0, 0 mm  33333333-0000-4000-8000-000000000003\n");
}

TEST_F(View, ShowsServicesThenStreamsThenWatchdogs) {
    const FakeStation station;
    auto entity = toJson(station.entities_[2], false);
    entity["call"] = "Cyton";
    const Json watchdogs{{{"hop", "client"}, {"timeout_ms", 1000.0}, {"longest_gap_ms", 120.0}}};
    shown({{{"event", "entity"},
            {"entity", entity},
            {"services", {toJson(station.services_[0])}},
            {"streams",
             {{{"name", "battery"}, {"kind", "scalar"}}, {{"name", "my camera"}, {"kind", "image"}}}},
            {"watchdogs", watchdogs}}});
    const auto text = out.str();
    EXPECT_THAT(text,
                HasSubstr("streams (axon watch Cyton STREAM)\n  battery    number\n  my camera  image\n"));
    EXPECT_LT(text.find("Driving"), text.find("streams"));
    EXPECT_LT(text.find("streams"), text.find("watchdog"));
}

TEST_F(View, ACellOfTheListHoldsTheFirstFindingAndHowManyThereAre) {
    auto entity = FakeStation::entity("44444444-0000-4000-8000-000000000004", "greeter");
    entity.ready = false;
    entity.category = entity.type = "";
    entity.state = EntityState::ERR;
    entity.reason = "basic.xml:1: error: one\nservices.xml:2: error: two\nservices.xml:9: error: three";
    auto json = toJson(entity, false);
    json["call"] = "greeter";
    EXPECT_EQ(shown({{{"event", "entities"}, {"server", "s"}, {"entities", {json}}}}),
              "NAME     STATE  HOLDER  REASON\n"
              "greeter  ERR    -       basic.xml:1: error: one (and 2 more: axon info greeter)\n");
    out.str("");
    EXPECT_THAT(
        shown({{{"event", "entity"}, {"entity", json}, {"services", Json::array()}}}),
        HasSubstr(
            "  basic.xml:1: error: one\n  services.xml:2: error: two\n  services.xml:9: error: three\n"));
}

TEST_F(View, ShowsWhyAServiceIsSwitchedOff) {
    FakeStation station;
    auto& service = station.services_[0];
    service.parameters.clear();
    service.resources.clear();
    service.active = false;
    auto entity = toJson(station.entities_[2], false);
    entity["call"] = "Cyton";
    shown({{{"event", "entity"}, {"entity", entity}, {"services", {toJson(service)}}}});
    EXPECT_THAT(out.str(),
                HasSubstr("Driving (peoplebot_drive)  switched off by the robot application; pausable\n"));
    service.inactive_reason = "battery low";
    shown({{{"event", "entity"}, {"entity", entity}, {"services", {toJson(service)}}}});
    EXPECT_THAT(out.str(), HasSubstr("Driving (peoplebot_drive)  switched off: battery low; pausable\n"));
}

TEST_F(View, ShowsWhatIsNotAsItsProfilesMeanIt) {
    const FakeStation station;
    auto entity = toJson(station.entities_[2], false);
    entity["call"] = "Cyton";
    shown({{{"event", "entity"},
            {"entity", entity},
            {"findings", {{{"message", "a saved value was dropped"}, {"fix", "set it again"}}}},
            {"services", Json::array()}}});
    EXPECT_EQ(out.str(),
              "Cyton  ROBOT STATIONARY  IDLE  free\n"
              "  a saved value was dropped\n"
              "    fix: set it again\n"
              "  at 0, 0, 0 mm  33333333-0000-4000-8000-000000000003\n");
}

TEST_F(View, PrintsProgressNowAndThenWhereLinesCannotBeRedrawn) {
    auto done = taskEvent(TaskState::Succeeded, 1, "", 4.2);
    done["results"] = {{"Distance", {998}}};
    EXPECT_EQ(shown({taskEvent(TaskState::Queued, -1, "", 0), taskEvent(TaskState::Running, 0, "", 0.1),
                     taskEvent(TaskState::Running, 0.01, "", 0.2),
                     taskEvent(TaskState::Running, 0.02, "", 0.3), taskEvent(TaskState::Running, 0.5, "", 2),
                     taskEvent(TaskState::Running, 0.51, "turning", 2.1), done}),
              "PeopleBot Driving  queued  0.0 ms\n"
              "PeopleBot Driving  [----------------------------]   0 %  100 ms\n"
              "PeopleBot Driving  [##############--------------]  50 %  2.0 s\n"
              "PeopleBot Driving  [##############--------------]  51 %  2.1 s  turning\n"
              "✓ PeopleBot Driving succeeded after 4.2 s\n"
              "  Distance = 998 mm\n");
}

TEST_F(View, ShowsTheFEEDBACKOfATaskWhileItRunsAndItsOUTPUTWhenItHasEnded) {
    auto running = taskEvent(TaskState::Running, 0.5, "", 2);
    running["live"] = {"Speed", "Beacon", "Angles"};
    running["units"] = {{"Distance", "mm"}, {"Speed", "mm/s"}};
    running["results"] = {{"Distance", {500}}, {"Speed", {198.5}}, {"Angles", {1.5, 2}}};
    auto done = running;
    done["state"] = "SUCCEEDED";
    done["final"] = true;
    EXPECT_EQ(
        shown({running, done}),
        "PeopleBot Driving  [##############--------------]  50 %  2.0 s  Speed 198.5 mm/s  Angles 1.5, 2\n"
        "✓ PeopleBot Driving succeeded after 2.0 s\n"
        "  Distance = 500 mm\n");
    auto stopped = done;
    stopped["state"] = "STOPPED";
    out.str("");
    EXPECT_THAT(shown({stopped}), HasSubstr("  Speed = 198.5 mm/s\n")) << "what is known of its end";
}

TEST_F(View, NothingIsAtMinusZeroPercent) {
    EXPECT_EQ(shown({taskEvent(TaskState::Running, -0.0, "", 0.1)}),
              "PeopleBot Driving  [----------------------------]   0 %  100 ms\n");
}

TEST_F(View, SaysHowManyTasksTheListLeavesOut) {
    auto task = taskEvent(TaskState::Running, 0.5, "", 0.1);
    task["id"] = "3f2a1b4c-0000-4000-8000-000000000001";
    task["reason"] = nullptr;
    EXPECT_THAT(shown({{{"event", "tasks"}, {"tasks", Json::array({task})}, {"forgotten", 12}}}),
                HasSubstr("12 older tasks have ended and are no longer listed\n"));
}

TEST_F(View, RedrawsProgressOnATerminalAndTakesItAway) {
    Terminal terminal;
    terminal.live = true;
    terminal.width = 40;
    EXPECT_EQ(shown({taskEvent(TaskState::Running, 0.5, "near the door", 2),
                     taskEvent(TaskState::Stopped, 0.5, "", 3)},
                    terminal),
              "  near the door\n"
              "\r\x1b[KPeopleBot Driving  [##############----…"
              "\r\x1b[K✗ PeopleBot Driving stopped after 3.0 s\n");
}

TEST_F(View, TellsWhyATaskFailedAndHowToFixIt) {
    auto refused = taskEvent(TaskState::Refused, -1, "", 0.1);
    refused["reason"] = {{"code", "LATCHED"}, {"message", "PeopleBot was stopped"}};
    refused["fix"] = "axon rearm PeopleBot";
    EXPECT_EQ(shown({refused}), "✗ PeopleBot Driving refused after 100 ms\n");
    EXPECT_EQ(err.str(), "axon: PeopleBot was stopped (LATCHED)\nfix: axon rearm PeopleBot\n");
}

TEST_F(View, ShowsTheReceiptOfAStopStageByStage) {
    Receipt good;
    good.name = "PeopleBot";
    good.state = EntityState::REG;
    good.server = Seconds(0.0004);
    good.manager = Seconds(0.0009);
    good.callback_returned = Seconds(0.0012);
    good.standstill = Seconds(0.21);
    Receipt bad = good;
    bad.name = "Cyton";
    bad.callback_returned.reset();
    bad.standstill.reset();
    bad.fault = "it threw: no brake";
    auto list = Json::array({toJson(good), toJson(bad)});
    for (auto& one : list) one["call"] = one["name"];
    EXPECT_EQ(shown({{{"event", "receipts"}, {"confirmed", false}, {"receipts", list}}}),
              "STOPPED    SERVER  MANAGER  CALLBACK  STANDSTILL  STATE  RECEIPT\n"
              "PeopleBot  0.4 ms  0.9 ms   1.2 ms    210 ms      REG    ✓ confirmed\n"
              "Cyton      0.4 ms  0.9 ms   -         -           REG    ✗ NOT CONFIRMED\n");
    EXPECT_THAT(err.str(), HasSubstr("not every stop is confirmed"));
    EXPECT_THAT(err.str(),
                HasSubstr("the stop callback of Cyton fails and is called again: it threw: no brake"));
}

TEST_F(View, WhatTheClockCannotTellIsNotZero) {
    Receipt receipt;
    receipt.name = "PeopleBot";
    receipt.server = Seconds(0);
    receipt.manager = receipt.callback_returned = Seconds(0.008);
    receipt.precision = Seconds(0.004);
    auto json = toJson(receipt);
    json["call"] = "PeopleBot";
    EXPECT_THAT(shown({{{"event", "receipts"}, {"receipts", Json::array({json})}, {"confirmed", true}}}),
                AllOf(HasSubstr("< 4.0 ms"), HasSubstr("  8.0 ms"), Not(HasSubstr("0.0 ms"))));
}

TEST_F(View, ARobotWhoseApplicationIsLostIsNeverShownAsNothingToStop) {
    Receipt hung;
    hung.name = "PeopleBot";
    hung.state = EntityState::UNAV;
    hung.server = Seconds(0.0004);
    hung.manager = Seconds(0.0009);
    hung.application_lost = "the robot application has been silent for 250 ms";
    hung.application_lost_for = Seconds(12.5);
    auto list = Json::array({toJson(hung)});
    list[0]["call"] = "PeopleBot";
    EXPECT_EQ(shown({{{"event", "receipts"}, {"confirmed", false}, {"receipts", list}}}),
              "STOPPED    SERVER  MANAGER  CALLBACK  STANDSTILL  STATE  RECEIPT\n"
              "PeopleBot  0.4 ms  0.9 ms   -         -           UNAV   ✗ NOT CONFIRMED\n");
    EXPECT_THAT(err.str(), HasSubstr("PeopleBot may be moving: its robot application has not been reachable "
                                     "for 12.5 s: the robot application has been silent for 250 ms"));
    EXPECT_THAT(err.str(), HasSubstr("look at the robots"));
}

TEST_F(View, ShowsWhoHasNotComeToRestYet) {
    Receipt rolls;
    rolls.name = "PeopleBot";
    rolls.state = EntityState::REG;
    rolls.server = rolls.manager = rolls.callback_returned = Seconds(0.001);
    rolls.standstill_follows = true;
    auto list = Json::array({toJson(rolls)});
    list[0]["call"] = "PeopleBot";
    EXPECT_EQ(shown({{{"event", "receipts"}, {"confirmed", true}, {"receipts", list}}}),
              "STOPPED    SERVER  MANAGER  CALLBACK  STANDSTILL  STATE  RECEIPT\n"
              "PeopleBot  1.0 ms  1.0 ms   1.0 ms    not yet     REG    ✓ confirmed\n");
}

TEST_F(View, SaysWhatAResetAndAClearHaveDone) {
    const auto done = [&](const char* verb, int ended, int removed, bool confirmed = true) {
        out.str({});
        return shown({{{"event", "done"},
                       {"verb", verb},
                       {"entity", "Cyton"},
                       {"confirmed", confirmed},
                       {"tasks_ended", ended},
                       {"tasks_removed", removed}}});
    };
    EXPECT_EQ(done("reset", 1, 0), "Cyton has ended 1 task; the next waiting task starts\n");
    EXPECT_EQ(done("reset", 0, 0), "Cyton was running no task\n");
    EXPECT_EQ(done("clear", 2, 1), "Cyton has ended 2 tasks, and removed 1 waiting task\n");
    EXPECT_EQ(done("clear", 0, 0, false), "Cyton was running no task, and none was waiting\n");
    EXPECT_THAT(err.str(), HasSubstr("its stop callback has not returned yet"));
}

TEST_F(View, ShowsErrorsWithCodeHolderAndFix) {
    shown({errorEvent({RefusalCode::AlreadyHeld, "PeopleBot is not free", "cl2@lab"}, "PeopleBot")});
    EXPECT_EQ(out.str(), "");
    EXPECT_EQ(err.str(),
              "axon: PeopleBot is not free (ALREADY_HELD)\n"
              "held by: cl2@lab\n"
              "fix: ask cl2@lab for it: axon checkout PeopleBot --ask REASON; or wait until it is free: "
              "axon checkout PeopleBot --wait\n");
}

TEST_F(View, ShowsSamplesAsPeopleReadThem) {
    auto ranges = Json::array();
    for (int i = 0; i < 20; ++i) ranges.push_back(i * 0.5);
    const auto sample = [](const char* stream, const Json& content) {
        return Json{{"event", "sample"},
                    {"entity", "PeopleBot"},
                    {"stream", stream},
                    {"sequence", 7},
                    {"sample", content}};
    };
    EXPECT_EQ(
        shown({sample("pose", {{"pose", {{"x", 1.5}, {"y", 2}, {"frame", ""}}}}),
               sample("battery", {{"scalar", {{"value", 12.1}, {"units", "V"}}}}),
               sample("quality", {{"scalar", {{"units", "%"}, {"value", 98.58}}}}),
               sample("arm", {{"vector", {{"units", "deg"}, {"values", {1, -2.5}}}}}),
               sample("camera",
                      {{"image",
                        {{"width", 320}, {"height", 240}, {"encoding", "jpeg"}, {"pixels", "/9j/4AA="}}}}),
               sample("laser", {{"raw", "AAECAw=="}}), sample("sonar", {{"scan", {{"ranges", ranges}}}}),
               sample("odd", "no json")}),
        "PeopleBot pose #7  x=1.5 y=2\n"
        "PeopleBot battery #7  12.1 V\n"
        "PeopleBot quality #7  98.58 %\n"
        "PeopleBot arm #7  [1 -2.5] deg\n"
        "PeopleBot camera #7  320 × 240 jpeg, 5 B\n"
        "PeopleBot laser #7  4 B of raw data\n"
        "PeopleBot sonar #7  [0 0.5 1 1.5 2 2.5 3 3.5 4 4.5 5 5.5 …] 20 values\n"
        "PeopleBot odd #7  no json\n");
}

TEST_F(View, TellsALostCheckOutLoudly) {
    shown({{{"event", "lost"},
            {"entity", "PeopleBot"},
            {"code", "REVOKED_LEASE"},
            {"message", "taken over"},
            {"holder", "cl2@lab"}}});
    EXPECT_EQ(err.str(),
              "axon: the check-out of PeopleBot is LOST: taken over; held by cl2@lab (REVOKED_LEASE)\n");
}

TEST(JsonLines, AreOneObjectEach) {
    std::ostringstream out;
    JsonView view(out);
    view.emit({{"event", "text"}, {"text", "two\nlines"}});
    EXPECT_EQ(out.str(), "{\"event\":\"text\",\"text\":\"two\\nlines\"}\n");
}
