// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/desktop.hpp"

#include <gmock/gmock.h>
#include <pthread.h>
#include <stdlib.h>
#include <sys/stat.h>

#include <csignal>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>

#include "cli/fake_station.hpp"
#include "support/loopback.hpp"

using namespace axon;
using namespace axon::cli;
using std::chrono::milliseconds;
using testing::HasSubstr;
using testing::Not;

namespace {

namespace fs = std::filesystem;

/// Programs that stand in for those of a desktop, and an environment like that of an agent.
struct OnDesktop : testing::Test {
    fs::path folder;
    std::string path = ::getenv("PATH");

    OnDesktop() {
        std::string name = (fs::temp_directory_path() / "axon-desktop-XXXXXX").string();
        folder = ::mkdtemp(name.data());
        ::setenv("PATH", (folder.string() + ":" + path).c_str(), 1);
        ::setenv("DISPLAY", ":agent", 1);
        ::setenv("WAYLAND_DISPLAY", "wayland-agent", 1);
        ::setenv("AXON_PASSWORD", "secret", 1);
        ::setenv("XDG_RUNTIME_DIR", folder.c_str(), 1);
    }
    ~OnDesktop() override {
        ::setenv("PATH", path.c_str(), 1);
        for (const auto* name : {"DISPLAY", "WAYLAND_DISPLAY", "AXON_PASSWORD", "XDG_RUNTIME_DIR"})
            ::unsetenv(name);
        fs::remove_all(folder);
    }
    /// A shell script, whose `tell` becomes said().
    void program(const std::string& name, const std::string& script) const {
        fs::remove(folder / "said");
        const auto file = folder / name;
        std::ofstream(file) << "#!/bin/sh\ntell() { cat >'" << folder.string() << "/part'; mv '"
                            << folder.string() << "/part' '" << folder.string() << "/said'; }\n"
                            << script << '\n';
        fs::permissions(file, fs::perms::owner_all);
    }
    std::string said() const {
        EXPECT_TRUE(test::waitUntil([this] { return fs::exists(folder / "said"); }));
        std::ifstream in(folder / "said");
        return {std::istreambuf_iterator<char>(in), {}};
    }
};

}  // namespace

TEST_F(OnDesktop, AProgramSeesTheDesktopOfTheUserAndNoPassword) {
    program("probe", "env | tell");
    EXPECT_TRUE(Desktop::of({{"DISPLAY", ":7"}, {"LD_PRELOAD", "evil"}, {"XAUTHORITY", 7}}).start({"probe"}));
    const auto environment = said();
    EXPECT_THAT(environment, HasSubstr("DISPLAY=:7\n"));
    EXPECT_THAT(environment, Not(HasSubstr("agent"))) << "the desktop of this process is another one";
    EXPECT_THAT(environment, Not(HasSubstr("AXON_PASSWORD")));
    EXPECT_THAT(environment, Not(HasSubstr("evil")));
    EXPECT_FALSE(Desktop::here().start({"no-such-program"}));
}

TEST_F(OnDesktop, AProgramTakesSignalsAsIfItWereStartedByAShell) {
    sigset_t ours;
    sigset_t before;
    ::sigemptyset(&ours);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP}) ::sigaddset(&ours, signal);
    ::pthread_sigmask(SIG_BLOCK, &ours, &before);
    const auto pipe_before = ::signal(SIGPIPE, SIG_IGN);
    program("probe", "sed -n 's/^Sig\\(Blk\\|Ign\\):.*\\(........\\)$/\\2/p' /proc/self/status | tell");
    EXPECT_TRUE(Desktop::here().start({"probe"}));
    // The C library keeps the two signals above these for itself.
    std::istringstream masks(said());
    std::uint32_t blocked = ~0U;
    std::uint32_t ignored = ~0U;
    masks >> std::hex >> blocked >> ignored;
    EXPECT_EQ(blocked, 0U);
    EXPECT_EQ(ignored & 0x7FFFFFFFU, 0U);
    ::signal(SIGPIPE, pipe_before);
    ::pthread_sigmask(SIG_SETMASK, &before, nullptr);
}

TEST_F(OnDesktop, AFileIsShownIfXdgOpenSaysSo) {
    const auto desktop = Desktop::here();
    EXPECT_FALSE(Desktop::of({{"DBUS_SESSION_BUS_ADDRESS", "unix:"}}).open("page.html")) << "no screen";
    program("xdg-open", "exit 4");
    EXPECT_FALSE(desktop.open("page.html", milliseconds(60'000)));
    program("xdg-open", "echo noise; echo \"$1\" | tell");
    EXPECT_TRUE(desktop.open("page.html", milliseconds(60'000)));
    EXPECT_EQ(said(), "page.html\n");
    // A browser that runs until the test ends.
    ASSERT_EQ(::mkfifo((folder / "end").c_str(), 0600), 0);
    program("xdg-open", "echo runs | tell; read line <'" + (folder / "end").string() + "'");
    EXPECT_TRUE(desktop.open("page.html", milliseconds(1))) << "it has become the browser";
    EXPECT_EQ(said(), "runs\n");
    std::ofstream(folder / "end") << "end\n";
}

TEST_F(OnDesktop, AViewOpensWhereTheUserIsWhoTypedIt) {
    program("xdg-open", "echo \"$DISPLAY $WAYLAND_DISPLAY $AXON_PASSWORD\" | tell");
    ::setenv("DISPLAY", ":7", 1);
    ::unsetenv("WAYLAND_DISPLAY");
    Json args{{"entity", "Cyton"}, {"streams", {"camera"}}, {"view", true}, {"for", 0.01}};
    EXPECT_EQ(findVerb("watch")->prepare(args), "");
    // In the agent.
    ::setenv("DISPLAY", ":agent", 1);
    ::setenv("WAYLAND_DISPLAY", "wayland-agent", 1);
    Recorded seen;
    const Settings settings;
    const auto watch = [&] {
        const auto station = std::make_shared<FakeStation>();
        station->stream = "camera";
        station->samples = {
            {1,
             R"({"stream":"camera","image":{"width":2,"height":1,"encoding":"jpeg","pixels":"/9j/b2xk"}})"}};
        Session session{args, seen, std::make_shared<Mailbox>(), station, settings, true};
        EXPECT_EQ(findVerb("watch")->perform(session), kDone);
        return seen.last("viewing")->at("opened").get<bool>();
    };
    EXPECT_TRUE(watch());
    EXPECT_EQ(said(), ":7  \n");
    program("xdg-open", "exit 3");
    EXPECT_FALSE(watch()) << "it is not said to be shown";
    program("xdg-open", "exit 0");
    args.erase("desktop");
    EXPECT_FALSE(watch()) << "the agent's desktop is not the user's";
}
