// SPDX-License-Identifier: GPL-2.0-or-later
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <netinet/in.h>
#include <sys/socket.h>

#include <algorithm>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <map>
#include <thread>

#include "cli/fake_station.hpp"
#include "cli/holding.hpp"
#include "cli/reach.hpp"
#include "cli/words.hpp"
#include "common/descriptor.hpp"
#include "support/loopback.hpp"

using namespace axon;
using namespace axon::cli;
using testing::AllOf;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

namespace {

struct Verbs : testing::Test {
    std::shared_ptr<FakeStation> station = std::make_shared<FakeStation>();
    std::shared_ptr<Mailbox> mailbox = std::make_shared<Mailbox>();
    Recorded seen;
    Settings settings;
    bool kept = false;

    int perform(const std::string& verb, Json args) {
        Session session{std::move(args), seen, mailbox, station, settings, kept};
        return findVerb(verb)->perform(session);
    }
    Json runCyton() {
        return {{"entity", "Cyton"}, {"service", "driving"}, {"parameters", {"distance=1000mm"}}};
    }
    std::string cyton() { return station->entities_[2].id; }
};

}  // namespace

TEST_F(Verbs, LsListsWhatIsNotReadyOnlyWithAll) {
    auto waiting = FakeStation::entity("44444444-0000-4000-8000-000000000004", "greeter");
    waiting.ready = false;
    waiting.category = waiting.type = "";
    waiting.state = EntityState::UNAV;
    waiting.reason = "waiting for the robot application \"greeter\"";
    station->entities_.push_back(waiting);
    auto second = waiting;  // an Entity Manager beside that of a Cyton that is there
    second.id = "55555555-0000-4000-8000-000000000005";
    second.name = "Cyton";
    station->entities_.push_back(second);
    EXPECT_EQ(perform("ls", Json::object()), kDone);
    EXPECT_EQ(seen.last("entities")->at("entities").size(), 3U);
    EXPECT_EQ(seen.last("entities")->at("not_ready"), 2);
    EXPECT_EQ(perform("ls", {{"all", true}}), kDone);
    const auto& all = seen.last("entities")->at("entities");
    ASSERT_EQ(all.size(), 5U);
    EXPECT_EQ(seen.last("entities")->at("not_ready"), 0);
    EXPECT_EQ(all[0]["call"], "Cyton");
    EXPECT_EQ(all[1]["call"], "55555555");
    EXPECT_EQ(all[4]["call"], "greeter");
    EXPECT_EQ(all[4]["ready"], false);
    EXPECT_EQ(all[4]["reason"], waiting.reason);
}

TEST_F(Verbs, DoctorNamesAnEntityWithoutItsApplicationAndOneWithoutProfiles) {
    auto waiting = FakeStation::entity("44444444-0000-4000-8000-000000000004", "greeter");
    waiting.ready = false;
    waiting.state = EntityState::UNAV;
    waiting.reason = "no robot application \"greeter\" is found";
    auto silent = waiting;
    silent.id = "55555555-0000-4000-8000-000000000005";
    silent.name = "half";
    silent.state = EntityState::INIT;
    silent.reason = "it has uploaded no services profile";
    station->entities_ = {waiting, silent};
    Session session{Json::object(), seen, mailbox, nullptr, settings, kept};
    session.connect = [&](const Settings&) { return std::shared_ptr<Station>(station); };
    EXPECT_EQ(findVerb("doctor")->perform(session), kRefused);
    std::map<std::string, Json> findings;
    for (const auto& event : seen.events) findings[event.value("name", "")] = event;
    EXPECT_EQ(findings["greeter"]["level"], "bad");
    EXPECT_THAT(findings["greeter"]["message"].get<std::string>(), HasSubstr(waiting.reason));
    EXPECT_THAT(findings["greeter"]["fix"].get<std::string>(), HasSubstr("--application"));
    EXPECT_EQ(findings["half"]["level"], "bad");
    EXPECT_THAT(findings["half"]["message"].get<std::string>(), HasSubstr(silent.reason));
}

TEST_F(Verbs, DoctorSaysWhatKeepsASessionFromBeingMade) {
    const auto finding = [&](const std::string& server, const std::string& name) {
        seen.events.clear();
        settings.server = server;
        Session session{Json::object(), seen, mailbox, nullptr, settings, kept};
        session.connect = [&](const Settings&) {
            return Result<std::shared_ptr<Station>>(
                Refusal{RefusalCode::Unavailable, "nobody listens there", {}});
        };
        EXPECT_EQ(findVerb("doctor")->perform(session), kRefused);
        for (const auto& event : seen.events)
            if (event.value("name", "") == name) return event.value("message", "");
        return std::string();
    };
    // Another program at the second of a server's ports, and then at the first.
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof address;
    std::optional<Descriptor> taken;
    std::uint16_t port = 0;
    while (!taken || isTaken(static_cast<std::uint16_t>(port - 1))) {
        taken.emplace(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0));
        address.sin_port = 0;
        ASSERT_EQ(::bind(taken->get(), reinterpret_cast<sockaddr*>(&address), size), 0);
        ASSERT_EQ(::listen(taken->get(), 4), 0);
        ASSERT_EQ(::getsockname(taken->get(), reinterpret_cast<sockaddr*>(&address), &size), 0);
        port = ntohs(address.sin_port);
    }
    EXPECT_THAT(finding("127.0.0.1:" + std::to_string(port - 1), "server ports"),
                HasSubstr(std::to_string(port)));
    EXPECT_THAT(finding("127.0.0.1:" + std::to_string(port), "network"), HasSubstr("a program listens"));
    EXPECT_EQ(finding("Axon.Clients/router:tcp -h lab -p 1", "network"), "") << "a router has no such ports";
}

TEST_F(Verbs, DoctorLooksAtTheClock) {
    Session session{Json::object(), seen, mailbox, nullptr, settings, kept};
    session.connect = [&](const Settings&) { return std::shared_ptr<Station>(station); };
    findVerb("doctor")->perform(session);
    const auto found = std::find_if(seen.events.begin(), seen.events.end(),
                                    [](const Json& event) { return event.value("name", "") == "clock"; });
    ASSERT_NE(found, seen.events.end());
    EXPECT_THAT((*found)["message"].get<std::string>(), HasSubstr(" UTC"));
    EXPECT_NE((*found)["level"], "bad");
}

TEST_F(Verbs, DoctorLooksAtLinksBetweenServersAmongWhatIsUnsafeOnly) {
    const auto file = std::filesystem::path(testing::TempDir()) / "axon-doctor-links.cfg";
    std::ofstream(file) << "FrontEndServerTopic.Endpoints=tcp -h 0.0.0.0 -p 10425\n";
    const auto examine = [&](Json args) {
        seen.events.clear();
        Session session{std::move(args), seen, mailbox, nullptr, settings, kept};
        session.connect = [&](const Settings&) { return std::shared_ptr<Station>(station); };
        return findVerb("doctor")->perform(session);
    };
    EXPECT_EQ(examine({{"security", true}, {"links", file.string()}}), kRefused);
    EXPECT_TRUE(std::any_of(seen.events.begin(), seen.events.end(), [](const Json& event) {
        return event.value("name", "") == "links" && event.value("level", "") == "bad";
    }));
    EXPECT_EQ(examine({{"links", file.string()}}), kUsage);
    EXPECT_EQ(seen.last("finding"), nullptr);
    std::filesystem::remove(file);
}

TEST_F(Verbs, DoctorLooksForWhoeverCouldBeLetInWhoShouldNotBe) {
    const auto folder = std::filesystem::path(testing::TempDir()) / "axon-doctor-state";
    std::filesystem::remove_all(folder);
    std::filesystem::create_directories(folder / "axon" / "greeter");
    std::filesystem::permissions(folder / "axon" / "greeter", std::filesystem::perms::owner_all);
    ASSERT_EQ(::setenv("XDG_STATE_HOME", folder.c_str(), 1), 0);
    bool needs_password = true;
    Refusal refusal{RefusalCode::PermissionDenied, "no", {}};
    const auto examine = [&] {
        seen.events.clear();
        Session session{{{"security", true}}, seen, mailbox, nullptr, settings, kept};
        session.connect = [&](const Settings& with) -> Result<std::shared_ptr<Station>> {
            if (with.password.empty() && (needs_password || refusal.code == RefusalCode::Overloaded))
                return refusal;
            return std::shared_ptr<Station>(station);
        };
        findVerb("doctor")->perform(session);
        std::map<std::string, std::string> levels;
        for (const auto& event : seen.events) levels[event.value("name", "")] = event.value("level", "");
        return levels;
    };
    settings.user = "ana";
    settings.password = "secret";
    auto levels = examine();
    EXPECT_EQ(levels["connection"], "ok") << "loopback";
    EXPECT_EQ(levels["log-in"], "ok");
    EXPECT_EQ(levels["state"], "ok");
    EXPECT_FALSE(levels.contains("role"));

    settings.server = "192.168.0.9:10410";
    EXPECT_EQ(examine()["connection"], "bad");
    settings.server = "ssl://lab.example.org:10410";
    EXPECT_EQ(examine()["connection"], "ok");

    for (const auto& [router, level] : std::map<std::string, std::string>{
             {"Axon.Clients/router:tcp -h 127.0.0.1 -p 10414", "ok"},
             {"Axon.Clients/router:ssl -h lab.example.org -p 10414", "ok"},
             {"Axon.Clients/router:tcp -h lab.example.org -p 10414", "bad"},
             {"Axon.Clients/router:ssl -h lab.example.org -p 10414:tcp -h lab.example.org -p 10415",
              "warn"}}) {
        settings.server = router;
        EXPECT_EQ(examine()["connection"], level) << router;
    }

    settings.server = "192.168.0.9:10410";
    needs_password = false;
    EXPECT_EQ(examine()["log-in"], "bad");
    settings.server = "127.0.0.1:10410";
    EXPECT_EQ(examine()["log-in"], "warn");
    refusal = {RefusalCode::Overloaded, "too many log in", {}};
    EXPECT_EQ(examine()["log-in"], "warn") << "it was not tried";
    refusal = {RefusalCode::PermissionDenied, "no", {}};
    needs_password = true;
    EXPECT_EQ(examine()["log-in"], "ok");
    needs_password = false;
    settings.properties["IceSSL.CertFile"] = "ana.p12";
    EXPECT_EQ(examine()["log-in"], "ok") << "and says that it was not tried";
    settings.properties.clear();

    station->my_role = Role::Admin;
    EXPECT_EQ(examine()["role"], "warn");
    std::filesystem::permissions(folder / "axon" / "greeter", std::filesystem::perms(0750));
    EXPECT_EQ(examine()["state"], "bad");
    ASSERT_EQ(::unsetenv("XDG_STATE_HOME"), 0);
    std::filesystem::remove_all(folder);
}

TEST_F(Verbs, RunChecksOutForItselfAndReleases) {
    station->services_[0].parameters.emplace_back().name = "Speed";
    station->services_[0].parameters.back().kind = client::ParameterKind::Feedback;
    station->script = {{TaskState::Running, 0.5, "half way", {}, {}},
                       {TaskState::Succeeded, 1, "", {}, {{"Distance", {std::int64_t{998}}}}}};
    EXPECT_EQ(perform("run", runCyton()), kDone);
    EXPECT_THAT(station->journalNow(), ElementsAre("checkOut", "release"));
    EXPECT_EQ(seen.events.front()["event"], "checked_out");
    EXPECT_EQ(seen.events.front()["for"], "run");
    const auto& last = seen.events.back();
    EXPECT_EQ(last["event"], "task");
    EXPECT_EQ(last["state"], "SUCCEEDED");
    EXPECT_EQ(last["results"]["Distance"][0], 998);
    EXPECT_EQ(last["units"]["Distance"], "mm");
    EXPECT_EQ(last["live"], Json::array({"Speed"}));
    EXPECT_EQ(station->run_arguments.at(0).units, "mm");
}

TEST_F(Verbs, RunKeepsACheckOutThatIsKept) {
    kept = true;
    ASSERT_TRUE(station->checkOut({cyton()}));
    station->script = {{TaskState::Succeeded, 1, "", {}, {}}};
    EXPECT_EQ(perform("run", runCyton()), kDone);
    EXPECT_EQ(station->held().size(), 1U);
    EXPECT_EQ(seen.last("checked_out"), nullptr);
}

TEST_F(Verbs, RunExitsByWhatBecameOfTheTask) {
    for (const auto& [state, exit] :
         std::vector<std::pair<TaskState, int>>{{TaskState::Failed, kRefused},
                                                {TaskState::Refused, kRefused},
                                                {TaskState::Stopped, kStopped},
                                                {TaskState::Cancelled, kStopped},
                                                {TaskState::Unknown, kNotConfirmed}}) {
        station->script = {{state, -1, "", {RefusalCode::Failed, "because", {}}, {}}};
        EXPECT_EQ(perform("run", runCyton()), exit) << client::toString(state);
    }
    station->script = {{TaskState::Refused, -1, "", {RefusalCode::TimedOut, "late", {}}, {}}};
    EXPECT_EQ(perform("run", runCyton()), kNotConfirmed);
}

TEST_F(Verbs, AnInterruptCancelsTheTaskAndReleases) {
    station->script = {{TaskState::Running, 0.1, "", {}, {}}};
    station->on_run = [this] { mailbox->interrupt(); };
    EXPECT_EQ(perform("run", runCyton()), kInterrupted);
    EXPECT_THAT(station->journalNow(), ElementsAre("checkOut", "cancel", "release"));
    EXPECT_EQ(seen.events.back()["state"], "CANCELLED");
}

TEST_F(Verbs, AnInterruptOfACheckOutOfItsOwnGivesThatUpAndBeginsNothing) {
    station->waits_for_ever = true;
    const std::pair<const char*, Json> verbs[] = {
        {"run", runCyton()},
        {"set", {{"entity", "Cyton"}, {"service", "Driving"}, {"parameters", {"Range Threshold=500"}}}},
        {"upload", {{"entity", "Cyton"}, {"service", "Driving"}, {"resource", "Map"}, {"file", "m"}}},
        {"send", {{"entity", "Cyton"}, {"text", "hello"}}}};
    for (const auto& [verb, args] : verbs) {
        station->on_check_out = [this] { mailbox->interrupt(); };
        EXPECT_EQ(perform(verb, args), kInterrupted) << verb;
        EXPECT_EQ(seen.last("notice")->at("message"), "cancelled; nothing was checked out") << verb;
        EXPECT_EQ(seen.last("error"), nullptr) << verb;
    }
    EXPECT_TRUE(station->held().empty());
    EXPECT_TRUE(station->run_arguments.empty() && station->set_arguments.empty() && station->sent.empty());
}

TEST_F(Verbs, ACheckOutThatIsGrantedAsItIsGivenUpIsReleased) {
    station->on_check_out = [this] { mailbox->interrupt(); };
    station->script = {{TaskState::Succeeded, 1, "", {}, {}}};
    EXPECT_EQ(perform("run", runCyton()), kInterrupted);
    EXPECT_THAT(station->journalNow(), ElementsAre("checkOut", "release"));
    EXPECT_TRUE(station->run_arguments.empty());
}

TEST_F(Verbs, ASecondInterruptDoesNotWaitForTheTask) {
    station->script = {{TaskState::Running, 0.1, "", {}, {}}};
    station->cancel_is_heard = false;
    station->on_run = [this] { mailbox->interrupt(); };
    // The second one comes as the first is handled: the fake never answers, and only this ends the wait at
    // once.
    std::thread second([this] {
        while (station->journalNow().size() < 2) std::this_thread::yield();
        mailbox->interrupt();
    });
    EXPECT_EQ(perform("run", runCyton()), kInterrupted);
    second.join();
    EXPECT_EQ(seen.last("error")->at("code"), "OUTCOME_UNKNOWN");
}

TEST_F(Verbs, RunCancelsWhenTheTimeIsUp) {
    station->script = {{TaskState::Running, 0.1, "", {}, {}}};
    auto args = runCyton();
    args["wait"] = 0.0;
    EXPECT_EQ(perform("run", args), kNotConfirmed);
    EXPECT_EQ(seen.events.back()["state"], "CANCELLED");
}

TEST_F(Verbs, DetachNeedsACheckOutThatOutlivesIt) {
    auto args = runCyton();
    args["detach"] = true;
    EXPECT_EQ(perform("run", args), kUsage);
    EXPECT_THAT(station->journalNow(), ElementsAre());
}

namespace {
constexpr bool kAccepted = true;
}

TEST_F(Verbs, DetachWaitsForTheAdmission) {
    kept = true;
    ASSERT_TRUE(station->checkOut({cyton()}));
    auto args = runCyton();
    args["detach"] = true;
    using State = TaskState;
    // Before anybody has answered the library says QUEUED.
    const std::pair<Refusal, int> refused[] = {
        {{RefusalCode::Latched, "It has been stopped.", {}}, kRefused},
        {{RefusalCode::MissingDependency, "Distance has no value.", {}}, kRefused},
        {{RefusalCode::QueueFull, "64 tasks wait.", {}}, kRefused},
        {{RefusalCode::Denied, "too far", {}}, kRefused},
        {{RefusalCode::TimedOut, "no answer", {}}, kNotConfirmed}};
    for (const auto& [reason, exit] : refused) {
        for (const auto before : {State::Queued, State::Dispatched}) {
            seen.events.clear();
            station->script = {{State::Queued, -1, "", {}, {}},
                               {before, -1, "", {}, {}, before == State::Dispatched},
                               {State::Refused, -1, "", reason, {}}};
            EXPECT_EQ(perform("run", args), exit) << reason.message;
            EXPECT_EQ(seen.events.back()["state"], "REFUSED");
            EXPECT_EQ(seen.events.back()["reason"]["message"], reason.message);
            EXPECT_NE(seen.events.front()["state"], "QUEUED") << "nobody had answered";
            EXPECT_EQ(seen.last("notice"), nullptr);
        }
    }
    station->script = {{State::Queued, -1, "", {}, {}},
                       {State::Dispatched, -1, "", {}, {}, kAccepted},
                       {State::Running, -1, "", {}, {}, kAccepted}};
    EXPECT_EQ(perform("run", args), kDone);
    EXPECT_EQ(seen.last("task")->at("state"), "RUNNING");
    EXPECT_THAT(seen.last("notice")->at("message").get<std::string>(), HasSubstr("axon wait abcdef00"));
    station->script = {{State::Queued, -1, "", {}, {}}, {State::Queued, -1, "", {}, {}, kAccepted}};
    EXPECT_EQ(perform("run", args), kDone);
    EXPECT_THAT(seen.last("notice")->at("message").get<std::string>(), HasSubstr("is waiting for its turn"));
}

TEST_F(Verbs, ATaskWhoseAdmissionIsInterruptedIsCancelled) {
    kept = true;
    ASSERT_TRUE(station->checkOut({cyton()}));
    station->script = {{TaskState::Dispatched, -1, "", {}, {}, kAccepted}};
    station->on_run = [this] { mailbox->interrupt(); };
    auto args = runCyton();
    args["detach"] = true;
    EXPECT_EQ(perform("run", args), kInterrupted);
    EXPECT_EQ(seen.last("task")->at("state"), "CANCELLED");
    args["wait"] = 3.0;
    EXPECT_EQ(perform("run", args), kUsage) << "nobody would cancel it when the time is up";
}

TEST_F(Verbs, WaitEndsWithTheTaskAndWithItsStatus) {
    kept = true;
    ASSERT_TRUE(station->checkOut({cyton()}));
    auto args = runCyton();
    args["detach"] = true;
    station->script = {{TaskState::Running, 0.5, "", {}, {}, kAccepted}};
    for (const auto& [state, exit] :
         std::vector<std::pair<TaskState, int>>{{TaskState::Succeeded, kDone},
                                                {TaskState::Stopped, kStopped},
                                                {TaskState::Failed, kRefused},
                                                {TaskState::Unknown, kNotConfirmed}}) {
        mailbox = std::make_shared<Mailbox>();
        ASSERT_EQ(perform("run", args), kDone);
        // The end comes while the verb looks at what there is, and after it.
        station->on_follow = [this, end = state] { station->goOn(end); };
        EXPECT_EQ(perform("wait", {{"task", {"abcd"}}}), exit) << client::toString(state);
        EXPECT_EQ(seen.last("task")->at("state"), client::toString(state));
        EXPECT_EQ(seen.last("task")->at("entity"), "Cyton");
        EXPECT_EQ(seen.last("task")->at("units")["Distance"], "mm");
        station->on_follow = {};
        EXPECT_EQ(perform("wait", {{"task", {"abcd"}}}), exit) << "it has ended before";
        EXPECT_EQ(perform("wait", Json::object()), kDone) << "nothing is left to wait for";
    }
    mailbox = std::make_shared<Mailbox>();
    ASSERT_EQ(perform("run", args), kDone);
    seen.on_event = [this](const Json& event) {
        if (event.at("event") == "task" && event.at("state") == "RUNNING")
            station->goOn(TaskState::Succeeded);
    };
    EXPECT_EQ(perform("wait", Json::object()), kDone);
    EXPECT_EQ(seen.last("task")->at("state"), "SUCCEEDED");
}

TEST_F(Verbs, WaitLeavesTheTaskAloneWhenItsTimeIsUpOrItIsInterrupted) {
    kept = true;
    ASSERT_TRUE(station->checkOut({cyton()}));
    auto args = runCyton();
    args["detach"] = true;
    station->script = {{TaskState::Running, 0.5, "", {}, {}, kAccepted}};
    ASSERT_EQ(perform("run", args), kDone);
    EXPECT_EQ(perform("wait", {{"for", 0.0}}), kNotConfirmed);
    EXPECT_EQ(seen.last("error")->at("code"), "TIMED_OUT");
    EXPECT_THAT(seen.last("error")->at("fix").get<std::string>(), HasSubstr("wait longer"));
    mailbox->interrupt();
    EXPECT_EQ(perform("wait", Json::object()), kInterrupted);
    EXPECT_THAT(seen.last("notice")->at("message").get<std::string>(), HasSubstr("the task continues"));
    EXPECT_THAT(station->journalNow(), ElementsAre("checkOut"));
    EXPECT_EQ(perform("wait", {{"task", {"0000"}}}), kRefused);
    EXPECT_EQ(seen.last("error")->at("code"), "UNKNOWN_TASK");
    auto other = station->tasks().list.front();
    other.report.id = "abcdef11-0000-4000-8000-00000000000c";
    station->others = {other};
    EXPECT_EQ(perform("wait", {{"task", {"abcd"}}}), kRefused);
    EXPECT_THAT(seen.last("error")->at("message").get<std::string>(), HasSubstr(other.report.id));
}

TEST_F(Verbs, TasksSayHowManyAreNoLongerListedAndFollow) {
    kept = true;
    ASSERT_TRUE(station->checkOut({cyton()}));
    auto args = runCyton();
    args["detach"] = true;
    station->script = {{TaskState::Running, 0.5, "", {}, {}, kAccepted}};
    ASSERT_EQ(perform("run", args), kDone);
    station->forgotten_tasks = 12;
    EXPECT_EQ(perform("tasks", Json::object()), kDone);
    EXPECT_EQ(seen.last("tasks")->at("forgotten"), 12);
    EXPECT_EQ(seen.last("tasks")->at("tasks").at(0).at("elapsed_s"), 1.5);
    EXPECT_EQ(perform("tasks", {{"for", 1.0}}), kUsage);
    seen.on_event = [this](const Json& event) {
        if (event.at("event") == "tasks") {
            station->goOn(TaskState::Failed, {RefusalCode::Failed, "a wheel is off", {}});
            station->goOn(TaskState::Running);  // late: it has been told as failed
            mailbox->post({{"event", "text"}});
        } else if (event.at("event") == "text") {
            mailbox->interrupt();
        }
    };
    seen.events.clear();
    EXPECT_EQ(perform("tasks", {{"follow", true}}), kInterrupted);
    seen.on_event = {};
    ASSERT_NE(seen.last("task"), nullptr);
    EXPECT_EQ(seen.last("task")->at("state"), "FAILED");
    EXPECT_EQ(seen.last("task")->at("reason")["message"], "a wheel is off");
    seen.events.clear();
    EXPECT_EQ(perform("tasks", {{"entity", "Cyton"}, {"follow", true}, {"for", 0.0}}), kDone);
    EXPECT_EQ(seen.events.size(), 1U);
}

TEST_F(Verbs, ARefusedCheckOutNamesTheHolderAndRunsNothing) {
    station->check_out_refusal = {RefusalCode::AlreadyHeld, "Cyton is held by cl2@lab", "cl2@lab"};
    EXPECT_EQ(perform("run", runCyton()), kRefused);
    EXPECT_EQ(seen.events.back()["holder"], "cl2@lab");
    EXPECT_TRUE(station->run_arguments.empty());
}

TEST_F(Verbs, NobodyIsToldToAskAHolderWhoIsLostOrIsOneself) {
    const auto fix = [&] {
        EXPECT_EQ(perform("run", runCyton()), kRefused);
        return seen.last("error")->at("fix").get<std::string>();
    };
    station->check_out_refusal = {RefusalCode::AlreadyHeld, "Cyton is held by cl2@lab", "cl2@lab"};
    EXPECT_THAT(fix(), HasSubstr("ask cl2@lab"));
    station->entities_[2].orphaned = true;
    EXPECT_THAT(fix(), AllOf(HasSubstr("has lost its connection"), HasSubstr("axon checkout Cyton --wait")));
    station->entities_[2].orphaned = false;
    station->check_out_refusal.holder = station->self().name;
    EXPECT_THAT(fix(), AllOf(HasSubstr("another command of yours"), Not(HasSubstr("ask "))));
    station->my_role = Role::Observer;
    EXPECT_THAT(fix(), HasSubstr("log in as an operator"));
}

TEST_F(Verbs, ADirectoryIsNoFileAndIsCalledADirectory) {
    for (const auto* verb : {"upload", "send"}) {
        Json args{{"file", "/"}};
        EXPECT_THAT(findVerb(verb)->prepare(args), HasSubstr("found a directory at \"/\"")) << verb;
    }
    Json args{{"file", "/nowhere"}};
    EXPECT_THAT(findVerb("upload")->prepare(args), HasSubstr("found none at"));
}

TEST_F(Verbs, WrongParametersAreRefusedBeforeTheCheckOut) {
    auto args = runCyton();
    args["parameters"] = {"speed=3"};
    EXPECT_EQ(perform("run", args), kRefused);
    args["parameters"] = {"1000"};
    EXPECT_EQ(perform("run", args), kUsage);
    EXPECT_THAT(station->journalNow(), ElementsAre());
}

TEST_F(Verbs, StopOfASharedNameStopsAllOfThem) {
    EXPECT_EQ(perform("stop", {{"entity", {"PeopleBot"}}}), kDone);
    EXPECT_THAT(station->stopped, ElementsAre("PeopleBot")) << "the library knows what it means";
    EXPECT_EQ(seen.last("receipts")->at("receipts").at(1).at("call"), "PeopleBot#2");
}

TEST_F(Verbs, StopOfABeginningThatSeveralShareStopsAllOfThem) {
    station->entities_[1].id = "11111111-0000-4000-8000-000000000002";
    EXPECT_EQ(perform("stop", {{"entity", {"1111"}}}), kDone);
    EXPECT_EQ(seen.last("receipts")->at("receipts").size(), 2U);
}

TEST_F(Verbs, AStopThatReachedNothingIsNotConfirmed) {
    station->entities_.clear();
    EXPECT_EQ(perform("stop", Json::object()), kNotConfirmed);
    EXPECT_FALSE(seen.last("receipts")->at("confirmed"));
    EXPECT_THAT(seen.last("notice")->at("message").get<std::string>(), HasSubstr("nothing to stop"));
}

TEST_F(Verbs, AnInterruptedUploadSendsNoMore) {
    ASSERT_TRUE(station->checkOut({cyton()}));
    station->upload_is_stuck = true;
    mailbox->interrupt();
    EXPECT_EQ(
        perform("upload", {{"entity", "Cyton"}, {"service", "Driving"}, {"resource", "Map"}, {"file", "m"}}),
        kInterrupted);
    EXPECT_TRUE(axon::test::waitUntil([&] { return station->upload_was_given_up.load(); }));
}

TEST_F(Verbs, StopWithoutANameStopsEverything) {
    EXPECT_EQ(perform("stop", Json::object()), kDone);
    EXPECT_TRUE(station->stopped.empty());
    EXPECT_EQ(seen.last("receipts")->at("receipts").size(), 3U);
}

TEST_F(Verbs, StopSucceedsOnlyWhenConfirmed) {
    station->stop_is_confirmed = false;
    EXPECT_EQ(perform("stop", {{"entity", {"Cyton"}}}), kNotConfirmed);
    EXPECT_FALSE(seen.last("receipts")->at("confirmed"));
}

TEST_F(Verbs, AStopOfASilentApplicationIsNotConfirmed) {
    station->lost_application = "the robot application has been silent for 250 ms";
    EXPECT_EQ(perform("stop", Json::object()), kNotConfirmed);
    EXPECT_FALSE(seen.last("receipts")->at("confirmed"));
    EXPECT_EQ(seen.last("receipts")->at("receipts").at(0).at("application_lost"), station->lost_application);
    EXPECT_FALSE(seen.last("receipts")->at("receipts").at(0).at("no_application"));
}

TEST_F(Verbs, StopWaitsForStandstillUnlessItIsToldNotTo) {
    perform("stop", Json::object());
    EXPECT_EQ(station->waited_for_standstill, Seconds(5));
    perform("stop", {{"deadline", 2.0}});
    EXPECT_EQ(station->waited_for_standstill, Seconds(2));
    perform("stop", {{"no-wait", true}});
    EXPECT_EQ(station->waited_for_standstill, Seconds(0));
}

TEST_F(Verbs, AnOperatorRearmsAFreeEntityByHoldingItForThatMoment) {
    station->rearm_refusal = Refusal{RefusalCode::NotHolder, "You do not hold this entity.", {}};
    EXPECT_EQ(perform("rearm", {{"entity", {"Cyton"}}}), kDone);
    EXPECT_THAT(station->rearmed, ElementsAre(cyton()));
    EXPECT_THAT(station->journal, ElementsAre("checkOut", "release"));
    EXPECT_EQ(seen.last("checked_out")->at("for"), "rearm");
    EXPECT_EQ(seen.last("done")->at("entity"), "Cyton");
}

TEST_F(Verbs, WhatSomebodyElseHoldsIsNotCheckedOutForARearm) {
    station->rearm_refusal = Refusal{RefusalCode::NotHolder, "You do not hold this entity.", {}};
    station->entities_[2].holder = {"other", "bob@lab", Role::Operator};
    EXPECT_EQ(perform("rearm", {{"entity", {"Cyton"}}}), kRefused);
    EXPECT_THAT(station->rearmed, IsEmpty());
    EXPECT_THAT(station->journal, IsEmpty());
}

TEST_F(Verbs, ARearmThatIsRefusedForAnotherReasonChecksNothingOut) {
    station->rearm_refusal = Refusal{RefusalCode::PermissionDenied, "Observers may watch and stop.", {}};
    EXPECT_EQ(perform("rearm", {{"entity", {"Cyton"}}}), kRefused);
    EXPECT_THAT(station->journal, IsEmpty());
}

TEST_F(Verbs, ResetAndClearSayWhatWasDoneAndPassOnARefusal) {
    kept = true;
    ASSERT_TRUE(station->checkOut({cyton()}));
    for (const auto* verb : {"reset", "clear"}) {
        Receipt done;
        done.manager = done.callback_returned = Seconds(0.001);
        done.tasks_ended = 1;
        station->answer_of_command = done;
        EXPECT_EQ(perform(verb, {{"entity", "Cyton"}}), kDone);
        EXPECT_EQ(seen.last("done")->at("tasks_ended"), 1);
        EXPECT_TRUE(seen.last("done")->at("confirmed"));
        done.callback_returned.reset();
        station->answer_of_command = done;
        EXPECT_EQ(perform(verb, {{"entity", "Cyton"}}), kNotConfirmed);
        station->answer_of_command = Refusal{RefusalCode::WrongState, "it takes part in a collaboration", {}};
        EXPECT_EQ(perform(verb, {{"entity", "Cyton"}}), kRefused);
        EXPECT_EQ(seen.last("error")->at("code"), "WRONG_STATE");
    }
}

TEST_F(Verbs, StopDoesWhatItCanWhenANameIsWrong) {
    EXPECT_EQ(perform("stop", {{"entity", {"Cyton", "Citon"}}}), kRefused);
    EXPECT_THAT(station->stopped, ElementsAre("Cyton"));
    EXPECT_EQ(seen.last("error")->at("code"), "UNKNOWN_ENTITY");
    station->stopped = {"untouched"};
    EXPECT_EQ(perform("stop", {{"entity", {"Citon"}}}), kRefused);
    EXPECT_THAT(station->stopped, ElementsAre("untouched"));
}

TEST_F(Verbs, CheckOutTakesAllAndSaysWhatIsHeldAlready) {
    kept = true;
    ASSERT_TRUE(station->checkOut({cyton()}));
    EXPECT_EQ(
        perform("checkout", {{"entity", {"Cyton", station->entities_[0].id, station->entities_[0].id}}}),
        kDone);
    EXPECT_EQ(station->held().size(), 2U);
    EXPECT_EQ(seen.last("checked_out")->at("already").at(0).at("name"), "Cyton");
    EXPECT_EQ(seen.last("checked_out")->at("entities").size(), 1U);
}

TEST_F(Verbs, ReleaseWithoutANameReleasesEverything) {
    ASSERT_TRUE(station->checkOut({cyton(), station->entities_[0].id}));
    EXPECT_EQ(perform("release", Json::object()), kDone);
    EXPECT_TRUE(station->held().empty());
    EXPECT_EQ(perform("release", {{"entity", {"Cyton"}}}), kRefused);
    EXPECT_EQ(seen.last("error")->at("code"), "NOT_HOLDER");
}

TEST_F(Verbs, ALostCheckOutIsNamedAsTheReason) {
    station->lost_id = cyton();
    EXPECT_EQ(perform("cancel", {{"entity", "Cyton"}}), kRefused);
    EXPECT_THAT(seen.last("error")->at("message").get<std::string>(),
                HasSubstr("was lost: an admin took it over"));
    EXPECT_EQ(seen.last("error")->at("holder"), "cl2@lab");
}

TEST_F(Verbs, CancelFindsTheOnlyTask) {
    kept = true;
    ASSERT_TRUE(station->checkOut({cyton()}));
    station->script = {{TaskState::Running, 0.1, "", {}, {}, kAccepted}};
    auto args = runCyton();
    args["detach"] = true;
    EXPECT_EQ(perform("run", args), kDone);
    EXPECT_EQ(perform("cancel", {{"entity", "Cyton"}, {"task", "0000"}}), kRefused);
    EXPECT_EQ(perform("pause", {{"entity", "Cyton"}, {"task", "abcd"}}), kDone);
    EXPECT_EQ(perform("cancel", {{"entity", "Cyton"}}), kDone);
    EXPECT_EQ(perform("tasks", Json::object()), kDone);
    EXPECT_EQ(seen.last("tasks")->at("tasks").at(0).at("state"), "CANCELLED");
    EXPECT_EQ(perform("cancel", {{"entity", "Cyton"}}), kRefused);
}

TEST_F(Verbs, SetSendsEachParameterAndUploadShowsProgress) {
    EXPECT_EQ(perform("set",
                      {{"entity", "Cyton"}, {"service", "Driving"}, {"parameters", {"range_threshold=700"}}}),
              kDone);
    EXPECT_EQ(station->set_arguments.at(0).name, "Range Threshold");
    EXPECT_EQ(
        perform("upload",
                {{"entity", "Cyton"}, {"service", "Driving"}, {"resource", "map"}, {"file", "/lab.map"}}),
        kDone);
    EXPECT_EQ(seen.last("upload")->at("sent"), 1000);
    EXPECT_EQ(seen.events.back()["event"], "uploaded");
    EXPECT_EQ(
        perform("upload",
                {{"entity", "Cyton"}, {"service", "Driving"}, {"resource", "mop"}, {"file", "/lab.map"}}),
        kRefused);
}

TEST_F(Verbs, SendCarriesBytesUnharmed) {
    const std::string bytes("\x00\xff\n", 3);
    EXPECT_EQ(perform("send", {{"entity", "Cyton"}, {"hex", toHex(bytes)}}), kDone);
    EXPECT_EQ(station->sent, bytes);
    EXPECT_EQ(perform("send", {{"entity", "Cyton"}, {"hex", "0g"}}), kUsage);
}

TEST_F(Verbs, WatchShowsSamplesAndTextsUntilItsTimeIsUp) {
    station->samples = {{1, R"({"stream":"pose","sequence":"1","taken_at_us":"12345","pose":{"x":1.5}})"},
                        {3, "no sample"}};
    station->says = "hello";
    EXPECT_EQ(perform("watch", {{"entity", "Cyton"}, {"streams", {"pose"}}, {"for", 0.05}}), kDone);
    EXPECT_THAT(station->watched, ElementsAre("pose"));
    EXPECT_EQ(seen.last("text")->at("text"), "hello");
    EXPECT_EQ(seen.events.at(2)["sample"].size(), 1U);
    EXPECT_EQ(seen.events.at(2)["sample"]["pose"]["x"], 1.5);
    EXPECT_EQ(seen.events.at(2)["taken_at_us"], 12345);
    EXPECT_EQ(seen.last("sample")->at("sample"), Json::object());
    EXPECT_EQ(seen.last("sample")->at("sequence"), 3);
    mailbox->interrupt();
    EXPECT_EQ(perform("watch", {{"entity", "Cyton"}}), kInterrupted);
}

TEST_F(Verbs, WatchOfAStreamThatIsNotSentNamesThoseThatAre) {
    station->samples = {{1, R"({"stream":"pose","sequence":"1","pose":{"x":1.5}})"}};
    EXPECT_EQ(perform("watch", {{"entity", "Cyton"}, {"streams", {"pos"}}, {"for", 0.01}}), kNotConfirmed);
    EXPECT_EQ(seen.last("notice")->at("message"), "Cyton sends no stream \"pos\" now; it sends pose");
    station->samples.clear();
    EXPECT_EQ(perform("watch", {{"entity", "Cyton"}, {"streams", {"pos"}}, {"for", 0.01}}), kNotConfirmed);
    EXPECT_EQ(seen.last("notice")->at("message"), "Cyton sends no stream \"pos\" now; it sends none at all");
    EXPECT_EQ(perform("watch", {{"entity", "Cyton"}, {"for", 0.01}}), kDone);
    EXPECT_EQ(seen.last("notice")->at("message"), "nothing was received from Cyton");
}

TEST_F(Verbs, WatchKeepsTheNewestPictureInAFileAndPassesNoPixelsOn) {
    const auto file = std::filesystem::path(testing::TempDir()) / "axon-picture.jpg";
    std::filesystem::remove(file);
    station->stream = "camera";
    station->samples = {
        {1, R"({"stream":"camera","image":{"width":2,"height":1,"encoding":"jpeg","pixels":"/9j/b2xk"}})"},
        {2, R"({"stream":"camera","image":{"width":2,"height":1,"encoding":"jpeg","pixels":"/9j/bmV3"}})"}};
    const Json args{{"entity", "Cyton"}, {"streams", {"camera"}}, {"for", 0.05}, {"save", file.string()}};
    EXPECT_EQ(perform("watch", args), kDone);
    std::ifstream in(file, std::ios::binary);
    std::string content;
    in >> content;
    EXPECT_EQ(content, "\xFF\xD8\xFFnew");
    EXPECT_EQ(seen.last("sample")->at("file"), file.string());
    EXPECT_EQ(seen.last("sample")->at("sample"),
              Json({{"image", {{"width", 2}, {"height", 1}, {"encoding", "jpeg"}}}}));
    station->samples = {{3, R"({"stream":"camera","scalar":{"value":1}})"}};
    EXPECT_EQ(perform("watch", args), kUsage);
    EXPECT_THAT(seen.last("error")->at("message").get<std::string>(), HasSubstr("has no pictures"));
    std::filesystem::remove(file);
}

TEST_F(Verbs, APictureIsSavedOfOneStreamAndFromAnyFolder) {
    Json args{{"entity", "Cyton"}, {"save", "now.jpg"}};
    EXPECT_THAT(findVerb("watch")->prepare(args), HasSubstr("the name of one stream"));
    args["streams"] = {"camera"};
    EXPECT_EQ(findVerb("watch")->prepare(args), "");
    EXPECT_TRUE(std::filesystem::path(args["save"].get<std::string>()).is_absolute());
}

TEST_F(Verbs, InfoListsTheStreamsThatAreSentUnlessItIsToldNotTo) {
    station->samples = {{1, R"({"stream":"pose","sequence":"1","pose":{"x":1.5}})"},
                        {2, R"({"stream":"pose","sequence":"2","pose":{"x":2.5}})"}};
    EXPECT_EQ(perform("info", {{"entity", "Cyton"}}), kDone);
    EXPECT_EQ(seen.last("entity")->at("streams"), Json::array({{{"name", "pose"}, {"kind", "pose"}}}));
    EXPECT_EQ(perform("info", {{"entity", "Cyton"}, {"no-streams", true}}), kDone);
    EXPECT_EQ(seen.last("entity")->at("streams"), Json::array());
}

TEST_F(Verbs, LsNumbersSharedNames) {
    EXPECT_EQ(perform("ls", Json::object()), kDone);
    const auto& list = seen.last("entities")->at("entities");
    EXPECT_EQ(list.at(0).at("call"), "Cyton");
    EXPECT_EQ(list.at(1).at("call"), "PeopleBot#1");
    EXPECT_EQ(perform("info", {{"entity", "PeopleBot"}}), kRefused);
    EXPECT_EQ(seen.last("error")->at("code"), "AMBIGUOUS_ENTITY");
    EXPECT_EQ(perform("info", {{"entity", "Cyton"}, {"service", "Driving"}}), kDone);
    EXPECT_EQ(seen.last("entity")->at("services").size(), 1U);
}

TEST(MailboxTest, DropsTheOldestThatMayBeDroppedAndCounts) {
    Mailbox mailbox;
    mailbox.post({{"n", -1}}, false);
    for (std::size_t i = 0; i < Mailbox::kLimit + 4; ++i) mailbox.post({{"n", i}}, true);
    EXPECT_EQ(mailbox.takeDropped(), 5U);
    EXPECT_EQ(mailbox.wait()->at("n"), -1);
    EXPECT_EQ(mailbox.wait()->at("n"), 5);
}

TEST(Completion, OffersWhatFitsTheWord) {
    const auto station = std::make_shared<FakeStation>();
    const Settings settings;
    const auto offered = [&](std::vector<std::string> words) {
        Recorded seen;
        words.insert(words.begin(), std::to_string(words.size() - 1));
        Session session{{{"words", words}}, seen, std::make_shared<Mailbox>(), nullptr, settings};
        session.perform = [&](const std::string& verb, const Json& args, Events& sink) {
            Session inner{args, sink, std::make_shared<Mailbox>(), station, settings};
            return findVerb(verb)->perform(inner);
        };
        EXPECT_EQ(findVerb("__complete")->perform(session), kDone);
        return seen.events.empty() ? std::string() : seen.events.back()["text"].get<std::string>();
    };
    EXPECT_EQ(offered({"axon", "re"}), "rearm\nrelease\nresume\nreset");
    EXPECT_EQ(offered({"axon", "run", "Peo"}), "PeopleBot#1\nPeopleBot#2");
    EXPECT_EQ(offered({"axon", "run", "Cyton", ""}), "Driving");
    station->samples = {{1, R"({"stream":"pose","pose":{"x":1.5}})"}};
    EXPECT_EQ(offered({"axon", "watch", "Cyton", "p"}), "pose");
    EXPECT_EQ(offered({"axon", "help", "global", "ch"}), "check");
    EXPECT_EQ(offered({"axon", "help", "chec"}), "checkout");
    EXPECT_EQ(offered({"axon", "run", "--wait", "3", "Cyton", "Driving", "Distance=1", ""}),
              "Range_Threshold=\nColours=");
    EXPECT_EQ(offered({"axon", "run", "Cyton", "Driving", "Colours", "=", "r"}), "red");
    EXPECT_EQ(offered({"axon", "run", "Cyton", "Driving", "range"}), "Range_Threshold=");
    EXPECT_EQ(offered({"axon", "upload", "Cyton", "Driving", ""}), "Map");
    EXPECT_EQ(offered({"axon", "upload", "Cyton", "Driving", "Map", "x"}), "__files__");
    EXPECT_EQ(offered({"axon", "stop", "Cyton", "--d"}), "--deadline");
    EXPECT_EQ(offered({"axon", "agent", "s"}), "status\nstop");
    EXPECT_EQ(offered({"axon", "wait", ""}), "");
    TaskReport task;
    task.id = "abcdef00-0000-4000-8000-00000000000a";
    task.entity = station->entities_[2].id;
    task.state = TaskState::Running;
    station->others = {{task, Seconds(1)}};
    EXPECT_EQ(offered({"axon", "wait", "ab"}), "abcdef00");
    EXPECT_EQ(offered({"axon", "cancel", "Cyton", ""}), "abcdef00");
    EXPECT_EQ(offered({"axon", "cancel", "PeopleBot#1", ""}), "");
    EXPECT_EQ(offered({"axon", "tasks", "--f"}), "--follow\n--for");
    EXPECT_EQ(offered({"axon", "checkout", "--wait", "Cy"}), "Cyton") << "--wait takes no word of its own";
    EXPECT_EQ(offered({"axon", "checkout", "Cyton", "--hand-over", ""}), "ask\nyield\nrefuse");
    EXPECT_EQ(offered({"axon", "handover", "Cyton", ""}), "accept\nrefuse");
    EXPECT_EQ(offered({"axon", "ls", "--password-file", ""}), "__files__");
    EXPECT_EQ(offered({"axon", "ls", "--no"}), "--no-direct");
    EXPECT_EQ(offered({"axon", "--no-direct", "agent", "s"}), "status\nstop")
        << "which takes no word of its own";
    EXPECT_EQ(offered({"axon", "nonsense", ""}), "");
}

TEST_F(Verbs, DoctorDoesNotSayThatAllIsWellWhileEveryServiceIsSwitchedOff) {
    const auto examine = [this] {
        seen.events.clear();
        Session session{Json::object(), seen, mailbox, nullptr, settings, false};
        session.connect = [this](const Settings&) -> Result<std::shared_ptr<Station>> {
            return std::shared_ptr<Station>(station);
        };
        findVerb("doctor")->perform(session);
        std::string said;
        for (const auto& event : seen.events)
            if (event.value("name", "") == "Cyton")
                said += event.value("level", "") + ": " + event.value("message", "") + '\n';
        return said;
    };
    EXPECT_THAT(examine(), HasSubstr("ok: IDLE, lists its 1 service in"));
    station->services_[0].active = false;
    EXPECT_THAT(examine(), HasSubstr("all of them are switched off by the robot's application\n"));
    EXPECT_THAT(examine(), HasSubstr("warn: "));
    station->services_[0].inactive_reason = "battery low";
    EXPECT_THAT(examine(),
                HasSubstr("all of them are switched off by the robot's application (battery low)\n"));
    station->services_.push_back(station->services_[0]);
    station->services_[1].name = "Turning";
    station->services_[1].inactive_reason = "no floor";
    EXPECT_THAT(examine(), HasSubstr("all of them are switched off by the robot's application: Driving "
                                     "(battery low), Turning (no floor)\n"));
    station->services_[1].active = true;
    EXPECT_THAT(examine(), HasSubstr("ok: "));
    EXPECT_THAT(examine(),
                HasSubstr("one of them is switched off by the robot's application: Driving (battery low)\n"));
    station->findings = {{"the saved value 5 of parameter \"Speed\" was dropped", "set it again"}};
    EXPECT_THAT(examine(), HasSubstr("warn: the saved value 5 of parameter \"Speed\" was dropped\n"));
}
