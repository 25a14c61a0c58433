// SPDX-License-Identifier: GPL-2.0-or-later
// Several servers and a real icebox whose links are under TLS, with certificates of a CA that the test makes:
// who is let in at the ports for other servers, and who is not.
#include <IceStorm/IceStorm.h>
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>
#include <sys/socket.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iomanip>
#include <iterator>
#include <memory>
#include <set>
#include <sstream>

#include "certificates/folder.hpp"
#include "component/any_ports.hpp"
#include "component/raw_peers.hpp"
#include "server/options.hpp"
#include "server/server.hpp"
#include "support/log_lines.hpp"
#include "support/logged_program.hpp"

namespace axon::test {
namespace {

using namespace std::chrono_literals;
using certificates::Kind;
using server::ServerRole;
using testing::HasSubstr;
namespace fs = std::filesystem;
using Properties = std::map<std::string, std::string>;
using FrontEndPrx = Axon::EntityComm::EntityToFrontEndCommPrx;
using EntityPrx = Axon::FrontEndComm::FrontEndToEntityCommPrx;

std::shared_ptr<LogLines> catchLog() {
    auto lines = std::make_shared<LogLines>();
    spdlog::set_default_logger(std::make_shared<spdlog::logger>("", lines));
    return lines;
}
const std::shared_ptr<LogLines> kLog = catchLog();

/// Of the ports for other servers, at this process's own address.
constexpr int kFrontEnd = 10425;
constexpr int kFrontEndSignal = 10426;
constexpr int kEntityServer = 10427;
constexpr int kEntityServerSignal = 10428;

std::string ssl(int port) {
    return "ssl -h " + loopbackAddress() + " -p " + std::to_string(port);
}

class Links : public testing::Test {
  protected:
    Links() {
        kLog->clear();
        ours.init(now(), false);
        others.init(now(), false);
    }
    ~Links() override {
        fe1.reset();
        es1.reset();
        storm.reset();
        fs::remove_all(folder);
    }
    static fs::path newFolder() {
        std::string name = fs::temp_directory_path() / "axon-links-XXXXXX";
        return ::mkdtemp(name.data());
    }
    static certificates::WallTime now() {
        return std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now());
    }
    static fs::path file(const certificates::Folder& by, Kind kind, const std::string& name) {
        std::vector<std::string> names{name};
        if (isNamedServer(kind)) names.push_back(loopbackAddress());
        return by.issue({kind, names}, now(), true).files.back();
    }
    static Properties issued(const certificates::Folder& by, Kind kind, const std::string& name) {
        const auto properties = Ice::createProperties();
        properties->load(file(by, kind, name).string());
        return properties->getPropertiesForPrefix("Ice");
    }
    Properties issued(Kind kind, const std::string& name) const { return issued(ours, kind, name); }

    server::ServerSettings settings(ServerRole role, const std::string& name) const {
        auto its = onLoopback();
        const bool front_end = role == ServerRole::FrontEnd;
        its.role = role;
        its.name = name;
        its.client_endpoint = its.client_signal_endpoint = its.entity_endpoint = its.entity_signal_endpoint =
            "ssl://" + loopbackAddress() + ":0";
        its.topic_endpoint = ssl(front_end ? kFrontEnd : kEntityServer);
        its.topic_signal_endpoint = ssl(front_end ? kFrontEndSignal : kEntityServerSignal);
        its.topic_manager = "IceStorm/TopicManager:" + ssl(10430);
        its.ice_properties = issued(front_end ? Kind::FrontEnd : Kind::EntityServer, name);
        its.front_end.watchdog_idle = 10min;  // the stubs send no keepAlive
        its.audit.folder = (folder / ("audit-" + name)).string();
        return its;
    }
    void startStorm(const fs::path& certificate) {
        std::ofstream(folder / "icebox.cfg")
            << "IceBox.Service.IceStorm=IceStormService,37:createIceStorm --Ice.Config="
            << (folder / "storm.cfg").string() << ',' << certificate.string() << "\nIce.Admin.Enabled=0\n";
        std::ofstream(folder / "storm.cfg")
            << "IceStorm.InstanceName=IceStorm\nIceStorm.Transient=1\nIceStorm.TopicManager.Endpoints="
            << ssl(10430) << "\nIceStorm.Publish.Endpoints=" << ssl(10431)
            << "\nIceStorm.Publish.ThreadPool.Size=4\nIceStorm.Publish.ThreadPool.Serialize=1\n"
               "IceStorm.Discard.Interval=1\nIce.MessageSizeMax=4096\n";
        storm = std::make_unique<LoggedProgram>(
            std::vector<std::string>{"icebox", "--Ice.Config=" + (folder / "icebox.cfg").string()},
            folder / "icebox.log");
        EXPECT_TRUE(waitUntil([] { return listens(10430); }, 10s)) << storm->text();
    }
    static int connectedTo(int port) {
        const int its = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
        sockaddr_in at{};
        at.sin_family = AF_INET;
        at.sin_port = htons(static_cast<std::uint16_t>(port));
        inet_pton(AF_INET, loopbackAddress().c_str(), &at.sin_addr);
        if (::connect(its, reinterpret_cast<const sockaddr*>(&at), sizeof at) == 0) return its;
        ::close(its);
        return -1;
    }
    static bool listens(int port) {
        const int its = connectedTo(port);
        if (its >= 0) ::close(its);
        return its >= 0;
    }
    void startStorm() { startStorm(file(ours, Kind::Storm, loopbackAddress())); }
    void startServers() {
        fe1 = std::make_unique<server::Server>(settings(ServerRole::FrontEnd, "fe1"));
        es1 = std::make_unique<server::Server>(settings(ServerRole::Entity, "es1"));
    }
    std::unique_ptr<RawClient> newClient() const {
        return std::make_unique<RawClient>(fe1->clientAddress(Lane::Data), "client1@lab", true, "", "",
                                           issued(Kind::Client, "client1"));
    }
    std::unique_ptr<RawEntity> newRobot() const {
        auto robot = std::make_unique<RawEntity>(es1->entityAddress(Lane::Data), kFirst, "PeopleBot", "", "",
                                                 issued(Kind::Entity, "PeopleBot"));
        robot->registration.heartbeat_idle_ms = 60'000;
        robot->join();
        return robot;
    }
    /// Straight and by the topic: a stop comes twice.
    static bool reaches(RawClient& client, RawEntity& robot) {
        return waitUntil([&] {
            const auto before = robot.log.count("signal stop");
            client.stop(robot.registration.entity);
            return waitUntil([&] { return robot.log.count("signal stop") >= before + 2; }, 300ms);
        });
    }
    static bool logged(const std::string& part) {
        return waitUntil([&] { return kLog->has(part); }, 5s);
    }
    std::string trailOf(const std::string& server) const {
        std::string all;
        std::error_code none;
        for (const auto& one : fs::directory_iterator(folder / ("audit-" + server), none)) {
            std::ifstream its(one.path());
            all.append(std::istreambuf_iterator<char>(its), {});
        }
        return all;
    }
    bool audited(const std::string& server, const std::string& part) const {
        return waitUntil([&] { return trailOf(server).find(part) != std::string::npos; }, 5s);
    }
    /// How many the server says that it has refused.
    static int refused(const server::Server& server) {
        for (const auto& line : server.margins()) {
            const std::string before = "links between servers: ";
            if (line.rfind(before, 0) == 0) return std::stoi(line.substr(before.size()));
        }
        return -1;
    }
    static Ice::CommunicatorHolder communicator(const Properties& properties) {
        return transport::makeCommunicator({"stranger", Lane::Data, 1, 1, properties});
    }
    /// Whether who shows this gets an answer to a call that any server would answer.
    static bool comesIn(const Properties& shown, const std::string& identity, const std::string& endpoint) {
        const auto its = communicator(shown);
        try {
            its->stringToProxy(identity + ":" + endpoint)->ice_invocationTimeout(2000)->ice_ping();
            return true;
        } catch (const Ice::LocalException&) {
            return false;
        }
    }

    /// Each time, and counted once, and the log says why; it has ten lines in a second at most.
    static bool isRefused(const server::Server& by, const std::function<bool()>& comes_in,
                          const std::string& why) {
        kLog->clear();
        const auto before = refused(by);
        int tries = 0;
        return waitUntil(
                   [&] {
                       EXPECT_FALSE(comes_in());
                       ++tries;
                       return waitUntil([&] { return kLog->has(why); }, 200ms);
                   },
                   5s) &&
               waitUntil([&] { return refused(by) == before + tries; }, 1s);
    }
    /// The own ends of the connections that this process has opened to this port, and that stand.
    static std::set<std::string> openTo(int port) {
        in_addr address{};
        inet_pton(AF_INET, loopbackAddress().c_str(), &address);
        std::ostringstream wanted;
        wanted << std::hex << std::uppercase << std::setfill('0') << std::setw(8) << address.s_addr << ':'
               << std::setw(4) << port;
        std::set<std::string> ends;
        std::ifstream table("/proc/self/net/tcp");
        std::string line;
        while (std::getline(table, line)) {
            std::istringstream words(line);
            std::string number, local, remote, state;
            words >> number >> local >> remote >> state;
            if (remote == wanted.str() && state == "01") ends.insert(local);
        }
        return ends;
    }

    const fs::path folder = newFolder();
    const certificates::Folder ours{folder / "ours"};
    const certificates::Folder others{folder / "others"};
    std::unique_ptr<LoggedProgram> storm;
    std::unique_ptr<server::Server> fe1, es1;
};

TEST_F(Links, TheRightCertificatesJoinTheServersAndAClientStopsTheRobotOfTheOther) {
    startStorm();
    startServers();
    const auto robot = newRobot();
    const auto client = newClient();
    ASSERT_TRUE(waitUntil([&] { return client->log.has("joined PeopleBot"); }))
        << kLog->all() << storm->text();
    EXPECT_TRUE(reaches(*client, *robot)) << kLog->all();
    client->text(kFirst, "hello", 1);
    EXPECT_TRUE(waitUntil([&] { return robot->log.has("msg client1@lab TEXT hello"); }));
    robot->dataOneway()->sendToClient(transport::toIce(robot->headTo(client->facts.me.id)), toRange("yes"));
    EXPECT_TRUE(waitUntil([&] { return client->log.has(std::string("data msg ") + kFirst + " yes"); }));
    robot->status(EntityState::IDLE);
    EXPECT_TRUE(waitUntil([&] { return client->log.has(std::string("status ") + kFirst + " IDLE"); }));
    EXPECT_EQ(refused(*fe1), 0) << kLog->all();
    EXPECT_EQ(refused(*es1), 0) << kLog->all();
}

TEST_F(Links, IceStormMayDieAndComeBackAndStopsNeedItNot) {
    startStorm();
    startServers();
    const auto robot = newRobot();
    const auto client = newClient();
    ASSERT_TRUE(waitUntil([&] { return client->log.has("joined PeopleBot"); })) << kLog->all();
    ASSERT_TRUE(reaches(*client, *robot)) << kLog->all();
    storm->kill();
    const auto before = robot->log.count("signal stop");
    client->stop(kFirst);
    EXPECT_TRUE(waitUntil([&] { return robot->log.count("signal stop") > before; })) << "straight";
    client->text(kFirst, "straight", 1);
    EXPECT_TRUE(waitUntil([&] { return robot->log.has("msg client1@lab TEXT straight"); }));
    startStorm();
    EXPECT_TRUE(reaches(*client, *robot)) << "by the topic, again\n" << kLog->all();
}

TEST_F(Links, AServerThatComesBackIsReachedAgain) {
    startStorm();
    startServers();
    auto robot = newRobot();
    const auto client = newClient();
    ASSERT_TRUE(waitUntil([&] { return client->log.has("joined PeopleBot"); })) << kLog->all();
    ASSERT_TRUE(reaches(*client, *robot)) << kLog->all();
    es1.reset();
    EXPECT_TRUE(waitUntil([&] { return client->log.has("left PeopleBot"); }));
    es1 = std::make_unique<server::Server>(settings(ServerRole::Entity, "es1"));
    robot = newRobot();
    EXPECT_TRUE(waitUntil([&] { return client->log.count("joined PeopleBot") == 2; })) << kLog->all();
    EXPECT_TRUE(reaches(*client, *robot)) << kLog->all();
}

TEST_F(Links, WhoeverComesWithoutTheRightCertificateIsRefusedAndHonestServersGoOn) {
    startStorm();
    startServers();
    const auto robot = newRobot();
    const auto client = newClient();
    ASSERT_TRUE(waitUntil([&] { return client->log.has("joined PeopleBot"); })) << kLog->all();

    auto stranger = issued(others, Kind::EntityServer, "es9");
    stranger["IceSSL.CAs"] = (ours.path() / "ca.cert.pem").string();
    const Properties nothing{{"Ice.Plugin.IceSSL", "IceSSL:createIceSSL"},
                             {"IceSSL.CAs", (ours.path() / "ca.cert.pem").string()}};
    const std::string of_kind = "; expected one of the kind ";
    const struct {
        const char* who;
        Properties shows;
        bool to_front_end, to_entity_server;
        std::string why;
    } cases[] = {
        {"nobody", nothing, false, false, "no certificate was shown"},
        {"foreign CA", stranger, false, false, "the certificate is of another CA"},
        {"client", issued(Kind::Client, "client1"), false, false, "the client 'client1'" + of_kind},
        {"entity", issued(Kind::Entity, "PeopleBot"), false, false, "the entity 'PeopleBot'" + of_kind},
        {"router", issued(Kind::Router, loopbackAddress()), false, false, "the router '"},
        {"server", issued(Kind::Server, loopbackAddress()), false, false, "the server '"},
        {"front-end", issued(Kind::FrontEnd, "fe9"), false, true, "the front-end 'fe9'" + of_kind},
        {"entity server", issued(Kind::EntityServer, "es9"), true, true, ""},
        // IceStorm comes to the data lane, with what was published, and never straight.
        {"storm", issued(Kind::Storm, loopbackAddress()), false, false, "the storm '"},
    };
    for (const auto& one : cases) {
        SCOPED_TRACE(one.who);
        for (const bool signal : {false, true}) {
            const auto at_front_end = [&] {
                return comesIn(one.shows, "FrontEndServerStraight/fe1",
                               ssl(signal ? kFrontEndSignal : kFrontEnd));
            };
            const auto at_entity_server = [&] {
                return comesIn(one.shows, "EntityServerStraight/es1",
                               ssl(signal ? kEntityServerSignal : kEntityServer));
            };
            if (one.to_front_end)
                EXPECT_TRUE(at_front_end());
            else
                EXPECT_TRUE(isRefused(*fe1, at_front_end, one.why)) << kLog->all();
            // A ping is for front-end servers, as every operation that names no other kind.
            if (!one.to_entity_server)
                EXPECT_TRUE(isRefused(*es1, at_entity_server, one.why)) << kLog->all();
            else if (one.to_front_end)
                EXPECT_TRUE(isRefused(*es1, at_entity_server, "called 'ice_ping'")) << kLog->all();
            else
                EXPECT_TRUE(at_entity_server());
        }
    }
    EXPECT_TRUE(audited("fe1", "the client 'client1'")) << trailOf("fe1");
    EXPECT_TRUE(audited("es1", "the certificate is of another CA")) << trailOf("es1");
    EXPECT_TRUE(reaches(*client, *robot)) << "honest servers go on\n" << kLog->all();
}

TEST_F(Links, WhoeverSpeaksNoTlsIsRefused) {
    startStorm();
    startServers();
    const auto robot = newRobot();
    const auto client = newClient();
    ASSERT_TRUE(waitUntil([&] { return client->log.has("joined PeopleBot"); })) << kLog->all();
    const auto before = refused(*fe1);
    for (const int port : {kFrontEnd, kFrontEndSignal}) {
        const int plain = connectedTo(port);
        ASSERT_GE(plain, 0);
        // The head of a request of Ice.
        const std::string request("IceP\x01\x00\x01\x00\x00\x00\x20\x00\x00\x00", 14);
        ASSERT_GT(::send(plain, request.data(), request.size(), MSG_NOSIGNAL), 0);
        const timeval patience{5, 0};
        ::setsockopt(plain, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
        std::string said;
        char byte = 0;
        while (::recv(plain, &byte, 1, 0) == 1) said += byte;
        EXPECT_EQ(said.find("IceP"), std::string::npos) << "nothing but the alert of TLS";
        ::close(plain);
    }
    EXPECT_TRUE(waitUntil([&] { return refused(*fe1) >= before + 2; })) << kLog->all();
    EXPECT_TRUE(reaches(*client, *robot)) << kLog->all();
}

TEST_F(Links, NobodySpeaksInAnothersName) {
    startStorm();
    startServers();
    const auto robot = newRobot();
    const auto client = newClient();
    ASSERT_TRUE(waitUntil([&] { return client->log.has("joined PeopleBot"); })) << kLog->all();
    const auto straight = [](auto type, const Ice::CommunicatorHolder& its, const std::string& to) {
        using Prx = typename decltype(type)::element_type;
        // Another connection where the one before was closed.
        return Ice::uncheckedCast<Prx>(its->stringToProxy(to)->ice_connectionCached(false));
    };
    Axon::CommUtil::ServerAnnouncement announced{};
    announced.instance = "one";
    // Whoever is refused is disconnected, so the next call may find its connection closed.
    const auto refusedCall = [](const std::function<void()>& call, const std::string& why) {
        return waitUntil(
            [&] {
                try {
                    call();
                } catch (const Ice::LocalException&) {
                }
                return waitUntil([&] { return kLog->has(why); }, 200ms);
            },
            5s);
    };
    const auto front_end = communicator(issued(Kind::FrontEnd, "fe9"));
    const auto at_entity_server = straight(std::shared_ptr<EntityPrx>(), front_end,
                                           "EntityServerStraight/es1:" + ssl(kEntityServerSignal));
    announced.name = "fe9";
    EXPECT_NO_THROW(at_entity_server->frontEndServerUpdate(announced));
    announced.name = "fe1";
    EXPECT_TRUE(refusedCall([&] { at_entity_server->frontEndServerUpdate(announced); },
                            "the front-end 'fe9' announced itself as 'fe1'; expected its own name"))
        << kLog->all();

    Axon::CommUtil::Header head{};
    head.sender.id = client->facts.me.id;
    head.entity = kFirst;
    head.msgType = kMsgText;
    EXPECT_TRUE(refusedCall([&] { at_entity_server->clientMsg(head, toRange("forged")); },
                            "the front-end 'fe9' speaks for a client of 'fe1'"))
        << kLog->all();

    // An entity server's operations are not a front-end server's, and the topic is IceStorm's alone.
    EXPECT_TRUE(refusedCall([&] { at_entity_server->peerMsg(head, toRange("forged")); },
                            "called 'peerMsg', which is for the kind entity-server"))
        << kLog->all();
    const auto as_topic =
        straight(std::shared_ptr<EntityPrx>(), front_end, "EntityServer/es1:" + ssl(kEntityServer));
    EXPECT_TRUE(refusedCall([&] { as_topic->clientMsg(head, toRange("forged")); },
                            "called 'clientMsg', which is for the kind storm"))
        << kLog->all();

    const auto entity_server = communicator(issued(Kind::EntityServer, "es9"));
    const auto at_front_end = straight(std::shared_ptr<FrontEndPrx>(), entity_server,
                                       "FrontEndServerStraight/fe1:" + ssl(kFrontEnd));
    Axon::CommUtil::EntityStatus status{};
    status.entity = kFirst;
    status.server = "es1";
    EXPECT_TRUE(refusedCall([&] { at_front_end->entityUpdate(status, 1e6); },
                            "the entity-server 'es9' tells of an entity of 'es1'"))
        << kLog->all();
    Axon::CommUtil::Registration registration;
    registration.entity = kFirst;
    registration.server = "es1";
    EXPECT_TRUE(refusedCall(
        [&] {
            at_front_end->entityBasicPrflUpdate(Axon::CommUtil::Presence::Left, registration, toRange(""));
        },
        "called 'entityBasicPrflUpdate', which is for the kind storm"))
        << kLog->all();
    EXPECT_TRUE(refusedCall([&] { at_front_end->entityServerEntities("es1", {}); },
                            "called 'entityServerEntities', which is for the kind storm"))
        << kLog->all();
    EXPECT_TRUE(refusedCall([&] { at_entity_server->clientRequest(head); },
                            "called 'clientRequest', which is for the kind storm"))
        << kLog->all();
    announced.name = "es1";
    EXPECT_TRUE(refusedCall([&] { at_front_end->entityServerUpdate(announced); },
                            "the entity-server 'es9' announced itself as 'es1'"))
        << kLog->all();
    EXPECT_FALSE(robot->log.has("msg client1@lab TEXT forged"));
    EXPECT_FALSE(client->log.has("left PeopleBot"));
    EXPECT_TRUE(reaches(*client, *robot)) << kLog->all();
}

TEST_F(Links, WhoAnswersInTheNameOfAnotherServerGetsNoMessage) {
    startStorm();
    startServers();
    const auto robot = newRobot();
    const auto client = newClient();
    ASSERT_TRUE(waitUntil([&] { return client->log.has("joined PeopleBot"); })) << kLog->all();
    ASSERT_TRUE(reaches(*client, *robot)) << kLog->all();
    const auto signals = openTo(kEntityServerSignal);
    const auto messages = openTo(kEntityServer);
    ASSERT_FALSE(signals.empty());
    ASSERT_FALSE(messages.empty());
    // es9 says that it is where es1 is.
    const auto entity_server = communicator(issued(Kind::EntityServer, "es9"));
    Axon::CommUtil::ServerAnnouncement announced{};
    announced.name = "es9";
    announced.instance = "one";
    announced.signals = "EntityServerStraight/es1:" + ssl(kEntityServerSignal);
    announced.messages = "EntityServerStraight/es1:" + ssl(kEntityServer);
    Ice::uncheckedCast<FrontEndPrx>(
        entity_server->stringToProxy("FrontEndServerStraight/fe1:" + ssl(kFrontEndSignal)))
        ->entityServerUpdate(announced);
    EXPECT_TRUE(logged("is that of the entity-server 'es1'; expected that of the entity-server 'es9'"))
        << kLog->all();
    // And where nobody speaks TLS.
    announced.signals = "EntityServerStraight/es1:tcp -h " + loopbackAddress() + " -p 9";
    announced.messages.clear();
    announced.instance = "two";
    Ice::uncheckedCast<FrontEndPrx>(
        entity_server->stringToProxy("FrontEndServerStraight/fe1:" + ssl(kFrontEndSignal)))
        ->entityServerUpdate(announced);
    EXPECT_TRUE(logged("server es9 is out of reach")) << kLog->all();
    EXPECT_TRUE(reaches(*client, *robot)) << kLog->all();
    EXPECT_THAT(openTo(kEntityServerSignal), testing::IsSupersetOf(signals)) << "es1's own go on";
    EXPECT_THAT(openTo(kEntityServer), testing::IsSupersetOf(messages));
}

TEST_F(Links, WhoAnswersInTheNameOfIceStormIsNotBelieved) {
    fe1 = std::make_unique<server::Server>(settings(ServerRole::FrontEnd, "fe1"));
    ASSERT_TRUE(logged("IceStorm is out of reach")) << kLog->all();
    startStorm(file(ours, Kind::Router, loopbackAddress()));
    EXPECT_TRUE(logged("is that of the router '" + loopbackAddress() + "'; expected one of the kind storm"))
        << kLog->all();
    EXPECT_FALSE(kLog->has("IceStorm was found"));
    storm.reset();
    startStorm();
    EXPECT_TRUE(logged("IceStorm was found")) << kLog->all();
}

TEST_F(Links, OnlyServersMayPublishAndSubscribe) {
    startStorm();
    fe1 = std::make_unique<server::Server>(settings(ServerRole::FrontEnd, "fe1"));
    ASSERT_TRUE(logged("IceStorm was found")) << kLog->all();
    const auto at = [&](Properties shown) {
        // As a hostile peer, which asks nobody whom it calls.
        for (const auto* key : {"IceSSL.TrustOnly.Server", "IceSSL.TrustOnly.Client"}) shown.erase(key);
        Ice::InitializationData init;
        init.properties = Ice::createProperties();
        for (const auto& [key, value] : shown) init.properties->setProperty(key, value);
        init.properties->setProperty("Ice.RetryIntervals", "-1");
        const Ice::CommunicatorHolder its(init);
        for (const int port : {10430, 10431}) {
            try {
                its->stringToProxy("IceStorm/TopicManager:" + ssl(port))
                    ->ice_invocationTimeout(2000)
                    ->ice_ping();
                return true;
            } catch (const Ice::ObjectNotExistException&) {  // it is let in
                return true;
            } catch (const Ice::LocalException&) {
            }
        }
        return false;
    };
    EXPECT_TRUE(at(issued(Kind::FrontEnd, "fe9")));
    EXPECT_TRUE(at(issued(Kind::EntityServer, "es9")));
    for (const auto kind :
         {Kind::Client, Kind::Entity, Kind::Router, Kind::Server, Kind::Storm, Kind::Registry})
        EXPECT_FALSE(
            at(issued(kind, kind == Kind::Client || kind == Kind::Entity ? "somebody" : loopbackAddress())))
            << toString(kind);
}

TEST_F(Links, AServersCertificateIsNoClientsAndNoEntitys) {
    startServers();
    const auto refusalOf = [](const std::function<void()>& action) {
        try {
            action();
        } catch (const std::exception&) {
            return transport::translate(std::current_exception(), true).message;
        }
        return std::string("accepted");
    };
    EXPECT_THAT(refusalOf([&] {
                    const RawEntity robot(es1->entityAddress(Lane::Data), kFirst, "es9", "", "",
                                          issued(Kind::EntityServer, "es9"));
                }),
                HasSubstr("expected one of the kind 'entity'"));
    EXPECT_THAT(refusalOf([&] {
                    const RawClient client(fe1->clientAddress(Lane::Data), "fe9", true, "", "",
                                           issued(Kind::FrontEnd, "fe9"));
                }),
                HasSubstr("expected one of the kind 'client'"));
}

TEST_F(Links, MisconfigurationIsToldWithItsMend) {
    const auto complaint = [](const server::ServerSettings& wrong) -> std::string {
        try {
            const server::Server server(wrong);
        } catch (const std::runtime_error& error) {
            return error.what();
        }
        return "accepted";
    };
    const auto plain = [&] {
        auto its = settings(ServerRole::FrontEnd, "fe1");
        its.topic_endpoint = its.topic_signal_endpoint = loopbackAddress() + ":0";
        its.topic_manager = "IceStorm/TopicManager:tcp -h 127.0.0.1 -p 10430";
        return its;
    };
    auto its = plain();
    EXPECT_EQ(complaint(its), "accepted") << "on loopback, as ever";
    its.topic_signal_endpoint = "0.0.0.0:0";
    its.plain_tcp = true;
    EXPECT_THAT(complaint(its), HasSubstr("axon certs issue --front-end fe1 HOST"));
    EXPECT_THAT(complaint(its), HasSubstr("Server.PlainTcp does not open this port"));
    its = plain();
    its.topic_manager = "IceStorm/TopicManager:tcp -h 192.0.2.7 -p 10430";
    EXPECT_THAT(complaint(its), HasSubstr("IceStorm is believed whatever it says"));
    its.topic_manager = "IceStorm/TopicManager:ssl -h 127.0.0.1 -p 10430";
    EXPECT_THAT(complaint(its), HasSubstr("expected tcp"));
    its = plain();
    its.neighbours["fe2"] = "SessionManager:tcp -h 192.0.2.7 -p 10426";
    EXPECT_THAT(complaint(its), HasSubstr("Server.Peer.fe2: 'SessionManager:tcp"));

    const auto tls = settings(ServerRole::FrontEnd, "fe1");
    its = tls;
    its.topic_manager = "IceStorm/TopicManager:tcp -h 127.0.0.1 -p 10430";
    EXPECT_THAT(complaint(its), HasSubstr("expected ssl"));
    its = tls;
    its.topic_signal_endpoint = loopbackAddress() + ":0";
    EXPECT_THAT(complaint(its), HasSubstr("expected TLS for all of these endpoints, or for none"));
    its = tls;
    its.ice_properties.clear();
    EXPECT_THAT(complaint(its), HasSubstr("axon certs issue --front-end fe1 HOST"));
    its = tls;
    its.ice_properties["IceSSL.VerifyPeer"] = "0";
    EXPECT_THAT(complaint(its), HasSubstr("IceSSL.VerifyPeer=0"));
    its.ice_properties["IceSSL.VerifyPeer"] = "00";
    EXPECT_THAT(complaint(its), HasSubstr("IceSSL.VerifyPeer=00"));
    its = tls;
    its.ice_properties["FrontEndServerTopicSignal.PublishedEndpoints"] = "tcp -h 192.0.2.7 -p 10426";
    EXPECT_THAT(complaint(its), HasSubstr("FrontEndServerTopicSignal.PublishedEndpoints: 'tcp"));
    its = tls;
    its.neighbours["fe2"] = "SessionManager:tcp -h 127.0.0.1 -p 10426";
    EXPECT_THAT(complaint(its), HasSubstr("Server.Peer.fe2: 'SessionManager:tcp"));
    its = tls;
    its.client_router_endpoint = "0.0.0.0:0";
    its.plain_tcp = true;
    EXPECT_THAT(complaint(its), HasSubstr("is for routers, and the links between servers are under TLS"));
    its = tls;
    its.topic_manager = "IceStorm/TopicManager:tcp -p 10430";  // Ice calls this machine
    EXPECT_THAT(complaint(its), HasSubstr("expected ssl"));
    its.topic_manager = "IceStorm/TopicManager";
    EXPECT_THAT(complaint(its), HasSubstr("is not a proxy with an address"));
    its = tls;
    its.ice_properties = issued(Kind::FrontEnd, "fe2");
    EXPECT_THAT(complaint(its), HasSubstr("the front-end 'fe2'; expected that of the front-end 'fe1'"));
    its.ice_properties = issued(Kind::EntityServer, "fe1");
    EXPECT_THAT(complaint(its), HasSubstr("the entity-server 'fe1'; expected that of the front-end 'fe1'"));
    its.ice_properties = issued(Kind::Server, loopbackAddress());
    EXPECT_THAT(complaint(its), HasSubstr("expected that of the front-end 'fe1'"));
}

TEST_F(Links, ListenOnEveryAddressWithoutUsersWhereClientsDoNot) {
    auto its = settings(ServerRole::Entity, "es1");
    its.topic_endpoint = its.topic_signal_endpoint = "ssl -h 0.0.0.0 -p 0";
    EXPECT_NO_THROW(const server::Server server(its));
}

}  // namespace
}  // namespace axon::test
