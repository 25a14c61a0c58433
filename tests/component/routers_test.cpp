// SPDX-License-Identifier: GPL-2.0-or-later
// A server behind real glacier2router processes, with peers that speak the bare contracts and with an Entity
// Manager's way to the server.
#include <gtest/gtest.h>

#include <fcntl.h>
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <Glacier2/Router.h>
#include <axon/messages.pb.h>
#include <axon/profile.pb.h>
#include <spdlog/spdlog.h>
#include <asio/io_context.hpp>
#include <asio/post.hpp>
#include <asio/strand.hpp>
#include <chrono>
#include <fstream>
#include <optional>
#include <sstream>
#include <thread>

#include "common/release.hpp"
#include "component/raw_peers.hpp"
#include "entity_manager/links/server/entity_communicator.hpp"
#include "entity_manager/links/server/server_communicators.hpp"
#include "server/server.hpp"
#include "support/log_lines.hpp"
#include "support/loopback.hpp"

namespace axon::test {
namespace {

using namespace std::chrono_literals;

constexpr const char* kEntity = "00000000-0000-4000-8000-000000000001";

/// The example configuration at addresses of this test's own.
class Router {
  public:
    explicit Router(const std::string& server) {
        static int number = 0;
        file_ = testing::TempDir() + "router-" + std::to_string(::getpid()) + "-" + std::to_string(++number) +
                ".cfg";
        const auto host = loopbackAddress();
        const auto port = std::to_string(20000 + (::getpid() * 7 + number * 2) % 10000);
        std::stringstream example;
        example << std::ifstream(ROUTER_CONFIGURATION).rdbuf();
        auto text = example.str();
        const auto put = [&](const std::string& usual, const std::string& ours) {
            for (auto at = text.find(usual); at != std::string::npos; at = text.find(usual, at + ours.size()))
                text.replace(at, usual.size(), ours);
        };
        put("tcp -h 127.0.0.1 -p 10414", "tcp -h " + host + " -p " + port);
        put("tcp -h 127.0.0.1 -p 10415", "tcp -h " + host + " -p " + std::to_string(std::stoi(port) + 1));
        put("tcp -h 127.0.0.1 -p 10416", transport::tcpEndpoint(server));
        std::ofstream(file_) << text;
        proxy = "Axon.Clients/router:tcp -h " + host + " -p " + port;
        std::string program = GLACIER2ROUTER;
        std::string config = "--Ice.Config=" + file_;
        char* words[] = {program.data(), config.data(), nullptr};
        EXPECT_EQ(::posix_spawn(&pid, program.c_str(), nullptr, nullptr, words, environ), 0);
        const auto holder = transport::makeCommunicator({"probe", Lane::Data, 1, 1, {}});
        EXPECT_TRUE(waitUntil([&] {
            try {
                holder->stringToProxy(proxy)->ice_getConnection();
                return true;
            } catch (const Ice::Exception&) {
                return false;
            }
        })) << "the router listens";
    }
    ~Router() {
        kill();
        std::remove(file_.c_str());
    }
    void kill() {
        if (pid <= 0) return;
        ::kill(pid, SIGKILL);
        ::waitpid(pid, nullptr, 0);
        pid = 0;
    }
    long residentKib() const {
        std::ifstream status("/proc/" + std::to_string(pid) + "/status");
        for (std::string word; status >> word;) {
            if (word == "VmRSS:" && status >> word) return std::stol(word);
        }
        return 0;
    }

    std::string proxy;
    pid_t pid = 0;

  private:
    std::string file_;
};

server::ServerSettings settings(const std::string& name = {}) {
    server::ServerSettings its;
    const auto any_port = loopbackAddress() + ":0";
    its.client_endpoint = its.client_signal_endpoint = its.client_router_endpoint = any_port;
    its.entity_endpoint = its.entity_signal_endpoint = its.entity_router_endpoint = any_port;
    its.name = name;
    return its;
}

class BehindARouter : public testing::Test {
  protected:
    void SetUp() override {
        robot.join();
        robot.status(EntityState::IDLE);
    }
    RawClient::Routers both() const { return {router.proxy, router.proxy}; }

    server::Server server{settings()};
    Router router{server.clientRouterAddress()};
    RawEntity robot{server.entityAddress(Lane::Data), kEntity};
};

TEST_F(BehindARouter, MessagesAndStopsGoBothWays) {
    RawClient client(both());
    EXPECT_EQ(static_cast<Role>(client.facts.me.role), Role::Operator) << "whoever runs the router";
    EXPECT_EQ(client.facts.me.name, "client1@lab");
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("status ") + kEntity + " IDLE"); }));
    for (int i = 0; i < 300; ++i) client.text(kEntity, std::to_string(i), i + 1);
    ASSERT_TRUE(waitUntil([&] { return robot.log.count("msg ") == 300; }));
    int expected = 0;
    for (const auto& line : robot.log.lines()) {
        if (line.rfind("msg ", 0) != 0) continue;
        EXPECT_EQ(line, "msg client1@lab TEXT " + std::to_string(expected++));
    }
    auto head = robot.headTo(client.facts.me.id);
    for (int i = 0; i < 300; ++i)
        robot.dataOneway()->sendToClient(transport::toIce(head), toRange(std::to_string(i)));
    ASSERT_TRUE(waitUntil([&] { return client.log.count("data msg ") == 300; }));
    expected = 0;
    for (const auto& line : client.log.lines()) {
        if (line.rfind("data msg ", 0) != 0) continue;
        EXPECT_EQ(line, std::string("data msg ") + kEntity + " " + std::to_string(expected++));
    }
    client.stop(kEntity);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop requested client1@lab"); }));
    EXPECT_TRUE(waitUntil([&] { return client.log.has("signal stop accepted for 1"); }));
}

TEST_F(BehindARouter, TheServerTellsItsReleaseAndHearsThatOfTheClient) {
    const auto lines = std::make_shared<LogLines>();
    const auto before = spdlog::default_logger();
    spdlog::set_default_logger(std::make_shared<spdlog::logger>("", lines));
    const auto communicator = transport::makeCommunicator({});
    auto context = transport::contractContext();
    context[transport::kContextRelease] = "7.1";
    Ice::uncheckedCast<Glacier2::RouterPrx>(communicator->stringToProxy(router.proxy))
        ->createSession("client1", "secret1", context);
    spdlog::set_default_logger(before);
    EXPECT_TRUE(lines->has("connected with a client of release 7.1, this server has ")) << lines->all();
    const RawClient client(both());
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("signal heartbeat of ") + kRelease); }));
}

TEST_F(BehindARouter, LeaveIsTheOrderlyEndAndDestroyMeansLost) {
    {
        RawClient client(both());
        robot.status(EntityState::REG, client.facts.me.id);
        client.data()->leave();
        EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal client ended"); }));
        EXPECT_FALSE(robot.log.has("signal stop"));
    }
    RawClient client(both());
    robot.status(EntityState::REG, client.facts.me.id);
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("status ") + kEntity + " REG"); }));
    client.data()->destroy();
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop client"); }));
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal client lost"); }));
}

TEST_F(BehindARouter, ARouterThatDiesLosesAllOfItsClients) {
    RawClient first(both());
    RawClient second(both());
    RawClient direct(server.clientAddress(Lane::Data));
    robot.status(EntityState::REG, second.facts.me.id);
    EXPECT_TRUE(waitUntil([&] { return first.log.has(std::string("status ") + kEntity + " REG"); }));
    EXPECT_EQ(server.frontEndCore().clients(), 3U);
    router.kill();
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop client"); }));
    EXPECT_TRUE(waitUntil([&] { return server.frontEndCore().clients() == 1; }));
}

TEST_F(BehindARouter, NobodyMayCallAnythingButHisOwnSession) {
    RawClient client(both());
    RawClient other(both());
    const auto connection = client.data()->ice_getConnection();
    const auto call = [&](const Ice::Identity& identity) { connection->createProxy(identity)->ice_ping(); };
    EXPECT_NO_THROW(call(client.data()->ice_getIdentity()));
    EXPECT_THROW(call(other.data()->ice_getIdentity()), Ice::ObjectNotExistException);
    EXPECT_THROW(call(Ice::stringToIdentity("ClientGate")), Ice::ObjectNotExistException);
    EXPECT_THROW(call(Ice::stringToIdentity("SessionManager")), Ice::ObjectNotExistException);
}

/// In KiB of each message, and how many of them: 125 MiB of those that are answered each, and 31 MiB of those
/// of which one in some is.
class BehindARouterWithData : public BehindARouter,
                              public testing::WithParamInterface<std::pair<int, int>> {};
INSTANTIATE_TEST_SUITE_P(Data, BehindARouterWithData,
                         testing::Values(std::pair{64, 2000}, std::pair{4, 8000}));

TEST_P(BehindARouterWithData, AClientThatDoesNotReadCostsTheRouterLittleMemoryAndIsServedAgainWhenItDoes) {
    const int kib = GetParam().first, chunks = GetParam().second;
    RawClient slow(both());
    RawClient good(both());
    auto head = robot.headTo(slow.facts.me.id);
    const std::string chunk(static_cast<std::size_t>(kib) * 1024, 'x');
    const auto before = router.residentKib();
    ASSERT_GT(before, 0);
    slow.stalled = true;
    for (int i = 1; i <= chunks; ++i) {
        head.sequence = i;
        robot.data()->sendToClientDataSeq(transport::toIce(head), toRange(chunk));
    }
    const auto grown = router.residentKib() - before;
    EXPECT_LT(grown, 16 * 1024) << "KiB, for what waits for one client";
    robot.dataOneway()->sendToClient(transport::toIce(robot.headTo(good.facts.me.id)), toRange("you"));
    EXPECT_TRUE(waitUntil([&] { return good.log.has("data msg"); })) << "others do not wait";
    slow.stalled = false;
    slow.stalled.notify_all();
    EXPECT_TRUE(waitUntil([&] { return slow.log.has("data " + std::to_string(chunks)); }))
        << "the newest has come";
    RecordProperty("grown_kib", static_cast<int>(grown));
}

TEST(TwoServersBehindRouters, TheSecondSessionGoesToTheServerThatHasTheFirst) {
    const server::Server first(settings("fe1"));
    auto of_second = settings("fe2");
    of_second.neighbours["fe1"] = "SessionManager:" + transport::tcpEndpoint(first.clientRouterAddress());
    const server::Server second(of_second);
    const Router to_first(first.clientRouterAddress());
    const Router to_second(second.clientRouterAddress());
    RawEntity robot(first.entityAddress(Lane::Data), kEntity);
    robot.join();
    RawClient client(RawClient::Routers{to_first.proxy, to_second.proxy});
    EXPECT_EQ(client.facts.token.rfind("fe1/", 0), 0U) << client.facts.token;
    client.stop(kEntity);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop requested"); }));
    EXPECT_TRUE(waitUntil([&] { return client.log.has("signal stop accepted for 1"); }));
    try {
        const RawClient lost(RawClient::Routers{to_second.proxy, to_first.proxy});
        FAIL() << "the first server knows no fe2";
    } catch (const std::exception&) {
        const auto refusal = transport::translate(std::current_exception());
        EXPECT_NE(refusal.message.find("Server.Peer.fe2"), std::string::npos) << refusal.message;
    }
}

/// Of an Entity Manager whose entity is registered as soon as there is a session.
class Registering final : public entity_manager::ServerEvents {
  public:
    void serverUp() override {
        Registration registration;
        registration.entity = kEntity;
        registration.name = "Robot";
        way->sendBasicPrfl(registration, {});
    }
    void serverDown(const std::string&) override {}
    void clientMsg(Lane, Header head, std::string) override { log.add("msg " + head.sender.name); }
    void clientMsgDataSeq(Header, std::string) override {}
    void stopSignal(Header, StopCause) override { log.add("stop"); }
    void resetSignal(Header) override {}
    void clearSignal(Header) override {}
    void clientUpdate(Header, ClientChange) override {}
    void serverHeartbeat() override {}
    void undeliverable(Lane, Header, const Refusal&) override {}

    Log log;
    std::unique_ptr<entity_manager::EntityCommunicator> way;  // of the strand
};

TEST(AnEntityManagerBehindARouter, SendsInItsOrderAndItsLeaveComesAfterAllOfIt) {
    const server::Server server(settings());
    const Router router(server.entityRouterAddress());
    RawClient client(server.clientAddress(Lane::Data));
    const SteadyClock clock{};
    asio::io_context executor;
    const auto work = asio::make_work_guard(executor);
    const auto strand = asio::make_strand(executor);
    std::thread thread([&] { executor.run(); });
    const auto ice = std::make_shared<entity_manager::ServerCommunicators>();
    const auto manager = std::make_shared<Registering>();
    entity_manager::ServerAddress address;
    address.user = address.password = "robot";
    address.router = router.proxy;
    asio::post(strand, [&] {
        manager->way =
            std::make_unique<entity_manager::EntityCommunicator>(strand, ice, address, clock, manager);
        manager->way->wantConnection(true);
    });
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("joined Robot ") + kEntity); }));
    client.text(kEntity, "hello");
    client.stop(kEntity);
    EXPECT_TRUE(waitUntil([&] { return manager->log.has("msg client1@lab") && manager->log.has("stop"); }));

    Header head;
    head.sender.id = client.facts.me.id;
    head.msg_type = kMsgText;
    asio::post(strand, [&] {
        EntityStatus status;
        status.entity = kEntity;
        status.state = EntityState::IDLE;
        manager->way->sendStatus(status);
        manager->way->sendToClientBytes(Lane::Signal, head, "receipt");
    });
    EXPECT_TRUE(waitUntil([&] {
        return client.log.has(std::string("status ") + kEntity + " IDLE") &&
               client.log.has(std::string("signal msg ") + kEntity + " receipt");
    }));

    constexpr int kMessages = 300;  // 2.3 MiB: nine windows of the outbox
    asio::post(strand, [&] {
        for (int i = 0; i < kMessages; ++i)
            manager->way->sendToClientBytes(Lane::Data, head,
                                            std::to_string(i) + " " + std::string(8000, 'x'));
        manager->way->wantConnection(false);
    });
    EXPECT_TRUE(waitUntil([&] { return client.log.has("left Robot"); }));
    int expected = 0;
    for (const auto& line : client.log.lines()) {
        if (line.rfind("data msg ", 0) != 0) continue;
        const auto beginning = std::string("data msg ") + kEntity + " " + std::to_string(expected++) + " ";
        EXPECT_EQ(line.substr(0, beginning.size()), beginning);
    }
    EXPECT_EQ(expected, kMessages);
    asio::post(strand, [&] { manager->way.reset(); });
    ice->destroy();
    executor.stop();
    thread.join();
}

}  // namespace
}  // namespace axon::test
