// SPDX-License-Identifier: GPL-2.0-or-later
// How soon a robot stands when a process freezes or dies while it moves: the robots' own programs as
// processes, judged by the laboratory's ground truth. AXON_FREEZES=N does N of each kind instead of one, and
// the figures are printed.
#include <arpa/inet.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <signal.h>
#include <sys/socket.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <cstdlib>
#include <nlohmann/json.hpp>
#include <thread>

#include "common/descriptor.hpp"
#include "lab/lab_server.hpp"
#include "robots/common/robot_settings.hpp"
#include "tests/support/loopback.hpp"
#include "tests/support/program.hpp"
#include "tests/support/robot_manager.hpp"

namespace axon::robots {
namespace {

using nlohmann::json;
using std::chrono::milliseconds;
using test::Program;
using test::waitUntil;

/// Ground truth, by the laboratory's control port.
class Truth {
  public:
    explicit Truth(const std::string& address) : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
        const auto colon = address.find(':');
        sockaddr_in to{};
        to.sin_family = AF_INET;
        to.sin_port = htons(static_cast<std::uint16_t>(std::stoi(address.substr(colon + 1))));
        ::inet_pton(AF_INET, address.substr(0, colon).c_str(), &to.sin_addr);
        if (::connect(socket_.get(), reinterpret_cast<sockaddr*>(&to), sizeof to) != 0) socket_.reset();
    }
    json ask(const json& request) const {
        const auto line = request.dump() + "\n";
        if (::send(socket_.get(), line.data(), line.size(), MSG_NOSIGNAL) < 0) return {};
        std::string answer;
        char byte = 0;
        while (::recv(socket_.get(), &byte, 1, 0) == 1 && byte != '\n') answer += byte;
        return json::parse(answer, nullptr, false);
    }
    json now() const { return ask({{"do", "truth"}}); }

  private:
    Descriptor socket_;
};

struct Robot {
    std::string kind;
    std::string program;
    std::string place;  // in the laboratory
    std::string link;   // the option with its address
    std::string service;
    std::vector<std::pair<std::string, double>> parameters;
    bool serial = false;  // on a line that tells the robot of no end, instead of a connection
};

const Robot kPeopleBot{"peoplebot", AXON_PEOPLEBOT, "PeopleBot",
                       "--robot",   "Driving",      {{"Distance", 5000}, {"Velocity", 300}}};
const Robot kCyton{"cyton", AXON_CYTON, "Cyton", "--arm", "Reach Demo", {{"Speed", 60}}};

Robot onALine(Robot robot) {
    robot.serial = true;
    return robot;
}

enum class Victim { Application, Guard, Manager };
struct Strike {
    Robot robot;
    Victim victim;
    bool freeze;  // else killed

    friend void PrintTo(const Strike& strike, std::ostream* out) { *out << strike.name(); }
    std::string name() const {
        static constexpr std::array kVictims{"Application", "Guard", "Manager"};
        return robot.kind + (robot.serial ? "OnALine" : "") + kVictims[static_cast<std::size_t>(victim)] +
               (freeze ? "Frozen" : "Killed");
    }
};

class FreezeTest : public ::testing::TestWithParam<Strike> {
  protected:
    struct Rest {
        double ms = 0;
        double way = 0;  // mm, or degrees of the joint that goes farthest
    };
    // As the trials of stops judge: below this the tall body rocks on its casters; half a degree of an arm.
    static constexpr double kRocking_m_s = 0.03;
    static constexpr double kJoint_deg = 0.5;
    static constexpr double kUnderWay_deg = 5;  // from where it stood
    static constexpr double kWatched_s = 1.2;

    void SetUp() override {
        lab::WorldDescription world;
        world.robots = {{.name = "PeopleBot", .x = 1.5, .y = 3}};
        world.devices = {{.kind = "cyton", .name = "Cyton", .x = 1, .y = 5.4, .z = 0}};
        lab_ = std::make_unique<lab::LabServer>(
            world, lab::LabServer::Options{
                       .listen = test::loopbackAddress(), .first_port = 0, .pty = GetParam().robot.serial});
        lab_thread_ = std::thread([this] { lab_->run(); });
        truth_ = std::make_unique<Truth>(lab_->address("control"));
    }
    void TearDown() override {
        truth_.reset();
        lab_->stop();
        lab_thread_.join();
    }
    bool isArm() const { return GetParam().robot.kind == "cyton"; }
    static double farthest(const json& a, const json& b) {
        double most = 0;
        for (std::size_t i = 0; i < a.size(); ++i)
            most = std::max(most, std::abs(a[i].get<double>() - b[i].get<double>()));
        return most;
    }
    bool moves(const json& truth) {
        if (!isArm()) return truth["robots"][0]["speed_m_s"].get<double>() > 0.295;
        const auto joints = truth["arms"][0]["joints_deg"];
        if (first_joints_.is_null()) first_joints_ = joints;
        return farthest(joints, first_joints_) > kUnderWay_deg;
    }
    void strike(test::RobotManager& manager, const Program& program) const {
        const int signal = GetParam().freeze ? SIGSTOP : SIGKILL;
        switch (GetParam().victim) {
            case Victim::Application:
                ASSERT_EQ(::kill(program.pid(), signal), 0);
                break;
            case Victim::Guard:
                ASSERT_GT(program.guard(), 0);
                ASSERT_EQ(::kill(program.guard(), signal), 0);
                break;
            case Victim::Manager:
                if (GetParam().freeze)
                    manager.freeze();
                else
                    manager.die();
        }
    }
    Rest judge(const json& before, const std::vector<json>& after) const {
        const auto& end = after.back();
        const double since = before["time_s"];
        Rest rest;
        for (const auto& now : after) {
            const bool moving =
                isArm() ? farthest(now["arms"][0]["joints_deg"], end["arms"][0]["joints_deg"]) > kJoint_deg
                        : std::abs(now["robots"][0]["speed_m_s"].get<double>()) > kRocking_m_s;
            if (moving) rest.ms = (now["time_s"].get<double>() - since) * 1000;
        }
        if (isArm()) {
            rest.way = farthest(before["arms"][0]["joints_deg"], end["arms"][0]["joints_deg"]);
        } else {
            const auto& a = before["robots"][0];
            const auto& b = end["robots"][0];
            rest.way = std::hypot(a["x_m"].get<double>() - b["x_m"].get<double>(),
                                  a["y_m"].get<double>() - b["y_m"].get<double>()) *
                       1000;
        }
        return rest;
    }
    void once(int round, Rest& rest) {
        const auto& robot = GetParam().robot;
        const auto application =
            robot.kind + "-freeze-" + std::to_string(::getpid()) + "-" + std::to_string(round);
        truth_->ask({{"do", "move"}, {"name", "PeopleBot"}, {"x", 1.5}, {"y", 3}, {"theta", 0}});
        std::vector<std::string> words{robot.program,   robot.link,   lab_->address(robot.place),
                                       "--application", application,  "--ports",
                                       ports_.path(),   "--profiles", "robots/" + robot.kind};
        if (!isArm()) words.insert(words.end(), {"--camera", ""});
        Program program(words);
        ASSERT_GT(program.pid(), 0);
        test::RobotManager manager(application, test::RobotManager::Watchdogs::Strict);
        ASSERT_TRUE(waitUntil([&] { return manager.active(robot.service); }, std::chrono::seconds{20}));
        first_joints_ = nullptr;
        manager.dispatch(robot.service, robot.parameters);
        ASSERT_TRUE(waitUntil([&] { return moves(truth_->now()); }, std::chrono::seconds{20}))
            << manager.lastWords();
        const auto before = truth_->now();
        strike(manager, program);
        std::vector<json> after;
        ASSERT_TRUE(waitUntil(
            [&] {
                after.push_back(truth_->now());
                return after.back()["time_s"].get<double>() > before["time_s"].get<double>() + kWatched_s;
            },
            std::chrono::seconds{20}));
        rest = judge(before, after);
    }

    const TemporaryFile ports_{"Axon.Ports = 5500-8000\nAxon.Address = " + test::loopbackAddress() + "\n"};
    std::unique_ptr<lab::LabServer> lab_;
    std::thread lab_thread_;
    std::unique_ptr<Truth> truth_;
    json first_joints_;
};

INSTANTIATE_TEST_SUITE_P(
    Each, FreezeTest, ::testing::ValuesIn([] {
        std::vector<Strike> strikes;
        for (const auto& robot : {kPeopleBot, kCyton, onALine(kPeopleBot), onALine(kCyton)})
            for (const auto victim : {Victim::Application, Victim::Guard, Victim::Manager})
                for (const bool freeze : {true, false}) strikes.push_back({robot, victim, freeze});
        return strikes;
    }()),
    [](const auto& strike) { return strike.param.name(); });

TEST_P(FreezeTest, TheRobotStandsWithinHalfASecond) {
    const char* many = std::getenv("AXON_FREEZES");
    const int rounds = many == nullptr ? 1 : std::max(1, std::atoi(many));
    std::vector<double> times, ways;
    for (int round = 0; round < rounds; ++round) {
        Rest rest;
        once(round, rest);
        if (HasFatalFailure()) return;
        EXPECT_LE(rest.ms, 500) << "and went on for " << rest.way << (isArm() ? " deg" : " mm");
        times.push_back(rest.ms);
        ways.push_back(rest.way);
    }
    std::sort(times.begin(), times.end());
    std::sort(ways.begin(), ways.end());
    std::printf("figures %s: n %d, to rest median %.0f max %.0f ms, way median %.1f max %.1f %s\n",
                GetParam().name().c_str(), rounds, times[times.size() / 2], times.back(),
                ways[ways.size() / 2], ways.back(), isArm() ? "deg" : "mm");
}

}  // namespace
}  // namespace axon::robots
