// SPDX-License-Identifier: GPL-2.0-or-later
// The whole application between its two neighbours, over real sockets: the Entity Manager's end of the link
// on one side, the virtual controller on the other.
#include "robots/cyton/application.hpp"

#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <cmath>
#include <functional>
#include <map>
#include <thread>

#include "common/descriptor.hpp"
#include "lab/cyton/ssc32_server.hpp"
#include "robots/ssc32/protocol.hpp"
#include "tests/support/loopback.hpp"
#include "tests/support/program.hpp"
#include "tests/support/robot_manager.hpp"

namespace axon::cyton {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using test::waitUntil;
using ::testing::HasSubstr;

/// The virtual controller on a TCP port, in real time.
class Board {
  public:
    /// Just switched on: it tells no pulses before it has been given one. The arm stands upright.
    static constexpr bool kSwitchedOn = true;

    explicit Board(int port = 0, bool switched_on = false) {
        if (switched_on) {
            for (std::size_t i = 0; i < kJoints; ++i) {
                const auto line =
                    "#" + std::to_string(i) + "P" + std::to_string(std::lround(pulseOf(kChain[i], 0))) + "\r";
                for (const char byte : line) receive(static_cast<std::uint8_t>(byte));
            }
            board_.step(seconds{10});
            silent_about_pulses_ = true;
        }
        const int one = 1;
        ::setsockopt(listener_.get(), SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
        sockaddr_in address{};
        address.sin_family = AF_INET;
        address.sin_port = htons(static_cast<std::uint16_t>(port));
        ::inet_pton(AF_INET, test::loopbackAddress().c_str(), &address.sin_addr);
        socklen_t size = sizeof address;
        if (::bind(listener_.get(), reinterpret_cast<sockaddr*>(&address), size) != 0 ||
            ::listen(listener_.get(), 4) != 0)
            throw std::runtime_error("cannot listen");
        ::getsockname(listener_.get(), reinterpret_cast<sockaddr*>(&address), &size);
        port_ = ntohs(address.sin_port);
        thread_ = std::thread([this] { run(); });
    }
    ~Board() {
        quit_ = true;
        thread_.join();
    }
    int port() const { return port_; }
    /// rad, and metres that each claw is open.
    std::array<double, kChannels> targets() {
        const std::lock_guard lock(mutex_);
        return board_.targets();
    }
    /// For so long no servo was told anything else.
    Duration restsSince() {
        const std::lock_guard lock(mutex_);
        return std::chrono::steady_clock::now() - changed_;
    }
    std::uint64_t moves() {
        const std::lock_guard lock(mutex_);
        return board_.counters().moves;
    }
    std::uint64_t refusedLines() {
        const std::lock_guard lock(mutex_);
        return board_.counters().refused_lines;
    }
    /// Answers no more, but keeps the connection.
    void fallSilent() { silent_ = true; }

  private:
    std::vector<std::uint8_t> receive(std::uint8_t byte) {
        const auto moves = board_.counters().moves;
        auto answers = board_.receive({&byte, 1});
        silent_about_pulses_ = silent_about_pulses_ && board_.counters().moves == moves;
        const bool end = byte == '\r';
        if (end && silent_about_pulses_ && line_.starts_with("QP"))
            std::fill(answers.begin(), answers.end(), std::uint8_t{0});
        if (end || byte == ssc32::kEscape)
            line_.clear();
        else
            line_ += static_cast<char>(byte);
        return answers;
    }
    void run() {
        auto last = std::chrono::steady_clock::now();
        while (!quit_) {
            std::array<pollfd, 2> waiting{pollfd{listener_.get(), POLLIN, 0},
                                          pollfd{client_.get(), POLLIN, 0}};
            ::poll(waiting.data(), client_.open() ? 2 : 1, 2);
            const auto now = std::chrono::steady_clock::now();
            {
                const std::lock_guard lock(mutex_);
                const auto before = board_.targets();
                board_.step(now - last);
                if (board_.targets() != before) changed_ = now;
            }
            last = now;
            if (!client_.open() && waiting[0].revents != 0) {
                client_ = Descriptor(::accept(listener_.get(), nullptr, nullptr));
                const std::lock_guard lock(mutex_);
                board_.clientConnected();
                continue;
            }
            if (!client_.open()) continue;
            std::array<std::uint8_t, 1024> chunk;
            const auto got = ::recv(client_.get(), chunk.data(), chunk.size(), MSG_DONTWAIT);
            if (got == 0) client_.reset();
            if (got <= 0) continue;
            std::vector<std::uint8_t> answers;
            {
                const std::lock_guard lock(mutex_);
                for (const auto byte : std::span(chunk).first(static_cast<std::size_t>(got))) {
                    const auto more = receive(byte);
                    answers.insert(answers.end(), more.begin(), more.end());
                }
            }
            if (!answers.empty() && !silent_)
                ::send(client_.get(), answers.data(), answers.size(), MSG_NOSIGNAL);
        }
    }

    const Descriptor listener_{::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)};
    Descriptor client_;
    int port_ = 0;
    std::mutex mutex_;
    lab::Ssc32Server board_;  // these four guarded by mutex_
    TimePoint changed_{};
    std::string line_;
    bool silent_about_pulses_ = false;
    std::atomic<bool> quit_ = false;
    std::atomic<bool> silent_ = false;
    std::thread thread_;
};

class CytonApplication : public ::testing::Test {
  protected:
    void SetUp() override {
        board_ = std::make_unique<Board>();
        Settings settings;
        settings.guard_silence = std::chrono::seconds{2};  // this machine may stand still for a while
        settings.arm = test::loopbackAddress() + ":" + std::to_string(board_->port());
        settings.application = "cyton-test-" + std::to_string(::getpid());
        settings.ports = ports_.path();
        settings.profiles = "robots/cyton";
        application_ = std::make_unique<Application>(settings);
        application_->start();
        manager_ = std::make_unique<test::RobotManager>(settings.application);
        ASSERT_TRUE(
            waitUntil([&] { return manager_->active("Control") && manager_->active("Grab and Place"); }));
    }
    void TearDown() override {
        application_.reset();
        manager_.reset();
        board_.reset();
    }

    double joint_deg(std::size_t joint) { return degrees(board_->targets()[joint]); }
    double farthestFromHome() {
        double farthest = 0;
        const auto now = board_->targets();
        for (std::size_t i = 0; i < kJoints; ++i) farthest = std::max(farthest, std::abs(now[i] - kHome[i]));
        return farthest;
    }
    bool stands() { return board_->restsSince() > milliseconds{100}; }
    bool standsWithin(Duration time) {
        return waitUntil([&] { return stands(); }, std::chrono::duration_cast<milliseconds>(time));
    }
    /// The arm to where it moves for seconds.
    std::string longMove() { return manager_->dispatch("Control", {{"Shoulder Roll", -90}, {"Speed", 20}}); }
    void waitUntilMoving() {
        ASSERT_TRUE(waitUntil([&] { return joint_deg(0) < degrees(kHome[0]) - 3; }));
    }
    void expectEnd(const std::string& task, proto::TaskState state, seconds limit = seconds{15}) {
        ASSERT_TRUE(waitUntil([&] { return manager_->end(task).has_value(); }, limit));
        EXPECT_EQ(manager_->end(task)->state(), state) << manager_->end(task)->reason().message();
    }

    const robots::TemporaryFile ports_{"Axon.Ports = 5500-8000\nAxon.Address = " + test::loopbackAddress() +
                                       "\n"};
    std::unique_ptr<Board> board_;
    std::unique_ptr<test::RobotManager> manager_;
    std::unique_ptr<Application> application_;
};

TEST_F(CytonApplication, ConnectingMovesNothing) {
    EXPECT_EQ(board_->moves(), 0U);
    EXPECT_LT(farthestFromHome(), 0.02);
}

TEST_F(CytonApplication, ControlTakesTheGivenJointsThereAndLeavesTheOthers) {
    const auto task = manager_->dispatch(
        "Control", {{"Shoulder Pitch", 20}, {"Wrist Yaw", -30}, {"Gripper", 10}, {"Speed", 180}});
    expectEnd(task, proto::TASK_SUCCEEDED);
    EXPECT_TRUE(standsWithin(seconds{5}));
    EXPECT_NEAR(joint_deg(1), 20, 0.2);
    EXPECT_NEAR(joint_deg(6), -30, 0.2);
    EXPECT_NEAR(2000 * (board_->targets()[7] + 0.00083), 10, 0.2);
    EXPECT_NEAR(joint_deg(0), degrees(kHome[0]), 1);
    EXPECT_EQ(board_->refusedLines(), 0U);
    ASSERT_FALSE(manager_->end(task)->results().empty());
}

TEST_F(CytonApplication, ASpeedThatIsSetOnTheWayHoldsAndFeedbackTellsTheAngles) {
    // At this speed it would take 25 s.
    const auto task = manager_->dispatch("Control", {{"Shoulder Roll", -90}, {"Speed", 10}});
    ASSERT_TRUE(waitUntil([&] { return joint_deg(0) < degrees(kHome[0]) - 1; }));
    manager_->configure("Control", "Speed", 120, task);
    expectEnd(task, proto::TASK_SUCCEEDED);
    EXPECT_NEAR(joint_deg(0), -90, 0.2);
    EXPECT_EQ(board_->refusedLines(), 0U);
    bool told = false;
    const auto end = *manager_->end(task);
    for (const auto& result : end.results()) {
        if (result.name() != "Angles") continue;
        told = true;
        EXPECT_EQ(result.units(), "deg");
        ASSERT_EQ(result.values_size(), static_cast<int>(kJoints));
        EXPECT_LE(result.values(0).dbl(), degrees(kHome[0]));
    }
    EXPECT_TRUE(told);
}

TEST_F(CytonApplication, AStopFreezesTheArmAndIsAcknowledgedTwice) {
    const auto task = longMove();
    waitUntilMoving();
    const auto generation = manager_->stop();
    ASSERT_TRUE(
        waitUntil([&] { return manager_->reached(generation, proto::StopReceipt::CALLBACK_RETURNED); }));
    const double there = joint_deg(0);
    EXPECT_TRUE(waitUntil([&] { return manager_->reached(generation, proto::StopReceipt::STANDSTILL); }));
    EXPECT_TRUE(standsWithin(seconds{5}));
    EXPECT_NEAR(joint_deg(0), there, 0.5);
    expectEnd(task, proto::TASK_STOPPED);
    EXPECT_NEAR(joint_deg(0), there, 0.5);
    // What was stopped does not keep the next task from moving.
    const auto next = manager_->dispatch("Control", {{"Wrist Roll", 20}, {"Speed", 180}});
    expectEnd(next, proto::TASK_SUCCEEDED);
    EXPECT_NEAR(joint_deg(0), there, 0.5) << "nor does the next one go on with it";
}

TEST_F(CytonApplication, ACancelAPauseAndALostManagerLeaveItStanding) {
    const auto cancelled = longMove();
    waitUntilMoving();
    manager_->cancel(cancelled);
    expectEnd(cancelled, proto::TASK_CANCELLED);
    EXPECT_TRUE(standsWithin(seconds{5}));

    const auto task = manager_->dispatch("Control", {{"Shoulder Pitch", 40}, {"Speed", 40}});
    ASSERT_TRUE(waitUntil([&] { return joint_deg(1) > 5; }));
    manager_->pause(task, false);
    ASSERT_TRUE(standsWithin(seconds{5}));
    EXPECT_LT(joint_deg(1), 39);
    EXPECT_FALSE(manager_->end(task));
    manager_->pause(task, true);
    expectEnd(task, proto::TASK_SUCCEEDED);
    EXPECT_NEAR(joint_deg(1), 40, 0.3);

    longMove();
    ASSERT_TRUE(waitUntil([&] { return !stands(); }));
    manager_->die();
    EXPECT_TRUE(standsWithin(seconds{5}));
    EXPECT_GT(joint_deg(0), -85);
}

TEST_F(CytonApplication, AnApplicationThatEndsLeavesAnArmThatStands) {
    longMove();
    waitUntilMoving();
    application_.reset();
    EXPECT_TRUE(standsWithin(seconds{1}));
    EXPECT_GT(joint_deg(0), -85);
}

TEST_F(CytonApplication, LosingTheControllerFailsTheTaskAndItsReturnMendsEverything) {
    const auto task = longMove();
    waitUntilMoving();
    const int port = board_->port();
    board_.reset();
    expectEnd(task, proto::TASK_FAILED);
    EXPECT_EQ(manager_->end(task)->reason().code(), proto::ROBOT_LOST);
    ASSERT_TRUE(waitUntil([&] { return !manager_->active("Control"); }));
    EXPECT_THAT(manager_->inactiveReason("Control"), HasSubstr("the arm is lost"));
    const auto refused = longMove();
    ASSERT_TRUE(waitUntil([&] { return manager_->answer(refused).has_value(); }));
    EXPECT_EQ(manager_->answer(refused)->code(), proto::ROBOT_LOST);

    board_ = std::make_unique<Board>(port);
    ASSERT_TRUE(waitUntil([&] { return manager_->active("Control"); }));
    EXPECT_EQ(board_->moves(), 0U) << "nothing moves because it is back";
    const auto next = manager_->dispatch("Control", {{"Wrist Roll", 20}, {"Speed", 180}});
    expectEnd(next, proto::TASK_SUCCEEDED);
    EXPECT_NEAR(joint_deg(0), degrees(kHome[0]), 1)
        << "from where the new one is, not from where the old one was";
}

TEST_F(CytonApplication, AControllerThatFallsSilentIsLostWithinASecondOrTwo) {
    board_->fallSilent();
    EXPECT_TRUE(waitUntil([&] { return !manager_->active("Control"); }));
    EXPECT_THAT(manager_->inactiveReason("Control"), HasSubstr("has not answered"));
}

TEST_F(CytonApplication, WhatCannotBeDoneIsRefusedBeforeAnythingMoves) {
    const auto nothing = manager_->dispatch("Control", {});
    ASSERT_TRUE(waitUntil([&] { return manager_->answer(nothing).has_value(); }));
    EXPECT_THAT(manager_->answer(nothing)->message(), HasSubstr("at least one joint"));
    const auto too_far = manager_->dispatch("Control", {{"Wrist Pitch", 80}});
    ASSERT_TRUE(waitUntil([&] { return manager_->answer(too_far).has_value(); }));
    EXPECT_THAT(manager_->answer(too_far)->message(), HasSubstr("Wrist Pitch turns from -65.0 to 65.0 deg"));
    const auto far = manager_->dispatch("Grab and Place", {{"Pick X", 590}, {"Pick Y", 400}});
    ASSERT_TRUE(waitUntil([&] { return manager_->answer(far).has_value(); }));
    EXPECT_THAT(manager_->answer(far)->message(), HasSubstr("the arm is 469 mm long"));
    const auto near = manager_->dispatch("Grab and Place", {{"Pick X", 200}, {"Pick Y", 150}});
    expectEnd(near, proto::TASK_FAILED);
    EXPECT_THAT(manager_->end(near)->reason().message(), HasSubstr("cannot grip"));
    EXPECT_LT(farthestFromHome(), 0.02);
}

TEST_F(CytonApplication, GrabAndPlaceClosesTheClawsOpensThemAndGoesHome) {
    for (const char* stream : {"joints", "gripper"}) manager_->watch(stream);
    const auto task = manager_->dispatch("Grab and Place", {{"Speed", 60}});
    const auto opening_mm = [&] { return 2000 * (board_->targets()[7] + 0.00083); };
    EXPECT_TRUE(waitUntil([&] { return opening_mm() > 33; }, seconds{20}));
    EXPECT_TRUE(waitUntil([&] { return opening_mm() < 24; }, seconds{20}));
    EXPECT_THAT(manager_->textResult(task, "Done"), HasSubstr("closed"));
    EXPECT_TRUE(waitUntil([&] { return opening_mm() > 33; }, seconds{20}));
    expectEnd(task, proto::TASK_SUCCEEDED, seconds{20});
    EXPECT_THAT(manager_->textResult(task, "Done"), HasSubstr("placed at (390, 0, 0) mm"));
    EXPECT_TRUE(standsWithin(seconds{5}));
    EXPECT_LT(farthestFromHome(), 0.02);
    EXPECT_EQ(board_->refusedLines(), 0U);
    for (const char* stream : {"joints", "gripper"}) EXPECT_GT(manager_->samples(stream), 20) << stream;
}

TEST_F(CytonApplication, WhatAStoppedTaskMayHoldIsNotDroppedByTheNext) {
    const auto task = manager_->dispatch("Grab and Place", {{"Speed", 60}});
    ASSERT_TRUE(waitUntil([&] { return manager_->textResult(task, "Step") == "lifting it"; }, seconds{20}));
    manager_->stop();
    expectEnd(task, proto::TASK_STOPPED);
    EXPECT_THAT(manager_->textResult(task, "Done"), HasSubstr("not put down"));
    const auto next = manager_->dispatch("Grab and Place", {});
    ASSERT_TRUE(waitUntil([&] { return manager_->answer(next).has_value(); }));
    EXPECT_THAT(manager_->answer(next)->message(), HasSubstr("may still hold"));
    expectEnd(manager_->dispatch("Control", {{"Gripper", 34}}), proto::TASK_SUCCEEDED);
    const auto again = manager_->dispatch("Reach Demo", {});
    EXPECT_TRUE(waitUntil([&] { return manager_->textResult(again, "Joint") == "upright"; }));
    manager_->stop();
    expectEnd(again, proto::TASK_STOPPED);
}

TEST_F(CytonApplication, ReachDemoTurnsJointsToTheirEndsAndCanBeStopped) {
    const auto task = manager_->dispatch("Reach Demo", {{"Speed", 180}});
    EXPECT_TRUE(waitUntil([&] { return joint_deg(0) < -89; }));
    EXPECT_TRUE(waitUntil([&] { return joint_deg(0) > 89; }));
    EXPECT_THAT(manager_->textResult(task, "Joint"), HasSubstr("Shoulder Roll"));
    EXPECT_TRUE(waitUntil([&] { return joint_deg(1) < -40; }));
    manager_->stop();
    EXPECT_TRUE(standsWithin(seconds{1}));
    expectEnd(task, proto::TASK_STOPPED);
}

/// While the arm goes home for the first time, one single move of 5 s that the controller finishes by itself.
struct Homing {
    const char* name;
    int signal;
    const char* guard_ms;

    friend void PrintTo(const Homing& homing, std::ostream* out) { *out << homing.name; }
};

class CytonFirstHoming : public ::testing::TestWithParam<Homing> {
  protected:
    /// 0 upright to 1 at home.
    double way() { return board_.targets()[0] / kHome[0]; }
    /// Strikes the application under way; how far the arm was when it came to rest.
    double strike() {
        const auto name = std::string("cyton-homing-") + GetParam().name + std::to_string(::getpid());
        test::RobotManager manager(name);  // ends after the program, whose frozen end it might wait for
        const test::Program program({AXON_CYTON, "--arm",
                                     test::loopbackAddress() + ":" + std::to_string(board_.port()),
                                     "--application", name, "--ports", ports_.path(), "--profiles",
                                     "robots/cyton", "--guard", GetParam().guard_ms});
        if (!waitUntil([&] { return manager.active("Control"); }, seconds{20})) return -1;
        EXPECT_NEAR(way(), 0, 0.02) << "connecting moves nothing";
        manager.dispatch("Control", {{"Wrist Yaw", 10}});
        EXPECT_TRUE(waitUntil([&] { return way() > 0.05; }, seconds{20}));
        EXPECT_EQ(::kill(program.pid(), GetParam().signal), 0);
        EXPECT_TRUE(waitUntil([&] { return board_.restsSince() > milliseconds{500}; }, seconds{20}));
        return way();
    }

    Board board_{0, Board::kSwitchedOn};
    const robots::TemporaryFile ports_{"Axon.Ports = 5500-8000\nAxon.Address = " + test::loopbackAddress() +
                                       "\n"};
};

INSTANTIATE_TEST_SUITE_P(Each, CytonFirstHoming,
                         ::testing::Values(Homing{"Frozen", SIGSTOP, "200"}, Homing{"Killed", SIGKILL, "200"},
                                           Homing{"FrozenUnguarded", SIGSTOP, "0"}),
                         [](const auto& homing) { return std::string(homing.param.name); });

TEST_P(CytonFirstHoming, IsEndedByTheGuardAndByNothingElse) {
    const double rest = strike();
    if (GetParam().guard_ms == std::string("0"))
        EXPECT_NEAR(rest, 1, 0.02) << "the controller finishes the move";
    else
        EXPECT_THAT(rest, ::testing::AllOf(::testing::Gt(0.05), ::testing::Lt(0.5)));
}

}  // namespace
}  // namespace axon::cyton
