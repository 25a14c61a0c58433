// SPDX-License-Identifier: GPL-2.0-or-later
// A disk that takes longer than any watchdog for each operation, under a real Entity Manager whose robot
// moves: client library, servers, Entity Manager with its stores in files, and the Entity Interfacer in a
// robot application.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spdlog/sinks/base_sink.h>
#include <spdlog/spdlog.h>
#include <stdlib.h>

#include <array>
#include <axon/client.hpp>
#include <axon/entity_interfacer.hpp>
#include <fstream>
#include <future>
#include <sstream>
#include <thread>

#include "component/with_manager.hpp"
#include "entity_manager/storage/file_journal.hpp"
#include "entity_manager/storage/file_resources.hpp"
#include "entity_manager/storage/file_storage.hpp"
#include "support/loopback.hpp"
#include "support/slow_disk.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;
namespace fs = std::filesystem;
using entity_manager::EntityManager;
using test::waitUntil;
using testing::ElementsAre;
using testing::IsEmpty;

constexpr auto kEach = 700ms;
/// Shorter than an operation of the disk, and longer than a machine stands still that tests something else as
/// well.
constexpr auto kWatchdog = 500ms;

constexpr const char* kServices = R"(<ServiceProfile count="3">
  <Service name="Drive" type="SMPL" blocking="false"/>
  <Service name="Look" type="SMPL" blocking="false"/>
  <Service name="Find" type="SMPL" blocking="false">
    <Resources><Resource name="Map" required="true" savable="true"/></Resources>
  </Service>
</ServiceProfile>)";

/// What an operator is warned of.
class Warnings final : public spdlog::sinks::base_sink<std::mutex> {
  public:
    std::vector<std::string> lines() {
        const std::lock_guard lock(mutex_);
        return lines_;
    }

  protected:
    void sink_it_(const spdlog::details::log_msg& message) override {
        if (message.level >= spdlog::level::warn)
            lines_.emplace_back(message.payload.data(), message.payload.size());
    }
    void flush_() override {}

  private:
    std::vector<std::string> lines_;
};

std::string contentOf(const fs::path& file) {
    std::stringstream text;
    text << std::ifstream(file).rdbuf();
    return text.str();
}

class SlowDiskTest : public test::WithManager {
  protected:
    SlowDiskTest() {
        char name[] = "/tmp/axon-slow-XXXXXX";
        folder_ = ::mkdtemp(name);
        before_ = spdlog::default_logger();
        spdlog::set_default_logger(std::make_shared<spdlog::logger>("slow disk", warnings_));
        test::makeSlow(folder_ / "state", 0ms);
    }
    void SetUp() override {
        startServer();
        startApplication();
        files_of_state_ = std::make_unique<entity_manager::FileStorage>(folder_ / "state");
        resources_ = std::make_unique<entity_manager::FileResourceStore>(folder_ / "state");
        journal_ = std::make_unique<entity_manager::FileJournal>(folder_ / "state");
        entity_manager::EntityManagerCoreSettings core;
        core.application = "slow";
        core.server_watchdog_busy = kWatchdog;
        entity_manager::BackEndSettings link;
        link.application = "slow";
        link.manager = "slow disk test";
        link.watchdog_busy = link.watchdog_idle = kWatchdog;
        link.where.address = test::loopbackAddress();
        createManager(core, EntityManager::overTcp(link, random_), *files_of_state_, *resources_,
                      journal_.get());
        manager_->start();
        client_ = connected({.display_name = "user@host"});
        ASSERT_TRUE(client_);
        ASSERT_TRUE(client_->waitFor("Rover", client::Seconds{10}).ok());
    }
    void TearDown() override {
        test::makeSlow(folder_ / "state", 0ms);
        WithManager::TearDown();
        application_.reset();
        journal_.reset();
        resources_.reset();
        files_of_state_.reset();
        server_.reset();
        spdlog::set_default_logger(before_);
        fs::remove_all(folder_);
    }
    void startApplication() {
        std::ofstream(folder_ / "basic.xml")
            << R"(<BasicProfile name="Rover" category="ROBOT" type="MOBILE"/>)";
        std::ofstream(folder_ / "services.xml") << kServices;
        EntityInterfacer::Options options;
        options.application = "slow";
        options.address = test::loopbackAddress();
        options.watch_profiles = false;
        application_ = std::make_unique<EntityInterfacer>(options);
        application_->uploadBasicProfile(folder_ / "basic.xml");
        application_->uploadServiceProfile(folder_ / "services.xml");
        application_->onResource([](const std::string&, const std::string&, const fs::path& file) {
            std::array<char, 3> begin{};
            std::ifstream(file).read(begin.data(), begin.size());
            return std::string_view(begin.data(), begin.size()) == "map" ? Decision::grant()
                                                                         : Decision::deny("not a map");
        });
        application_->onTask("Drive", [this](axon::Task& task) {
            moving_ = true;
            while (task.waitFor(std::chrono::hours{1})) {
            }
            moving_ = false;
        });
        application_->onTask("Look", [this](axon::Task&) { ++looks_; });
        application_->onTask("Find", [this](axon::Task& task) {
            const std::lock_guard lock(mutex_);
            found_.push_back(contentOf(task.resource("Map")).substr(0, 7));
        });
        application_->onStop([this](const StopSignal&) { ++stops_; });
        application_->start();
    }
    fs::path fileOf(const std::string& content) {
        const auto path = folder_ / ("file" + std::to_string(++files_));
        std::ofstream(path) << content;
        return path;
    }
    std::vector<std::string> found() {
        const std::lock_guard lock(mutex_);
        return found_;
    }

    fs::path folder_;
    const std::shared_ptr<Warnings> warnings_ = std::make_shared<Warnings>();
    std::shared_ptr<spdlog::logger> before_;
    std::atomic<int> stops_{0}, looks_{0};
    std::atomic<bool> moving_{false};
    std::mutex mutex_;
    std::vector<std::string> found_;  // guarded by mutex_: the beginning of each map that Find was given
    int files_ = 0;
    std::unique_ptr<EntityInterfacer> application_;
    std::unique_ptr<entity_manager::FileStorage> files_of_state_;
    std::unique_ptr<entity_manager::FileResourceStore> resources_;
    std::unique_ptr<entity_manager::FileJournal> journal_;
};

TEST_F(SlowDiskTest, NoRobotStopsAndNoWatchdogWarnsWhateverTheDiskHoldsUp) {
    const auto taken = client_->checkOut("Rover");
    ASSERT_TRUE(taken.ok()) << taken.refusal().message;
    const auto held = taken.value();
    std::atomic<int> lost{0};
    held.onLost([&](const Refusal&) { ++lost; });
    ASSERT_TRUE(held.upload("Find", "Map", fileOf("map one")).ok());
    test::makeSlow(folder_ / "state", kEach);

    // Whoever asks the entity meanwhile is answered by the strand.
    std::atomic<std::int64_t> longest_us{0};
    std::jthread asker([&](const std::stop_token& enough) {
        while (!enough.stop_requested()) {
            const auto before = std::chrono::steady_clock::now();
            if (!client_->details("Rover").ok()) longest_us = std::numeric_limits<std::int64_t>::max();
            const auto took = std::chrono::duration_cast<std::chrono::microseconds>(
                std::chrono::steady_clock::now() - before);
            longest_us = std::max<std::int64_t>(longest_us, took.count());
            waitUntil([&] { return enough.stop_requested(); }, 5ms);
        }
    });

    const auto driving = held.run("Drive");
    EXPECT_TRUE(waitUntil([&] { return driving.report().accepted; }));
    EXPECT_EQ(driving.report().state, client::TaskState::Queued) << "it waits for its entry";
    EXPECT_FALSE(moving_);
    ASSERT_TRUE(waitUntil([&] { return moving_.load(); }));

    const auto began = std::chrono::steady_clock::now();
    const auto denied = held.upload("Find", "Map", fileOf("no map"));
    EXPECT_EQ(denied.refusal().code, RefusalCode::Denied) << denied.refusal().message;
    EXPECT_EQ(held.run("Find").wait(client::Seconds{20}).state, client::TaskState::Succeeded);
    EXPECT_THAT(found(), ElementsAre("map one")) << "a denied upload leaves the old file";
    const auto replaced = held.upload("Find", "Map", fileOf("map two" + std::string(200'000, '.')));
    EXPECT_TRUE(replaced.ok()) << replaced.refusal().message;
    EXPECT_GT(std::chrono::steady_clock::now() - began, 5s) << "longer than a client waits in silence";
    EXPECT_EQ(held.run("Find").wait(client::Seconds{20}).state, client::TaskState::Succeeded);
    EXPECT_THAT(found(), ElementsAre("map one", "map two"));
    EXPECT_GT(test::slowCalls(), 10U);

    EXPECT_TRUE(moving_);
    EXPECT_EQ(stops_, 0);
    EXPECT_EQ(lost, 0);
    EXPECT_THAT(warnings_->lines(), IsEmpty());

    // A task that waits for its entry when the robot is stopped does not begin. One that has not been
    // accepted yet would be overtaken by the stop and refused.
    test::makeSlow(folder_ / "state", 4 * kEach);
    const auto late = held.run("Look");
    ASSERT_TRUE(waitUntil([&] { return late.report().accepted; }));
    const auto before = std::chrono::steady_clock::now();
    const auto receipts = client_->stop({"Rover"});
    EXPECT_LT(std::chrono::steady_clock::now() - before, kEach / 2);
    ASSERT_TRUE(receipts.ok()) << receipts.refusal().message;
    EXPECT_TRUE(waitUntil([&] { return !moving_; }));
    const auto end = late.wait(client::Seconds{5});
    EXPECT_EQ(end.state, client::TaskState::Stopped) << end.reason.message;
    test::makeSlow(folder_ / "state", kEach);
    EXPECT_TRUE(waitUntil(
        [&] { return contentOf(folder_ / "state" / "tasks.jsonl").find(late.id()) != std::string::npos; }));
    ASSERT_TRUE(client_->details("Rover").ok()) << "the strand has heard of it";
    asker.request_stop();
    asker.join();
    EXPECT_LT(longest_us, std::chrono::microseconds(kEach).count()) << "the strand has waited for the disk";
    RecordProperty("longest_us", std::to_string(longest_us));
    EXPECT_EQ(looks_, 0);
    EXPECT_EQ(stops_, 1);
}

/// As they were found: to replace a file of 450 MB took the strand 245 ms.
TEST_F(SlowDiskTest, LargeFilesThatReplaceEachOtherStopNothing) {
    if (std::getenv("AXON_LONG_TRIALS") == nullptr)
        GTEST_SKIP() << "set AXON_LONG_TRIALS; it writes two gigabytes";
    const auto taken = client_->checkOut("Rover");
    ASSERT_TRUE(taken.ok()) << taken.refusal().message;
    const auto held = taken.value();
    const auto driving = held.run("Drive");
    ASSERT_TRUE(waitUntil([&] { return moving_.load(); }));
    const auto file = fileOf("map ");
    for (const std::uintmax_t megabytes : {450, 451, 1000}) {
        fs::resize_file(file, megabytes << 20U);
        const auto uploaded = held.upload("Find", "Map", file);
        EXPECT_TRUE(uploaded.ok()) << megabytes << " MB: " << uploaded.refusal().message;
    }
    EXPECT_TRUE(moving_);
    EXPECT_EQ(stops_, 0);
    EXPECT_THAT(warnings_->lines(), IsEmpty());
}

}  // namespace
}  // namespace axon
