// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/lab_server.hpp"

#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <filesystem>
#include <fstream>
#include <mutex>
#include <sstream>
#include <thread>

#include "common/ids.hpp"
#include "robots/arcos/arcos_client.hpp"
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
            arcos::tcpStreams(address(robot)),
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
    auto opened = arcos::tcpStreams(address())(std::chrono::seconds{2});
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
        EXPECT_THROW(arcos::tcpStreams(address), std::invalid_argument) << address;
    }
}

}  // namespace
}  // namespace axon::lab
