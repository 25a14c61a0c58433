// SPDX-License-Identifier: GPL-2.0-or-later
// The guard of a device and the process that it watches, as real processes that are frozen and killed. The
// device is the other end of a socket, or of a pseudo-terminal.
#include <fcntl.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <pty.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <axon/device_guard.hpp>
#include <optional>
#include <string>

#include "common/clock.hpp"
#include "common/descriptor.hpp"
#include "support/loopback.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;
using test::waitUntil;

constexpr auto kSilence = 200ms;
const std::string kStop = "STOP\r";

/// What a test tells the application that it has started: one letter each, answered by one byte.
enum class Order : char {
    Release = 'r',
    Close = 'c',   // the device's connection, then the guard's object
    Beat = 'b',    // '1' or '0', as the last beat() said
    Watch = 'w',   // again, the same descriptor: '1' or '0'
    Stopped = 's'  // '1' or '0'
};

class DeviceGuardTest : public ::testing::Test {
  protected:
    void SetUp() override { ::signal(SIGPIPE, SIG_IGN); }
    void TearDown() override {
        if (application_ > 0) {
            ::kill(application_, SIGKILL);
            ::waitpid(application_, nullptr, 0);
        }
    }
    /// An application that beats, and obeys the test. `ours` is the device's end.
    void start(Descriptor ours, Descriptor its, int errors = STDERR_FILENO) {
        device_ = std::move(ours);
        ::fcntl(device_.get(), F_SETFL, O_NONBLOCK);
        std::array<int, 2> ends{};
        ASSERT_EQ(::socketpair(AF_UNIX, SOCK_SEQPACKET, 0, ends.data()), 0);
        talk_ = Descriptor(ends[0]);
        Descriptor other(ends[1]);
        application_ = ::fork();
        if (application_ == 0) {
            device_.reset();
            talk_.reset();
            ::dup2(errors, STDERR_FILENO);
            serve(other.get(), its.get());
        }
        other.reset();
        ASSERT_EQ(::recv(talk_.get(), &guard_, sizeof guard_, 0), static_cast<ssize_t>(sizeof guard_));
        ASSERT_GT(guard_, 0);
    }
    void start() {
        std::array<int, 2> ends{};
        ASSERT_EQ(::socketpair(AF_UNIX, SOCK_STREAM, 0, ends.data()), 0);
        start(Descriptor(ends[0]), Descriptor(ends[1]));
    }
    [[noreturn]] static void serve(int talk, int device) {
        {
            DeviceGuard guard({.device = "the test's device",
                               .stop = kStop,
                               .silence = kSilence,
                               .logger = [](const std::string&) {}});
            bool good = guard.watch(device);
            int pid = good ? guard.pid() : 0;
            ::send(talk, &pid, sizeof pid, 0);
            pollfd wait{talk, POLLIN, 0};
            while (true) {
                ::poll(&wait, 1, 20);
                good = guard.beat();
                char order = 0;
                if ((wait.revents & POLLIN) == 0) continue;
                if (::recv(talk, &order, 1, 0) != 1) ::_exit(1);
                char answer = '1';
                switch (static_cast<Order>(order)) {
                    case Order::Release:
                        guard.release();
                        break;
                    case Order::Beat:
                        answer = good ? '1' : '0';
                        break;
                    case Order::Watch:
                        answer = guard.watch(device) ? '1' : '0';
                        break;
                    case Order::Stopped:
                        answer = guard.stopped() ? '1' : '0';
                        break;
                    case Order::Close:
                        break;
                }
                ::send(talk, &answer, 1, 0);
                if (static_cast<Order>(order) == Order::Close) break;
            }
            guard.release();
        }
        ::_exit(0);
    }
    bool ask(Order order) {
        const char letter = static_cast<char>(order);
        char answer = 0;
        return ::send(talk_.get(), &letter, 1, 0) == 1 && ::recv(talk_.get(), &answer, 1, 0) == 1 &&
               answer == '1';
    }
    /// What has come at the device since it was asked last.
    std::string heard() {
        std::array<char, 512> bytes{};
        std::string all;
        while (true) {
            const auto got = ::read(device_.get(), bytes.data(), bytes.size());
            if (got <= 0) {
                closed_ = closed_ || got == 0 || (errno != EAGAIN && errno != EINTR);
                return all;
            }
            all.append(bytes.data(), static_cast<std::size_t>(got));
        }
    }
    /// How long until the stop arrives at the device.
    std::optional<Duration> stopped() {
        const SteadyClock clock{};
        const auto begin = clock.now();
        std::string all;
        if (!waitUntil([&] { return (all += heard()).find(kStop) != std::string::npos; }))
            return std::nullopt;
        return clock.now() - begin;
    }
    void strike(int pid, int signal) const { ASSERT_EQ(::kill(pid, signal), 0); }

    int application_ = 0;
    int guard_ = 0;
    Descriptor device_, talk_;
    bool closed_ = false;
};

TEST_F(DeviceGuardTest, AnApplicationThatBeatsIsLeftAlone) {
    start();
    const SteadyClock clock{};
    const auto end = clock.now() + 5 * kSilence;
    bool good = true;
    EXPECT_TRUE(waitUntil([&] {
        good = good && ask(Order::Beat);
        return !good || clock.now() >= end;
    }));
    EXPECT_TRUE(good);
    EXPECT_EQ(heard(), "");
    EXPECT_FALSE(ask(Order::Stopped));
}

TEST_F(DeviceGuardTest, AKilledApplicationsDeviceIsStoppedAtOnce) {
    start();
    strike(application_, SIGKILL);
    const auto time = stopped();
    ASSERT_TRUE(time);
    EXPECT_LT(*time, kSilence);  // nobody waited for silence
    EXPECT_TRUE(waitUntil([&] { return heard(), closed_; })) << "the guard ends with its application";
}

TEST_F(DeviceGuardTest, AFrozenApplicationsDeviceIsStoppedAndItsConnectionShutBeforeItWakesUp) {
    start();
    strike(application_, SIGSTOP);
    const auto time = stopped();
    ASSERT_TRUE(time);
    EXPECT_GE(*time, kSilence - 40ms);
    EXPECT_LT(*time, kSilence + 150ms);
    EXPECT_TRUE(waitUntil([&] { return heard(), closed_; }));
    strike(application_, SIGCONT);
    EXPECT_TRUE(ask(Order::Stopped));
    EXPECT_FALSE(ask(Order::Beat));
}

TEST_F(DeviceGuardTest, TheNextConnectionIsGuardedAgain) {
    start();
    strike(application_, SIGSTOP);
    ASSERT_TRUE(stopped());
    strike(application_, SIGCONT);
    EXPECT_TRUE(ask(Order::Watch));
    EXPECT_FALSE(ask(Order::Stopped));
    EXPECT_TRUE(ask(Order::Beat));
}

TEST_F(DeviceGuardTest, ASerialLineIsToldAgainAndAgainForItCannotBeShut) {
    int master = -1;
    int slave = -1;
    termios raw{};
    ::cfmakeraw(&raw);
    ASSERT_EQ(::openpty(&master, &slave, nullptr, &raw, nullptr), 0);
    start(Descriptor(master), Descriptor(slave));
    strike(application_, SIGSTOP);
    std::string all;
    EXPECT_TRUE(waitUntil([&] { return (all += heard()).size() >= 10 * kStop.size(); }));
    EXPECT_EQ(all.substr(0, kStop.size()), kStop);
    strike(application_, SIGCONT);
    EXPECT_TRUE(ask(Order::Stopped));
    EXPECT_TRUE(ask(Order::Release));
    heard();
    EXPECT_TRUE(ask(Order::Watch));
    EXPECT_TRUE(ask(Order::Beat));
}

TEST_F(DeviceGuardTest, WhatIsReleasedIsNotStoppedHoweverTheApplicationEnds) {
    start();
    ASSERT_TRUE(ask(Order::Release));
    strike(application_, SIGKILL);
    EXPECT_TRUE(waitUntil([&] {
        EXPECT_EQ(heard(), "");
        return closed_;
    }));
}

TEST_F(DeviceGuardTest, AGuardThatIsFrozenKeepsNoReleasedConnectionOpen) {
    start();
    strike(guard_, SIGSTOP);
    ASSERT_TRUE(ask(Order::Release));
    strike(application_, SIGKILL);
    EXPECT_TRUE(waitUntil([&] {
        EXPECT_EQ(heard(), "");
        return closed_;
    })) << "the frozen guard still has it";
}

TEST_F(DeviceGuardTest, AGuardThatAnswersIsKeptForTheNextConnection) {
    start();
    ASSERT_TRUE(ask(Order::Release));
    ASSERT_TRUE(ask(Order::Watch));
    EXPECT_TRUE(ask(Order::Beat));
    EXPECT_EQ(::kill(guard_, 0), 0);
}

TEST_F(DeviceGuardTest, AnApplicationThatEndsInOrderEndsItsGuardToo) {
    start();
    ASSERT_TRUE(ask(Order::Close));
    int status = -1;
    ASSERT_EQ(::waitpid(std::exchange(application_, 0), &status, 0) > 0, true);
    EXPECT_EQ(status, 0);
    EXPECT_EQ(heard(), "");
    EXPECT_EQ(::kill(guard_, 0), -1);
}

TEST_F(DeviceGuardTest, AGuardThatIsKilledIsNoticedAndReplaced) {
    start();
    strike(guard_, SIGKILL);
    EXPECT_TRUE(waitUntil([&] { return !ask(Order::Beat); }));
    EXPECT_TRUE(ask(Order::Watch));
    EXPECT_TRUE(ask(Order::Beat));
    strike(application_, SIGKILL);
    EXPECT_TRUE(stopped()) << "by the new one";
}

TEST_F(DeviceGuardTest, AGuardThatIsFrozenIsNoticedAndReplaced) {
    start();
    strike(guard_, SIGSTOP);
    EXPECT_TRUE(waitUntil([&] { return !ask(Order::Beat); }));
    EXPECT_TRUE(ask(Order::Watch));
    EXPECT_NE(::kill(guard_, 0), 0) << "the frozen one stops nothing once it goes on";
    strike(application_, SIGSTOP);
    EXPECT_TRUE(stopped());
}

TEST_F(DeviceGuardTest, AFullPipeBehindStandardErrorHoldsNoStopUp) {
    std::array<int, 2> pipe{};
    ASSERT_EQ(::pipe2(pipe.data(), O_CLOEXEC), 0);
    const Descriptor unread(pipe[0]), full(pipe[1]);
    ::fcntl(full.get(), F_SETFL, O_NONBLOCK);
    while (::write(full.get(), "................................", 32) > 0) continue;
    ::fcntl(full.get(), F_SETFL, 0);  // as a terminal's, whoever writes there waits
    std::array<int, 2> ends{};
    ASSERT_EQ(::socketpair(AF_UNIX, SOCK_STREAM, 0, ends.data()), 0);
    start(Descriptor(ends[0]), Descriptor(ends[1]), full.get());
    strike(application_, SIGSTOP);
    std::string all;
    EXPECT_TRUE(waitUntil([&] { return (all += heard()).size() >= 3 * kStop.size(); })) << "it repeats it";
    EXPECT_TRUE(waitUntil([&] { return heard().empty() && closed_; })) << "and shuts the connection";
}

TEST(DeviceGuard, WhoeverBeatsIsToldOfALostGuardBeforeTheLogIs) {
    std::atomic<int> lines{0};
    std::array<int, 2> ends{};
    ASSERT_EQ(::socketpair(AF_UNIX, SOCK_STREAM, 0, ends.data()), 0);
    const Descriptor ours(ends[0]), its(ends[1]);
    DeviceGuard guard({.device = "the test's device",
                       .stop = "stop",
                       .silence = std::chrono::milliseconds{200},
                       .logger = [&](const std::string&) { ++lines; }});
    ASSERT_TRUE(guard.watch(its.get()));
    ASSERT_EQ(::kill(guard.pid(), SIGKILL), 0);
    ASSERT_TRUE(waitUntil([&] { return !guard.beat(); }));
    EXPECT_EQ(lines, 0) << "a log that blocks does not keep the device from being stopped";
    guard.release();
    EXPECT_EQ(lines, 1);
    EXPECT_FALSE(guard.watch(-1)) << "no descriptor";
}

TEST_F(DeviceGuardTest, SignalsOfATerminalDoNotReachTheGuard) {
    start();
    for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGQUIT, SIGTSTP}) strike(guard_, signal);
    EXPECT_TRUE(ask(Order::Beat));
    strike(application_, SIGKILL);
    EXPECT_TRUE(stopped());
}

TEST(DeviceGuard, OptionsThatCannotBeAreNamedWithTheRemedy) {
    const auto refused = [](DeviceGuard::Options options) {
        try {
            const DeviceGuard guard(std::move(options));
            return std::string();
        } catch (const std::invalid_argument& error) {
            return std::string(error.what());
        }
    };
    EXPECT_NE(refused({}).find("expected 1 to 1024"), std::string::npos);
    EXPECT_NE(refused({.device = "d", .stop = std::string(1025, 's')}).find("1025 bytes"), std::string::npos);
    EXPECT_NE(refused({.device = "d", .stop = "s", .silence = 10ms}).find("expected 50 to 10000 ms"),
              std::string::npos);
}

}  // namespace
}  // namespace axon
