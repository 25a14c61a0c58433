// SPDX-License-Identifier: GPL-2.0-or-later
// Check-outs that wait, ask, take and choose; hand-over; drills; passwords.
#include <gmock/gmock.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <sstream>
#include <thread>

#include "cli/command_line.hpp"
#include "cli/fake_station.hpp"
#include "cli/holding.hpp"
#include "cli/invoker.hpp"
#include "cli/password.hpp"
#include "cli/view.hpp"
#include "cli/words.hpp"
#include "support/loopback.hpp"

using namespace axon;
using namespace axon::cli;
using testing::HasSubstr;
using testing::Not;

namespace {

struct Ownership : testing::Test {
    std::shared_ptr<FakeStation> station = std::make_shared<FakeStation>();
    std::shared_ptr<Mailbox> mailbox = std::make_shared<Mailbox>();
    Recorded seen;
    Settings settings;

    int perform(const std::string& verb, Json args) {
        Session session{std::move(args), seen, mailbox, station, settings, true};
        return findVerb(verb)->perform(session);
    }
    std::string shown() {
        std::ostringstream out;
        std::ostringstream err;
        ManualClock clock;
        {
            PersonView view(out, err, {}, clock);
            for (const auto& event : seen.events) view.emit(event);
        }
        return out.str() + err.str();
    }
};

Parsed parsed(const std::vector<std::string>& words, const std::string& password_file = {}) {
    return parseCommandLine(words, [&](const char* name) -> const char* {
        return std::string_view(name) == "AXON_PASSWORD_FILE" ? password_file.c_str() : nullptr;
    });
}

std::filesystem::path passwordFile(const std::string& name, mode_t mode, const std::string& content) {
    const auto path = std::filesystem::path(testing::TempDir()) / name;
    std::filesystem::remove(path);
    std::ofstream(path) << content;
    ::chmod(path.c_str(), mode);
    return path;
}

}  // namespace

TEST_F(Ownership, WaitAskForceAndPolicyReachTheLibrary) {
    EXPECT_EQ(perform("checkout", {{"entity", {"Cyton"}}, {"wait", 2.5}, {"hand-over", "yield"}}), kDone);
    EXPECT_EQ(station->asked.wait, Seconds(2.5));
    EXPECT_TRUE(station->asked.hand_over.yield);
    EXPECT_FALSE(station->asked.ask || station->asked.force);
    EXPECT_EQ(seen.last("checked_out")->at("entities").at(0).at("call"), "Cyton");
    ASSERT_TRUE(station->release(station->entities_[2].id).ok());
    EXPECT_EQ(perform("checkout", {{"entity", {"Cyton"}}, {"ask", "a demonstration"}}), kDone);
    EXPECT_TRUE(station->asked.ask);
    EXPECT_EQ(station->asked.reason, "a demonstration");
    ASSERT_TRUE(station->release(station->entities_[2].id).ok());
    EXPECT_EQ(perform("checkout", {{"entity", {"Cyton"}}, {"force", "fire"}, {"hand-over", "refuse"}}),
              kDone);
    EXPECT_TRUE(station->asked.force && station->asked.hand_over.refuse);
    EXPECT_EQ(perform("checkout", {{"entity", {"PeopleBot"}}, {"force", "a"}, {"ask", "b"}}), kUsage);
}

TEST_F(Ownership, AQueryOrNamesNotBothNotNeither) {
    EXPECT_EQ(perform("checkout", {{"query", "1 ROBOT/STATIONARY"}}), kDone);
    EXPECT_EQ(station->queried, "1 ROBOT/STATIONARY");
    EXPECT_EQ(seen.last("checked_out")->at("entities").at(0).at("call"), "Cyton");
    EXPECT_EQ(perform("checkout", Json::object()), kUsage);
    EXPECT_EQ(perform("checkout", {{"entity", {"Cyton"}}, {"query", "1 ROBOT"}}), kUsage);
    EXPECT_EQ(perform("checkout", {{"query", "nonsense"}}), kUsage) << "a query is part of the command line";
}

TEST_F(Ownership, WhoWaitsSeesThePlaceAndMayGiveUp) {
    station->waits_for_ever = true;
    std::thread user([this] {
        while (mailbox.use_count() < 3) std::this_thread::yield();
        mailbox->interrupt();
    });
    EXPECT_EQ(perform("checkout", {{"entity", {"Cyton"}}, {"wait", true}}), kInterrupted);
    user.join();
    EXPECT_THAT(seen.last("notice")->at("message").get<std::string>(), HasSubstr("nothing was checked out"));
    EXPECT_TRUE(station->held().empty());
}

TEST_F(Ownership, ThePlaceIsShownAsItChanges) {
    seen.emit({{"event", "waiting"}, {"message", "Place 2 in the wait list of Cyton."}, {"place", 2}});
    EXPECT_THAT(shown(), HasSubstr("Place 2 in the wait list of Cyton."));
}

TEST_F(Ownership, ARefusedHandOverSaysWhatElseCanBeDone) {
    station->check_out_refusal = {RefusalCode::HandOverRefused, "client2@lab does not hand it over", {}};
    EXPECT_EQ(perform("checkout", {{"entity", {"Cyton"}}, {"ask", "please"}}), kRefused);
    EXPECT_EQ(seen.last("error")->at("fix"), "wait until it is free: axon checkout Cyton --wait");
}

TEST_F(Ownership, TheHolderAnswersOnce) {
    ASSERT_TRUE(station->checkOut({station->entities_[2].id}).ok());
    station->asks = "client2@lab";
    EXPECT_EQ(perform("handover", {{"entity", "Cyton"}, {"answer", "refuse"}, {"reason", "not now"}}), kDone);
    EXPECT_EQ(station->sent, "refuse not now");
    EXPECT_EQ(seen.last("done")->at("answer"), "refuse");
    EXPECT_EQ(perform("handover", {{"entity", "Cyton"}, {"answer", "accept"}}), kRefused);
    EXPECT_EQ(seen.last("error")->at("code"), "WRONG_STATE");
    EXPECT_EQ(perform("handover", {{"entity", "PeopleBot#1"}, {"answer", "accept"}}), kRefused);
}

TEST_F(Ownership, ARequestIsShownWithHowToAnswerItOrHowItEnds) {
    const auto text = [](const std::string& answer) {
        std::ostringstream out, err;
        ManualClock clock;
        PersonView view(out, err, {}, clock);
        view.emit(toJson(HandOverRequest{"client2@lab", "a demonstration", Seconds(30)}, "Cyton", answer));
        return err.str();
    };
    EXPECT_THAT(text("axon handover"), HasSubstr("client2@lab asks for Cyton: a demonstration"));
    EXPECT_THAT(text("axon handover"), HasSubstr("axon handover Cyton accept, or refuse; no answer refuses"));
    EXPECT_THAT(text(""), HasSubstr("nobody can answer for this command: Cyton stays here after 30.0 s"));
    EXPECT_THAT(text(""), Not(HasSubstr("axon handover")));
    station->asks = "client2@lab";
    EXPECT_EQ(perform("watch", {{"entity", "Cyton"}, {"for", 0.01}}), kDone);
    ASSERT_NE(seen.last("hand_over"), nullptr);
    EXPECT_EQ(seen.last("hand_over")->at("answer"), "axon handover Cyton");
    Session own{{{"entity", "Cyton"}, {"for", 0.01}}, seen, mailbox, station, settings, false};
    EXPECT_EQ(findVerb("watch")->perform(own), kDone);
    EXPECT_EQ(seen.last("hand_over")->at("answer"), nullptr) << "of a connection that ends with the command";
}

TEST_F(Ownership, ACheckOutThatWaitsForTheRobotToStandStillMayBeGivenUp) {
    station->waits_for_ever = true;
    std::thread user([this] {
        while (mailbox.use_count() < 3) std::this_thread::yield();
        mailbox->interrupt();
    });
    EXPECT_EQ(perform("checkout", {{"entity", {"Cyton"}}}), kInterrupted);
    user.join();
    EXPECT_TRUE(station->held().empty());
}

TEST_F(Ownership, ASecondWaitForTheSameSaysWhichOneToEnd) {
    station->check_out_refusal = {
        RefusalCode::Duplicate, "You wait for it already, with another request.", {}};
    EXPECT_EQ(perform("checkout", {{"entity", {"Cyton"}}, {"wait", true}}), kRefused);
    EXPECT_THAT(seen.last("error")->at("fix").get<std::string>(),
                HasSubstr("another axon checkout of yours"));
}

TEST_F(Ownership, LsAndInfoShowWhatIsOwnedAndHowNearTheDeadMenAre) {
    auto& arm = station->entities_[2];
    arm.holder = {"other", "client2@lab", Role::Operator};
    arm.orphaned = true;
    arm.waiting = 2;
    arm.stop_latency = Seconds(0.0012);
    station->watchdogs = {{"client", Seconds(0.25), Seconds(0.2)}};
    EXPECT_EQ(perform("ls", Json::object()), kDone);
    EXPECT_EQ(perform("info", {{"entity", "Cyton"}}), kDone);
    EXPECT_EQ(seen.last("entity")->at("watchdogs").at(0).at("longest_gap_ms"), 200);
    const auto text = shown();
    EXPECT_THAT(text, HasSubstr("client2@lab (lost)"));
    EXPECT_THAT(text, HasSubstr("2 clients are waiting for it"));
    EXPECT_THAT(text, HasSubstr("stop latency 1.2 ms"));
    EXPECT_THAT(
        text,
        HasSubstr("watchdog client: stops after 250 ms of silence, longest gap in the last minute 200 ms"));
}

TEST_F(Ownership, WhichWayMessagesGoIsShownOfWhatIsHeld) {
    EXPECT_EQ(perform("info", {{"entity", "Cyton"}}), kDone);
    EXPECT_THAT(shown(), Not(HasSubstr("messages go")));
    ASSERT_EQ(perform("checkout", {{"entity", {"Cyton"}}}), kDone);
    EXPECT_EQ(perform("info", {{"entity", "Cyton"}}), kDone);
    EXPECT_EQ(seen.last("entity")->at("entity").at("direct"), false);
    EXPECT_THAT(shown(), HasSubstr("messages go through the servers"));
    station->direct_id = station->entities_[2].id;
    EXPECT_EQ(perform("info", {{"entity", "Cyton"}}), kDone);
    EXPECT_EQ(seen.last("entity")->at("entity").at("direct"), true);
    EXPECT_THAT(shown(), HasSubstr("messages go directly to its Entity Manager"));
    EXPECT_EQ(perform("ls", Json::object()), kDone);
    for (const auto& entity : seen.last("entities")->at("entities"))
        EXPECT_EQ(entity.at("direct"), entity.at("id") == station->direct_id);
    EXPECT_EQ(perform("agent", {{"action", "status"}}), kDone);
    EXPECT_THAT(shown(), HasSubstr("direct"));
}

TEST_F(Ownership, TheAgentIsToldWhereItsUserIsReachedAndHowLongItKeepsWhatNobodyUses) {
    Json where;
    double limit_s = -1;
    const auto agent = [&](const Json& args, bool in_agent) {
        Session session{args, seen, mailbox, station, settings, true};
        if (in_agent) {
            session.notify = [&](const Json& told) { where = told; };
            session.set_idle = [&](double seconds) { limit_s = seconds; };
        }
        return findVerb("agent")->perform(session);
    };
    Json args{{"notify", true}, {"idle", 600.0}};
    EXPECT_EQ(findVerb("agent")->prepare(args), "");
    EXPECT_TRUE(args["notify"].is_object()) << "what the agent cannot see itself";
    args["notify"] = {{"terminal", "/dev/pts/0"}};  // the test may have none
    EXPECT_EQ(agent(args, true), kDone);
    EXPECT_EQ(where, args["notify"]);
    EXPECT_EQ(limit_s, 600);
    EXPECT_NE(seen.last("agent"), nullptr) << "without an action it is the status";
    EXPECT_EQ(agent(args, false), kUsage) << "under checkout -- COMMAND there is no such agent";
}

TEST_F(Ownership, ADrillShowsADistribution) {
    EXPECT_EQ(perform("drill", {{"entity", {"Cyton"}}, {"count", 10}, {"every", 0.0}}), kDone);
    const auto* drill = seen.last("drill");
    ASSERT_NE(drill, nullptr);
    EXPECT_EQ(drill->at("tries"), 10);
    EXPECT_EQ(drill->at("callback").at("n"), 10);
    EXPECT_EQ(drill->at("callback").at("p99_ms"), nullptr);
    EXPECT_TRUE(station->stopped.empty());
    const auto text = shown();
    EXPECT_THAT(text, HasSubstr("Cyton  10 tries"));
    EXPECT_THAT(text, HasSubstr("≤ 1.0 ms  ########"));
}

TEST_F(Ownership, ADrillThatIsRefusedInTheMiddleShowsWhatThereWas) {
    station->refused_drill = 4;
    EXPECT_EQ(perform("drill", {{"entity", {"Cyton"}}, {"count", 10}, {"every", 0.0}}), kNoServer);
    ASSERT_NE(seen.last("drill"), nullptr);
    EXPECT_EQ(seen.last("drill")->at("tries"), 3);
    EXPECT_EQ(seen.last("error")->at("code"), "NOT_CONNECTED");
}

TEST_F(Ownership, ADrillThatNeverArrivedIsNotConfirmed) {
    station->lost_drill = 3;
    EXPECT_EQ(perform("drill", {{"all", true}, {"count", 5}, {"every", 0.0}}), kNotConfirmed);
    EXPECT_EQ(seen.last("drill")->at("callback").at("never_arrived"), 1);
    EXPECT_THAT(shown(), HasSubstr("never"));
    EXPECT_EQ(perform("drill", Json::object()), kUsage);
    EXPECT_EQ(perform("drill", {{"entity", {"Citon"}}}), kRefused);
}

TEST_F(Ownership, AnInterruptedDrillShowsWhatItHas) {
    mailbox->interrupt();
    EXPECT_EQ(perform("drill", {{"entity", {"Cyton"}}, {"count", 1000}, {"every", 60.0}}), kInterrupted);
    EXPECT_EQ(seen.last("drill")->at("tries"), 1);
}

TEST(OwnershipWords, WaitTakesItsTimeWithAnEqualsSignOnly) {
    auto line = parsed({"checkout", "--wait", "PeopleBot"}).line;
    ASSERT_TRUE(line);
    EXPECT_EQ(line->args.at("wait"), true);
    EXPECT_EQ(line->args.at("entity"), Json({"PeopleBot"}));
    line = parsed({"checkout", "PeopleBot", "--wait=2.5"}).line;
    ASSERT_TRUE(line);
    EXPECT_EQ(line->args.at("wait"), 2.5);
    const auto wrong = parsed({"checkout", "PeopleBot", "--wait=soon"});
    EXPECT_EQ(wrong.exit, kUsage);
    EXPECT_THAT(wrong.err, HasSubstr("--wait=SECONDS"));
    EXPECT_EQ(parsed({"checkout", "PeopleBot", "--wait=-1"}).exit, kUsage);
}

TEST(OwnershipWords, OptionsAreReadAndWrongOnesRefused) {
    const auto line =
        parsed({"checkout", "--query", "2 ROBOT/MOBILE + 1 MACHINE", "--hand-over", "refuse"}).line;
    ASSERT_TRUE(line);
    EXPECT_EQ(line->args.at("query"), "2 ROBOT/MOBILE + 1 MACHINE");
    EXPECT_EQ(parsed({"checkout", "A", "--hand-over", "never"}).exit, kUsage);
    EXPECT_EQ(parsed({"handover", "A", "perhaps"}).exit, kUsage);
    EXPECT_EQ(parsed({"drill", "A", "--count", "0"}).exit, kUsage);
    EXPECT_EQ(parsed({"drill", "A", "--count", "100"}).line->args.at("count"), 100);
    const auto held = parsed({"checkout", "A", "--ask", "please", "--", "sh", "--wait"});
    ASSERT_TRUE(held.line);
    EXPECT_EQ(held.line->command.size(), 2U);
    EXPECT_FALSE(held.line->args.contains("wait")) << "the command's own";
}

TEST(Passwords, AreReadFromAFileThatOnlyItsUserMayRead) {
    const auto file = passwordFile("axon-password", 0600, "open sesame\nsecond line\n");
    EXPECT_EQ(readPassword(file).value(), "open sesame");
    EXPECT_EQ(parsed({"ls", "--password-file", file.string()}).line->settings.password, "open sesame");
    EXPECT_EQ(parsed({"ls"}, file.string()).line->settings.password, "open sesame");

    const auto open = passwordFile("axon-password-open", 0640, "open sesame\n");
    EXPECT_EQ(readPassword(open).refusal().code, RefusalCode::PermissionDenied);
    EXPECT_THAT(readPassword(open).refusal().message, HasSubstr("chmod 600"));
    const auto refused = parsed({"ls", "--password-file", open.string()});
    EXPECT_EQ(refused.exit, kUsage);
    EXPECT_THAT(refused.err, HasSubstr("chmod 600"));
    EXPECT_TRUE(parsed({"version", "--password-file", open.string()}).line) << "which connects to nothing";

    EXPECT_FALSE(readPassword(passwordFile("axon-password-empty", 0600, "\n")).ok());
    EXPECT_FALSE(readPassword(testing::TempDir()).ok());
    EXPECT_FALSE(readPassword("/no/such/file").ok());
}

TEST(Passwords, AreAskedForOnlyWhereAConnectionNeedsOne) {
    int asked = 0;
    std::string used;
    const auto invoke = [&](const Settings& settings, const char* verb, Json args) {
        Invoker invoker(
            settings,
            [&](const Settings& with) -> Result<std::shared_ptr<Station>> {
                used = with.password;
                return std::shared_ptr<Station>(std::make_shared<FakeStation>());
            },
            [&](const Settings&) -> std::optional<std::string> {
                ++asked;
                return "typed";
            });
        Recorded seen;
        return invoker.perform(*findVerb(verb), std::move(args), seen);
    };
    Settings settings;
    settings.server = "127.0.0.1:1";  // no agent is there
    EXPECT_EQ(invoke(settings, "ls", Json::object()), kDone);
    EXPECT_EQ(asked, 0) << "nobody is named";
    settings.user = "client1";
    EXPECT_EQ(invoke(settings, "ls", Json::object()), kDone);
    EXPECT_EQ(asked, 1);
    EXPECT_EQ(used, "typed");
    EXPECT_EQ(invoke(settings, "version", Json::object()), kDone);
    EXPECT_EQ(asked, 1);
    settings.password = "known";
    EXPECT_EQ(invoke(settings, "ls", Json::object()), kDone);
    EXPECT_EQ(asked, 1);
    EXPECT_EQ(used, "known");
}
