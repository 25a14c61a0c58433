// SPDX-License-Identifier: GPL-2.0-or-later
// The direct path: the client library, the servers and the real Entity Manager over loopback, and relays in
// the direct path's two connections that cut them or fall silent. All of that over plain TCP, and in a
// laboratory whose connections are TLS. And somebody who knocks at the Entity Manager's door without a right
// to.
#include <axon/directcomm.h>
#include <axon/messages.pb.h>
#include <gtest/gtest.h>

#include <axon/client.hpp>
#include <filesystem>
#include <future>
#include <map>
#include <optional>

#include "component/raw_check_out.hpp"
#include "component/raw_peers.hpp"
#include "component/with_manager.hpp"
#include "direct/proof.hpp"
#include "support/certificate_folder.hpp"
#include "support/lane_stranger.hpp"
#include "support/loopback.hpp"
#include "support/tcp_silence.hpp"
#include "support/tcp_valve.hpp"

namespace axon {
namespace {

using namespace std::chrono_literals;
using certificates::Kind;
using client::CheckOut;
using client::Client;
using test::LaneStranger;
using test::RawClient;
using test::TcpValve;
using test::waitUntil;

enum class Speaks { Plain, Tls };

/// What a program is configured with that uses this certificate.
std::map<std::string, std::string> propertiesOf(const std::filesystem::path& configuration) {
    const auto properties = Ice::createProperties();
    properties->load(configuration.string());
    return properties->getPropertiesForPrefix("Ice");
}

class DirectPathTest : public test::WithManager, public testing::WithParamInterface<Speaks> {
  protected:
    void SetUp() override { startServer(); }
    bool tls() const { return GetParam() == Speaks::Tls; }
    void startServer(server::ServerSettings settings = test::onLoopback()) {
        if (tls()) {
            laboratory_.emplace();
            settings.ice_properties =
                propertiesOf(laboratory_->issue(Kind::Server, {test::loopbackAddress()}));
            for (auto* endpoint : {&settings.client_endpoint, &settings.client_signal_endpoint,
                                   &settings.entity_endpoint, &settings.entity_signal_endpoint})
                *endpoint = "ssl://" + *endpoint;
            entityShows(Kind::Entity, "PeopleBot");
        }
        WithManager::startServer(std::move(settings));
    }
    /// Before its Entity Manager is there.
    void entityShows(Kind kind, const std::string& name) {
        ice_ = std::make_shared<entity_manager::ServerCommunicators>(
            1, 1, propertiesOf(laboratory_->issue(kind, {name})));
    }
    /// Clients are told of relays where the Entity Manager listens: first that of data, then that of signals.
    void startManager(bool offered = true, bool with_valves = true) {
        createManagerOfMemoryRobot(core_);
        entity_manager::DirectSettings direct;
        direct.offered = offered;
        if (with_valves) {
            direct.named = [this](const std::string& endpoint) {
                listens_at_.push_back(endpoint);
                valves_.push_back(std::make_unique<TcpValve>(endpoint));
                return valves_.back()->address();
            };
        }
        manager_->offerDirect(direct);
        manager_->start();
        ASSERT_TRUE(waitUntil([&] { return manager_->state() == EntityState::IDLE; }));
    }
    std::unique_ptr<Client> connect(bool direct = true, int paths = 64) {
        client::Options options;
        options.display_name = "client1@lab";
        options.direct = direct;
        options.direct_paths = paths;
        if (tls()) options.properties = propertiesOf(laboratory_->issue(Kind::Client, {"client1"}));
        auto client = connected(options);
        EXPECT_TRUE(client && client->waitFor("PeopleBot", client::Seconds{5}).ok());
        return client;
    }
    CheckOut take() {
        if (!client_) client_ = connect();
        auto held = client_->checkOut("PeopleBot");
        EXPECT_TRUE(held.ok()) << held.refusal().message;
        return held.value();
    }
    /// Both directions.
    bool direct(const CheckOut& held) const { return held.direct() && manager_->direct(); }
    std::uint64_t directBytes() const { return valves_.at(0)->bytes(); }
    void send(const CheckOut& held, const std::string& text) {
        ASSERT_TRUE(waitUntil([&] { return held.sendText(text).ok(); }));
    }

    std::optional<test::CertificateFolder> laboratory_;  // with TLS
    entity_manager::EntityManagerCoreSettings core_;     // of the Entity Manager
    std::vector<std::string> listens_at_;                // the Entity Manager, behind the valves
    std::vector<std::unique_ptr<TcpValve>> valves_;
};

TEST_P(DirectPathTest, AfterTheCheckOutMessagesOfBothDirectionsGoStraight) {
    startManager();
    const auto held = take();
    std::atomic<int> heard{0};
    held.onText([&](const std::string&) { ++heard; });
    ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    const auto before = directBytes();
    const std::string text(10000, 'x');
    send(held, text);
    ASSERT_TRUE(waitUntil([&] { return seen_.count() == 1; }));
    EXPECT_GT(directBytes(), before + 10000);
    robot_->text(text);
    ASSERT_TRUE(waitUntil([&] { return heard == 1; }));
    EXPECT_GT(directBytes(), before + 20000);
    EXPECT_EQ(seen_.texts.front(), text);
}

TEST_P(DirectPathTest, ACallbackThatDoesNotReturnHoldsUpNoAnswer) {
    startManager();
    const auto held = take();
    std::promise<void> entered, back;
    std::atomic<int> heard{0};
    held.onText([&](const std::string&) {
        if (++heard != 1) return;
        entered.set_value();
        back.get_future().wait();
    });
    ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    robot_->text("first");
    entered.get_future().wait();
    robot_->text("second");
    EXPECT_EQ(held.run("Fly").report().reason.code, RefusalCode::UnknownService);
    EXPECT_TRUE(direct(held)) << "the path ended instead";
    EXPECT_EQ(heard, 1) << "two callbacks at once";
    back.set_value();
    ASSERT_TRUE(waitUntil([&] { return heard == 2; }));
}

TEST_P(DirectPathTest, TasksAndTheirRefusalsAreTheSameByEitherWay) {
    startManager();
    for (const bool direct_way : {true, false}) {
        client_ = connect(direct_way);
        const auto held = take();
        if (direct_way) {
            ASSERT_TRUE(waitUntil([&] { return direct(held); }));
        }
        const auto before = directBytes();
        const auto task = held.run("Drive");
        ASSERT_TRUE(waitUntil([&] { return manager_->state() == EntityState::BUSY; }));
        EXPECT_EQ(directBytes() > before, direct_way);
        EXPECT_EQ(held.run("Fly").report().reason.code, RefusalCode::UnknownService);
        ASSERT_TRUE(client_->stop({"PeopleBot"}).ok());
        EXPECT_EQ(task.wait(client::Seconds{5}).state, client::TaskState::Stopped);
        EXPECT_EQ(held.run("Drive").wait(client::Seconds{5}).reason.code, RefusalCode::Latched);
        ASSERT_TRUE(client_->rearm("PeopleBot").ok());
        const auto again = held.run("Drive");
        ASSERT_TRUE(waitUntil([&] { return manager_->state() == EntityState::BUSY; }))
            << again.report().reason.message;
        ASSERT_TRUE(held.clear().ok());
        EXPECT_EQ(again.wait(client::Seconds{5}).state, client::TaskState::Stopped);
        ASSERT_TRUE(held.release().ok());
        EXPECT_EQ(held.sendText("?").refusal().code, RefusalCode::NotHolder);
        ASSERT_TRUE(waitUntil([&] { return manager_->state() == EntityState::IDLE; }));
        EXPECT_TRUE(waitUntil([&] { return !manager_->direct(); }));
    }
    EXPECT_EQ(seen_.tasks, 4);
}

TEST_P(DirectPathTest, EveryMessageComesOnceAndInOrderWhileThePathIsCutAndComesBack) {
    startManager();
    const auto held = take();
    std::mutex mutex;
    std::vector<std::string> heard;
    held.onText([&](const std::string& text) {
        const std::lock_guard lock(mutex);
        heard.push_back(text);
    });
    const auto heardCount = [&] {
        const std::lock_guard lock(mutex);
        return heard.size();
    };
    // From before the path is there, so that its beginning is among them.
    int sent = 0;
    const auto content = [](int number) {
        return std::to_string(number) + std::string(static_cast<std::size_t>(number % 700), '.');
    };
    const auto some = [&](int count) {
        for (int i = 0; i < count; ++i, ++sent) {
            send(held, content(sent));
            robot_->text(content(sent));
            if (sent % 256 == 0) {
                ASSERT_TRUE(waitUntil([&] {
                    return heardCount() + 1000 > static_cast<std::size_t>(sent);
                }));  // callbacks are bounded
            }
        }
    };
    some(500);
    for (int round = 0; round < 2; ++round) {
        ASSERT_TRUE(waitUntil([&] { return direct(held); }));
        const auto before = directBytes();
        some(400);
        EXPECT_GT(directBytes(), before);
        for (const auto& valve : valves_) valve->cut();  // in the middle of what is under way
        some(400);
        for (const auto& valve : valves_) valve->open();
    }
    ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    some(100);
    ASSERT_TRUE(waitUntil([&] {
        return seen_.count() >= static_cast<std::size_t>(sent) &&
               heardCount() >= static_cast<std::size_t>(sent);
    })) << seen_.count()
        << " and " << heardCount() << " of " << sent;
    for (int i = 0; i < sent; ++i) {
        ASSERT_EQ(seen_.texts.at(static_cast<std::size_t>(i)), content(i));
        ASSERT_EQ(heard.at(static_cast<std::size_t>(i)), content(i));
    }
    EXPECT_EQ(seen_.count(), static_cast<std::size_t>(sent));
    EXPECT_EQ(heardCount(), static_cast<std::size_t>(sent));
    EXPECT_EQ(held.entity().state, EntityState::REG) << "the lease has not noticed";
}

TEST_P(DirectPathTest, SilenceWhileATaskRunsFallsBackAndTheTaskGoesOn) {
    startManager();
    const auto held = take();
    ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    const auto task = held.run("Drive");
    ASSERT_TRUE(waitUntil([&] { return manager_->state() == EntityState::BUSY; }));
    for (const auto& valve : valves_) valve->hold(true);  // no end of a connection is told
    const auto begun = clock_.now();
    send(held, "client to robot");
    robot_->text("robot to client");
    std::atomic<bool> heard{false};
    held.onText([&](const std::string&) { heard = true; });
    ASSERT_TRUE(waitUntil([&] { return seen_.count() == 1 && !held.direct() && !manager_->direct(); }));
    EXPECT_GE(clock_.now() - begun, 100ms) << "by the direct path after all?";
    EXPECT_EQ(manager_->state(), EntityState::BUSY);
    EXPECT_EQ(seen_.stops, 0);
    EXPECT_EQ(task.report().state, client::TaskState::Running);
    // And back again.
    for (const auto& valve : valves_) valve->hold(false);
    EXPECT_TRUE(waitUntil([&] { return direct(held); }));
    EXPECT_EQ(seen_.count(), 1U);
}

TEST_P(DirectPathTest, TheSessionsWithTheServerKeepTheirShortWatchdogsFedBesideThePath) {
    auto settings = test::onLoopback();
    settings.front_end.watchdog_busy = 200ms;
    settings.front_end.watchdog_idle = 1000ms;
    startServer(settings);
    core_.server_watchdog_busy = 200ms;
    core_.server_watchdog_idle = 500ms;
    startManager();
    const auto held = take();
    std::atomic<int> lost{0};
    client_->onConnection([&](bool, const std::string&) { ++lost; });
    ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    const auto lives = [&](Duration time) {
        const auto end = clock_.now() + time;
        return waitUntil([&] { return clock_.now() > end || lost > 0; }) && lost == 0;
    };
    EXPECT_TRUE(lives(3s));
    const auto task = held.run("Drive");
    ASSERT_TRUE(waitUntil([&] { return manager_->state() == EntityState::BUSY; }));
    EXPECT_TRUE(lives(1s));
    EXPECT_EQ(task.report().state, client::TaskState::Running);
    ASSERT_TRUE(held.clear().ok());
    EXPECT_EQ(task.wait(client::Seconds{5}).state, client::TaskState::Stopped);
    EXPECT_TRUE(lives(3s));
    EXPECT_EQ(seen_.stops, 0);
    EXPECT_TRUE(direct(held));
}

TEST_P(DirectPathTest, SilenceOfAnIdlePathIsSeenByTheFirstMessageThatGoesIntoIt) {
    startManager();
    const auto held = take();
    std::atomic<bool> heard{false};
    held.onText([&](const std::string&) { heard = true; });
    ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    for (const bool to_robot : {true, false}) {
        for (const auto& valve : valves_) valve->hold(true);
        const auto begun = clock_.now();
        if (to_robot) {
            send(held, "client to robot");
        } else {
            robot_->text("robot to client");
        }
        ASSERT_TRUE(waitUntil([&] { return to_robot ? seen_.count() == 1 : heard.load(); }));
        EXPECT_LT(clock_.now() - begun, direct::kWatchdogIdle / 2) << "the idle watchdog is not waited for";
        for (const auto& valve : valves_) valve->hold(false);
        ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    }
    EXPECT_EQ(seen_.count(), 1U);
}

// The signal lane beats on, and neither end of the data lane is told anything. Only the kernel's half minute,
// which is shortened here, ends the path.
TEST_P(DirectPathTest, SilenceOfTheDataLaneAloneEndsThePathAndEverythingIsRelayed) {
    startManager();
    const auto held = take();
    std::atomic<int> heard{0};
    held.onText([&](const std::string&) { ++heard; });
    for (const bool to_robot : {true, false}) {
        ASSERT_TRUE(waitUntil([&] { return direct(held); }));
        const auto valve = valves_.at(0)->address(), manager = listens_at_.at(0);
        const int sender = to_robot ? test::socketBetween("", valve) : test::socketBetween(manager, "");
        const int receiver = to_robot ? test::socketBetween(valve, "") : test::socketBetween("", manager);
        ASSERT_TRUE(test::losePatienceAfter(sender, 100ms));
        ASSERT_TRUE(test::deafen(receiver));
        const auto signals = valves_.at(1)->bytes();
        for (int i = 0; i < 3; ++i) {
            if (to_robot) {
                send(held, "client to robot");
            } else {
                robot_->text("robot to client");
            }
        }
        const auto come = [&] { return to_robot ? seen_.count() == 3 : heard == 3; };
        ASSERT_TRUE(waitUntil(come)) << "through the servers";
        EXPECT_GT(valves_.at(1)->bytes(), signals) << "the signal lane lives";
    }
    ASSERT_TRUE(waitUntil([&] { return direct(held); })) << "another path";
    EXPECT_EQ(seen_.count(), 3U);
    EXPECT_EQ(heard, 3);
}

TEST_P(DirectPathTest, ReleaseAndTheNextCheckOutKeepTheirOrderThoughThePathIsSilent) {
    startManager();
    auto held = take();
    for (int round = 1; round <= 3; ++round) {
        ASSERT_TRUE(waitUntil([&] { return direct(held); }));
        valves_.at(0)->hold(true);
        send(held, "the last words");
        ASSERT_TRUE(held.release().ok());
        held = take();
        send(held, "the first ones");
        ASSERT_TRUE(waitUntil([&] { return seen_.count() == 2U * static_cast<std::size_t>(round); }));
        valves_.at(0)->hold(false);
    }
    for (std::size_t i = 0; i < 6; ++i)
        EXPECT_EQ(seen_.texts.at(i), i % 2 == 0 ? "the last words" : "the first ones");
}

// While the application's lock is held, so is the Entity Manager's only thread. On a machine that is short of
// processors the path's watchdog may rightly end the path meanwhile; that says nothing of what is held back,
// so it is tried again. Nothing is lost either way.
TEST_P(DirectPathTest, WhoSendsFasterThanIsHandledIsHeldBackAndLosesNothing) {
    startManager();
    const auto held = take();
    std::size_t sent = 0;
    bool held_back = false;
    const auto content = [](std::size_t number) { return std::to_string(number) + std::string(2000, '.'); };
    for (int tries = 0; tries < 5 && !held_back; ++tries) {
        ASSERT_TRUE(waitUntil([&] { return direct(held); }));
        const auto before = sent;
        auto last = Result<void>();
        {
            const std::lock_guard slow(seen_.mutex);  // the strand waits for the application
            for (; held.direct() && sent < before + 100'000; ++sent) {
                last = held.sendText(content(sent));
                if (!last.ok()) break;
            }
        }
        ASSERT_TRUE(waitUntil([&] { return seen_.count() >= sent; })) << seen_.count() << " of " << sent;
        if (last.ok() || !direct(held)) continue;
        EXPECT_EQ(last.refusal().code, RefusalCode::Overloaded);
        EXPECT_GT(sent - before, 4096U) << "more than may wait for the strand";
        held_back = true;
    }
    EXPECT_TRUE(held_back) << "neither the path nor the session was given up";
    ASSERT_EQ(seen_.count(), sent);
    for (std::size_t i = 0; i < sent; ++i) ASSERT_EQ(seen_.texts.at(i), content(i));
}

TEST_P(DirectPathTest, NoMorePathsThanMayBe) {
    startManager();
    client_ = connect(true, 0);
    const auto held = take();
    send(held, "relayed");
    ASSERT_TRUE(waitUntil([&] { return seen_.count() == 1; }));
    EXPECT_FALSE(held.direct() || manager_->direct());
    EXPECT_EQ(directBytes(), 0U);
}

TEST_P(DirectPathTest, AResetThatComesByAllWaysCountsOnce) {
    startManager();
    const auto held = take();
    ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    const auto first = held.run("Drive");
    const auto second = held.run("Drive");
    ASSERT_TRUE(waitUntil([&] {
        return first.report().state == client::TaskState::Running &&
               second.report().state == client::TaskState::Queued;
    }));
    const auto before = valves_.at(1)->bytes();
    ASSERT_TRUE(held.reset().ok());
    EXPECT_EQ(first.wait(client::Seconds{5}).state, client::TaskState::Stopped);
    ASSERT_TRUE(waitUntil([&] { return second.report().state == client::TaskState::Running; }));
    EXPECT_TRUE(waitUntil([&] { return valves_.at(1)->bytes() > before + 50; }))
        << "by the direct signal lane too";
    send(held, "later than both, by either way");
    ASSERT_TRUE(waitUntil([&] { return seen_.count() == 1; }));
    EXPECT_EQ(second.report().state, client::TaskState::Running)
        << "the second copy of the reset must not end it";
}

TEST_P(DirectPathTest, AStopGoesByAllWaysAndIsExecutedOnce) {
    startManager();
    const auto held = take();
    ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    for (int i = 1; i <= 20; ++i) {
        const auto before = valves_.at(1)->bytes();
        const auto receipts = i % 2 == 0 ? client_->stop({"PeopleBot"}) : client_->stop({});
        ASSERT_TRUE(receipts.ok()) << receipts.refusal().message;
        ASSERT_EQ(receipts.value().size(), 1U);
        EXPECT_TRUE(receipts.value().front().confirmed());
        EXPECT_TRUE(waitUntil([&] { return valves_.at(1)->bytes() > before + 100; }))
            << "by the direct signal lane too";
        EXPECT_EQ(seen_.stops, i);
    }
}

TEST_P(DirectPathTest, EachStageOfAReceiptReachesTheHolderByTheDirectPath) {
    startManager();
    const auto held = take();
    ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    seen_.rolls = true;
    const auto task = held.run("Drive");
    ASSERT_TRUE(waitUntil([&] { return task.report().state == client::TaskState::Running; }));
    const auto receipts = client_->stop({"PeopleBot"}, client::Seconds{1}, client::Seconds{5});
    ASSERT_TRUE(receipts.ok()) << receipts.refusal().message;
    ASSERT_EQ(receipts->size(), 1U);
    EXPECT_TRUE(receipts->front().standstill);
    EXPECT_TRUE(receipts->front().atRest());
}

TEST_P(DirectPathTest, TheEndOfTheLeaseEndsThePathAndTheNextHolderHasItsOwn) {
    startManager();
    const auto held = take();
    ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    auto other = connect();
    ASSERT_TRUE(held.release().ok());
    EXPECT_FALSE(held.direct());
    auto theirs = other->checkOut("PeopleBot");
    ASSERT_TRUE(theirs.ok()) << theirs.refusal().message;
    ASSERT_TRUE(waitUntil([&] { return direct(theirs.value()); }));
    EXPECT_FALSE(held.direct());
    ASSERT_TRUE(theirs->sendText("mine").ok());
    ASSERT_TRUE(waitUntil([&] { return seen_.count() == 1; }));
}

TEST_P(DirectPathTest, TheEndOfTheSessionWithTheServerEndsThePath) {
    startManager();
    const auto held = take();
    ASSERT_TRUE(waitUntil([&] { return direct(held); }));
    server_.reset();
    EXPECT_TRUE(waitUntil([&] { return !held.direct() && !manager_->direct(); }));
    EXPECT_EQ(held.sendText("?").refusal().code, RefusalCode::NotConnected);
    EXPECT_EQ(seen_.count(), 0U);
}

TEST_P(DirectPathTest, ThereIsNoneWhereEitherSideHasItSwitchedOff) {
    startManager();
    client_ = connect(false);
    {
        const auto held = take();
        send(held, "relayed");
        ASSERT_TRUE(waitUntil([&] { return seen_.count() == 1; }));
        EXPECT_FALSE(held.direct() || manager_->direct());
        EXPECT_EQ(directBytes(), 0U);
    }
    client_.reset();
    manager_->stop();
    robot_->awaitQuiet();
    manager_.reset();
    startManager(false);
    const auto held = take();
    send(held, "relayed");
    ASSERT_TRUE(waitUntil([&] { return seen_.count() == 2; }));
    EXPECT_FALSE(held.direct() || manager_->direct());
}

INSTANTIATE_TEST_SUITE_P(, DirectPathTest, testing::Values(Speaks::Plain, Speaks::Tls),
                         [](const auto& one) { return one.param == Speaks::Tls ? "Tls" : "Plain"; });

/// In a laboratory with TLS.
class SecuredPathTest : public DirectPathTest {};
INSTANTIATE_TEST_SUITE_P(, SecuredPathTest, testing::Values(Speaks::Tls), [](const auto&) { return "Tls"; });

TEST_P(SecuredPathTest, NothingOfWhatIsSaidGoesInClear) {
    startManager(true, false);
    const auto endpoint = [&] {
        RawClient raw(server_->clientAddress(Lane::Data), "x@lab", false, "", "",
                      propertiesOf(laboratory_->issue(Kind::Client, {"client1"})));
        const auto granted = test::checkOut(raw, manager_->uuid(), random_);
        EXPECT_EQ(granted.direct_endpoint().rfind("ssl://127.", 0), 0U) << granted.direct_endpoint();
        EXPECT_EQ(granted.direct_signal_endpoint().rfind("ssl://127.", 0), 0U);
        return granted.direct_endpoint().substr(std::string("ssl://").size());
    }();
    LaneStranger plain(endpoint);
    plain.say("anybody there?\r\n");
    EXPECT_FALSE(plain.awaitFrame()) << "not even a nonce";
}

TEST_P(SecuredPathTest, AClientWithoutTheHoldersKeyIsRefusedWhateverItsCertificate) {
    startManager(true, false);
    RawClient raw(server_->clientAddress(Lane::Data), "x@lab", false, "", "",
                  propertiesOf(laboratory_->issue(Kind::Client, {"client1"})));
    const auto granted = test::checkOut(raw, manager_->uuid(), random_);
    const auto endpoint = granted.direct_endpoint().substr(std::string("ssl://").size());
    for (const auto kind : {Kind::Client, Kind::Entity, Kind::Server}) {
        const auto tls =
            direct::lane::Tls::of(laboratory_->credentials(kind, "client1"), test::CertificateFolder::now);
        const direct::Claim claim{Lane::Data,
                                  {static_cast<std::int32_t>(granted.lease().epoch()),
                                   static_cast<std::int32_t>(granted.lease().number())},
                                  Id128::parse(raw.facts.me.id).value(),
                                  Id128::random(random_),
                                  {}};
        LaneStranger knocks(endpoint, tls.get(), "PeopleBot");
        ASSERT_TRUE(knocks.channelOpen());
        knocks.claim = claim;
        knocks.awaitNonce();
        EXPECT_EQ(knocks.open(Id128::random(random_).bytes()), RefusalCode::PermissionDenied);
        LaneStranger holder(endpoint, tls.get(), "PeopleBot");
        holder.claim = claim;
        holder.awaitNonce();
        EXPECT_EQ(holder.open(granted.lease().key()), RefusalCode::Ok);
    }
    const test::CertificateFolder others;
    auto stranger = others.credentials(Kind::Client, "client1");
    stranger.authorities = laboratory_->credentials(Kind::Client, "client1").authorities;
    const auto tls = direct::lane::Tls::of(stranger, test::CertificateFolder::now);
    LaneStranger knocks(endpoint, tls.get(), "PeopleBot");
    EXPECT_TRUE(knocks.awaitClosed());
}

// The servers have let it in, and it has not checked what it is told.
TEST_P(SecuredPathTest, WithoutACertificateThatGnuTlsReadsEverythingIsRelayed) {
    auto properties = propertiesOf(laboratory_->issue(Kind::Client, {"client1"}));
    const std::filesystem::path folder = properties["IceSSL.DefaultDir"];
    properties["IceSSL.CAs"] = folder.string();  // IceSSL looks for its CAs in a folder, too
    properties["IceSSL.VerifyPeer"] = "0";
    startManager();
    client::Options options;
    options.display_name = "client1@lab";
    options.properties = properties;
    client_ = connected(options);
    ASSERT_TRUE(client_ && client_->waitFor("PeopleBot", client::Seconds{5}).ok());
    const auto held = take();
    send(held, "relayed");
    ASSERT_TRUE(waitUntil([&] { return seen_.count() == 1; }));
    EXPECT_FALSE(held.direct());
    EXPECT_EQ(directBytes(), 0U);
}

/// Peers without our library, over plain TCP.
class PlainPathTest : public DirectPathTest {};
INSTANTIATE_TEST_SUITE_P(, PlainPathTest, testing::Values(Speaks::Plain),
                         [](const auto&) { return "Plain"; });

namespace slice = ::Axon::DirectComm;

/// At the port of signals.
class Stranger {
  public:
    explicit Stranger(const std::string& endpoint)
        : communicator_(transport::makeCommunicator({"stranger", Lane::Data, 1, 1, {}})),
          gate_(Ice::uncheckedCast<slice::DirectGatePrx>(
              communicator_->stringToProxy("DirectGate:" + transport::tcpEndpoint(endpoint)))) {
        const auto adapter = communicator_->createObjectAdapter("");
        adapter->activate();
        callback_ =
            Ice::uncheckedCast<slice::DirectCallbackPrx>(adapter->addWithUUID(std::make_shared<Deaf>()));
        gate_->ice_ping();
        gate_->ice_getCachedConnection()->setAdapter(adapter);
    }
    void challenge() {
        const auto nonce = gate_->challenge();
        claim.nonce = Id128::fromBytes({reinterpret_cast<const char*>(nonce.data()), nonce.size()}).value();
    }
    /// How it is refused; Ok when it is not.
    RefusalCode open(const std::string& key) {
        const auto proof = direct::proofOf(claim, direct::Prover::Client, key);
        slice::Opening opening;
        opening.lane = transport::toIce(claim.lane);
        opening.held = {claim.lease.epoch, claim.lease.number};
        opening.client = claim.client.toString();
        const auto path = claim.path.bytes();
        opening.path.assign(path.begin(), path.end());
        opening.proof.assign(proof.begin(), proof.end());
        try {
            opened = gate_->open(opening, callback_);
            return RefusalCode::Ok;
        } catch (const Axon::CommUtil::RequestRefused& refused) {
            return static_cast<RefusalCode>(refused.code);
        }
    }
    direct::Claim claim;
    slice::Opened opened;

  private:
    class Deaf final : public slice::DirectCallback {
        void newEntityMsg(slice::Head, transport::ByteRange, const Ice::Current&) override {}
        void newHeartbeat(double, bool, const Ice::Current&) override {}
    };
    Ice::CommunicatorHolder communicator_;
    std::shared_ptr<slice::DirectGatePrx> gate_;
    std::shared_ptr<slice::DirectCallbackPrx> callback_;
};

TEST_P(PlainPathTest, OnlyTheHolderWithTheKeyIsLetIn) {
    startManager(true, false);
    RawClient raw(server_->clientAddress(Lane::Data));
    const auto granted = test::checkOut(raw, manager_->uuid(), random_);
    ASSERT_FALSE(granted.direct_endpoint().empty());
    ASSERT_NE(granted.direct_endpoint(), granted.direct_signal_endpoint());
    const auto key = granted.lease().key();
    const LeaseNumber lease{static_cast<std::int32_t>(granted.lease().epoch()),
                            static_cast<std::int32_t>(granted.lease().number())};

    direct::Claim right{Lane::Data, lease, Id128::parse(raw.facts.me.id).value(), Id128::random(random_), {}};
    const auto refused = [&](const direct::Claim& claim, const std::string& its_key) {
        LaneStranger knocks(granted.direct_endpoint());
        knocks.claim = claim;
        knocks.awaitNonce();
        const auto code = knocks.open(its_key);
        EXPECT_TRUE(knocks.awaitClosed()) << "a connection is for one try";
        return code;
    };
    EXPECT_EQ(refused(right, Id128::random(random_).bytes()), RefusalCode::PermissionDenied);
    auto wrong = right;
    ++wrong.lease.number;
    EXPECT_EQ(refused(wrong, key), RefusalCode::PermissionDenied);
    wrong = right;
    wrong.client = Id128::uuid(random_);
    EXPECT_EQ(refused(wrong, key), RefusalCode::PermissionDenied);
    wrong = right;
    wrong.lane = Lane::Signal;
    EXPECT_EQ(refused(wrong, key), RefusalCode::PermissionDenied) << "the proof is for the other port";
    wrong = right;
    wrong.path = Id128{};
    EXPECT_EQ(refused(wrong, key), RefusalCode::Malformed);
    {
        LaneStranger first(granted.direct_endpoint()), second(granted.direct_endpoint());
        first.claim = second.claim = right;
        const auto nonce = first.awaitNonce();
        EXPECT_NE(second.awaitNonce(), nonce);
        second.claim.nonce = nonce;
        EXPECT_EQ(second.open(key), RefusalCode::PermissionDenied) << "a nonce is its connection's";
    }
    {
        Stranger signals(granted.direct_signal_endpoint());
        const auto set = [&] {
            signals.claim = right;
            signals.claim.lane = Lane::Signal;
        };
        set();
        EXPECT_EQ(signals.open(key), RefusalCode::WrongState) << "without a challenge";
        signals.challenge();
        EXPECT_EQ(signals.open(Id128::random(random_).bytes()), RefusalCode::PermissionDenied);
        EXPECT_EQ(signals.open(key), RefusalCode::WrongState) << "a nonce is for one try";
        signals.challenge();
        signals.claim.lane = Lane::Data;
        EXPECT_EQ(signals.open(key), RefusalCode::Malformed) << "the other port is for that";
        set();
        signals.challenge();
        signals.claim.path = Id128{};
        EXPECT_EQ(signals.open(key), RefusalCode::Malformed);
        set();
        signals.challenge();
        EXPECT_EQ(signals.open(key), RefusalCode::WrongState) << "a signal lane alone";
    }
    EXPECT_FALSE(manager_->direct());

    LaneStranger knocks(granted.direct_endpoint());
    knocks.claim = right;
    knocks.awaitNonce();
    ASSERT_EQ(knocks.open(key), RefusalCode::Ok);
    EXPECT_TRUE(direct::proves(knocks.proof, knocks.claim, direct::Prover::EntityManager, key));
    // Half a path is none: what goes by it waits for ever.
    EXPECT_FALSE(manager_->direct());
    // A path is its connections' alone.
    LaneStranger thief(granted.direct_endpoint());
    thief.awaitNonce();
    thief.send(direct::Keeping::Kept, {}, "x");
    EXPECT_EQ(thief.awaitAnswer(), RefusalCode::Malformed);
    EXPECT_TRUE(thief.awaitClosed());

    // After the end of the lease the key opens nothing.
    proto::ToEntity body;
    body.mutable_release();
    auto head = raw.headTo(manager_->uuid(), 2);
    head.msg_type = kMsgRelease;
    head.held = lease;
    const auto bytes = body.SerializeAsString();
    raw.data()->sendToEntity(transport::toIce(head), transport::toRange(bytes));
    ASSERT_TRUE(waitUntil([&] { return manager_->state() == EntityState::IDLE; }));
    EXPECT_EQ(refused(right, key), RefusalCode::PermissionDenied);
}

// The servers keep the record of who rearmed.
TEST_P(PlainPathTest, ARearmEndsThePathThatBringsIt) {
    startManager(true, false);
    RawClient raw(server_->clientAddress(Lane::Data));
    const auto granted = test::checkOut(raw, manager_->uuid(), random_);
    LaneStranger data(granted.direct_endpoint());
    Stranger signals(granted.direct_signal_endpoint());
    const auto path = Id128::random(random_);
    data.claim = {Lane::Data,
                  {static_cast<std::int32_t>(granted.lease().epoch()),
                   static_cast<std::int32_t>(granted.lease().number())},
                  Id128::parse(raw.facts.me.id).value(),
                  path,
                  {}};
    data.awaitNonce();
    ASSERT_EQ(data.open(granted.lease().key()), RefusalCode::Ok);
    signals.claim = data.claim;
    signals.claim.lane = Lane::Signal;
    signals.challenge();
    ASSERT_EQ(signals.open(granted.lease().key()), RefusalCode::Ok);
    proto::ToEntity mark;
    mark.mutable_way()->set_path(path.bytes());
    auto head = raw.headTo(manager_->uuid(), 900);
    head.msg_type = kMsgWay;
    head.held = data.claim.lease;
    const auto bytes = mark.SerializeAsString();
    raw.data()->sendToEntity(transport::toIce(head), transport::toRange(bytes));
    std::int64_t sequence = 1000;
    const auto send = [&](const char* msg_type, const proto::ToEntity& message) {
        Header its;
        its.msg_type = msg_type;
        its.held = data.claim.lease;
        its.stop_generation = 1;
        its.sequence = ++sequence;
        data.send(direct::Keeping::Kept, its, message.SerializeAsString());
    };
    client_ = connect(false);
    ASSERT_TRUE(client_->stop({"PeopleBot"}).ok());
    const auto latched = [&] { return client_->find("PeopleBot").value().latched; };
    ASSERT_TRUE(waitUntil(latched));
    proto::ToEntity text;
    text.mutable_text()->set_text("by the path");
    send(kMsgText, text);
    ASSERT_TRUE(waitUntil([&] { return seen_.count() == 1; })) << "the mark has come, and the path stands";
    ASSERT_TRUE(manager_->direct());

    proto::ToEntity rearm;
    rearm.mutable_rearm()->set_request_id("r");
    send(kMsgRearm, rearm);
    ASSERT_TRUE(waitUntil([&] { return !manager_->direct(); }));
    ASSERT_TRUE(client_->stop({"PeopleBot"}).ok()) << "after which all that came before has been handled";
    EXPECT_TRUE(latched());
    head.sequence = 1100;
    head.msg_type = kMsgRearm;
    head.stop_generation = 2;
    const auto openly = rearm.SerializeAsString();
    raw.data()->sendToEntity(transport::toIce(head), transport::toRange(openly));
    EXPECT_TRUE(waitUntil([&] { return !latched(); }));
}

}  // namespace
}  // namespace axon
