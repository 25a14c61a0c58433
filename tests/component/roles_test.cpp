// SPDX-License-Identifier: GPL-2.0-or-later
// Several servers of each kind: in one process, joined without IceStorm, and as real processes with a real
// icebox.
#include <IceStorm/IceStorm.h>
#include <axon/messages.pb.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <unistd.h>

#include <axon/client.hpp>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <map>
#include <memory>

#include "component/any_ports.hpp"
#include "component/raw_peers.hpp"
#include "support/logged_program.hpp"

namespace axon::test {
namespace {

using namespace std::chrono_literals;

const std::string kUnknownEntity = "refused 20";

server::ServerSettings oneOfSeveral(server::ServerRole role, const std::string& name) {
    auto settings = onLoopback();
    settings.role = role;
    settings.name = name;
    return settings;
}

/// Signals and messages go straight only to servers that have been discovered; then a stop comes twice.
bool reaches(RawClient& client, RawEntity& robot) {
    return waitUntil([&] {
        const auto before = robot.log.count("signal stop");
        client.stop(robot.registration.entity);
        return waitUntil([&] { return robot.log.count("signal stop") >= before + 2; }, 300ms);
    });
}

/// Two front-end servers and two entity servers, whose topics are the others themselves.
class SeveralServers : public testing::Test {
  public:
    /// Made before there are threads: ThreadSanitizer cannot see how libspdlog lets only one make it.
    static void SetUpTestSuite() { spdlog::default_logger(); }

  protected:
    SeveralServers() { join(); }
    void join() {
        const std::vector<std::string> front_ends = {fe1->subscriber(), fe2->subscriber()};
        const std::vector<std::string> entity_servers = {es1->subscriber(), es2->subscriber()};
        for (const auto& one : {fe1.get(), fe2.get(), es1.get(), es2.get()})
            one->publishTo(front_ends, entity_servers);
    }
    std::string clients(const server::Server& at) const { return at.clientAddress(Lane::Data); }
    std::string entities(const server::Server& at) const { return at.entityAddress(Lane::Data); }
    std::unique_ptr<server::Server> fe1 =
        std::make_unique<server::Server>(oneOfSeveral(server::ServerRole::FrontEnd, "fe1"));
    std::unique_ptr<server::Server> fe2 =
        std::make_unique<server::Server>(oneOfSeveral(server::ServerRole::FrontEnd, "fe2"));
    std::unique_ptr<server::Server> es1 =
        std::make_unique<server::Server>(oneOfSeveral(server::ServerRole::Entity, "es1"));
    std::unique_ptr<server::Server> es2 =
        std::make_unique<server::Server>(oneOfSeveral(server::ServerRole::Entity, "es2"));
};

TEST_F(SeveralServers, SayInTheirReadyLineWhatTheyHave) {
    EXPECT_EQ(fe1->readyLine().rfind("ready client=", 0), 0U);
    EXPECT_EQ(fe1->readyLine().find("entity="), std::string::npos);
    EXPECT_EQ(es1->readyLine().rfind("ready entity=", 0), 0U);
}

TEST_F(SeveralServers, PresenceIsTheSameOnEveryFrontEndServer) {
    RawClient client1(clients(*fe1));
    RawClient client2(clients(*fe2), "client2@lab");
    RawEntity left(entities(*es1), kFirst, "Left");
    RawEntity right(entities(*es2), kSecond, "Right");
    left.join();
    right.join();
    right.status(EntityState::IDLE);
    for (auto* client : {&client1, &client2}) {
        EXPECT_TRUE(
            waitUntil([&] { return client->log.has("joined Left") && client->log.has("joined Right"); }));
        EXPECT_TRUE(waitUntil([&] { return client->log.has(std::string("status ") + kSecond + " IDLE"); }));
    }
    left.data()->destroy();
    for (auto* client : {&client1, &client2})
        EXPECT_TRUE(waitUntil([&] { return client->log.has("left Left"); }));
}

TEST_F(SeveralServers, MessagesFindTheEntityAndTheClientInOrderWhereverTheyAre) {
    RawEntity left(entities(*es1), kFirst, "Left");
    RawEntity right(entities(*es2), kSecond, "Right");
    left.join();
    right.join();
    RawClient client(clients(*fe2));
    ASSERT_TRUE(waitUntil([&] { return client.log.has("joined Left") && client.log.has("joined Right"); }));
    constexpr int kMessages = 200;
    for (int i = 0; i < kMessages; ++i) client.text(i % 2 == 0 ? kFirst : kSecond, std::to_string(i), i + 1);
    ASSERT_TRUE(waitUntil([&] {
        return left.log.count("msg client1@lab TEXT ") == kMessages / 2 &&
               right.log.count("msg client1@lab TEXT ") == kMessages / 2;
    }));
    int expected = 0;
    for (const auto& line : left.log.lines()) {
        if (line.rfind("msg ", 0) != 0) continue;
        EXPECT_EQ(line, "msg client1@lab TEXT " + std::to_string(expected));
        expected += 2;
    }
    right.dataOneway()->sendToClient(transport::toIce(right.headTo(client.facts.me.id)), toRange("answer"));
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("data msg ") + kSecond + " answer"); }));
}

TEST_F(SeveralServers, EntitiesReachEachOtherAcrossEntityServers) {
    RawEntity master(entities(*es1), kFirst, "Master");
    RawEntity slave(entities(*es2), kSecond, "Slave");
    master.join();
    slave.join();
    Header head;
    head.entity = kSecond;
    head.msg_type = kMsgCollaboration;
    EXPECT_TRUE(waitUntil([&] {  // until each server knows of the other's entities
        master.dataOneway()->sendToPeer(transport::toIce(head), toRange("step 1"));
        return waitUntil([&] { return slave.log.has("msg Master COLLABORATION step 1"); }, 50ms);
    }));
    master.signalOneway()->sendToPeer(transport::toIce(head), toRange("beat"));
    EXPECT_TRUE(waitUntil([&] { return slave.log.has("signal msg Master COLLABORATION beat"); }));
    EXPECT_FALSE(slave.log.has("msg Master COLLABORATION beat"));

    es1->publishTo({}, {});  // messages between entities need no topic
    es2->publishTo({}, {});
    master.dataOneway()->sendToPeer(transport::toIce(head), toRange("step 2"));
    EXPECT_TRUE(waitUntil([&] { return slave.log.has("msg Master COLLABORATION step 2"); }));
    join();
    slave.data()->destroy();
    EXPECT_TRUE(waitUntil([&] {
        master.dataOneway()->sendToPeer(transport::toIce(head), toRange("step 3"));
        return waitUntil([&] { return master.log.has(kUnknownEntity); }, 50ms);
    }));
}

TEST_F(SeveralServers, RefuseAnEntityThatAnotherOneHas) {
    RawEntity first(entities(*es1), kFirst, "First");
    RawEntity witness(entities(*es2), kSecond, "Witness");
    first.join();
    witness.join();
    Header head;
    head.entity = kFirst;
    head.msg_type = kMsgCollaboration;
    ASSERT_TRUE(waitUntil([&] {
        witness.dataOneway()->sendToPeer(transport::toIce(head), toRange("there?"));
        return waitUntil([&] { return first.log.has("msg Witness"); }, 50ms);
    })) << "es2 knows of it";
    RawEntity copy(entities(*es2), kFirst, "Copy");
    EXPECT_THROW(copy.join(), Axon::CommUtil::RequestRefused);
    first.data()->destroy();
    EXPECT_TRUE(waitUntil([&] {
        try {
            copy.join();
            return true;
        } catch (const Axon::CommUtil::RequestRefused&) {
            return false;
        }
    })) << "it may come once the other has left";
}

TEST_F(SeveralServers, AStopGoesTwoWaysAndOnlyOneIsLeftWhenTheTopicIsDown) {
    RawEntity robot(entities(*es2), kFirst);
    robot.join();
    RawClient client(clients(*fe1));
    ASSERT_TRUE(waitUntil([&] { return client.log.has("joined"); }));
    ASSERT_TRUE(reaches(client, robot)) << "once directly, once by the topic";

    fe1->publishTo({}, {});
    client.text(kFirst, "hello", 77);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("msg client1@lab TEXT hello"); })) << "straight";
    EXPECT_EQ(robot.log.count("msg client1@lab TEXT hello"), 1U);
    auto before = robot.log.count("signal stop");
    client.stop(kFirst);
    EXPECT_TRUE(waitUntil([&] { return robot.log.count("signal stop") == before + 1; }));

    // The receipt goes both ways back, too, while there are two: once es2 reaches fe1 directly.
    Header receipt = robot.headTo(client.facts.me.id);
    receipt.msg_type = kMsgReceipt;
    const auto comes = [&](std::size_t times, std::chrono::milliseconds within) {
        const auto before_it = client.log.count("signal msg");
        robot.signalOneway()->sendToClient(transport::toIce(receipt), toRange("receipt"));
        return waitUntil([&] { return client.log.count("signal msg") == before_it + times; }, within);
    };
    EXPECT_TRUE(waitUntil([&] { return comes(2, 300ms); }));
    es2->publishTo({}, {});
    const auto received = client.log.count("signal msg");
    EXPECT_TRUE(comes(1, 10s));
    EXPECT_FALSE(waitUntil([&] { return client.log.count("signal msg") > received + 1; }, 300ms));

    join();
    client.text(kFirst, "hello again");
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("msg client1@lab TEXT hello again"); }));
}

TEST_F(SeveralServers, AReceiptThatComesTwoWaysIsOneToTheClientLibrary) {
    RawEntity robot(entities(*es2), kFirst);
    robot.on_stop = [&](const Header& stop) {  // which comes two ways, too
        proto::ToClient message;
        auto& receipt = *message.mutable_receipt();
        receipt.set_stop_id(stop.sender.id + ":" + std::to_string(stop.sequence));
        receipt.set_stop_generation(1);
        receipt.set_stage(proto::StopReceipt::CALLBACK_RETURNED);
        Header head;
        head.sender.id = stop.sender.id;
        head.msg_type = kMsgReceipt;
        robot.signalOneway()->sendToClientAsync(transport::toIce(head), toRange(message.SerializeAsString()),
                                                [] {}, {}, {});
    };
    robot.join();
    robot.status(EntityState::IDLE);
    client::Options options;
    options.server = clients(*fe1);
    const auto connected = client::Client::connect(options);
    ASSERT_TRUE(connected.ok()) << connected.refusal().message;
    auto& client = *connected.value();
    ASSERT_TRUE(client.waitFor("Robot", client::Seconds{5}).ok());
    const auto stopsOnce = [&] {
        const auto receipts = client.stop({"Robot"});
        ASSERT_TRUE(receipts.ok()) << receipts.refusal().message;
        ASSERT_EQ(receipts.value().size(), 1U);
        EXPECT_TRUE(receipts.value().front().confirmed());
    };
    EXPECT_TRUE(waitUntil([&] {
        const auto before = robot.log.count("signal stop");
        stopsOnce();
        return waitUntil([&] { return robot.log.count("signal stop") >= before + 2; }, 300ms);
    })) << "the servers reach each other directly, too";
    for (int i = 0; i < 20; ++i) stopsOnce();
}

TEST_F(SeveralServers, WhatHappenedWhileTheTopicWasDownIsKnownAfterwards) {
    RawEntity stays(entities(*es1), kFirst, "Stays");
    RawEntity goes(entities(*es1), kSecond, "Goes");
    stays.join();
    goes.join();
    RawClient client(clients(*fe1));
    ASSERT_TRUE(waitUntil([&] { return client.log.has("joined Stays") && client.log.has("joined Goes"); }));
    es1->publishTo({}, {});
    goes.data()->destroy();
    RawEntity comes(entities(*es1), kThird, "Comes");
    comes.join();
    stays.status(EntityState::ERR);
    ASSERT_TRUE(waitUntil([&] { return es1->entityCore().entities() == 2; }));
    EXPECT_FALSE(client.log.has("left Goes"));
    join();
    EXPECT_TRUE(waitUntil([&] { return client.log.has("left Goes") && client.log.has("joined Comes"); }));
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("status ") + kFirst + " ERR"); }));
}

TEST_F(SeveralServers, RefuseWhatIsForNobody) {
    RawClient client(clients(*fe1));
    client.text(kFirst, "anybody there?", 77);
    EXPECT_TRUE(waitUntil([&] { return client.log.has(kUnknownEntity + " of 77"); }));
    client.stop(kFirst);
    EXPECT_TRUE(waitUntil([&] { return client.log.has("signal stop accepted for 0"); }));
}

class RealServers : public testing::Test {
  protected:
    RealServers() {
        std::string name = std::filesystem::temp_directory_path() / "axon-roles-XXXXXX";
        folder = ::mkdtemp(name.data());
        const auto host = loopbackAddress();
        std::ofstream(folder / "icebox.cfg")
            << "IceBox.Service.IceStorm=IceStormService,37:createIceStorm --Ice.Config="
            << (folder / "storm.cfg").string() << "\n";
        std::ofstream(folder / "storm.cfg")
            << "IceStorm.InstanceName=IceStorm\nIceStorm.Transient=1\n"
            << "IceStorm.TopicManager.Endpoints=tcp -h " << host << " -p 10430\n"
            << "IceStorm.Publish.Endpoints=tcp -h " << host << " -p 10431\n"
            << "IceStorm.Publish.ThreadPool.Size=4\n"
            << "IceStorm.Publish.ThreadPool.Serialize=1\n"
            << "IceStorm.Send.QueueSizeMax=1000\n"
            << "IceStorm.Send.QueueSizeMaxPolicy=DropEvents\n"
            << "IceStorm.Discard.Interval=1\nIce.MessageSizeMax=4096\n";
        for (const std::string server : {"fe1", "fe2", "es1"}) {
            std::ofstream(folder / (server + ".cfg"))
                << "Server.Name=" << server << "\nServer.TopicManager=IceStorm/TopicManager:tcp -h " << host
                << " -p 10430\n"
                // The stubs send no keepAlive; only servers are to be late.
                << "FrontEndServer.WatchdogBusyMs=2000\n";
        }
    }
    ~RealServers() override {
        programs.clear();
        std::filesystem::remove_all(folder);
    }
    void startStorm() {
        programs["icebox"] = std::make_unique<LoggedProgram>(
            std::vector<std::string>{"icebox", "--Ice.Config=" + (folder / "icebox.cfg").string()},
            folder / "icebox.log");
    }
    LoggedProgram& start(const std::string& name) {
        const bool front_end = name.rfind("fe", 0) == 0;
        const std::string kind = front_end ? "client" : "entity";
        const auto any_port = loopbackAddress() + ":0";
        programs[name].reset();
        programs[name] = std::make_unique<LoggedProgram>(
            std::vector<std::string>{AXON_SERVER, "--role", front_end ? "front-end" : "entity", "--config",
                                     (folder / (name + ".cfg")).string(), "--" + kind + "-endpoint", any_port,
                                     "--" + kind + "-signal-endpoint", any_port},
            folder / (name + ".log"));
        return *programs[name];
    }

    std::filesystem::path folder;
    std::map<std::string, std::unique_ptr<LoggedProgram>> programs;
};

TEST_F(RealServers, IceStormMayComeLaterDieAndComeBack) {
    auto& front_end = start("fe1");
    auto& entity_server = start("es1");
    RawEntity robot(entity_server.ready("entity"), kFirst);
    robot.join();
    RawClient client(front_end.ready("client"));
    client.text(kFirst, "too early", 1);
    EXPECT_TRUE(waitUntil([&] { return client.log.has(kUnknownEntity + " of 1"); }));
    startStorm();
    EXPECT_TRUE(waitUntil([&] { return client.log.has("joined Robot"); }, 5s))
        << front_end.text() << entity_server.text();
    client.text(kFirst, "first", 2);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("msg client1@lab TEXT first"); }));
    ASSERT_TRUE(reaches(client, robot)) << "straight, too: before that the topic is the only way";

    programs["icebox"]->kill();
    // Messages and statuses go straight: nothing of them waits or is lost, all the time until it is there
    // again.
    std::int64_t number = 100;
    for (; number < 120; ++number) client.text(kFirst, "n" + std::to_string(number), number);
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("msg client1@lab TEXT n119"); }));
    robot.dataOneway()->sendToClient(transport::toIce(robot.headTo(client.facts.me.id)), toRange("answer"));
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("data msg ") + kFirst + " answer"); }));
    robot.status(EntityState::REG, client.facts.me.id);
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("status ") + kFirst + " REG"); }));
    const auto before = robot.log.count("signal stop");
    client.stop(kFirst);
    EXPECT_TRUE(waitUntil([&] { return robot.log.count("signal stop") > before; })) << "directly";
    robot.status(EntityState::ERR);
    robot.signalOneway()->keepAlive(1);

    startStorm();
    const auto deadline = std::chrono::steady_clock::now() + 3s;  // until the topics stand again, and a while
    while (std::chrono::steady_clock::now() < deadline) {
        client.text(kFirst, "n" + std::to_string(number), number);
        ++number;
        EXPECT_TRUE(
            waitUntil([&] { return robot.log.has("msg client1@lab TEXT n" + std::to_string(number - 1)); }));
    }
    EXPECT_EQ(robot.log.count("msg client1@lab TEXT n"), static_cast<std::size_t>(number - 100))
        << "each once";
    EXPECT_TRUE(waitUntil([&] { return client.log.has(std::string("status ") + kFirst + " ERR"); }, 5s));
    RawEntity late(entity_server.ready("entity"), kSecond, "Late");
    late.join();
    EXPECT_TRUE(waitUntil([&] { return client.log.has("joined Late"); }, 5s)) << "by the topic, again";
    EXPECT_FALSE(client.log.has("left Robot"));
}

TEST_F(RealServers, ServersOfAnotherEditionAreNotMetAndToldOf) {
    startStorm();
    const Ice::CommunicatorHolder communicator(Ice::initialize());
    const auto proxy =
        communicator->stringToProxy("IceStorm/TopicManager:tcp -h " + loopbackAddress() + " -p 10430");
    ASSERT_TRUE(waitUntil(
        [&] {
            try {
                proxy->ice_ping();
                return true;
            } catch (const Ice::ConnectFailedException&) {
                return false;
            }
        },
        5s));
    const auto manager = Ice::uncheckedCast<IceStorm::TopicManagerPrx>(proxy);
    const auto other = std::to_string(Axon::CommUtil::ContractNumber + 1);
    const auto newer = manager->create("FrontEndToEntity-" + other);
    newer->subscribeAndGetPublisher(
        {}, communicator->stringToProxy("nobody:tcp -h " + loopbackAddress() + " -p 1"));
    const auto nobodys = std::to_string(Axon::CommUtil::ContractNumber + 2);
    manager->create("FrontEndToEntity-" + nobodys);
    auto& entity_server = start("es1");
    const auto tells = [&](const std::string& number) {
        return entity_server.text().find("subscriptions of servers of contract " + number) !=
               std::string::npos;
    };
    EXPECT_TRUE(waitUntil([&] { return tells(other); }, 5s)) << entity_server.text();
    EXPECT_FALSE(tells(nobodys)) << "a topic to which nobody listens";
}

TEST_F(RealServers, AKilledFrontEndServerHasLostItsClientsWithinTheWatchdog) {
    startStorm();
    auto& entity_server = start("es1");
    RawEntity robot(entity_server.ready("entity"), kFirst);
    robot.registration.heartbeat_busy_ms = 2000;
    robot.join();
    RawClient client(start("fe1").ready("client"));
    RawClient other(start("fe2").ready("client"), "client2@lab");
    const auto id = client.facts.me.id;
    EXPECT_EQ(id.rfind("fe1:", 0), 0U);
    for (auto* one : {&client, &other}) ASSERT_TRUE(waitUntil([&] { return one->log.has("joined Robot"); }));
    // Its watchdog is short once it was heard directly.
    ASSERT_TRUE(waitUntil([&] { return entity_server.text().find("fe1 is there") != std::string::npos; }));
    ASSERT_TRUE(waitUntil([&] {
        const auto before = robot.log.count("signal stop requested");
        client.stop(kFirst);
        return waitUntil([&] { return robot.log.count("signal stop requested") >= before + 2; }, 200ms);
    }));
    robot.status(EntityState::BUSY, id);
    ASSERT_TRUE(waitUntil([&] { return other.log.has(std::string("status ") + kFirst + " BUSY"); }));
    programs["fe1"]->kill();
    const auto start_of_silence = std::chrono::steady_clock::now();
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop client lost"); }));
    // The watchdog is 250 ms; what is left is for a machine with a lot else to do. The idle one is 2 s.
    EXPECT_LT(std::chrono::steady_clock::now() - start_of_silence, 1500ms) << entity_server.text();
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal client lost " + id); }));

    RawClient again(start("fe1").ready("client"), "client1@lab");
    EXPECT_TRUE(waitUntil([&] { return again.log.has("joined Robot"); }, 5s));
    again.text(kFirst, "here again");
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("msg client1@lab TEXT here again"); }, 5s));
}

TEST_F(RealServers, AKilledServerIsMissedByItsPortBeforeAnyWatchdog) {
    startStorm();
    RawEntity robot(start("es1").ready("entity"), kFirst);
    robot.join();
    RawClient client(start("fe1").ready("client"));
    RawClient other(start("fe2").ready("client"), "client2@lab");
    for (auto* one : {&client, &other}) ASSERT_TRUE(waitUntil([&] { return one->log.has("joined Robot"); }));
    // Two copies each way: the servers have heard each other straight, and each watchdog is 2 s, because no
    // task runs.
    const auto id = client.facts.me.id;
    for (auto* one : {&client, &other}) {
        ASSERT_TRUE(reaches(*one, robot));
        Header receipt = robot.headTo(one->facts.me.id);
        receipt.msg_type = kMsgReceipt;
        ASSERT_TRUE(waitUntil([&] {
            const auto before = one->log.count("signal msg");
            robot.signalOneway()->sendToClient(transport::toIce(receipt), toRange("receipt"));
            return waitUntil([&] { return one->log.count("signal msg") == before + 2; }, 300ms);
        }));
    }
    robot.status(EntityState::REG, id);
    ASSERT_TRUE(waitUntil([&] { return other.log.has(std::string("status ") + kFirst + " REG"); }));

    const auto within = [](const std::function<bool()>& seen) {
        const auto begin = std::chrono::steady_clock::now();
        EXPECT_TRUE(waitUntil(seen, 5s));
        return std::chrono::steady_clock::now() - begin;
    };
    programs["fe1"]->kill();
    EXPECT_LT(within([&] { return robot.log.has("signal client lost " + id); }), 1500ms)
        << programs["es1"]->text();
    programs["es1"]->kill();
    EXPECT_LT(within([&] { return other.log.has("left Robot"); }), 1500ms) << programs["fe2"]->text();
}

TEST_F(RealServers, TheEntitiesOfAKilledEntityServerHaveLeftAndComeBackWithIt) {
    startStorm();
    RawClient client(start("fe1").ready("client"));
    RawClient other(start("fe2").ready("client"), "client2@lab");
    auto robot = std::make_unique<RawEntity>(start("es1").ready("entity"), kFirst);
    robot->join();
    for (auto* one : {&client, &other})
        ASSERT_TRUE(waitUntil([&] { return one->log.has("joined Robot"); })) << programs["fe1"]->text();
    programs["es1"]->kill();
    for (auto* one : {&client, &other})
        EXPECT_TRUE(waitUntil([&] { return one->log.has("left Robot"); }, 5s));
    robot = std::make_unique<RawEntity>(start("es1").ready("entity"), kFirst);
    robot->join();
    for (auto* one : {&client, &other}) {
        EXPECT_TRUE(waitUntil([&] { return one->log.count("joined Robot") == 2; }, 5s))
            << programs["es1"]->text() << programs["fe1"]->text();
    }
}

}  // namespace
}  // namespace axon::test
