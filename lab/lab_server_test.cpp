// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/lab_server.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <sstream>
#include <thread>

#include "common/ids.hpp"
#include "common/shared_clock.hpp"
#include "robots/arcos/arcos_client.hpp"
#include "robots/lms2xx/lms2xx_client.hpp"
#include "tests/support/loopback.hpp"

namespace axon::lab {
namespace {

using arcos::ArcosClient;
using arcos::Command;
using std::chrono::milliseconds;
using test::waitUntil;

/// The real server on sockets, four times faster than the clock.
class LabServerTest : public ::testing::Test {
  protected:
    void serve(int robots = 1, double speed = 4) {
        WorldDescription world;
        for (int i = 0; i < robots; ++i) world.robots.push_back(parseRobot("", static_cast<std::size_t>(i)));
        LabServer::Options options{.listen = test::loopbackAddress(), .first_port = 0, .speed = speed};
        options.truth_path = truth_path_;
        server_ = std::make_unique<LabServer>(world, options);
        thread_ = std::thread([this] { server_->run(); });
    }
    void end() {
        if (!server_) return;
        server_->stop();
        thread_.join();
        server_.reset();
    }
    void TearDown() override {
        end();
        std::filesystem::remove(truth_path_);
    }
    std::string address(std::size_t robot = 0) const {
        return test::loopbackAddress() + ":" + std::to_string(server_->ports().at(robot));
    }
    std::unique_ptr<ArcosClient> connect(std::size_t robot = 0) {
        auto client = std::make_unique<ArcosClient>(
            robots::tcpStreams(address(robot)),
            ArcosClient::Callbacks{.on_lost = [this](const std::string& reason) {
                const std::lock_guard lock(mutex_);
                lost_.push_back(reason);
            }});
        client->start();
        return client;
    }
    std::size_t losses() {
        const std::lock_guard lock(mutex_);
        return lost_.size();
    }
    std::string lastTruth() const {
        std::ifstream file(truth_path_);
        std::string line;
        std::string last;
        while (std::getline(file, line)) last = line;
        return last;
    }

    const std::string truth_path_ =
        (std::filesystem::temp_directory_path() / ("axon-lab-truth-" + std::to_string(::getpid()))).string();
    std::mutex mutex_;
    std::vector<std::string> lost_;  // guarded by mutex_
    std::unique_ptr<LabServer> server_;
    std::thread thread_;
};

TEST_F(LabServerTest, ARealClientDrivesTheRobotOverTcp) {
    serve();
    const auto client = connect();
    ASSERT_TRUE(waitUntil([&] { return client->state().online; }));
    ASSERT_TRUE(client->command(Command::Enable, 1));
    ASSERT_TRUE(waitUntil([&] { return client->state().motors_on; }));
    ASSERT_TRUE(client->drive(300, 0));
    ASSERT_TRUE(waitUntil([&] { return client->state().x_mm > 200; }));
    ASSERT_TRUE(client->stop());
    ASSERT_TRUE(waitUntil([&] { return !client->state().moving; }));
    EXPECT_NE(lastTruth().find("\"name\":\"PeopleBot\""), std::string::npos);
    EXPECT_EQ(losses(), 0U);
}

TEST_F(LabServerTest, ASecondClientIsRefusedAndTheFirstNotesNothing) {
    serve();
    const auto first = connect();
    ASSERT_TRUE(waitUntil([&] { return first->state().online; }));
    const auto second = connect();
    ASSERT_TRUE(waitUntil([&] { return losses() >= 1; }));
    EXPECT_FALSE(second->state().online);
    const auto before = first->state().sequence;
    EXPECT_TRUE(waitUntil([&] { return first->state().sequence > before; }));
    EXPECT_TRUE(first->state().online);
}

TEST_F(LabServerTest, AClientThatClosesAndConnectsAgainWithinATickIsNotRefused) {
    serve(1, 1);
    const auto open = robots::tcpStreams(address());
    const auto sync = arcos::encodeCommand(Command::Pulse);  // shares its number with SYNC0
    std::unique_ptr<robots::ByteStream> stream;
    for (int i = 0; i < 20; ++i) {
        stream.reset();
        auto opened = open(std::chrono::seconds{5});
        ASSERT_TRUE(opened) << opened.refusal().message;
        stream = std::move(opened).value();
        ASSERT_TRUE(stream->write(sync));
        std::array<std::uint8_t, 64> echo{};
        int got = 0;
        ASSERT_TRUE(waitUntil([&] { return (got = stream->read(echo)) != 0; }));
        ASSERT_GT(got, 0) << "refused in round " << i;
        ASSERT_TRUE(stream->write(sync));  // and something unread is on its way when it closes
    }
}

TEST_F(LabServerTest, TheRobotStopsWhenItsClientIsLostAndTheNextOneFindsItStanding) {
    serve();
    auto client = connect();
    ASSERT_TRUE(waitUntil([&] { return client->state().online; }));
    client->command(Command::Enable, 1);
    client->drive(300, 0);
    ASSERT_TRUE(waitUntil([&] { return client->state().speed_mm_s() > 100; }));
    client.reset();
    client = connect();
    ASSERT_TRUE(waitUntil([&] { return client->state().online && !client->state().moving; }));
    EXPECT_FALSE(client->state().motors_on);
}

TEST_F(LabServerTest, TheClientComesBackWhenTheRobotDoes) {
    serve();
    const int port = server_->ports().at(0);
    const auto client = connect();
    ASSERT_TRUE(waitUntil([&] { return client->state().online; }));
    end();
    ASSERT_TRUE(waitUntil([&] { return !client->state().online; }));
    EXPECT_FALSE(client->stop());
    WorldDescription world;
    world.robots = {parseRobot("", 0)};
    server_ = std::make_unique<LabServer>(
        world, LabServer::Options{.listen = test::loopbackAddress(), .first_port = port});
    thread_ = std::thread([this] { server_->run(); });
    EXPECT_TRUE(waitUntil([&] { return client->state().online; }));
}

TEST_F(LabServerTest, RobotsHavePortsOfTheirOwnAndDoNotMix) {
    serve(2);
    const auto left = connect(0);
    const auto client2 = connect(1);
    ASSERT_TRUE(waitUntil([&] { return left->state().online && client2->state().online; }));
    left->command(Command::Enable, 1);
    left->drive(200, 0);
    ASSERT_TRUE(waitUntil([&] { return left->state().x_mm > 50; }));
    EXPECT_FALSE(client2->state().moving);
    EXPECT_FALSE(client2->state().motors_on);
}

/// One line there, one line back.
class ControlLine {
  public:
    explicit ControlLine(const std::string& address)
        : stream_(std::move(robots::tcpStreams(address)(std::chrono::seconds{2}).value())) {}
    std::string ask(const std::string& request) {
        say(request);
        return answer();
    }
    void say(const std::string& request) {
        const std::string line = request + "\n";
        EXPECT_TRUE(stream_->write(std::vector<std::uint8_t>(line.begin(), line.end())));
    }
    /// Whether an answer has arrived.
    bool said() {
        std::array<std::uint8_t, 4096> chunk;
        const int got = stream_->read(chunk);
        if (got > 0) in_.append(chunk.begin(), chunk.begin() + got);
        return in_.find('\n') != std::string::npos;
    }
    std::string answer() {
        EXPECT_TRUE(waitUntil([&] { return said(); }));
        const auto end = in_.find('\n');
        const auto line = in_.substr(0, end);
        in_.erase(0, end + 1);
        return line;
    }

  private:
    std::unique_ptr<robots::ByteStream> stream_;
    std::string in_;
};

class WholeLab : public LabServerTest {
  protected:
    void serveAll(LabServer::Options options) {
        WorldDescription world;
        world.tables = {{.name = "west", .x = 6, .y = 3, .dx = 0.8, .dy = 1.2, .height = 0.66}};
        world.objects = {{.name = "red", .colour = "red", .x = 6, .y = 3.2}};
        world.robots = {{.name = "Robot", .x = 2, .y = 3, .theta = 0, .port = {}}};
        world.devices = {
            {.kind = "cyton", .name = "Arm", .x = 6, .y = 2.8, .z = {}, .theta = 90, .port = {}}};
        options.listen = test::loopbackAddress();
        options.first_port = 0;
        server_ = std::make_unique<LabServer>(world, options);
        thread_ = std::thread([this] { server_->run(); });
    }
    std::unique_ptr<robots::ByteStream> open(const std::string& name) {
        return std::move(robots::robotStreams(server_->address(name))(std::chrono::seconds{2}).value());
    }
    static void say(robots::ByteStream& stream, const std::string& text) {
        EXPECT_TRUE(stream.write(std::vector<std::uint8_t>(text.begin(), text.end())));
    }
    static std::string hear(robots::ByteStream& stream, std::size_t bytes) {
        std::string heard;
        EXPECT_TRUE(waitUntil([&] {
            std::array<std::uint8_t, 65536> chunk;
            const int got = stream.read(chunk);
            if (got > 0) heard.append(chunk.begin(), chunk.begin() + got);
            return heard.size() >= bytes || got < 0;
        }));
        return heard;
    }
    static double member(const std::string& json, const std::string& name) {
        const auto at = json.find("\"" + name + "\":");
        return at == std::string::npos ? std::nan("") : std::stod(json.substr(at + name.size() + 3));
    }
};

TEST_F(WholeLab, AnArmIsTalkedToOverTcp) {
    serveAll({.speed = 4});
    const auto arm = open("Arm");
    say(*arm, "VER\rQ\r");
    EXPECT_EQ(hear(*arm, 15), "SSC32-V2.01XE\r.");
    ControlLine control(server_->address("control"));
    const double before = member(control.ask(R"({"do":"truth"})"), "claw_mm");
    say(*arm, "#7P600T200\r");
    EXPECT_TRUE(waitUntil([&] { return member(control.ask(R"({"do":"truth"})"), "claw_mm") > before + 4; }));
}

TEST_F(WholeLab, AnArmIsTalkedToOverATerminal) {
    serveAll({.speed = 4, .pty = true});
    const auto arm = open("Arm");
    say(*arm, "QP7\r");
    EXPECT_EQ(hear(*arm, 1), std::string(1, char(105)));
}

TEST_F(WholeLab, ARobotsSerialLineIsRaisedAndAKilledProgramsRobotIsFoundThere) {
    serveAll({.speed = 1, .pty = true});
    const auto connect = [this] {
        auto client = std::make_unique<ArcosClient>(robots::robotStreams(server_->address("Robot")),
                                                    ArcosClient::Callbacks());
        client->start();
        return client;
    };
    auto client = connect();
    ASSERT_TRUE(waitUntil([&] { return client->state().online; }));
    EXPECT_EQ(client->state().baud, 38400);
    ASSERT_TRUE(client->command(Command::Enable, 1));
    EXPECT_TRUE(waitUntil([&] { return client->state().motors_on; }));
    client.reset();  // the robot stays at its speed, and the line begins at 9600 baud again
    client = connect();
    ASSERT_TRUE(waitUntil([&] { return client->state().online; }));
    EXPECT_EQ(client->state().baud, 38400);
}

TEST_F(WholeLab, ALaserOnALineOfItsOwnIsHeardOverBothKindsOfLinks) {
    for (const bool pty : {false, true}) {
        serveAll({.speed = 1, .pty = pty, .lasers = true});
        std::mutex mutex;
        std::vector<lms2xx::Scan> scans;
        std::optional<lms2xx::Setting> setting;
        lms2xx::Lms2xxClient laser(robots::robotStreams(server_->address("Robot.laser")),
                                   {.on_online =
                                        [&](const lms2xx::Setting& now) {
                                            const std::lock_guard lock(mutex);
                                            setting = now;
                                        },
                                    .on_scan =
                                        [&](const lms2xx::Scan& scan) {
                                            const std::lock_guard lock(mutex);
                                            scans.push_back(scan);
                                        },
                                    .on_lost = {}});
        laser.start();
        ASSERT_TRUE(waitUntil([&] {
            const std::lock_guard lock(mutex);
            return scans.size() >= 3;
        }));
        const std::lock_guard lock(mutex);
        EXPECT_EQ(setting->baud, pty ? 38400 : 0);
        ASSERT_EQ(scans.back().ranges_mm.size(), 181U);
        EXPECT_NEAR(scans.back().ranges_mm[0], 3000, 20);
        end();
    }
}

TEST_F(WholeLab, TimePassesOnlyByStepsAndTheSameStepsGiveTheSameTruth) {
    std::string first;
    for (int run = 0; run < 2; ++run) {
        serveAll({.step = true, .noise = 1});
        ControlLine control(server_->address("control"));
        const auto arm = open("Arm");
        say(*arm, "#0P1500#1P1700#3P1800T1000\rQ\r");
        EXPECT_EQ(hear(*arm, 1), "+");
        EXPECT_DOUBLE_EQ(member(control.ask(R"({"do":"truth"})"), "time_s"), 0);
        EXPECT_NE(control.ask(R"({"do":"step","ms":2000})").find("\"ok\":true"), std::string::npos);
        const auto truth = control.ask(R"({"do":"truth"})");
        EXPECT_DOUBLE_EQ(member(truth, "time_s"), 2);
        if (run == 0)
            first = truth;
        else
            EXPECT_EQ(truth, first);
        say(*arm, "Q\r");
        EXPECT_EQ(hear(*arm, 1), ".");
        end();
    }
}

TEST_F(WholeLab, OtherProgramsAreToldTheLaboratorysTime) {
    serveAll({.step = true, .clock_path = truth_path_});
    ControlLine control(server_->address("control"));
    const SharedClock clock(truth_path_);
    const auto begin = clock.now();
    control.ask(R"({"do":"step","ms":1500})");
    EXPECT_EQ(clock.now() - begin, milliseconds{1500});
    EXPECT_EQ(clock.realTimeUntil(clock.now() + milliseconds{1}), SharedClock::kLongestWait) << "it stands";
}

TEST_F(WholeLab, TheHandsOfTheExperimenter) {
    serveAll({.step = true});
    ControlLine control(server_->address("control"));
    const auto ok = [&](const std::string& request) {
        const auto answer = control.ask(request);
        EXPECT_NE(answer.find("\"ok\":true"), std::string::npos) << request << " " << answer;
    };
    const auto refused = [&](const std::string& request, const std::string& why) {
        const auto answer = control.ask(request);
        EXPECT_NE(answer.find("\"ok\":false"), std::string::npos) << request << " " << answer;
        EXPECT_NE(answer.find(why), std::string::npos) << request << " " << answer;
    };
    ok(R"({"do":"move","name":"red","x":5.8,"y":3.4})");
    ok(R"({"do":"step","ms":400})");
    const auto truth = control.ask(R"({"do":"truth"})");
    EXPECT_NE(truth.find("west"), std::string::npos) << "it stands on the table";
    ok(R"({"do":"block","name":"crate","x":3,"y":3})");
    ok(R"({"do":"move","name":"crate","x":3.5,"y":3})");
    ok(R"({"do":"unblock","name":"crate"})");
    ok(R"({"do":"fault","name":"Robot","kind":"dead-sonar","which":3})");
    ok(R"({"do":"mend","name":"Robot","kind":"dead-sonar","which":3})");
    ok(R"({"do":"fault","name":"Arm","kind":"stuck-gripper"})");
    ok(R"({"do":"speed","factor":5})");
    ok(R"({"do":"reset"})");
    ok(R"({"do":"forget-touches"})");
    refused("nonsense", "JSON object");
    refused("[]", "JSON object");
    refused("{}", "do");
    refused(R"({"do":"dance"})", "expected one of");
    refused(R"({"do":"move","name":"green","x":1,"y":1})", "green");
    refused(R"({"do":"unblock","name":"nothing"})", "nothing");
    refused(R"({"do":"fault","name":"Robot","kind":"tired"})", "dead-sonar");
    refused(R"({"do":"fault","name":"Nobody","kind":"dead-sonar"})", "Nobody");
    refused(R"({"do":"speed","factor":"fast"})", "number");
    refused(R"({"do":"speed","factor":1000})", "0.01 to 100");
    refused(R"({"do":"picture","file":"/no/such/folder/p.png"})", "/no/such/folder");
    ok(R"({"do":"resume"})");
    refused(R"({"do":"step","ms":100})", "pause");
}

TEST_F(WholeLab, TheWorldGoesOnWhileAPictureIsDrawnAndWritten) {
    serveAll({});
    ControlLine painter(server_->address("control"));
    ControlLine judge(server_->address("control"));
    const auto before = member(judge.ask(R"({"do":"truth"})"), "time_s");
    painter.say(R"({"do":"path","file":")" + truth_path_ + R"(.png"})" + "\n" + R"({"do":"truth"})");
    while (member(judge.ask(R"({"do":"truth"})"), "time_s") < before + 0.016) {
    }
    EXPECT_FALSE(painter.said()) << "a picture of this size takes many times 16 ms";
    EXPECT_NE(painter.answer().find("\"ok\":true"), std::string::npos);
    EXPECT_GT(std::filesystem::file_size(truth_path_ + ".png"), 1000U) << "it is answered when it is written";
    EXPECT_NE(painter.answer().find("time_s"), std::string::npos) << "what comes after it waits for it";
    std::filesystem::remove(truth_path_ + ".png");
}

TEST_F(WholeLab, PicturesArePausedWithTheWorldButCanBeTaken) {
    serveAll({.step = true, .overview = true});
    const auto camera = open("Robot.camera");
    say(*camera, "GET /frame.jpg HTTP/1.1\r\n\r\n");
    const auto jpeg = hear(*camera, 2000);
    EXPECT_EQ(jpeg.substr(0, 15), "HTTP/1.1 200 OK");
    EXPECT_NE(jpeg.find("\xFF\xD8\xFF"), std::string::npos);
    const auto room = open("overview");
    say(*room, "GET /overview.png HTTP/1.1\r\n\r\n");
    EXPECT_NE(hear(*room, 5000).find("PNG"), std::string::npos);
    const auto lost = open("overview");
    say(*lost, "GET /etc/passwd HTTP/1.1\r\n\r\n");
    EXPECT_EQ(hear(*lost, 60).substr(0, 12), "HTTP/1.1 404");
    const auto blobs = open("Robot.acts");
    say(*blobs, "0");
    EXPECT_GE(hear(*blobs, 128).size(), 128U);
}

TEST_F(WholeLab, RawPicturesComeTenASecondOfTheLaboratorysTime) {
    serveAll({.step = true});
    ControlLine control(server_->address("control"));
    const auto camera = open("Robot.camera");
    say(*camera, "GET /raw HTTP/1.1\r\n\r\n");
    const std::size_t one = 15 + 320 * 240 * 3;
    EXPECT_NE(hear(*camera, one).find("\r\n\r\nP6\n320 240\n255\n"), std::string::npos);
    for (int i = 0; i < 3; ++i) {
        control.ask(R"({"do":"step","ms":100})");
        EXPECT_EQ(hear(*camera, one).size(), one);
    }
}

TEST_F(LabServerTest, AnAddressInUseIsNamedWithTheMend) {
    serve();
    WorldDescription world;
    world.robots = {parseRobot("", 0)};
    try {
        LabServer second(world, {.listen = test::loopbackAddress(), .first_port = server_->ports().at(0)});
        FAIL() << "two laboratories on one port";
    } catch (const std::system_error& error) {
        EXPECT_NE(std::string(error.what()).find("choose another --port"), std::string::npos);
    }
}

TEST_F(LabServerTest, GarbageDisturbsNothing) {
    serve();
    auto opened = robots::tcpStreams(address())(std::chrono::seconds{2});
    ASSERT_TRUE(opened);
    SeededRandom random(7);
    arcos::Bytes noise(5000);
    random.fill(noise.data(), noise.size());
    ASSERT_TRUE(opened.value()->write(noise));
    opened.value().reset();
    const auto client = connect();
    EXPECT_TRUE(waitUntil([&] { return client->state().online; }));
}

TEST(TcpStreams, ABadAddressIsNamedWithAnExample) {
    for (const char* address : {"", "host", "host:", ":8101", "host:0", "host:65536", "host:81a"}) {
        EXPECT_THROW(robots::tcpStreams(address), std::invalid_argument) << address;
    }
}

}  // namespace
}  // namespace axon::lab
