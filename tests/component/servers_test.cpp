// SPDX-License-Identifier: GPL-2.0-or-later
// Both servers in one process over real sockets, with peers that speak the bare contracts.
#include <gtest/gtest.h>

#include <axon/messages.pb.h>
#include <spdlog/spdlog.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdio>
#include <cstdlib>
#include <filesystem>
#include <fstream>

#include "audit/testing.hpp"
#include "common/release.hpp"
#include "component/any_ports.hpp"
#include "component/raw_peers.hpp"
#include "server/options.hpp"
#include "support/log_lines.hpp"
#include "users/users_file.hpp"

namespace axon::test {
namespace {

using namespace std::chrono_literals;

class Servers : public testing::Test {
  protected:
    std::string clients() const { return server.clientAddress(Lane::Data); }
    std::string entities() const { return server.entityAddress(Lane::Data); }

    server::Server server{onLoopback()};
};

TEST(ServerStart, IsReadyWithin200Milliseconds) {
    auto fastest = std::chrono::steady_clock::duration::max();
    for (int i = 0; i < 5 && fastest >= 200ms; ++i) {  // what else runs may want the processor meanwhile
        const auto start = std::chrono::steady_clock::now();
        const server::Server server(onLoopback());
        fastest = std::min(fastest, std::chrono::steady_clock::now() - start);
        EXPECT_EQ(server.readyLine().rfind("ready client=" + loopbackAddress() + ":", 0), 0U);
    }
    EXPECT_LT(fastest, 200ms);
}

std::size_t threadsCalled(const std::string& name) {
    std::size_t found = 0;
    for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
        std::string its;
        std::getline(std::ifstream(task.path() / "comm"), its);
        if (its == name) ++found;
    }
    return found;
}

TEST(ServerStart, EachOfItsPortsHasAsManyThreadsAsTheSettingsSay) {
    auto settings = onLoopback();
    const auto has = [&](std::size_t data, std::size_t signal, std::size_t receipts) {
        const server::Server server(settings);
        EXPECT_TRUE(waitUntil([&] {
            return threadsCalled("axon-data") == data && threadsCalled("axon-signal") == signal &&
                   threadsCalled("axon-receipts") == receipts;
        })) << threadsCalled("axon-data")
            << ' ' << threadsCalled("axon-signal") << ' ' << threadsCalled("axon-receipts");
    };
    // With one for what comes over connections that the server opens.
    has(1 + 2, 1 + 1, 1 + 1);
    settings.data_threads = 3;
    settings.signal_threads = 2;
    has(1 + 2 * 3, 1 + 2, 1 + 2);
}

TEST(ServerStart, RefusesToListenElsewhereThanOnLoopback) {
    auto settings = onLoopback();
    settings.client_endpoint = "0.0.0.0:0";
    EXPECT_THROW(server::Server{settings}, std::runtime_error);
    settings.client_endpoint = "no-port";
    EXPECT_THROW(server::Server{settings}, std::runtime_error);
    EXPECT_FALSE(server::checkEndpoints("localhost:10410", false, false));
    EXPECT_TRUE(server::checkEndpoints("0.0.0.0:10410", true, true));
    EXPECT_FALSE(server::checkEndpoints("ssl://0.0.0.0:10410", true, false));
    EXPECT_FALSE(server::checkEndpoints("ssl -h 0.0.0.0 -p 4063:tcp -h 127.0.0.1 -p 10410", true, false));
    EXPECT_THROW(server::checkEndpoints("laboratory:10410", false, true), std::runtime_error);
    EXPECT_THROW(server::checkEndpoints("0.0.0.0:10410", true, false), std::runtime_error) << "not silently";
    EXPECT_THROW(server::checkEndpoints("ssl -h 0.0.0.0 -p 4063:tcp -h 0.0.0.0 -p 10410", true, false),
                 std::runtime_error);
    EXPECT_THROW(server::checkEndpoints("ssl://0.0.0.0:10410", false, false), std::runtime_error);
}

TEST(ServerStart, SaysThatAnAddressHasFourNumbers) {
    try {
        server::checkEndpoints("127.1:10410", false, false);
        FAIL() << "expected a misconfiguration";
    } catch (const std::runtime_error& error) {
        EXPECT_NE(std::string(error.what()).find("four numbers"), std::string::npos) << error.what();
    }
}

TEST(ServerStart, TellsTheSignalLanesOwnAddress) {
    auto settings = onLoopback();
    settings.client_signal_endpoint = settings.entity_signal_endpoint = "127.251.0.1:0";
    const server::Server server(settings);
    RawEntity robot(server.entityAddress(Lane::Data), kFirst);
    robot.join();
    RawClient client(server.clientAddress(Lane::Data));
    EXPECT_EQ(client.facts.signalEndpoint.rfind("tcp -h 127.251.0.1 -p ", 0), 0U)
        << client.facts.signalEndpoint;
    client.stop(kFirst);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop requested"); }));
}

TEST(ServerStart, TellsThePublishedAddressOfTheSignalLaneWhereOneIsConfigured) {
    auto settings = onLoopback();
    const auto file = testing::TempDir() + "published-" + loopbackAddress() + ".cfg";
    std::ofstream(file) << "FrontEndServerSignal.PublishedEndpoints=127.251.0.2:10499\n";
    server::readConfiguration(file, settings);
    const server::Server server(settings);
    const RawClient client(server.clientAddress(Lane::Data), "client1@lab", false);
    EXPECT_EQ(client.facts.signalEndpoint, "tcp -h 127.251.0.2 -p 10499");
    std::ofstream(file) << "EntityServerSignal.PublishedEndpoints=nowhere\n";
    EXPECT_THROW(server::readConfiguration(file, settings), std::runtime_error) << "no port";
    std::remove(file.c_str());
}

TEST(ServerStart, SaysThatAPortIsTaken) {
    const server::Server first(onLoopback());
    auto settings = onLoopback();
    settings.client_endpoint = first.clientAddress(Lane::Data);
    try {
        const server::Server second(settings);
        FAIL() << "expected a misconfiguration";
    } catch (const std::runtime_error& error) {
        EXPECT_NE(std::string(error.what()).find("perhaps an axon-server that is already running"),
                  std::string::npos)
            << error.what();
    }
}

TEST(ServerStart, OffersTheGlobalServicesOfItsFolder) {
    auto settings = onLoopback();
    std::string name = testing::TempDir() + "axon-services-XXXXXX";
    const std::string folder = ::mkdtemp(name.data());
    std::filesystem::copy_file("api/schema/samples/valid/figure_a_1.xml", folder + "/figure_a_1.xml");
    settings.global_services = folder;
    const server::Server server(settings);
    RawClient client(server.clientAddress(Lane::Data));
    proto::ToEntity request;
    request.mutable_global_services()->set_request_id("7");
    Header head;
    head.msg_type = kMsgGlobalServices;
    const auto ask = [&](const std::string& message) {
        client.dataOneway()->sendRequest(transport::toIce(head), toRange(message));
    };
    const auto answered = [&](const std::string& part) {
        return [&client, part] {
            const auto lines = client.log.lines();
            return std::any_of(lines.begin(), lines.end(), [&](const auto& line) {
                return line.rfind("data msg  ", 0) == 0 && line.find(part) != std::string::npos;
            });
        };
    };
    ask(request.SerializeAsString());
    ASSERT_TRUE(waitUntil(answered("Pick and Place Demo")));
    for (const auto& line : client.log.lines()) {
        if (line.rfind("data msg  ", 0) != 0) continue;
        proto::ToClient answer;
        ASSERT_TRUE(answer.ParseFromString(line.substr(10)));
        ASSERT_EQ(answer.global_services().files_size(), 1);
        EXPECT_EQ(answer.global_services().request_id(), "7");
        EXPECT_EQ(answer.global_services().files(0).profile().services_size(), 2);
        EXPECT_EQ(answer.global_services().files(0).findings_size(), 1) << "its count is odd";
    }
    ask("no request");
    EXPECT_TRUE(waitUntil([&] { return client.log.has("refused 39"); }));

    std::ofstream(folder + "/new.tmp")
        << "<GlobalProfile><Service name='Patrol'><entity category='ROBOT' type='MOBILE' "
           "id='0' service_global_id='walk' preced='1'/></Service></GlobalProfile>";
    std::filesystem::rename(folder + "/new.tmp", folder + "/new.xml");
    EXPECT_TRUE(waitUntil([&] {
        ask(request.SerializeAsString());
        return answered("Patrol")();
    })) << "what is new is noticed";
    std::filesystem::remove_all(folder);
}

TEST_F(Servers, WithoutAFolderThereAreNoGlobalServices) {
    RawClient client(clients());
    Header head;
    head.msg_type = kMsgGlobalServices;
    client.dataOneway()->sendRequest(transport::toIce(head), toRange(""));
    EXPECT_TRUE(waitUntil([&] { return client.log.has("refused 40"); }));
}

TEST_F(Servers, PushesWhoIsThereToWhoComesEarlyAndLate) {
    RawClient early(clients());
    RawEntity robot(entities(), kFirst, "PeopleBot");
    robot.join();
    robot.status(EntityState::IDLE);
    EXPECT_TRUE(waitUntil([&] { return early.log.has(std::string("status ") + kFirst + " IDLE"); }));
    EXPECT_TRUE(early.log.has(std::string("joined PeopleBot ") + kFirst + " profile of PeopleBot"));

    RawClient late(clients());
    EXPECT_EQ(late.facts.entities, 1);
    EXPECT_TRUE(waitUntil([&] { return late.log.has(std::string("status ") + kFirst + " IDLE"); }));

    robot.data()->destroy();
    EXPECT_TRUE(waitUntil([&] { return early.log.has("left PeopleBot") && late.log.has("left PeopleBot"); }));
}

TEST_F(Servers, CarryMessagesBothWaysInOrder) {
    RawEntity robot(entities(), kFirst);
    robot.join();
    RawClient client(clients());
    constexpr int kMessages = 500;
    for (int i = 0; i < kMessages; ++i) client.text(kFirst, std::to_string(i), i + 1);
    ASSERT_TRUE(waitUntil([&] { return robot.log.count("msg ") == kMessages; }));
    int expected = 0;
    for (const auto& line : robot.log.lines()) {
        if (line.rfind("msg ", 0) == 0) {
            // The sender is the session's, not what the client wrote.
            EXPECT_EQ(line, "msg client1@lab TEXT " + std::to_string(expected++));
        }
    }
    for (int i = 0; i < kMessages; ++i) {
        robot.dataOneway()->sendToClient(transport::toIce(robot.headTo(client.facts.me.id)),
                                         toRange(std::to_string(i)));
    }
    ASSERT_TRUE(waitUntil([&] { return client.log.count("data msg ") == kMessages; }));
    expected = 0;
    for (const auto& line : client.log.lines()) {
        if (line.rfind("data msg ", 0) == 0) {
            EXPECT_EQ(line, std::string("data msg ") + kFirst + " " + std::to_string(expected++));
        }
    }
}

TEST_F(Servers, CarryMessagesBetweenEntities) {
    RawEntity first(entities(), kFirst, "Master");
    RawEntity second(entities(), kSecond, "Slave");
    first.join();
    second.join();
    Header head;
    head.entity = kSecond;
    head.msg_type = kMsgCollaboration;
    first.dataOneway()->sendToPeer(transport::toIce(head), toRange("step 1"));
    EXPECT_TRUE(waitUntil([&] { return second.log.has("msg Master COLLABORATION step 1"); }));
    head.entity = "nobody";
    first.dataOneway()->sendToPeer(transport::toIce(head), toRange("step 2"));
    EXPECT_TRUE(waitUntil([&] { return first.log.has("refused 20"); }));
    first.signalOneway()->sendToPeer(transport::toIce(head), toRange("beat"));
    EXPECT_TRUE(waitUntil([&] { return first.log.has("signal refused 20"); }));
    head.entity = kSecond;
    first.signalOneway()->sendToPeer(transport::toIce(head), toRange("beat"));
    EXPECT_TRUE(waitUntil([&] { return second.log.has("signal msg Master COLLABORATION beat"); }));
}

TEST_F(Servers, RefuseWhatIsForNobody) {
    RawClient client(clients());
    client.text(kFirst, "anybody there?", 77);
    EXPECT_TRUE(waitUntil([&] { return client.log.has("refused 20 of 77"); }));
    client.stop(kFirst);
    EXPECT_TRUE(waitUntil([&] { return client.log.has("signal stop accepted for 0"); }));
}

TEST_F(Servers, AStopOfSeveralIsOneMessageAndReachesNobodyElse) {
    RawEntity first(entities(), kFirst, "First");
    first.join();
    RawEntity second(entities(), kSecond, "Second");
    second.join();
    RawEntity third(entities(), kThird, "Third");
    third.join();
    RawClient client(clients());
    client.signalOneway()->sendStopSignals(transport::toIce(client.headTo(kSecond, 7)),
                                           Axon::CommUtil::StopList({kFirst, "nobody", kThird}),
                                           Axon::CommUtil::StopCause::Requested);
    EXPECT_TRUE(waitUntil([&] { return first.log.has("signal stop requested client1@lab"); }));
    EXPECT_TRUE(waitUntil([&] { return third.log.has("signal stop requested client1@lab"); }));
    EXPECT_TRUE(waitUntil([&] { return client.log.has("refused 20 of 7"); }));
    EXPECT_TRUE(waitUntil([&] { return client.log.has("signal stop accepted for 2"); }));
    EXPECT_FALSE(second.log.has("signal stop"));
}

TEST_F(Servers, StopOvertakesAFilledDataLane) {
    RawEntity robot(entities(), kFirst);
    robot.join();
    RawClient client(clients());
    ASSERT_TRUE(waitUntil([&] { return client.log.has("joined"); }));
    robot.status(EntityState::REG, client.facts.me.id);  // who does not hold it may not send so much
    ASSERT_TRUE(waitUntil([&] { return client.log.has(std::string("status ") + kFirst + " REG"); }));
    robot.stalled = true;
    const std::string block(60'000, 'x');
    for (int i = 0; i < 400; ++i) {
        client.data()->sendToEntityDataSeq(transport::toIce(client.headTo(kFirst, i)), toRange(block));
    }
    const auto start = std::chrono::steady_clock::now();
    client.stop("");
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop requested client1@lab"); }));
    EXPECT_LT(std::chrono::steady_clock::now() - start, 500ms);  // usually less than one
    EXPECT_EQ(robot.data_received, 0U);
    EXPECT_TRUE(waitUntil([&] { return client.log.has("signal stop accepted for 1"); }));
}

TEST_F(Servers, DropTheOldestDataOfWhoDoesNotReadAndHurtNobodyElse) {
    RawEntity stalled(entities(), kFirst, "Stalled");
    RawEntity healthy(entities(), kSecond, "Healthy");
    stalled.join();
    healthy.join();
    RawClient client(clients());
    ASSERT_TRUE(waitUntil([&] { return client.log.has("joined Stalled"); }));
    stalled.status(EntityState::REG, client.facts.me.id);  // who does not hold it may not send so much
    ASSERT_TRUE(waitUntil([&] { return client.log.has(std::string("status ") + kFirst + " REG"); }));
    stalled.stalled = true;
    const std::string block(60'000, 'x');
    constexpr int kBlocks = 500;  // 30 MB: more than the kernel's buffers
    for (int i = 1; i <= kBlocks; ++i) {
        client.data()->sendToEntityDataSeq(transport::toIce(client.headTo(kFirst, i)), toRange(block));
    }
    for (int i = 0; i < 100; ++i) client.text(kSecond, std::to_string(i));
    EXPECT_TRUE(waitUntil([&] { return healthy.log.count("msg ") == 100; }));

    stalled.resume();
    EXPECT_TRUE(waitUntil([&] { return stalled.log.has("data " + std::to_string(kBlocks)); }));
    EXPECT_LT(stalled.data_received, static_cast<std::uint64_t>(kBlocks));
    EXPECT_GT(stalled.data_received, 10U);
    // What arrived is in order, and the newest did.
    long last = 0;
    for (const auto& line : stalled.log.lines()) {
        if (line.rfind("data ", 0) != 0) continue;
        const long number = std::stol(line.substr(5));
        EXPECT_GT(number, last);
        last = number;
    }
    EXPECT_EQ(last, kBlocks);
}

TEST_F(Servers, StopForAClientWhoseConnectionBreaks) {
    for (const bool cut_signal : {false, true}) {
        RawEntity robot(entities(), cut_signal ? kFirst : kSecond);
        robot.join();
        RawClient client(clients());
        const auto id = client.facts.me.id;
        robot.status(EntityState::BUSY, id);
        cut_signal ? client.cutSignal() : client.cutData();
        EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal client lost " + id); }));
        EXPECT_TRUE(robot.log.has("signal stop client lost"));
    }
}

TEST_F(Servers, StopForAClientThatFallsSilentWhileItsTaskRuns) {
    RawEntity robot(entities(), kFirst);
    robot.registration.heartbeat_busy_ms =
        2000;  // the stub sends no keepAlive; only the client is to be late
    robot.join();
    RawClient client(clients());
    client.asksFor(kFirst);
    const auto start = std::chrono::steady_clock::now();
    robot.status(EntityState::BUSY, client.facts.me.id);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop client lost"); }));
    EXPECT_GE(std::chrono::steady_clock::now() - start, 240ms);
    EXPECT_LT(std::chrono::steady_clock::now() - start, 2s);
}

TEST_F(Servers, RefuseOnTheSignalLaneWhatBelongsOnTheOther) {
    RawClient client(clients());
    RawEntity robot(entities(), kFirst);
    try {
        robot.signal()->sendBasicPrfl(transport::toIce(robot.registration), toRange("profile"), {});
        FAIL() << "expected a refusal";
    } catch (const Axon::CommUtil::RequestRefused& refused) {
        EXPECT_EQ(refused.code, static_cast<int>(RefusalCode::WrongState));
    }
    robot.join();
    EntityStatus status;
    status.state = EntityState::BUSY;
    robot.signal()->sendStatus(transport::toIce(status));
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("refused 60 STATUS"); }));
    robot.status(EntityState::IDLE);
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("status ") + kFirst + " IDLE"); }));
    EXPECT_FALSE(client.log.has(std::string("status ") + kFirst + " BUSY"));
}

TEST(ServerDrill, PublishesEachEntitysStopLatencyToTheClients) {
    auto settings = onLoopback();
    settings.entity.drill_period = 50ms;
    const server::Server server(settings);
    RawClient client(server.clientAddress(Lane::Data));
    RawEntity robot(server.entityAddress(Lane::Data), kFirst);
    robot.join();
    robot.status(EntityState::IDLE);
    EXPECT_TRUE(waitUntil([&] { return client.log.has("a stop takes "); }));
    EXPECT_TRUE(robot.log.has("signal stop drill the entity server"));
    EXPECT_EQ(client.log.count("signal msg"), 0U);  // its receipts are the server's own
    EXPECT_EQ(server.margins().size(), 2U);
}

/// A server whose users.cfg has three clients and a robot.
class ServerUsers : public testing::Test {
  protected:
    ServerUsers() {
        std::string name = std::filesystem::temp_directory_path() / "axon-server-XXXXXX";
        folder = ::mkdtemp(name.data());
        auto settings = onLoopback();
        settings.users_file = folder + "/users.cfg";
        using users::UserRole;
        for (const auto& [user, role] :
             {std::pair{"watcher", UserRole::Observer}, std::pair{"client1", UserRole::Operator},
              std::pair{"boss", UserRole::Admin}, std::pair{"left", UserRole::Entity}})
            users::writeUser(settings.users_file, user, role, std::string("password of ") + user);
        server = std::make_unique<server::Server>(settings);
    }
    ~ServerUsers() override {
        server.reset();
        std::filesystem::remove_all(folder);
    }
    std::string clients() const { return server->clientAddress(Lane::Data); }
    std::string entities() const { return server->entityAddress(Lane::Data); }
    std::unique_ptr<RawClient> logIn(const std::string& user, const std::string& password) {
        return std::make_unique<RawClient>(clients(), "somebody@desk3", true, user, password);
    }

    std::string folder;
    std::unique_ptr<server::Server> server;
};

TEST_F(ServerUsers, TheRoleTravelsFromTheLogInToTheEntity) {
    RawEntity robot(entities(), kFirst, "Robot", "left", "password of left");
    robot.join();
    for (const auto& [user, role] : {std::pair{"watcher", Role::Observer},
                                     std::pair{"client1", Role::Operator}, std::pair{"boss", Role::Admin}}) {
        const auto client = logIn(user, std::string("password of ") + user);
        EXPECT_EQ(client->facts.me.name, std::string(user) + "@desk3");
        EXPECT_EQ(static_cast<Role>(client->facts.me.role), role);
        const auto before = robot.messages_received.load();
        client->text(kFirst, "hello");  // its head says Admin
        ASSERT_TRUE(waitUntil([&] { return robot.messages_received > before; }));
        EXPECT_EQ(robot.last_role.load(), role);
        client->stop(kFirst);
        EXPECT_TRUE(waitUntil(
            [&, name = std::string(user)] { return robot.log.has("signal stop requested " + name); }));
    }
}

TEST_F(ServerUsers, RefuseWhoHasNoPasswordOrTheWrongOneOrTheWrongDoor) {
    const auto code = [](const auto& attempt) {
        try {
            attempt();
        } catch (const Axon::CommUtil::RequestRefused& refused) {
            EXPECT_FALSE(refused.reason.empty());
            return static_cast<RefusalCode>(refused.code);
        }
        return RefusalCode::Ok;
    };
    EXPECT_EQ(code([&] { logIn("", ""); }), RefusalCode::PermissionDenied);
    EXPECT_EQ(code([&] { logIn("boss", "password of client1"); }), RefusalCode::PermissionDenied);
    EXPECT_EQ(code([&] { logIn("left", "password of left"); }), RefusalCode::PermissionDenied);
    EXPECT_EQ(code([&] { RawEntity(entities(), kFirst); }), RefusalCode::PermissionDenied);
    EXPECT_EQ(code([&] { RawEntity(entities(), kFirst, "Robot", "boss", "password of boss"); }),
              RefusalCode::PermissionDenied);
    EXPECT_EQ(code([&] { logIn("boss", "password of boss"); }), RefusalCode::Ok);
    EXPECT_EQ(server->frontEndCore().clients(), 0U);
}

TEST_F(ServerUsers, ASessionOnTheSignalPortIsNothingWithoutAToken) {
    RawEntity robot(entities(), kFirst, "Robot", "left", "password of left");
    robot.join();
    const auto communicator = transport::makeCommunicator({});
    const auto gate = Ice::uncheckedCast<Axon::FrontEndComm::ClientGatePrx>(
        communicator.communicator()
            ->stringToProxy("ClientGate:" + transport::tcpEndpoint(server->clientAddress(Lane::Signal)))
            ->ice_context(transport::contractContext()));
    const auto opened = gate->open("", "", "eve");
    const auto session = Ice::uncheckedCast<Axon::FrontEndComm::ClientSessionPrx>(
        gate->ice_getCachedConnection()->createProxy(opened->ice_getIdentity()));
    EXPECT_THROW(session->sendStopSignal({}, Axon::CommUtil::StopCause::Requested),
                 Ice::ObjectNotExistException);
    EXPECT_THROW(session->keepAlive(1), Ice::ObjectNotExistException);
    EXPECT_FALSE(robot.log.has("signal stop"));
}

TEST_F(ServerUsers, GuessingHoldsUpNoStop) {
    RawEntity robot(entities(), kFirst, "Robot", "left", "password of left");
    robot.join();
    const auto client = logIn("client1", "password of client1");
    const auto communicator = transport::makeCommunicator({});
    const auto gate = Ice::uncheckedCast<Axon::FrontEndComm::ClientGatePrx>(
        communicator.communicator()
            ->stringToProxy("ClientGate:" + transport::tcpEndpoint(clients()))
            ->ice_context(transport::contractContext()));
    std::atomic<int> refused{0};
    for (int i = 0; i < 40; ++i) {
        gate->openAsync(
            "user" + std::to_string(i), "guess", "eve", [](const auto&) {},
            [&](std::exception_ptr) { ++refused; });
    }
    client->stop(kFirst);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop requested"); }));
    EXPECT_LT(refused, 40) << "the guesses were over before the stop: the test says nothing";
    EXPECT_TRUE(waitUntil([&] { return refused == 40; }, 60s));
}

TEST(ServerWithoutUsers, OnlyItsOwnUserAndRootAreAdmin) {
    const server::Server server(onLoopback());
    const RawClient own(server.clientAddress(Lane::Data));
    EXPECT_EQ(static_cast<Role>(own.facts.me.role), Role::Admin);
    if (::geteuid() != 0) GTEST_SKIP() << "only root can try as somebody else";
    const auto program = std::filesystem::read_symlink("/proc/self/exe").string();
    const auto variable = "AXON_TEST_SERVER=" + server.clientAddress(Lane::Data);
    std::array<char*, 2> environment{const_cast<char*>(variable.c_str()), nullptr};
    const auto child = ::fork();
    if (child == 0) {
        if (::setgid(65534) != 0 || ::setuid(65534) != 0) ::_exit(3);
        ::execle(program.c_str(), program.c_str(), "--gtest_filter=*AsSomebodyElse", nullptr,
                 environment.data());
        ::_exit(4);
    }
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    EXPECT_TRUE(WIFEXITED(status));
    if (WEXITSTATUS(status) == 4) GTEST_SKIP() << "somebody else may not read this program";
    EXPECT_EQ(WEXITSTATUS(status), 0);
}

TEST(ServerWithoutUsers, AsSomebodyElse) {
    const char* address = std::getenv("AXON_TEST_SERVER");
    if (address == nullptr)
        GTEST_SKIP() << "runs as a child of OnlyItsOwnUserAndRootAreAdmin, under another user";
    const RawClient other(address);
    EXPECT_EQ(static_cast<Role>(other.facts.me.role), Role::Operator);
}

TEST_F(Servers, EndInOrderWithoutAStopWhereNothingRuns) {
    RawEntity robot(entities(), kFirst);
    robot.join();
    RawClient client(clients());
    robot.status(EntityState::REG, client.facts.me.id);
    client.signal()->destroy();
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal client ended"); }));
    EXPECT_FALSE(robot.log.has("signal stop"));
}

TEST_F(Servers, DropOnlyThePeerThatSendsAnOversizeMessage) {
    RawEntity robot(entities(), kFirst);
    robot.join();
    RawClient bad(clients(), "bad@lab");
    RawClient good(clients(), "good@lab");
    robot.status(EntityState::BUSY, bad.facts.me.id);
    const std::string huge((transport::kMessageSizeMaxKib + 1) * 1024, 'x');
    try {
        bad.data()->sendToEntity(transport::toIce(bad.headTo(kFirst)), toRange(huge));
    } catch (const Ice::Exception&) {  // the sender's own communicator may refuse, or the server closes
    }
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop improper"); }));
    good.text(kFirst, "still here");
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("msg good@lab TEXT still here"); }));
}

TEST_F(Servers, DropThePeerWhoseHeadIsMalformedAfterItsStop) {
    RawEntity robot(entities(), kFirst);
    robot.join();
    RawClient bad(clients(), "bad@lab");
    auto head = bad.headTo("");
    head.msg_type = std::string(transport::kHeadStringMax + 1, 'x');
    bad.signalOneway()->sendStopSignal(transport::toIce(head), Axon::CommUtil::StopCause::Requested);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop requested bad@lab"); }));
    EXPECT_TRUE(waitUntil([&] { return server.frontEndCore().clients() == 0; }));

    RawClient worse(clients(), "worse@lab");
    head.entity = kFirst;
    worse.dataOneway()->sendToEntity(transport::toIce(head), toRange("hello"));
    EXPECT_TRUE(waitUntil([&] { return server.frontEndCore().clients() == 0; }));
    EXPECT_FALSE(robot.log.has("msg worse@lab"));
}

TEST_F(Servers, NoticeThatAnEntityManagerIsKilled) {
    RawClient client(clients());
    RawEntity robot(entities(), kFirst);
    robot.join();
    ASSERT_TRUE(waitUntil([&] { return client.log.has("joined"); }));
    robot.cutSignal();
    EXPECT_TRUE(waitUntil([&] { return client.log.has("left"); }));
    // Its place is free again.
    RawEntity again(entities(), kFirst);
    again.join();
    EXPECT_TRUE(waitUntil([&] { return client.log.count("joined") == 2; }));
}

TEST_F(Servers, RefuseASecondEntityOfTheSameUuid) {
    RawEntity first(entities(), kFirst);
    first.join();
    RawEntity copy(entities(), kFirst);
    try {
        copy.join();
        FAIL() << "expected a refusal";
    } catch (const Axon::CommUtil::RequestRefused& refused) {
        EXPECT_EQ(refused.code, static_cast<int>(RefusalCode::Duplicate));
        EXPECT_NE(refused.reason.find("give the copy an empty one (--state)"), std::string::npos)
            << refused.reason;
    }
}

TEST_F(Servers, AnswerASessionOnlyOnItsOwnConnection) {
    RawClient client(clients());
    const auto other = transport::makeCommunicator({});
    const auto foreign = Ice::uncheckedCast<Axon::FrontEndComm::ClientSessionPrx>(
        other.communicator()->stringToProxy(Ice::identityToString(client.data()->ice_getIdentity()) + ":" +
                                            transport::tcpEndpoint(clients())));
    EXPECT_THROW(foreign->sendStopSignal({}, Axon::CommUtil::StopCause::Requested),
                 Ice::ObjectNotExistException);
    EXPECT_THROW(foreign->destroy(), Ice::ObjectNotExistException);
    EXPECT_NO_THROW(client.data()->keepAlive(1));
}

TEST_F(Servers, OpenOneSessionForEachConnection) {
    const auto communicator = transport::makeCommunicator({});
    const auto gate = Ice::uncheckedCast<Axon::FrontEndComm::ClientGatePrx>(
        communicator.communicator()
            ->stringToProxy("ClientGate:" + transport::tcpEndpoint(clients()))
            ->ice_context(transport::contractContext()));
    gate->open("", "", "one");
    EXPECT_THROW(gate->open("", "", "two"), Axon::CommUtil::RequestRefused);
}

TEST_F(Servers, RefuseWhoHasAnotherContract) {
    const auto communicator = transport::makeCommunicator({});
    const auto answer = [&](const std::string& identity, const std::string& address,
                            const Ice::Context& context) {
        const auto proxy = communicator.communicator()
                               ->stringToProxy(identity + ":" + transport::tcpEndpoint(address))
                               ->ice_connectionId(Ice::generateUUID())
                               ->ice_context(context);
        try {
            if (identity == "ClientGate") {
                Ice::uncheckedCast<Axon::FrontEndComm::ClientGatePrx>(proxy)->open("", "", "one");
            } else {
                Ice::uncheckedCast<Axon::EntityComm::EntityGatePrx>(proxy)->open("", "");
            }
        } catch (const Axon::CommUtil::RequestRefused& refused) {
            return static_cast<RefusalCode>(refused.code);
        }
        return RefusalCode::Ok;
    };
    constexpr int kOurs = Axon::CommUtil::ContractNumber;
    using At = std::pair<std::string, std::string>;
    for (const auto& [identity, address] :
         {At{"ClientGate", clients()}, At{"ClientGate", server.clientAddress(Lane::Signal)},
          At{"EntityGate", entities()}, At{"EntityGate", server.entityAddress(Lane::Signal)}}) {
        EXPECT_EQ(answer(identity, address, {}), RefusalCode::NotSupported) << identity << ' ' << address;
        for (const int number : {kOurs - 1, kOurs + 1})
            EXPECT_EQ(answer(identity, address, {{"axon-contract", std::to_string(number)}}),
                      RefusalCode::NotSupported)
                << identity << ' ' << address << ' ' << number;
        EXPECT_EQ(answer(identity, address, {{"axon-contract", std::to_string(kOurs)}}), RefusalCode::Ok);
    }
}

TEST(ServerAudit, WhoIsTurnedAwayBeforeThereIsASessionIsRecordedWithTheAddress) {
    const audit::TrailFolder folder;
    auto settings = onLoopback();
    settings.audit.folder = folder.path;
    settings.front_end.clients_max = 1;
    const server::Server server(settings);
    const auto recorded = [&](const std::string& what, const std::string& code) {
        return waitUntil([&] {
            const auto all = folder.records();
            return std::any_of(all.begin(), all.end(), [&](const auto& record) {
                return record.kind == "refusal" && record.peer.starts_with("127.") &&
                       record.what.find(what) != std::string::npos && record.outcome == code;
            });
        });
    };
    const auto communicator = transport::makeCommunicator({});
    const auto proxyOf = [&](const std::string& identity, const std::string& address) {
        return communicator.communicator()->stringToProxy(identity + ":" + transport::tcpEndpoint(address));
    };
    for (const auto lane : {Lane::Data, Lane::Signal}) {
        const auto before = folder.records().size();
        const auto gate = Ice::uncheckedCast<Axon::FrontEndComm::ClientGatePrx>(
            proxyOf("ClientGate", server.clientAddress(lane)));
        EXPECT_THROW(gate->open("", "", "one"), Axon::CommUtil::RequestRefused);
        EXPECT_TRUE(waitUntil([&] { return folder.records().size() > before; }));
        EXPECT_TRUE(recorded("a session of a client: ", "NOT_SUPPORTED"));
    }
    const auto gate = Ice::uncheckedCast<Axon::EntityComm::EntityGatePrx>(
        proxyOf("EntityGate", server.entityAddress(Lane::Data)));
    EXPECT_THROW(gate->open("", ""), Axon::CommUtil::RequestRefused);
    EXPECT_TRUE(recorded("a session of an Entity Manager: ", "NOT_SUPPORTED"));
    const RawClient first(server.clientAddress(Lane::Data));
    EXPECT_THROW(RawClient(server.clientAddress(Lane::Data)), Axon::CommUtil::RequestRefused);
    EXPECT_TRUE(recorded("raise FrontEndServer.ClientsMax", "OVERLOADED"));
    // Of version 8: bound to a secret that this one does not show.
    RawEntity thief(server.entityAddress(Lane::Data), "00000000-0000-8000-8000-000000000001");
    EXPECT_THROW(thief.join(), Axon::CommUtil::RequestRefused);
    EXPECT_TRUE(recorded("the registration of an entity: the UUID 0000", "PERMISSION_DENIED"));
}

/// How often the part is in the text.
std::size_t count(const std::string& text, const std::string& part) {
    std::size_t found = 0;
    for (auto at = text.find(part); at != std::string::npos; at = text.find(part, at + 1)) ++found;
    return found;
}

TEST_F(Servers, SayOnceOfEachKindOfPeerThatItHasAnotherRelease) {
    const auto lines = std::make_shared<LogLines>();
    const auto before = spdlog::default_logger();
    spdlog::set_default_logger(std::make_shared<spdlog::logger>("", lines));
    const auto communicator = transport::makeCommunicator({});
    const auto open = [&](const std::string& identity, const std::string& address, const char* release) {
        auto context = transport::contractContext();
        context.erase(transport::kContextRelease);
        if (release != nullptr) context[transport::kContextRelease] = release;
        const auto proxy = communicator.communicator()
                               ->stringToProxy(identity + ":" + transport::tcpEndpoint(address))
                               ->ice_connectionId(Ice::generateUUID())
                               ->ice_context(context);
        if (identity == "ClientGate") {
            Ice::uncheckedCast<Axon::FrontEndComm::ClientGatePrx>(proxy)->open("", "", "one");
        } else {
            Ice::uncheckedCast<Axon::EntityComm::EntityGatePrx>(proxy)->open("", "");
        }
    };
    for (const auto* release : {static_cast<const char*>(nullptr), "", kRelease})
        for (const auto& [identity, address] :
             {std::pair{"ClientGate", clients()}, std::pair{"EntityGate", entities()}})
            open(identity, address, release);
    EXPECT_EQ(lines->all().find("connected with"), std::string::npos) << lines->all();
    const std::string long_one(1000, 'x');
    for (const auto* release : {"7.1", "7.1", "7\n1\xff", long_one.c_str()}) {
        open("ClientGate", clients(), release);
        open("EntityGate", entities(), release);
        open("ClientGate", server.clientAddress(Lane::Signal), "7.2");  // nobody has vouched for it
    }
    spdlog::set_default_logger(before);
    const auto rest = std::string(", this server has ") + kRelease +
                      "; they work together, because both have " + transport::ourContract() + "\n";
    const auto all = lines->all();
    for (const std::string peer : {"a client", "an Entity Manager"}) {
        EXPECT_EQ(count(all, "connected with " + peer + " of release 7.1" + rest), 1U) << all;
        EXPECT_EQ(count(all, "connected with " + peer + R"( of an unknown release ('7\x0a1\xff'))" + rest),
                  1U)
            << all;
    }
    EXPECT_EQ(count(all, "connected with"), 4U) << all;
}

TEST_F(Servers, TellTheirReleaseWithTheFirstHeartbeatOnly) {
    RawEntity robot(entities(), kFirst);
    robot.registration.heartbeat_idle_ms = 100;
    robot.join();
    const RawClient client(clients());
    const RawClient browser(clients(), "browser", false);
    const auto first = std::string(" heartbeat of ") + kRelease;
    ASSERT_TRUE(waitUntil([&] {
        robot.signal()->keepAlive(1);
        return robot.log.count("signal heartbeat") > 3;
    }));
    EXPECT_EQ(robot.log.count("signal" + first), 1U);
    EXPECT_TRUE(waitUntil([&] { return client.log.has("signal" + first); }));
    EXPECT_TRUE(waitUntil([&] { return browser.log.has("data" + first); }));
}

TEST_F(Servers, ServeAClientWithoutASignalLane) {
    RawEntity robot(entities(), kFirst);
    robot.join();
    RawClient browser(clients(), "browser", false);
    browser.dataOneway()->sendStopSignal(transport::toIce(browser.headTo(kFirst)),
                                         Axon::CommUtil::StopCause::Requested);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop requested browser"); }));
    EXPECT_TRUE(waitUntil([&] { return browser.log.has("data stop accepted for 1"); }));
}

TEST(ServerEnd, TellsItsClients) {
    auto server = std::make_unique<server::Server>(onLoopback());
    RawClient client(server->clientAddress(Lane::Data));
    server.reset();
    EXPECT_TRUE(waitUntil([&] { return client.log.has("update the server is shutting down"); }));
}

}  // namespace
}  // namespace axon::test
