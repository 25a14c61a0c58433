// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/project.hpp"

#include <gmock/gmock.h>
#include <sys/wait.h>

#include <csignal>
#include <cstdlib>
#include <fstream>
#include <iterator>

#include "cli/fake_station.hpp"

using namespace axon;
using namespace axon::cli;
using testing::Contains;
using testing::HasSubstr;
using testing::Not;

namespace {

namespace fs = std::filesystem;

struct Project : testing::Test {
    fs::path folder = fs::path(testing::TempDir()) / "axon-project";
    Recorded seen;

    Project() { fs::remove_all(folder); }
    ~Project() override { fs::remove_all(folder); }

    int init(const std::string& kind, const std::string& name, const fs::path& into) {
        const Settings settings;
        Session session{{{"kind", kind}, {"name", name}, {"folder", into.string()}},
                        seen,
                        std::make_shared<Mailbox>(),
                        nullptr,
                        settings};
        return findVerb("init")->perform(session);
    }
    /// Stands in for a program that the script of a robot uses.
    void program(const fs::path& file, const std::string& script) const {
        fs::create_directories((folder / file).parent_path());
        std::ofstream(folder / file) << "#!/bin/sh\n" << script << '\n';
        fs::permissions(folder / file, fs::perms::owner_all);
    }
    /// The exit status of the script.
    int run() const {
        const auto in = folder.string();
        const int status = std::system(  // NOLINT: the words are the test's own
            ("cd '" + in + "' && PATH='" + in + "/bin':\"$PATH\" ./run >output 2>&1").c_str());
        return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
    }
    static std::string read(const fs::path& file) {
        std::ifstream in(file, std::ios::binary);
        return {std::istreambuf_iterator<char>(in), {}};
    }
};

}  // namespace

TEST_F(Project, HasItsNameEverywhereAndNothingLeftToFillIn) {
    for (const auto* kind : {"robot", "client"}) {
        const auto files = projectOf(kind, "Rover_2");
        ASSERT_TRUE(files);
        EXPECT_GE(files->size(), 6U);
        for (const auto& file : files.value()) {
            EXPECT_THAT(file.text, Not(HasSubstr("@NAME"))) << file.path;
            EXPECT_THAT(file.text, Not(HasSubstr("@TARGET"))) << file.path;
        }
    }
    const auto robot = projectOf("robot", "Rover_2");
    const auto named = [&](const std::string& path) {
        for (const auto& file : robot.value())
            if (file.path == path) return file.text;
        return std::string();
    };
    EXPECT_THAT(named("basic.xml"), HasSubstr("name=\"Rover_2\""));
    EXPECT_THAT(named("robot.hpp"), HasSubstr(".application = \"Rover_2\""));
    EXPECT_THAT(named("robot_test.cpp"), HasSubstr(".application = \"Rover_2\""));
    EXPECT_THAT(named("run"), HasSubstr("--application Rover_2 "));
    EXPECT_THAT(named("CMakeLists.txt"), HasSubstr("add_executable(rover_2-robot main.cpp)"));
}

TEST_F(Project, IsWrittenWithAScriptThatCanBeRun) {
    EXPECT_EQ(init("robot", "Rover", folder / "new" / "Rover"), kDone);
    EXPECT_NE(fs::status(folder / "new/Rover/run").permissions() & fs::perms::owner_exec, fs::perms::none);
    EXPECT_THAT(read(folder / "new" / "Rover" / "basic.xml"), HasSubstr("\"Rover\""));
    const auto* made = seen.last("project");
    ASSERT_NE(made, nullptr);
    EXPECT_THAT(made->at("files"), Contains("services.xml"));
    EXPECT_EQ(made->at("next").at(1), "./run");
}

TEST_F(Project, ItsScriptConfiguresAgainAfterAConfigureThatFailed) {
    ASSERT_EQ(init("robot", "Rover", folder), kDone);
    program("bin/axon-entity-manager", "exit 7");
    program("bin/cmake", "echo \"$1\" >>calls; mkdir -p build; test \"$1\" != -S");
    EXPECT_EQ(run(), 1) << "Axon is not found";
    program("bin/cmake", "echo \"$1\" >>calls");
    program("build/rover-robot", "exit 0");
    EXPECT_EQ(run(), 7) << read(folder / "output");
    EXPECT_EQ(read(folder / "calls"), "-S\n-S\n--build\n");
}

TEST_F(Project, ItsScriptLeavesNoProgramRunningHoweverEarlyItIsEnded) {
    ASSERT_EQ(init("robot", "Rover", folder), kDone);
    program("bin/cmake", "exit 0");
    program("bin/axon-entity-manager", "exec sleep 600");
    program("build/rover-robot", "echo $$ >id; kill -TERM $PPID; exec sleep 600");
    EXPECT_EQ(run(), 143) << read(folder / "output");
    pid_t robot = 0;
    std::ifstream(folder / "id") >> robot;
    ASSERT_GT(robot, 0);
    EXPECT_NE(::kill(robot, SIGKILL), 0) << "it was running";
    const auto script = read(folder / "run");
    EXPECT_LT(script.find("trap 'exit 130' INT"), script.find("build/rover-robot . &"));
    EXPECT_LT(script.find("application= manager="), script.find("trap '"));
}

TEST_F(Project, OverwritesNothing) {
    fs::create_directories(folder);
    EXPECT_EQ(init("client", "tour", folder), kDone) << "an empty folder has nothing to lose";
    std::ofstream(folder / "main.cpp") << "mine";
    EXPECT_EQ(init("client", "tour", folder), kUsage);
    EXPECT_EQ(read(folder / "main.cpp"), "mine");
    EXPECT_THAT(seen.last("error")->at("message").get<std::string>(), HasSubstr("not an empty folder"));
    EXPECT_EQ(init("client", "tour", folder / "main.cpp"), kUsage);
    EXPECT_EQ(read(folder / "main.cpp"), "mine");
}

TEST_F(Project, TakesNoNameThatWouldNotWork) {
    for (const auto* name : {"", "2nd", "-x", "../up", "two words", "a/b", "x\"y", "Zürich", "$(x)",
                             "a123456789b123456789c123456789d1234567890"}) {
        EXPECT_EQ(init("robot", name, folder / "x"), kUsage) << name;
        EXPECT_FALSE(fs::exists(folder / "x")) << name;
    }
    EXPECT_TRUE(projectOf("robot", "a123456789b123456789c123456789d123456789"));
}

TEST_F(Project, ItsProgramIsNoWordOfCMake) {
    EXPECT_EQ(programOf("robot", "Test"), "test-robot");
    EXPECT_EQ(programOf("client", "MyClient"), "myclient");
}
