// SPDX-License-Identifier: GPL-2.0-or-later
// What a client sees of an entity before it is ready: a real server, a real Entity Manager, a real Entity
// Interfacer and a real client, over loopback.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>
#include <unistd.h>

#include <axon/entity_interfacer.hpp>
#include <filesystem>
#include <fstream>
#include <mutex>

#include "client/axon/client.hpp"
#include "component/with_manager.hpp"
#include "support/log_lines.hpp"
#include "support/loopback.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;
using client::Entity;
using client::Listed;
using entity_manager::EntityManager;
using test::waitUntil;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

const char* const kBasic =
    R"(<BasicProfile name="Greeter" category="MACHINE" type="STATIONARY" descr="greets"/>)";
const char* const kServices =
    R"(<ServiceProfile count="1"><Service name="Greet" type="SMPL"/></ServiceProfile>)";

/// Of all that runs in this process.
std::shared_ptr<test::LogLines> catchLog() {
    auto lines = std::make_shared<test::LogLines>();
    spdlog::set_default_logger(std::make_shared<spdlog::logger>("", lines));
    return lines;
}
const std::shared_ptr<test::LogLines> kLog = catchLog();

class PresenceTest : public test::WithManager {
  protected:
    void SetUp() override {
        kLog->clear();
        std::filesystem::create_directories(folder_);
        startServer();
        client_ = connected();
        ASSERT_TRUE(client_);
        client_->onEntity([this](Presence presence, const Entity& entity) {
            const std::lock_guard lock(mutex_);
            if (presence != Presence::Changed)
                told_.push_back((presence == Presence::Joined ? "joined " : "left ") + entity.name);
        });
    }
    void TearDown() override {
        client_.reset();
        application_.reset();
        WithManager::TearDown();
        std::error_code ignored;
        std::filesystem::remove_all(folder_, ignored);
    }
    void startManager(const std::string& application) {
        entity_manager::EntityManagerCoreSettings core;
        core.application = application;
        core.profiles_within = 50ms;
        entity_manager::BackEndSettings link;
        link.application = application;
        link.where = {{5500, 5600}, test::loopbackAddress()};
        link.report_after = 20ms;
        createManager(core, EntityManager::overTcp(link, random_));
        manager_->start();
    }
    void startApplication(const char* basic, const char* services) {
        EntityInterfacer::Options options;
        options.application = "greeter";
        options.address = test::loopbackAddress();
        options.first_port = 5500;
        options.last_port = 5600;
        options.logger = [this](LogLevel, const std::string& line) {
            const std::lock_guard lock(mutex_);
            log_ += line + '\n';
        };
        application_ = std::make_unique<EntityInterfacer>(options);
        if (basic != nullptr) application_->uploadBasicProfile(file("basic.xml", basic));
        if (services != nullptr) application_->uploadServiceProfile(file("services.xml", services));
        application_->onAnyTask([](Task&) {});
        application_->start();
    }
    std::filesystem::path file(const std::string& name, const std::string& text) const {
        std::ofstream(folder_ / name, std::ios::binary | std::ios::trunc) << text;
        return folder_ / name;
    }
    /// The only entity there is, once it is in this state for a reason that contains `part`.
    bool shows(EntityState state, const std::string& part) {
        return waitUntil([&] {
            const auto all = client_->entities(Listed::All);
            return all.size() == 1 && all[0].state == state && all[0].reason.find(part) != std::string::npos;
        });
    }
    std::string said() {
        const auto all = client_->entities(Listed::All);
        return all.empty() ? "no entity" : std::string(toString(all[0].state)) + ": " + all[0].reason;
    }
    bool applicationLogged(const std::string& part) {
        return waitUntil([&] {
            const std::lock_guard lock(mutex_);
            return log_.find(part) != std::string::npos;
        });
    }
    std::vector<std::string> told() {
        const std::lock_guard lock(mutex_);
        return told_;
    }

    const std::filesystem::path folder_ =
        std::filesystem::temp_directory_path() / ("axon-presence-" + std::to_string(::getpid()));
    std::unique_ptr<EntityInterfacer> application_;
    std::mutex mutex_;
    std::string log_;
    std::vector<std::string> told_;
};

TEST_F(PresenceTest, AnEntityManagerWithoutItsApplicationIsSeenAndSaysWhatItFound) {
    startApplication(kBasic, kServices);  // "greeter"
    startManager("greetr");
    ASSERT_TRUE(shows(EntityState::UNAV, "found there: \"greeter\"")) << said();
    EXPECT_TRUE(kLog->has("did you mean \"greeter\"?")) << kLog->all();
    EXPECT_THAT(client_->entities(), IsEmpty());
    EXPECT_THAT(told(), IsEmpty());
    const auto refused = client_->checkOut("greetr");
    ASSERT_FALSE(refused.ok());
    EXPECT_EQ(refused.refusal().code, RefusalCode::Unavailable);
    EXPECT_THAT(refused.refusal().message, HasSubstr("found there: \"greeter\""));
    EXPECT_FALSE(client_->waitFor("greetr", client::Seconds{0.01}).ok());
    // A stop reaches it all the same, and it answers.
    const auto receipts = client_->stop({});
    ASSERT_TRUE(receipts.ok()) << receipts.refusal().message;
    ASSERT_EQ(receipts->size(), 1U);
    EXPECT_TRUE(receipts->front().confirmed());
    EXPECT_TRUE(receipts->front().no_application);
}

TEST_F(PresenceTest, AnApplicationWithOneProfileIsSeenInInitAndIsTold) {
    startApplication(kBasic, nullptr);
    startManager("greeter");
    ASSERT_TRUE(shows(EntityState::INIT, "no services profile")) << said();
    EXPECT_TRUE(applicationLogged("no services profile; fix: "));
    const auto refused = client_->checkOut("greeter");
    ASSERT_FALSE(refused.ok());
    EXPECT_THAT(refused.refusal().message, HasSubstr("no services profile"));

    application_->uploadServiceProfile(file("services.xml", kServices));
    const auto ready = client_->waitFor("Greeter", client::Seconds{10});
    ASSERT_TRUE(ready.ok()) << said();
    EXPECT_TRUE(ready->ready);
    EXPECT_TRUE(waitUntil([&] { return !told().empty(); })) << "the callback's thread may be later";
    EXPECT_THAT(told(), ::testing::ElementsAre("joined Greeter"));
    EXPECT_TRUE(client_->checkOut("Greeter").ok());
}

TEST_F(PresenceTest, AnApplicationWhoseProfileIsBrokenFromTheBeginningIsSeenInErr) {
    startApplication(kBasic, "<ServiceProfile count='1'><Service/></ServiceProfile>");
    startManager("greeter");
    ASSERT_TRUE(shows(EntityState::ERR, "services.xml:1: error")) << said();
    EXPECT_TRUE(applicationLogged("services.xml:1: error"));
    EXPECT_THAT(client_->entities(), IsEmpty());
}

TEST_F(PresenceTest, AProfileThatIsEditedWhileTheEntityIsHeldArrivesAtItsRelease) {
    startApplication(kBasic, kServices);
    startManager("greeter");
    ASSERT_TRUE(client_->waitFor("Greeter", client::Seconds{10}).ok()) << said();
    const auto held = client_->checkOut("Greeter");
    ASSERT_TRUE(held.ok()) << held.refusal().message;
    application_->uploadBasicProfile(
        file("basic.xml",
             R"(<BasicProfile name="Greeter" category="MACHINE" type="STATIONARY" descr="greets better"/>)"));
    EXPECT_TRUE(applicationLogged("kept, and uploaded at its release"));
    EXPECT_EQ(client_->find("Greeter")->descr, "greets");
    ASSERT_TRUE(held->release().ok());
    EXPECT_TRUE(waitUntil([&] { return client_->find("Greeter")->descr == "greets better"; }));
    EXPECT_TRUE(applicationLogged("uploaded now, at the release"));
    ASSERT_TRUE(client_->waitFor("Greeter", client::Seconds{10}).ok());
    EXPECT_TRUE(client_->checkOut("Greeter").ok());
}

TEST_F(PresenceTest, AServerThatIsNotReachableIsReportedBeforeAnyApplicationIsThere) {
    client_.reset();
    server_.reset();
    entity_manager::EntityManagerCoreSettings core;
    core.application = "greeter";
    entity_manager::BackEndSettings link;
    link.application = "greeter";
    link.where = {{5500, 5600}, test::loopbackAddress()};
    createManager(core, EntityManager::overTcp(link, random_));
    manager_->start();
    EXPECT_TRUE(waitUntil([&] { return kLog->has("no session with the entity server"); })) << kLog->all();
}

}  // namespace
}  // namespace axon
