// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/process/logging.hpp"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <cstdlib>
#include <string>

namespace axon::transport {
namespace {

/// Standard error becomes a pipe that is full and that nobody reads.
void blockStderr() {
    int ends[2];
    if (pipe(ends) != 0) std::abort();
    fcntl(ends[1], F_SETFL, O_NONBLOCK);
    const std::string block(4096, 'x');
    while (write(ends[1], block.data(), block.size()) > 0) {
    }
    fcntl(ends[1], F_SETFL, 0);
    dup2(ends[1], STDERR_FILENO);
}

TEST(LogDeathTest, ABlockedStandardErrorHoldsUpNeitherWhoLogsNorTheExit) {
    EXPECT_EXIT(
        {
            blockStderr();
            alarm(30);  // a hang ends by SIGALRM, which is not the exit expected
            logToStderr("info");
            for (int line = 0; line < 20'000; ++line) spdlog::info("line {}", line);
            std::exit(0);
        },
        testing::ExitedWithCode(0), "");
}

TEST(LogDeathTest, WritesAllLinesBeforeTheExitAndNoControlCharacters) {
    EXPECT_EXIT(
        {
            logToStderr("info");
            spdlog::info("client eve\nforged line\x1b[2J joined");
            spdlog::info("the last line");
            std::exit(0);
        },
        testing::ExitedWithCode(0), "eve.x0aforged line.x1b.2J joined\n.*the last line\n");
}

TEST(Log, TakesEachLevelThatItNamesAndWarn) {
    for (const char* level : {"trace", "debug", "info", "warning", "warn", "error", "critical", "off"}) {
        EXPECT_TRUE(isLogLevel(level)) << level;
        const bool named = kLogLevels.find(level) != std::string_view::npos;
        EXPECT_TRUE(named) << level;
    }
    for (const char* level : {"", "loud", "Info", "err", "warnings"})
        EXPECT_FALSE(isLogLevel(level)) << level;
    EXPECT_EQ(spdlog::level::from_str("warn"), spdlog::level::from_str("warning"));
    EXPECT_NE(spdlog::level::from_str("warn"), spdlog::level::off);
}

TEST(Log, WritesControlCharactersAsNumbersAndLeavesTheRest) {
    EXPECT_EQ(withoutControls("Zo\xc3\xab\t\x7f"), "Zo\xc3\xab\\x09\\x7f");
}

}  // namespace
}  // namespace axon::transport
