// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/caretaker.hpp"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <poll.h>
#include <stdlib.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>

#include "cli/fake_station.hpp"
#include "cli/holding.hpp"
#include "common/descriptor.hpp"
#include "support/loopback.hpp"

using namespace axon;
using namespace axon::cli;
using std::chrono::minutes;
using std::chrono::seconds;
using testing::HasSubstr;
using testing::Not;

namespace {

/// A terminal, and the end that its user looks at.
struct Pty {
    Descriptor seen{::posix_openpt(O_RDWR | O_NOCTTY | O_CLOEXEC | O_NONBLOCK)};
    Descriptor kept;  // so that nobody's closing it hangs it up
    std::string path;

    Pty() {
        EXPECT_EQ(::grantpt(seen.get()), 0);
        EXPECT_EQ(::unlockpt(seen.get()), 0);
        char name[128] = "";
        EXPECT_EQ(::ptsname_r(seen.get(), name, sizeof name), 0);
        path = name;
        kept = Descriptor(::open(name, O_RDWR | O_NOCTTY | O_CLOEXEC));
    }
    std::string text() const {
        std::string all;
        char bytes[1024];
        pollfd watched{seen.get(), POLLIN, 0};
        while (::poll(&watched, 1, 0) > 0 && (watched.revents & POLLIN) != 0) {
            const auto count = ::read(seen.get(), bytes, sizeof bytes);
            if (count <= 0) break;
            all.append(bytes, static_cast<std::size_t>(count));
        }
        return all;
    }
};

/// A station that nobody has used for an hour, on a clock that is set.
struct Unused : testing::Test {
    FakeStation station;
    ManualClock clock;
    IdleWatch idle{clock.now()};
    Notifier notifier;
    Pty pty;
    std::vector<std::string> logged;
    std::string cyton = station.entities_[2].id;

    Unused() { notifier.aim({{"terminal", pty.path}}); }
    bool look(Duration later, bool used = false) {
        clock.advance(later);
        return giveBackUnused(
            station, idle, notifier, [this](const std::string& text) { logged.push_back(text); }, clock.now(),
            used);
    }
    /// Whether something is released within two hours.
    bool isReleased() {
        const auto before = station.held().size();
        for (int i = 0; i < 120; ++i) look(minutes(1));
        return station.held().size() < before;
    }
};

struct Told : testing::Test {
    Pty pty;
    std::shared_ptr<Notifier> notifier = std::make_shared<Notifier>();
    FakeStation station;
};

}  // namespace

TEST(Idle, WarnsOnceAndThenReleases) {
    ManualClock clock;
    IdleWatch idle(clock.now());
    idle.setLimit(Seconds(1200));
    clock.advance(seconds(899));
    EXPECT_EQ(idle.look(clock.now(), false), IdleWatch::Says::Nothing);
    clock.advance(seconds(1));
    EXPECT_EQ(idle.look(clock.now(), false), IdleWatch::Says::Warn) << "five minutes before";
    clock.advance(seconds(1));
    EXPECT_EQ(idle.look(clock.now(), false), IdleWatch::Says::Nothing);
    clock.advance(seconds(299));
    EXPECT_EQ(idle.look(clock.now(), false), IdleWatch::Says::Release);
    EXPECT_EQ(idle.look(clock.now(), false), IdleWatch::Says::Nothing) << "once";
}

TEST(Idle, BeginsAnewWithEachUse) {
    ManualClock clock;
    IdleWatch idle(clock.now());
    idle.setLimit(Seconds(100));
    EXPECT_EQ(idle.warning(), Seconds(50)) << "of a short limit half";
    clock.advance(seconds(60));
    EXPECT_EQ(idle.look(clock.now(), false), IdleWatch::Says::Warn);
    EXPECT_EQ(idle.look(clock.now(), true), IdleWatch::Says::Nothing);
    clock.advance(seconds(49));
    EXPECT_EQ(idle.look(clock.now(), false), IdleWatch::Says::Nothing);
    clock.advance(seconds(1));
    EXPECT_EQ(idle.look(clock.now(), false), IdleWatch::Says::Warn) << "it is warned of again";
}

TEST(Idle, WithoutALimitNothingEnds) {
    ManualClock clock;
    IdleWatch idle(clock.now());
    EXPECT_EQ(idle.limit(), Seconds(3600));
    idle.setLimit(Seconds(0));
    clock.advance(seconds(1'000'000));
    EXPECT_EQ(idle.look(clock.now(), false), IdleWatch::Says::Nothing);
}

TEST_F(Unused, WhatNobodyUsesIsWarnedOfReleasedAndItsUserLearnsWhy) {
    ASSERT_TRUE(station.checkOut({cyton}));
    EXPECT_FALSE(look(minutes(55)));
    EXPECT_THAT(pty.text(), HasSubstr("Cyton is checked out and not used: it is released in 5 min 00 s"));
    EXPECT_TRUE(look(minutes(5)));
    EXPECT_TRUE(station.held().empty());
    EXPECT_THAT(pty.text(), HasSubstr("Cyton was released: it was not used for 60 min 00 s"));
    const Settings settings;
    Recorded seen;
    Session next{Json::object(), seen, std::make_shared<Mailbox>(),
                 std::shared_ptr<Station>(&station, [](Station*) {}), settings};
    const auto found = findHeld(next, "Cyton");
    ASSERT_FALSE(found);
    EXPECT_EQ(found.refusal().code, RefusalCode::Expired);
    EXPECT_THAT(found.refusal().message, HasSubstr("released because nobody used it for 60 min"));
    for (const auto* verb : {"release", "tasks"}) {
        seen.events.clear();
        EXPECT_EQ(findVerb(verb)->perform(next), kDone);
        EXPECT_THAT(seen.last("notice")->at("message").get<std::string>(),
                    HasSubstr("the check-out of Cyton was lost: it was released because nobody used it"))
            << verb;
    }
}

TEST_F(Unused, WhatIsInUseIsNeverReleased) {
    ASSERT_TRUE(station.checkOut({cyton}));
    KeptTask task;
    for (const auto state : {TaskState::Running, TaskState::Paused}) {
        task.report.state = state;
        station.others = {task};
        EXPECT_FALSE(isReleased()) << static_cast<int>(state);
    }
    EXPECT_FALSE(look(minutes(120), true)) << "a verb is running";
    EXPECT_TRUE(logged.empty()) << logged.front();
    task.report.state = TaskState::Succeeded;
    station.others = {task};
    EXPECT_TRUE(isReleased()) << "a task that is over uses nothing";
}

TEST_F(Unused, ARunOfAGlobalServiceUsesItUntilItIsOver) {
    ASSERT_TRUE(station.checkOut({cyton}));
    station.run_script = {[](RunReport& run) { run.state = RunState::Running; }};
    ASSERT_TRUE(station.runGlobal({}, {{0, cyton}}, cyton, false, [](const RunReport&) {}));
    EXPECT_FALSE(isReleased());
    ASSERT_TRUE(station.controlRun("", TaskAction::Cancel));
    EXPECT_TRUE(isReleased());
}

TEST_F(Unused, OnlyWhatWasReleasedIsSaidToBeAndTheRestIsTriedAgainInAMinute) {
    const auto& first = station.entities_[0];
    ASSERT_TRUE(station.checkOut({first.id, cyton}));
    station.unreleasable_id = cyton;
    look(minutes(55));
    static_cast<void>(pty.text());
    EXPECT_TRUE(look(minutes(5)));
    const auto text = pty.text();
    EXPECT_THAT(text, HasSubstr("PeopleBot#1 was released"));
    EXPECT_THAT(text, Not(HasSubstr("Cyton")));
    EXPECT_THAT(logged, testing::Contains(HasSubstr("cannot release Cyton: the server has gone")));
    logged.clear();
    EXPECT_FALSE(look(seconds(59)));
    EXPECT_TRUE(logged.empty());
    EXPECT_FALSE(look(seconds(1)));
    EXPECT_THAT(logged, testing::ElementsAre(HasSubstr("cannot release Cyton")));
    EXPECT_EQ(pty.text(), "") << "nothing was released";
    station.unreleasable_id.clear();
    EXPECT_TRUE(look(minutes(1)));
    EXPECT_THAT(pty.text(), HasSubstr("Cyton was released"));
    EXPECT_TRUE(station.held().empty());
}

TEST_F(Unused, AUseEndsTheTriesOfARefusedRelease) {
    ASSERT_TRUE(station.checkOut({cyton}));
    station.unreleasable_id = cyton;
    look(minutes(60));
    station.unreleasable_id.clear();
    EXPECT_FALSE(look(seconds(30), true));
    EXPECT_FALSE(look(minutes(1)));
    EXPECT_EQ(station.held().size(), 1U);
}

TEST_F(Unused, WhereNothingIsHeldNothingIsSaid) {
    EXPECT_FALSE(isReleased());
    EXPECT_TRUE(logged.empty());
    ASSERT_TRUE(station.checkOut({cyton}));
    EXPECT_FALSE(look(minutes(54))) << "the time begins with the check-out";
    EXPECT_TRUE(logged.empty());
}

TEST(UntoldTest, IsKeptUntilItIsToldAndForADayAtMost) {
    ManualClock clock;
    Untold untold;
    EXPECT_FALSE(untold.any(clock.now()));
    untold.add(clock.now());
    EXPECT_TRUE(untold.any(clock.now()));
    untold.told();
    EXPECT_FALSE(untold.any(clock.now()));
    untold.add(clock.now());
    clock.advance(std::chrono::hours(24) - seconds(1));
    EXPECT_TRUE(untold.any(clock.now()));
    clock.advance(seconds(1));
    EXPECT_FALSE(untold.any(clock.now()));
}

TEST_F(Told, ATerminalOfAnotherUserIsNoPlaceToBeReached) {
    EXPECT_EQ(terminalOf(pty.kept.get(), ::getuid()), pty.path);
    EXPECT_EQ(terminalOf(pty.kept.get(), ::getuid() + 1), "") << "after su";
    const Descriptor file(::open("/dev/null", O_RDWR | O_CLOEXEC));
    EXPECT_EQ(terminalOf(file.get(), ::getuid()), "");
}

TEST_F(Told, ALineAndTheBellComeToTheTerminalAndNothingSteersIt) {
    notifier->tell("too early");
    notifier->aim({{"terminal", pty.path}});
    notifier->tell("eve\x1b[2J asks for PeopleBot");
    const auto text = pty.text();
    EXPECT_THAT(text, testing::StartsWith("\a\r"));
    EXPECT_THAT(text, HasSubstr("\naxon: eve?[2J asks for PeopleBot\r"));
    EXPECT_THAT(text, Not(HasSubstr("early")));
}

TEST_F(Told, NothingIsWrittenIntoAFileThatIsNoTerminal) {
    const auto file = std::filesystem::path(testing::TempDir()) / "axon-no-terminal";
    std::ofstream(file) << "mine";
    notifier->aim({{"terminal", file.string()}});
    notifier->tell("hello");
    EXPECT_EQ(std::filesystem::file_size(file), 4U);
    std::filesystem::remove(file);
    notifier->aim({{"terminal", "/no/such/terminal"}});
    notifier->tell("hello");
}

TEST_F(Told, TheDesktopIsToldByNotifySendWhereThereIsOne) {
    const auto folder = std::filesystem::path(testing::TempDir()) / "axon-notify";
    std::filesystem::remove_all(folder);
    std::filesystem::create_directories(folder);
    const auto program = folder / "notify-send";
    std::ofstream(program)
        << "#!/bin/sh\nfor last; do :; done\nprintf '%s\\n' \"$DISPLAY $last\" >\"$0.part\"\nmv "
           "\"$0.part\" \"$0.said\"\n";
    std::filesystem::permissions(program, std::filesystem::perms::owner_all);
    const std::string path = ::getenv("PATH");
    ASSERT_EQ(::setenv("PATH", (folder.string() + ":" + path).c_str(), 1), 0);
    notifier->aim({{"environment", {{"DISPLAY", ":7"}, {"LD_PRELOAD", "evil"}}}});
    notifier->tell("hello");
    EXPECT_TRUE(test::waitUntil([&] { return std::filesystem::exists(folder / "notify-send.said"); }));
    std::ifstream said(folder / "notify-send.said");
    EXPECT_EQ(std::string(std::istreambuf_iterator<char>(said), {}), ":7 hello\n");
    said.close();
    std::filesystem::remove(folder / "notify-send.said");
    // What another client wrote is shown as it is, and is no markup.
    notifier->tell(R"(eve asks: <b>now</b> <a href="x">&</a> \n\x1b)");
    EXPECT_TRUE(test::waitUntil([&] { return std::filesystem::exists(folder / "notify-send.said"); }));
    said.open(folder / "notify-send.said");
    EXPECT_EQ(std::string(std::istreambuf_iterator<char>(said), {}),
              ":7 eve asks: &lt;b&gt;now&lt;/b&gt; &lt;a href=\"x\"&gt;&amp;&lt;/a&gt; \\\\n\\\\x1b\n");
    ASSERT_EQ(::setenv("PATH", path.c_str(), 1), 0);
    std::filesystem::remove_all(folder);
}

TEST_F(Told, ARequestForWhatIsHeldIsToldWithItsAnswer) {
    RequestWatch requests(notifier);
    station.asks = "eve@lab";
    ASSERT_TRUE(station.checkOut({station.entities_[2].id}));
    requests.follow(station);
    EXPECT_EQ(pty.text(), "") << "nobody wants to be told";
    notifier->aim({{"terminal", pty.path}});
    requests.follow(station);
    const auto text = pty.text();
    EXPECT_THAT(
        text, HasSubstr("eve@lab asks for Cyton: a demonstration. Answer within 30.0 s: axon handover Cyton "
                        "accept, or refuse; no answer refuses"));
    EXPECT_THAT(text, Not(HasSubstr("PeopleBot"))) << "which is not held";
    requests.follow(station);
    EXPECT_EQ(pty.text(), "") << "it is listened to already";
}
