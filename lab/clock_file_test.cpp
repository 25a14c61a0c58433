// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/clock_file.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <optional>
#include <sstream>

namespace axon::lab {
namespace {

using namespace std::chrono_literals;

class ClockFileTest : public ::testing::Test {
  protected:
    void TearDown() override { std::filesystem::remove(path_); }
    static TimePoint real() { return SteadyClock{}.now(); }
    std::string content() const {
        std::ostringstream text;
        text << std::ifstream(path_).rdbuf();
        return text.str();
    }

    const std::string path_ =
        (std::filesystem::temp_directory_path() / ("axon-lab-clock-" + std::to_string(::getpid()))).string();
};

TEST_F(ClockFileTest, ReadersSeeTheTimeAndThePaceThatAreTold) {
    ClockFile file(path_);
    const SharedClock clock(path_);
    const auto begin = clock.now();
    EXPECT_GT(begin, TimePoint{}) << "the first time is not that of \"never\"";
    file.tell(8ms, 4, real());
    EXPECT_EQ(clock.now() - begin, 8ms);
    EXPECT_EQ(clock.realTimeUntil(begin + 16ms), 2ms);
    file.tell(8ms, 0, real());
    EXPECT_EQ(clock.realTimeUntil(begin + 16ms), SharedClock::kLongestWait);
}

TEST_F(ClockFileTest, TheNextLaboratoryGoesOnWhereTheFormerOneLeftItsReaders) {
    std::optional<ClockFile> file(path_);
    const SharedClock clock(path_);
    const auto begin = clock.now();
    file->tell(10s, 4, real());
    file.reset();
    file.emplace(path_);
    EXPECT_EQ(clock.now() - begin, 10s);
    file->tell(1s, 4, real());
    EXPECT_EQ(clock.now() - begin, 11s);
}

TEST_F(ClockFileTest, ALaboratoryThatWasStoppedForLongGoesOnWhereItsReadersAre) {
    ClockFile file(path_);
    const SharedClock clock(path_);
    const auto begin = clock.now();
    const auto stopped = real();
    file.tell(1s, 4, stopped);
    file.tell(1s + 4ms, 4, stopped + SharedClockPage::kGoneAfter + 3s);
    EXPECT_EQ(clock.now() - begin, 4s + 4ms);
}

TEST_F(ClockFileTest, TwoLaboratoriesDoNotTellTheirTimeInOneFile) {
    const ClockFile file(path_);
    EXPECT_THROW(ClockFile second(path_), std::runtime_error);
}

TEST_F(ClockFileTest, AFileThatIsSomethingElseIsLeftAsItIs) {
    for (const auto& text : {std::string("my diary"), std::string("AXONCLK1") + std::string(8, '\0'),
                             std::string(sizeof(SharedClockPage), 'x')}) {
        std::ofstream(path_) << text;
        EXPECT_THROW(ClockFile file(path_), std::runtime_error);
        EXPECT_EQ(content(), text);
    }
    EXPECT_THROW(ClockFile file("/nowhere/clock"), std::system_error);
}

}  // namespace
}  // namespace axon::lab
