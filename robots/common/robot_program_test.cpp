// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/robot_program.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon::robots {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;

/// A robot's main function; what it prints is captured.
class RobotProgramTest : public ::testing::Test {
  protected:
    int run(std::vector<const char*> words, const std::function<void()>& start) {
        words.insert(words.begin(), "axon-blimp");
        RobotProgram program(settings_, "A blimp.", "axon-blimp --blimp 127.0.0.1:9000");
        program.option("--blimp", blimp_, "Its radio");
        ::testing::internal::CaptureStdout();
        ::testing::internal::CaptureStderr();
        const int status = program.run(static_cast<int>(words.size()), words.data(), start);
        out_ = ::testing::internal::GetCapturedStdout();
        err_ = ::testing::internal::GetCapturedStderr();
        return status;
    }

    RobotSettings settings_{"blimp"};
    std::string blimp_ = "127.0.0.1:9000";
    std::string out_;
    std::string err_;
};

TEST_F(RobotProgramTest, WhatAllRobotsHaveAndWhatThisOneHasAreReadBeforeItStarts) {
    bool started = false;
    EXPECT_EQ(run({"--blimp", "/dev/ttyS0", "--name", "Hindenburg", "--guard", "0", "--resources", "a", "b"},
                  [&] {
                      started = true;
                      EXPECT_EQ(blimp_, "/dev/ttyS0");
                      EXPECT_EQ(settings_.name, "Hindenburg");
                      EXPECT_EQ(settings_.application, "blimp");
                      EXPECT_EQ(settings_.guard_silence.count(), 0);
                      EXPECT_THAT(settings_.resources, ElementsAre("a", "b"));
                  }),
              0);
    EXPECT_TRUE(started);
}

TEST_F(RobotProgramTest, AWrongOptionIsStatusTwoAndStartsNothing) {
    for (const auto& wrong :
         {std::vector{"--gard", "1"}, {"--guard", "-1"}, {"--guard", "10001"}, {"--name"}})
        EXPECT_EQ(run(wrong, [] { FAIL() << "started"; }), 2) << wrong.front();
}

TEST_F(RobotProgramTest, WhatIsThrownAtTheStartIsPrintedAndStatusTwo) {
    EXPECT_EQ(run({}, [] { throw BadSetting("--at x: expected X,Y,Z"); }), 2);
    EXPECT_EQ(err_, "axon-blimp: --at x: expected X,Y,Z\n");
}

TEST_F(RobotProgramTest, TheHelpTellsDefaultsAndExamples) {
    EXPECT_EQ(run({"--help"}, [] { FAIL() << "started"; }), 0);
    EXPECT_THAT(out_, HasSubstr("--blimp TEXT=127.0.0.1:9000"));
    EXPECT_THAT(out_, HasSubstr("--application TEXT=blimp"));
    EXPECT_THAT(out_, HasSubstr("axon-blimp --blimp 127.0.0.1:9000\nAn Entity Manager"));
}

}  // namespace
}  // namespace axon::robots
