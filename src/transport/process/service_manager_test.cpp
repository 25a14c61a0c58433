// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/process/service_manager.hpp"

#include <gtest/gtest.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <csignal>
#include <cstddef>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <string>

#include "common/descriptor.hpp"

namespace axon::transport {
namespace {

using namespace std::chrono_literals;

/// What listens as systemd does.
class ServiceManager {
  public:
    explicit ServiceManager(const std::string& name) {
        sockaddr_un address{};
        address.sun_family = AF_UNIX;
        name.copy(address.sun_path, sizeof address.sun_path - 1);
        if (name.front() == '@') address.sun_path[0] = '\0';
        const auto size = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + name.size());
        EXPECT_EQ(::bind(socket_.get(), reinterpret_cast<const sockaddr*>(&address), size), 0);
        ::setenv("NOTIFY_SOCKET", name.c_str(), 1);
    }
    ~ServiceManager() { ::unsetenv("NOTIFY_SOCKET"); }
    ServiceManager(const ServiceManager&) = delete;
    ServiceManager& operator=(const ServiceManager&) = delete;

    std::string told() const {
        std::array<char, 64> text{};
        const auto size = ::recv(socket_.get(), text.data(), text.size(), MSG_DONTWAIT);
        return size < 0 ? "nothing" : std::string(text.data(), static_cast<std::size_t>(size));
    }

  private:
    Descriptor socket_{::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0)};
};

TEST(ServiceManager, IsToldOverASocketInTheFileSystem) {
    auto folder = (std::filesystem::temp_directory_path() / "axon-notify-XXXXXX").string();
    ASSERT_NE(::mkdtemp(folder.data()), nullptr);
    {
        const ServiceManager manager(folder + "/notify");
        EXPECT_EQ(manager.told(), "nothing");
        tellServiceManagerReady();
        EXPECT_EQ(manager.told(), "READY=1");
    }
    std::filesystem::remove_all(folder);
}

TEST(ServiceManager, IsToldOverAnAbstractSocket) {
    const ServiceManager manager("@axon-notify-" + std::to_string(::getpid()));
    tellServiceManagerReady();
    EXPECT_EQ(manager.told(), "READY=1");
}

TEST(ServiceManager, ThatCannotBeReachedEndsNothing) {
    ::setenv("NOTIFY_SOCKET", "/nowhere/axon/notify", 1);
    tellServiceManagerReady();
    ::setenv("NOTIFY_SOCKET", std::string(200, 'x').c_str(), 1);
    tellServiceManagerReady();
    ::unsetenv("NOTIFY_SOCKET");
    tellServiceManagerReady();
}

/// The variables of a watchdog for one test; null: not set.
class WatchdogVariables {
  public:
    WatchdogVariables(const char* microseconds, const char* process) {
        set("WATCHDOG_USEC", microseconds);
        set("WATCHDOG_PID", process);
    }
    ~WatchdogVariables() {
        set("WATCHDOG_USEC", nullptr);
        set("WATCHDOG_PID", nullptr);
    }
    WatchdogVariables(const WatchdogVariables&) = delete;
    WatchdogVariables& operator=(const WatchdogVariables&) = delete;

  private:
    static void set(const char* name, const char* value) {
        value == nullptr ? ::unsetenv(name) : ::setenv(name, value, 1);
    }
};

const std::string kThisProcess = std::to_string(::getpid());
const std::string kAbstract = "@axon-watchdog-" + kThisProcess;

TEST(ServiceWatchdog, OfTheEnvironmentTellsTheServiceManagerAtEachThirdOfThePeriod) {
    const ServiceManager manager(kAbstract);
    for (const char* process : {static_cast<const char*>(nullptr), kThisProcess.c_str()}) {
        const WatchdogVariables variables("30000000", process);
        const auto clock = std::make_shared<ManualClock>();
        const auto watchdog = ServiceWatchdog::fromEnvironment(clock);
        ASSERT_NE(watchdog, nullptr);
        const auto turned = watchdog->worker();
        EXPECT_EQ(manager.told(), "nothing");
        EXPECT_EQ(turned(), 10s);
        EXPECT_EQ(manager.told(), "WATCHDOG=1");
        clock->advance(9s);
        EXPECT_EQ(turned(), 1s);
        EXPECT_EQ(manager.told(), "nothing");
        clock->advance(1s);
        EXPECT_EQ(turned(), 10s);
        EXPECT_EQ(manager.told(), "WATCHDOG=1");
    }
}

TEST(ServiceWatchdog, IsOfNobodyWhoIsNotWatched) {
    const ServiceManager manager(kAbstract);
    {
        const WatchdogVariables variables(nullptr, nullptr);
        EXPECT_EQ(ServiceWatchdog::fromEnvironment(), nullptr);
    }
    const WatchdogVariables of_the_parent("30000000", std::to_string(::getppid()).c_str());
    EXPECT_EQ(ServiceWatchdog::fromEnvironment(), nullptr);
}

TEST(ServiceWatchdog, IsNotFedByVariablesThatMakeNoSense) {
    const ServiceManager manager(kAbstract);
    for (const char* microseconds : {"0", "-30000000", "29999", "30s", " 30000000", "30000000x", "1e9",
                                     "31536000000001", "99999999999999999999999"}) {
        const WatchdogVariables variables(microseconds, kThisProcess.c_str());
        EXPECT_EQ(ServiceWatchdog::fromEnvironment(), nullptr) << microseconds;
    }
    for (const char* process : {"0", "-1", "me", "99999999999999999999999"}) {
        const WatchdogVariables variables("30000000", process);
        EXPECT_EQ(ServiceWatchdog::fromEnvironment(), nullptr) << process;
    }
    const WatchdogVariables variables("30000", kThisProcess.c_str());
    EXPECT_NE(ServiceWatchdog::fromEnvironment(), nullptr);
    ::unsetenv("NOTIFY_SOCKET");
    EXPECT_EQ(ServiceWatchdog::fromEnvironment(), nullptr) << "nobody to tell";
}

TEST(ServiceWatchdogDeathTest, OfTheKernelEndsAProcessThatStandsStill) {
    EXPECT_EXIT(
        {
            const auto watchdog = ServiceWatchdog::ofTheKernel(50ms);
            watchdog->worker()();
            ::pause();
        },
        testing::KilledBySignal(SIGABRT), "");
}

TEST(ServiceWatchdogDeathTest, OfTheKernelLeavesAProcessAloneThatGoesOnOrHasNotBegun) {
    constexpr auto kPeriod = 600ms;
    EXPECT_EXIT(
        {
            const SteadyClock clock;
            const auto not_begun = ServiceWatchdog::ofTheKernel(1ms);
            auto goes_on = ServiceWatchdog::ofTheKernel(kPeriod);
            const auto turned = goes_on->worker();
            for (const auto begin = clock.now(); clock.now() - begin < 2 * kPeriod;) turned();
            goes_on.reset();  // and with it its timer
            std::exit(0);
        },
        testing::ExitedWithCode(0), "");
}

TEST(ServiceWatchdog, WhoseServiceManagerDoesNotReadNeitherBlocksNorEnds) {
    const ServiceManager manager(kAbstract);
    const WatchdogVariables variables("3000000", nullptr);
    const auto clock = std::make_shared<ManualClock>();
    const auto watchdog = ServiceWatchdog::fromEnvironment(clock);
    ASSERT_NE(watchdog, nullptr);
    const auto turned = watchdog->worker();
    for (int i = 0; i < 10000; ++i) clock->advance(turned());  // the socket's queue is full long before
    EXPECT_EQ(clock->now(), TimePoint{11000s});
    int told = 0;
    while (manager.told() == "WATCHDOG=1") ++told;
    EXPECT_GT(told, 0);
    EXPECT_LT(told, 10000);
    turned();
    EXPECT_EQ(manager.told(), "WATCHDOG=1") << "it is told again";
}

struct Workers : ::testing::Test {
    int told = 0;
    std::shared_ptr<ManualClock> clock = std::make_shared<ManualClock>();
    ServiceWatchdog watchdog{3s, [this] { ++told; }, clock};
    TimePoint start = clock->now();
};

TEST_F(Workers, OfWhichOneStandsStillAreNotBelieved) {
    const auto one = watchdog.worker();
    const auto other = watchdog.worker();
    EXPECT_EQ(one(), 1s);
    EXPECT_EQ(told, 0);
    other();
    EXPECT_EQ(told, 1);
    // The other one is stuck from here on.
    while (clock->now() < start + 60s) {
        clock->advance(5ms);
        one();
    }
    EXPECT_EQ(told, 1);
    other();
    EXPECT_EQ(told, 2);
}

TEST_F(Workers, WhoCallWhenTheyAreToldToKeepItFed) {
    const auto one = watchdog.worker();
    const auto other = watchdog.worker();
    auto first = start;
    auto second = start + 7ms;
    auto last = start;
    while (last < start + 60s) {
        const auto before = told;
        const auto now = std::min(first, second);
        clock->set(now);
        (now == first ? first : second) = now + (now == first ? one : other)();
        ASSERT_LE(now - last, 2s) << "of a period of 3 s";
        if (told > before) last = now;
    }
}

}  // namespace
}  // namespace axon::transport
