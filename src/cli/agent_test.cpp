// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/agent.hpp"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <poll.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>

#include "cli/fake_station.hpp"
#include "cli/invoker.hpp"
#include "cli/words.hpp"
#include "support/loopback.hpp"

using namespace axon;
using namespace axon::cli;
using std::chrono::milliseconds;
using testing::HasSubstr;

namespace {

/// An agent on a thread, and the other end of a connection to it.
struct Served : testing::Test {
    std::shared_ptr<FakeStation> station = std::make_shared<FakeStation>();
    std::optional<AgentLink> link;
    Descriptor raw;
    std::unique_ptr<Agent> agent;
    std::thread serving;
    std::atomic<bool> ended{false};
    Settings settings;

    void serve(milliseconds linger, bool raw_end = false) {
        int ends[2];
        ASSERT_EQ(::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends), 0);
        if (raw_end) {
            raw = Descriptor(ends[0]);
        } else {
            link.emplace(Descriptor(ends[0]));
        }
        agent = std::make_unique<Agent>(
            Descriptor(),
            [this](const Agent::Work& work) -> std::optional<int> {
                if (work.verb == "elsewhere") return std::nullopt;
                Session session{work.args, work.events, work.mailbox, station, settings, true};
                return findVerb(work.verb)->perform(session);
            },
            [this] { return !station->held().empty(); }, linger);
        agent->adopt(Descriptor(ends[1]));
        serving = std::thread([this] {
            agent->serve();
            ended = true;
        });
    }
    void TearDown() override {
        if (agent) agent->stop();
        if (serving.joinable()) serving.join();
    }
    std::string received() {
        std::string text;
        char bytes[4096];
        while (true) {
            const auto count = ::recv(raw.get(), bytes, sizeof bytes, 0);
            if (count <= 0) return text;
            text.append(bytes, static_cast<std::size_t>(count));
        }
    }
};

const Json kRunCyton{{"entity", "Cyton"}, {"service", "Driving"}, {"parameters", {"Distance=1"}}};

}  // namespace

TEST_F(Served, GivesEventsAndTheExitStatusBack) {
    serve(milliseconds(60'000));
    Recorded seen;
    const auto outcome = link->request("stop", {{"entity", {"Cyton"}}}, seen, milliseconds(10'000));
    EXPECT_EQ(outcome.ending, AgentLink::Ending::Done);
    EXPECT_EQ(outcome.exit, kDone);
    ASSERT_EQ(seen.events.size(), 1U);
    EXPECT_EQ(seen.events[0]["receipts"][0]["name"], "Cyton");
}

TEST_F(Served, AnEventIsNoEndWhateverItsMembersAreCalled) {
    serve(milliseconds(60'000));
    Recorded seen;
    const auto outcome = link->request("drill", {{"entity", {"Cyton"}}, {"count", 2}, {"every", 0.0}}, seen,
                                       milliseconds(10'000));
    EXPECT_EQ(outcome.ending, AgentLink::Ending::Done);
    ASSERT_EQ(seen.events.size(), 3U);
    EXPECT_EQ(seen.events[0]["done"], 1) << "how many tries are done, not the end of the answer";
    EXPECT_EQ(seen.events[2]["event"], "drill");
}

TEST_F(Served, SaysWhenAVerbIsNotForIt) {
    serve(milliseconds(60'000));
    Recorded seen;
    EXPECT_EQ(link->request("elsewhere", Json::object(), seen, milliseconds(10'000)).ending,
              AgentLink::Ending::Elsewhere);
}

TEST_F(Served, AnInterruptCancelsTheTaskAndShowsItsEnd) {
    station->script = {{TaskState::Running, 0.1, "", {}, {}}};
    serve(milliseconds(60'000));
    ASSERT_TRUE(station->checkOut({station->entities_[2].id}));
    struct : Events {
        void emit(const Json& event) override {
            last = event;
            if (event["event"] == "task" && event["state"] == "RUNNING") link->interrupt();
        }
        AgentLink* link = nullptr;
        Json last;
    } seen;
    seen.link = &*link;
    const auto outcome = link->request("run", kRunCyton, seen, milliseconds(10'000));
    EXPECT_EQ(outcome.exit, kInterrupted);
    EXPECT_EQ(seen.last["state"], "CANCELLED");
}

TEST_F(Served, ABrokenConnectionCancelsTheTaskThatItFollowed) {
    station->script = {{TaskState::Running, 0.1, "", {}, {}}};
    serve(milliseconds(60'000), true);
    ASSERT_TRUE(station->checkOut({station->entities_[2].id}));
    ASSERT_TRUE(sendLine(raw.get(), {{"verb", "run"}, {"args", kRunCyton}}));
    ASSERT_TRUE(axon::test::waitUntil([&] { return !station->tasks().list.empty(); }));
    raw = Descriptor();
    EXPECT_TRUE(axon::test::waitUntil(
        [&] { return station->tasks().list.front().report.state == TaskState::Cancelled; }));
    EXPECT_EQ(station->held().size(), 1U);
}

TEST_F(Served, EndsWhenAReleaseLeavesNothingHeld) {
    serve(milliseconds(60'000));
    ASSERT_TRUE(station->checkOut({station->entities_[2].id}));
    Recorded seen;
    EXPECT_EQ(link->request("release", Json::object(), seen, milliseconds(10'000)).exit, kDone);
    EXPECT_TRUE(axon::test::waitUntil([this] { return ended.load(); }));
}

TEST_F(Served, EndsByItselfWhenNothingIsHeldForAWhile) {
    serve(milliseconds(0));
    link.reset();
    EXPECT_TRUE(axon::test::waitUntil([this] { return ended.load(); }));
}

TEST_F(Served, StaysAsLongAsSomethingIsHeld) {
    serve(milliseconds(0));
    ASSERT_TRUE(station->checkOut({station->entities_[2].id}));
    link.reset();
    EXPECT_FALSE(axon::test::waitUntil([this] { return ended.load(); }, milliseconds(50)));
}

TEST_F(Served, CutsOffWhoSendsNoJson) {
    serve(milliseconds(60'000), true);
    ASSERT_EQ(::send(raw.get(), "GET / HTTP/1.0\n", 15, 0), 15);
    EXPECT_THAT(received(), HasSubstr("expects one request"));
}

TEST_F(Served, CutsOffWhoSendsALineWithoutEnd) {
    serve(milliseconds(60'000), true);
    const std::string much(kLongestLine, 'x');
    std::size_t sent = 0;
    while (sent < 2 * kLongestLine) {
        const auto count = ::send(raw.get(), much.data(), much.size(), MSG_NOSIGNAL);
        if (count <= 0) break;
        sent += static_cast<std::size_t>(count);
    }
    EXPECT_EQ(received(), "");
}

TEST_F(Served, RefusesArgumentsOfAnotherForm) {
    serve(milliseconds(60'000), true);
    ASSERT_TRUE(sendLine(raw.get(), {{"verb", "run"}, {"args", {{"entity", 5}}}}));
    const auto text = received();
    EXPECT_THAT(text, HasSubstr("arguments do not have the expected form"));
    EXPECT_THAT(text, HasSubstr("\"exit\":2"));
}

TEST(AgentLinkTest, DoesNotWaitForAnAgentThatDoesNotAnswer) {
    int ends[2];
    ASSERT_EQ(::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends), 0);
    const Descriptor silent(ends[1]);
    AgentLink link{Descriptor(ends[0])};
    Recorded seen;
    EXPECT_EQ(link.request("stop", Json::object(), seen, milliseconds(20)).ending,
              AgentLink::Ending::NoAnswer);
}

TEST(AgentLinkTest, TellsThatTheAgentWentAwayInTheMiddle) {
    int ends[2];
    ASSERT_EQ(::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends), 0);
    AgentLink link{Descriptor(ends[0])};
    {
        const Descriptor other(ends[1]);
        sendLine(other.get(), {{"accepted", true}});
        ::shutdown(other.get(), SHUT_WR);
        Recorded seen;
        EXPECT_EQ(link.request("run", Json::object(), seen, milliseconds(10'000)).ending,
                  AgentLink::Ending::Broken);
    }
}

/// A runtime directory of its own for each test, as XDG_RUNTIME_DIR names it.
struct Place : testing::Test {
    std::filesystem::path base;
    void SetUp() override {
        std::string pattern = (std::filesystem::temp_directory_path() / "axon-cli-XXXXXX").string();
        ASSERT_NE(::mkdtemp(pattern.data()), nullptr);
        base = pattern;
        ::setenv("XDG_RUNTIME_DIR", pattern.c_str(), 1);
        ::unsetenv("AXON_AGENT");
    }
    void TearDown() override {
        std::filesystem::remove_all(base);
        ::unsetenv("XDG_RUNTIME_DIR");
    }
};

TEST_F(Place, IsPrivate) {
    const auto place = agentPlace("127.0.0.1:10410");
    ASSERT_TRUE(place);
    struct stat found {};
    ASSERT_EQ(::stat(place->directory.c_str(), &found), 0);
    EXPECT_EQ(found.st_mode & 0777U, 0700U);
    const auto listening = listenAt(place->socket);
    ASSERT_TRUE(listening);
    ASSERT_EQ(::stat(place->socket.c_str(), &found), 0);
    EXPECT_EQ(found.st_mode & 0777U, 0600U);
    EXPECT_TRUE(AgentLink::open(place->socket));
}

TEST_F(Place, IsRefusedWhenOthersMayEnter) {
    std::filesystem::create_directory(base / "axon");
    ::chmod((base / "axon").c_str(), 0755);
    const auto place = agentPlace("127.0.0.1:10410");
    ASSERT_FALSE(place);
    EXPECT_THAT(place.refusal().message, HasSubstr("chmod 700"));
}

TEST_F(Place, IsRefusedWhenItIsALinkElsewhere) {
    std::filesystem::create_directory(base / "elsewhere");
    ::chmod((base / "elsewhere").c_str(), 0700);
    std::filesystem::create_directory_symlink(base / "elsewhere", base / "axon");
    EXPECT_FALSE(agentPlace("127.0.0.1:10410"));
}

TEST_F(Place, DiffersByServerAndFitsASocketsName) {
    EXPECT_NE(agentPlace("a:1")->socket, agentPlace("a:2")->socket);
    EXPECT_LT(agentPlace(std::string(300, 'h') + ":1")->socket.string().size(), 108U);
}

struct Invoked : Place {
    std::shared_ptr<FakeStation> station = std::make_shared<FakeStation>();
    Settings settings;
    Recorded seen;
    Invoker invoker{settings, [this](const Settings&) { return Result<std::shared_ptr<Station>>(station); }};
};

TEST_F(Invoked, VerbsAboutWhatIsKeptSayThatNothingIs) {
    EXPECT_EQ(invoker.perform(*findVerb("tasks"), Json::object(), seen), kDone);
    EXPECT_EQ(seen.last("notice")->at("message"), "nothing is checked out here");
    EXPECT_EQ(invoker.perform(*findVerb("cancel"), {{"entity", "Cyton"}}, seen), kRefused);
    EXPECT_EQ(seen.last("error")->at("fix"), "check it out first: axon checkout Cyton");
    EXPECT_EQ(invoker.perform(*findVerb("wait"), {{"task", {"3f2a"}}}, seen), kRefused)
        << "its end is not known";
    EXPECT_EQ(seen.last("error")->at("code"), "UNKNOWN_TASK");
    EXPECT_EQ(invoker.perform(*findVerb("wait"), Json::object(), seen), kDone);
    EXPECT_EQ(invoker.perform(*findVerb("agent"), {{"action", "status"}}, seen), kDone);
    EXPECT_EQ(seen.last("agent")->at("running"), false);
}

TEST_F(Invoked, NoServerHasAnExitStatusAndAFixOfItsOwn) {
    Invoker away(settings, [](const Settings&) {
        return Result<std::shared_ptr<Station>>(
            Refusal{RefusalCode::Unavailable, "nobody listens there", {}});
    });
    EXPECT_EQ(away.perform(*findVerb("ls"), Json::object(), seen), kNoServer);
    EXPECT_THAT(seen.last("error")->at("fix").get<std::string>(), HasSubstr("axon-server"));
}

TEST_F(Invoked, ACommandHoldsWhileItRunsAndGivesItsExitStatus) {
    const auto script = "test -S \"$AXON_AGENT\" && test \"$(stat -c %a \"$AXON_AGENT\")\" = 600 && exit 7";
    EXPECT_EQ(invoker.holdWhile({{"entity", {"Cyton"}}}, {"sh", "-c", script}, seen), 7);
    EXPECT_EQ(station->journalNow(), (std::vector<std::string>{"checkOut", "release"}));
    ::unsetenv("AXON_AGENT");
    EXPECT_EQ(invoker.holdWhile({{"entity", {"Cyton"}}}, {"/no/such/command"}, seen), 127);
    ::unsetenv("AXON_AGENT");
    EXPECT_EQ(invoker.holdWhile({{"entity", {"Cyton"}}}, {"sh", "-c", "kill -TERM $$"}, seen), 128 + SIGTERM);
    ::unsetenv("AXON_AGENT");
    EXPECT_TRUE(station->held().empty());
    EXPECT_TRUE(std::filesystem::is_empty(base / "axon"));
}

TEST_F(Invoked, NotifyIsForAnAgentAndNotForACommand) {
    const Json args{{"entity", {"Cyton"}}, {"notify", {{"terminal", "/dev/pts/0"}}}};
    EXPECT_EQ(invoker.holdWhile(args, {"touch", (base / "ran").string()}, seen), kUsage);
    EXPECT_THAT(seen.last("error")->at("message").get<std::string>(), HasSubstr("--notify is for the agent"));
    // And inside such a command, whose agent tells nobody.
    Session inside{args, seen, std::make_shared<Mailbox>(), station, settings, true};
    EXPECT_EQ(findVerb("checkout")->perform(inside), kUsage);
    EXPECT_TRUE(station->journalNow().empty()) << "nothing was checked out";
    EXPECT_FALSE(std::filesystem::exists(base / "ran"));
}

TEST_F(Invoked, NotifySaysWhenNothingCanBeReached) {
    int told = 0;
    for (const auto* verb : {"checkout", "agent"}) {
        Session session{{{"entity", {"Cyton"}}, {"notify", Json::object()}},
                        seen,
                        std::make_shared<Mailbox>(),
                        station,
                        settings,
                        true};
        session.notify = [&](const Json&) { ++told; };
        session.set_idle = [](double) {};
        EXPECT_EQ(findVerb(verb)->perform(session), kUsage) << verb;
        EXPECT_THAT(seen.last("error")->at("message").get<std::string>(), HasSubstr("no way to tell you"));
    }
    EXPECT_EQ(told, 0);
    EXPECT_TRUE(station->held().empty());
}

TEST_F(Invoked, AnAgentServesAtItsPlaceAndReleasesWhenItEnds) {
    ASSERT_TRUE(station->checkOut({station->entities_[2].id}));
    int ends[2];
    ASSERT_EQ(::pipe2(ends, O_CLOEXEC), 0);
    const Descriptor ready(ends[0]);
    std::thread serving([&] { EXPECT_EQ(invoker.serveAgent(ends[1]), kDone); });
    char said[64] = "";
    ASSERT_GT(::read(ready.get(), said, sizeof said - 1), 0);
    EXPECT_STREQ(said, "{\"ready\":true}\n");
    ASSERT_EQ(::read(ready.get(), said, sizeof said - 1), 0) << "the end of the pipe is given up";
    EXPECT_NE(::fcntl(ends[1], F_GETFD), -1) << "its number is not free for a socket";

    Invoker other(settings, [](const Settings&) {
        return Result<std::shared_ptr<Station>>(
            Refusal{RefusalCode::Unavailable, "nobody listens there", {}});
    });
    EXPECT_EQ(other.perform(*findVerb("ls"), Json::object(), seen), kDone);
    EXPECT_EQ(other.perform(*findVerb("agent"), {{"action", "status"}}, seen), kDone);
    EXPECT_EQ(seen.last("agent")->at("held").at(0).at("call"), "Cyton");
    // What it does not hold is not its business, and neither is a second one.
    EXPECT_EQ(
        other.perform(*findVerb("set"),
                      {{"entity", "PeopleBot"}, {"service", "Driving"}, {"parameters", Json::array()}}, seen),
        kRefused);
    EXPECT_EQ(seen.last("error")->at("code"), "AMBIGUOUS_ENTITY");
    // Without its server it does not keep a stop from finding another way.
    station->is_connected = false;
    EXPECT_EQ(other.perform(*findVerb("stop"), Json::object(), seen), kNoServer);
    EXPECT_THAT(seen.last("error")->at("fix").get<std::string>(), HasSubstr("NOTHING WAS STOPPED"));

    invoker.interrupt(SIGTERM);
    serving.join();
    EXPECT_TRUE(station->held().empty());
    EXPECT_FALSE(std::filesystem::exists(agentPlace(settings.server)->socket));
}

TEST_F(Invoked, AnAgentTakesThePlaceOfOneThatIsAboutToEnd) {
    std::filesystem::create_directories(agentPlace(settings.server)->lock.parent_path());
    // It has given its socket up, and is still releasing what it held.
    auto ending = std::make_unique<Descriptor>(
        ::open(agentPlace(settings.server)->lock.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600));
    ASSERT_EQ(::flock(ending->get(), LOCK_EX | LOCK_NB), 0);
    int ends[2];
    ASSERT_EQ(::pipe2(ends, O_CLOEXEC), 0);
    const Descriptor ready(ends[0]);
    std::thread serving([&] { EXPECT_EQ(invoker.serveAgent(ends[1]), kDone); });
    pollfd watched{ready.get(), POLLIN, 0};
    EXPECT_EQ(::poll(&watched, 1, 150), 0) << "one agent at a time";
    ending.reset();
    char said[256] = "";
    ASSERT_GT(::read(ready.get(), said, sizeof said - 1), 0);
    EXPECT_STREQ(said, "{\"ready\":true}\n");
    invoker.interrupt(SIGTERM);
    serving.join();
}

TEST_F(Invoked, AnInterruptDuringTheCheckOutRunsNoCommand) {
    station->on_check_out = [this] { invoker.interrupt(SIGINT); };
    EXPECT_EQ(invoker.holdWhile({{"entity", {"Cyton"}}}, {"touch", (base / "ran").string()}, seen),
              kInterrupted);
    EXPECT_FALSE(std::filesystem::exists(base / "ran"));
    EXPECT_TRUE(station->held().empty());
}

TEST_F(Invoked, TheAgentAroundIsNotAskedForAnotherServer) {
    ::setenv("AXON_AGENT", (base / "gone.sock").c_str(), 1);
    ::setenv("AXON_AGENT_SERVER", "lab.example.org:10410", 1);
    EXPECT_EQ(invoker.perform(*findVerb("stop"), Json::object(), seen), kDone);
    EXPECT_EQ(seen.last("receipts")->at("receipts").size(), 3U) << "by a connection of its own";
    // At the same server the one around is meant, and must be there.
    ::setenv("AXON_AGENT_SERVER", settings.server.c_str(), 1);
    EXPECT_EQ(invoker.perform(*findVerb("checkout"), {{"entity", {"Cyton"}}}, seen), kUsage);
    ::unsetenv("AXON_AGENT");
    ::unsetenv("AXON_AGENT_SERVER");
}

TEST_F(Invoked, OnlyAStopOfEverythingDoesNotWaitForTheEntities) {
    bool awaited = false;
    Invoker asked(settings, [&](const Settings& with) {
        awaited = with.await_entities;
        return Result<std::shared_ptr<Station>>(station);
    });
    EXPECT_EQ(asked.perform(*findVerb("stop"), {{"entity", {"Cyton"}}}, seen), kDone);
    EXPECT_TRUE(awaited);
    EXPECT_EQ(asked.perform(*findVerb("stop"), Json::object(), seen), kDone);
    EXPECT_FALSE(awaited);
}

TEST_F(Invoked, ARefusedCheckOutRunsNoCommand) {
    station->check_out_refusal = {RefusalCode::AlreadyHeld, "held", "cl2@lab"};
    EXPECT_EQ(invoker.holdWhile({{"entity", {"Cyton"}}}, {"touch", (base / "ran").string()}, seen), kRefused);
    EXPECT_FALSE(std::filesystem::exists(base / "ran"));
}
