// SPDX-License-Identifier: GPL-2.0-or-later
// Several servers and a real icebox whose links are under TLS, with certificates of a CA that the test makes:
// who is let in at the ports for other servers, and who is not.
#include <IceStorm/IceStorm.h>
#include <arpa/inet.h>
#include <gmock/gmock.h>
#include <gnutls/gnutls.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <atomic>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iomanip>
#include <iterator>
#include <memory>
#include <random>
#include <set>
#include <sstream>

#include "certificates/folder.hpp"
#include "component/any_ports.hpp"
#include "component/raw_peers.hpp"
#include "server/options.hpp"
#include "server/server.hpp"
#include "support/log_lines.hpp"
#include "support/logged_program.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/sessions/router_servants.hpp"

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
        ours.init(now() - std::chrono::days{500}, false);  // long enough for a certificate that has expired
        others.init(now(), false);
    }
    ~Links() override {
        client.reset();
        robot.reset();
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
    Neighbours::Timeouts neighbours;  ///< of entity servers, at the front-end server

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
        its.front_end.entity_servers = neighbours;
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
    static sockaddr_in ownAddress(int port) {
        sockaddr_in at{};
        at.sin_family = AF_INET;
        at.sin_port = htons(static_cast<std::uint16_t>(port));
        inet_pton(AF_INET, loopbackAddress().c_str(), &at.sin_addr);
        return at;
    }
    /// `from`: the port of this end, which several connections may have; 0: any that is free.
    static int connectedTo(int port, int from = 0) {
        const int its = ::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
        const auto to = ownAddress(port), here = ownAddress(from);
        const int yes = 1;
        if ((from == 0 || (::setsockopt(its, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes) == 0 &&
                           ::bind(its, reinterpret_cast<const sockaddr*>(&here), sizeof here) == 0)) &&
            ::connect(its, reinterpret_cast<const sockaddr*>(&to), sizeof to) == 0)
            return its;
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
        auto its = std::make_unique<RawEntity>(es1->entityAddress(Lane::Data), kFirst, "PeopleBot", "", "",
                                               issued(Kind::Entity, "PeopleBot"));
        its->registration.heartbeat_idle_ms = 60'000;
        its->join();
        return its;
    }
    /// IceStorm, both servers, a robot at one and a client at the other that has heard of it.
    void startAll() {
        startStorm();
        startServers();
        robot = newRobot();
        client = newClient();
        ASSERT_TRUE(waitUntil([&] { return client->log.has("joined PeopleBot"); }))
            << kLog->all() << storm->text();
    }
    /// Straight and by the topic: a stop comes twice.
    bool reaches() const {
        return waitUntil([&] {
            const auto before = robot->log.count("signal stop");
            client->stop(robot->registration.entity);
            return waitUntil([&] { return robot->log.count("signal stop") >= before + 2; }, 300ms);
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
    std::unique_ptr<RawEntity> robot;
    std::unique_ptr<RawClient> client;
};

TEST_F(Links, TheRightCertificatesJoinTheServersAndAClientStopsTheRobotOfTheOther) {
    ASSERT_NO_FATAL_FAILURE(startAll());
    EXPECT_TRUE(reaches()) << kLog->all();
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
    ASSERT_NO_FATAL_FAILURE(startAll());
    ASSERT_TRUE(reaches()) << kLog->all();
    storm->kill();
    const auto before = robot->log.count("signal stop");
    client->stop(kFirst);
    EXPECT_TRUE(waitUntil([&] { return robot->log.count("signal stop") > before; })) << "straight";
    client->text(kFirst, "straight", 1);
    EXPECT_TRUE(waitUntil([&] { return robot->log.has("msg client1@lab TEXT straight"); }));
    startStorm();
    EXPECT_TRUE(reaches()) << "by the topic, again\n" << kLog->all();
}

TEST_F(Links, AServerThatComesBackIsReachedAgain) {
    // Once a heartbeat has come directly, only the refused connection ends it so early. A receipt may come
    // before that heartbeat; then it is silence for three seconds.
    neighbours.idle = 10min;
    ASSERT_NO_FATAL_FAILURE(startAll());
    ASSERT_TRUE(reaches()) << kLog->all();
    // A receipt comes twice, too, when the front-end server hears the other one straight.
    ASSERT_TRUE(waitUntil([&] {
        Header receipt = robot->headTo(client->facts.me.id);
        receipt.msg_type = kMsgReceipt;
        const auto before = client->log.count("signal msg");
        robot->signalOneway()->sendToClient(transport::toIce(receipt), toRange("receipt"));
        return waitUntil([&] { return client->log.count("signal msg") == before + 2; }, 300ms);
    })) << kLog->all();
    es1.reset();
    EXPECT_TRUE(waitUntil([&] { return client->log.has("left PeopleBot"); }, 10s)) << "its port refuses";
    es1 = std::make_unique<server::Server>(settings(ServerRole::Entity, "es1"));
    robot = newRobot();
    EXPECT_TRUE(waitUntil([&] { return client->log.count("joined PeopleBot") == 2; })) << kLog->all();
    EXPECT_TRUE(reaches()) << kLog->all();
}

TEST_F(Links, WhoeverComesWithoutTheRightCertificateIsRefusedAndHonestServersGoOn) {
    ASSERT_NO_FATAL_FAILURE(startAll());

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
    EXPECT_TRUE(reaches()) << "honest servers go on\n" << kLog->all();
}

TEST_F(Links, WhoeverSpeaksNoTlsIsRefused) {
    ASSERT_NO_FATAL_FAILURE(startAll());
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
    EXPECT_TRUE(reaches()) << kLog->all();
}

TEST_F(Links, NobodySpeaksInAnothersName) {
    ASSERT_NO_FATAL_FAILURE(startAll());
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
    EXPECT_TRUE(reaches()) << kLog->all();
}

/// An entity server of its own certificate that is nothing else: it may call, and says what it is told to.
class EntitiesOfOthers : public Links {
  protected:
    struct Stranger {
        Ice::CommunicatorHolder communicator;
        std::shared_ptr<FrontEndPrx> at_front_end, signals_at_front_end;
        std::shared_ptr<EntityPrx> at_entity_server, signals_at_entity_server;
    };
    Stranger stranger(const std::string& name) const {
        Stranger its;
        its.communicator = communicator(issued(Kind::EntityServer, name));
        const auto at = [&](const std::string& identity, int port) {
            return its.communicator->stringToProxy(identity + ":" + ssl(port));
        };
        its.at_front_end = Ice::uncheckedCast<FrontEndPrx>(at("FrontEndServerStraight/fe1", kFrontEnd));
        its.signals_at_front_end =
            Ice::uncheckedCast<FrontEndPrx>(at("FrontEndServerStraight/fe1", kFrontEndSignal));
        its.at_entity_server = Ice::uncheckedCast<EntityPrx>(at("EntityServerStraight/es1", kEntityServer));
        its.signals_at_entity_server =
            Ice::uncheckedCast<EntityPrx>(at("EntityServerStraight/es1", kEntityServerSignal));
        return its;
    }
    /// es1 is told again, because a server that says nothing more is soon given up.
    static void has(const Stranger& its, const std::string& name, const std::string& entity) {
        Axon::CommUtil::ServerAnnouncement self{};
        self.name = name;
        self.instance = "one";
        its.at_entity_server->entityServerUpdate(self, {entity});
    }
    /// The connections of `proxy` and the number of refusals before and after `call`, which is refused
    /// because of `why` without an end to the connection. The log has a bound for each second.
    template <class Proxy>
    static void isDropped(const server::Server& by, const std::shared_ptr<Proxy>& proxy,
                          const std::function<void()>& call, const std::string& why) {
        const auto connection = proxy->ice_getConnection();
        EXPECT_TRUE(isRefused(
            by,
            [&] {
                call();  // twoway: it is over when this returns
                return false;
            },
            why))
            << why << "\n"
            << kLog->all();
        EXPECT_EQ(proxy->ice_getConnection(), connection) << "it is not disconnected";
        EXPECT_NO_THROW(connection->throwException());
    }
};

TEST_F(EntitiesOfOthers, AreNotSpokenForToClients) {
    ASSERT_NO_FATAL_FAILURE(startAll());
    const auto es9 = stranger("es9");
    Axon::CommUtil::Header head{};
    head.sender.id = client->facts.me.id;
    head.entity = kFirst;
    head.msgType = kMsgText;
    head.seq = 77;
    using Axon::CommUtil::Lane::Data;
    using Axon::CommUtil::Lane::Signal;
    const auto which = [](const std::string& what) {
        return "the entity-server 'es9' " + what + " the entity '" + kFirst + "', which the server 'es1' has";
    };
    isDropped(
        *fe1, es9.at_front_end, [&] { es9.at_front_end->entityMsg(Data, head, toRange("forged")); },
        which("sends a message of"));
    isDropped(
        *fe1, es9.signals_at_front_end,
        [&] { es9.signals_at_front_end->entityMsg(Signal, head, toRange("forged")); },
        which("sends a message of"));
    isDropped(
        *fe1, es9.at_front_end, [&] { es9.at_front_end->entityMsgDataSeq(head, toRange("forged")); },
        which("sends data of"));
    const auto code = static_cast<int>(RefusalCode::NotConnected);
    isDropped(
        *fe1, es9.at_front_end, [&] { es9.at_front_end->entityRefusal(head, code, "forged"); },
        which("refuses in the name of"));
    EXPECT_TRUE(audited("fe1", which("sends a message of"))) << trailOf("fe1");
    EXPECT_TRUE(audited("fe1", which("refuses in the name of"))) << trailOf("fe1");

    // What it may say on the same connection: that it does not know the entity, and what nobody else has.
    es9.at_front_end->entityRefusal(head, static_cast<int>(RefusalCode::UnknownEntity), "it left");
    EXPECT_TRUE(waitUntil([&] { return client->log.has("refused"); })) << "the entity has left that server";
    head.entity = kSecond;
    es9.at_front_end->entityMsg(Data, head, toRange("not yet told"));
    EXPECT_TRUE(waitUntil([&] { return client->log.has(std::string("data msg ") + kSecond); }));
    EXPECT_EQ(client->log.count("refused"), 1U);
    EXPECT_FALSE(client->log.has(std::string("data msg ") + kFirst + " forged"));
    EXPECT_FALSE(client->log.has(std::string("signal msg ") + kFirst + " forged"));
    EXPECT_FALSE(client->log.has("data 77"));

    robot->dataOneway()->sendToClient(transport::toIce(robot->headTo(client->facts.me.id)), toRange("yes"));
    EXPECT_TRUE(waitUntil([&] { return client->log.has(std::string("data msg ") + kFirst + " yes"); }));
    robot->dataOneway()->sendToClientDataSeq(transport::toIce(robot->headTo(client->facts.me.id)),
                                             toRange("data"));
    EXPECT_TRUE(waitUntil([&] { return client->log.has("data 0"); })) << "its own server speaks for it";
    EXPECT_TRUE(reaches()) << kLog->all();
}

TEST_F(EntitiesOfOthers, AreNotSpokenForToEntities) {
    startServers();
    robot = newRobot();
    const auto es2 = stranger("es2");
    const auto es9 = stranger("es9");
    Axon::CommUtil::Header head{};
    head.sender.id = kSecond;
    head.sender.name = "Second";
    head.entity = kFirst;
    head.msgType = kMsgText;
    isDropped(
        *es1, es9.at_entity_server,
        [&] {
            has(es2, "es2", kSecond);
            es9.at_entity_server->peerMsg(head, toRange("forged"));
        },
        std::string("the entity-server 'es9' sends a message of the entity '") + kSecond +
            "', which the server 'es2' has");
    isDropped(
        *es1, es9.signals_at_entity_server,
        [&] {
            has(es2, "es2", kSecond);
            es9.signals_at_entity_server->peerMsg(head, toRange("forged"));
        },
        "which the server 'es2' has");
    head.sender.id = kFirst;
    isDropped(
        *es1, es9.at_entity_server, [&] { es9.at_entity_server->peerMsg(head, toRange("forged")); },
        "which the server 'es1' has");
    EXPECT_TRUE(audited("es1", "which the server 'es2' has")) << trailOf("es1");

    // A refusal has the head of the message that is refused.
    head.entity = kSecond;
    const auto code = static_cast<int>(RefusalCode::Overloaded);
    isDropped(
        *es1, es9.at_entity_server,
        [&] {
            has(es2, "es2", kSecond);
            es9.at_entity_server->peerRefusal(head, code, "forged");
        },
        "the entity-server 'es9' refuses in the name of the entity '" + std::string(kSecond));
    EXPECT_FALSE(robot->log.has("refused"));
    es9.at_entity_server->peerRefusal(head, static_cast<int>(RefusalCode::UnknownEntity), "it left");
    EXPECT_TRUE(waitUntil([&] { return robot->log.count("refused") == 1; }));

    has(es2, "es2", kSecond);
    es2.at_entity_server->peerRefusal(head, code, "slow");
    EXPECT_TRUE(waitUntil([&] { return robot->log.count("refused") == 2; }));
    head.sender.id = kSecond;
    head.entity = kFirst;
    es2.at_entity_server->peerMsg(head, toRange("step"));
    EXPECT_TRUE(waitUntil([&] { return robot->log.has("msg Second TEXT step"); }));
    EXPECT_FALSE(robot->log.has("msg Second TEXT forged"));
    EXPECT_FALSE(robot->log.has("signal msg Second TEXT forged"));
}

TEST_F(Links, WhoAnswersInTheNameOfAnotherServerGetsNoMessage) {
    ASSERT_NO_FATAL_FAILURE(startAll());
    ASSERT_TRUE(reaches()) << kLog->all();
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
    EXPECT_TRUE(reaches()) << kLog->all();
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
                    const RawEntity its(es1->entityAddress(Lane::Data), kFirst, "es9", "", "",
                                        issued(Kind::EntityServer, "es9"));
                }),
                HasSubstr("expected one of the kind 'entity'"));
    EXPECT_THAT(refusalOf([&] {
                    const RawClient its(fe1->clientAddress(Lane::Data), "fe9", true, "", "",
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

/// Somebody opens many connections to the ports for other servers, and does not finish a handshake.
class FloodOfLinks : public Links {
  protected:
    FloodOfLinks() {
        // A server lets a quarter of its descriptors be strangers', and half of these be of one address.
        ::getrlimit(RLIMIT_NOFILE, &before_);
        const rlimit fewer{1024, before_.rlim_max};
        EXPECT_EQ(::setrlimit(RLIMIT_NOFILE, &fewer), 0);
    }
    ~FloodOfLinks() override {
        for (const int one : flood) ::close(one);
        ::setrlimit(RLIMIT_NOFILE, &before_);
    }
    static constexpr std::size_t kOfOneAddress = 128;
    void floodOf(std::size_t count, int port) {
        for (std::size_t i = 0; i < count; ++i) {
            const int its = connectedTo(port);
            ASSERT_GE(its, 0);
            // The beginning of a TLS handshake, for half of them.
            if (i % 2 == 0) {
                EXPECT_EQ(::send(its, "\x16\x03\x01\x02", 4, MSG_NOSIGNAL), 4);
            }
            flood.push_back(its);
        }
    }
    /// How many stand; each of the newest sends one more byte.
    std::size_t open() {
        std::size_t found = 0;
        for (std::size_t i = 0; i < flood.size(); ++i) {
            char byte = 0;
            const auto got = ::recv(flood[i], &byte, 1, MSG_DONTWAIT);
            const bool stands = got > 0 || (got < 0 && (errno == EAGAIN || errno == EWOULDBLOCK));
            found += stands ? 1 : 0;
            if (stands && i % 2 == 0 && i + 8 >= flood.size()) ::send(flood[i], "\0", 1, MSG_NOSIGNAL);
        }
        return found;
    }
    std::vector<int> flood;

  private:
    rlimit before_{};
};

/// A server's TLS over a socket, as far as what Ice says first.
class Handshake {
  public:
    /// `configuration`: of `axon certs issue`; the certificate and its key lie beside it.
    Handshake(int socket, const fs::path& configuration) : socket_(socket) {
        const auto of = [&](const char* end) {
            return fs::path(configuration).replace_extension(end).string();
        };
        gnutls_certificate_allocate_credentials(&credentials_);
        const int loaded = gnutls_certificate_set_x509_key_file(credentials_, of("cert.pem").c_str(),
                                                                of("key.pem").c_str(), GNUTLS_X509_FMT_PEM);
        EXPECT_GE(loaded, 0) << gnutls_strerror(loaded);
        gnutls_init(&session_, GNUTLS_CLIENT);
        gnutls_set_default_priority(session_);
        gnutls_credentials_set(session_, GNUTLS_CRD_CERTIFICATE, credentials_);
        gnutls_transport_set_int(session_, socket);
        gnutls_handshake_set_timeout(session_, 20'000);
        gnutls_record_set_timeout(session_, 20'000);
    }
    Handshake(const Handshake&) = delete;
    Handshake& operator=(const Handshake&) = delete;
    ~Handshake() {
        gnutls_deinit(session_);
        gnutls_certificate_free_credentials(credentials_);
        ::close(socket_);
    }
    /// Whether the other end has let it in: the first that Ice sends, its "validate connection", has come.
    bool isLetIn() {
        const auto until = [](auto step) {
            for (auto code = step();; code = step())
                if (code >= 0 || gnutls_error_is_fatal(static_cast<int>(code)) != 0) return code;
        };
        if (until([&] { return gnutls_handshake(session_); }) != GNUTLS_E_SUCCESS) return false;
        std::array<char, 14> message{};
        return until([&] { return gnutls_record_recv(session_, message.data(), message.size()); }) == 14;
    }

  private:
    const int socket_;
    gnutls_certificate_credentials_t credentials_ = nullptr;
    gnutls_session_t session_ = nullptr;
};

TEST_F(FloodOfLinks, WhoComesFromTheSamePortAsAServerIsAStrangerAllTheSame) {
    startServers();
    const int free = connectedTo(kFrontEnd);
    sockaddr_in here{};
    socklen_t size = sizeof here;
    ASSERT_EQ(::getsockname(free, reinterpret_cast<sockaddr*>(&here), &size), 0);
    ::close(free);
    const int port = ntohs(here.sin_port);

    const auto certificate = file(ours, Kind::EntityServer, "es9");
    const int its = connectedTo(kFrontEndSignal, port);
    ASSERT_GE(its, 0) << std::strerror(errno);
    Handshake server(its, certificate);
    ASSERT_TRUE(server.isLetIn()) << kLog->all();
    const int stranger = connectedTo(kFrontEnd, port);
    ASSERT_GE(stranger, 0) << std::strerror(errno);
    flood.push_back(stranger);
    const auto stands = [](int one) {
        char byte = 0;
        return ::recv(one, &byte, 1, MSG_DONTWAIT | MSG_PEEK) < 0 && errno == EAGAIN;
    };
    EXPECT_TRUE(waitUntil([&] { return !stands(stranger); }, 40s)) << "it has shown no certificate";
    EXPECT_TRUE(stands(its)) << "the server has gone, too";
    EXPECT_TRUE(waitUntil([&] { return kLog->has("no session in 10 s"); }, 30s)) << kLog->all();
}

TEST_F(FloodOfLinks, IsBoundedAndWhoeverFinishesNoHandshakeIsDisconnectedWhileHonestServersGoOn) {
    ASSERT_NO_FATAL_FAILURE(startAll());
    ASSERT_TRUE(reaches()) << kLog->all();
    // Both connections of the entity server have been used: no handshake of theirs is under way.
    const auto to_client = transport::toIce(robot->headTo(client->facts.me.id));
    robot->signalOneway()->sendToClient(to_client, toRange("signal"));
    robot->dataOneway()->sendToClient(to_client, toRange("data"));
    ASSERT_TRUE(waitUntil([&] {
        return client->log.has(std::string("signal msg ") + kFirst + " signal") &&
               client->log.has(std::string("data msg ") + kFirst + " data");
    })) << kLog->all();
    const auto signals = openTo(kFrontEndSignal);
    const auto messages = openTo(kFrontEnd);
    floodOf(150, kFrontEnd);
    floodOf(150, kFrontEndSignal);
    EXPECT_TRUE(waitUntil([&] { return open() <= kOfOneAddress; }, 30s)) << open();
    EXPECT_TRUE(logged("more than 128 of one address without a session")) << kLog->all();
    EXPECT_TRUE(reaches()) << kLog->all();
    EXPECT_TRUE(waitUntil([&] { return open() == 0; }, 40s)) << open() << " handshakes go on";
    EXPECT_TRUE(waitUntil([&] { return kLog->has("no session in 10 s"); }, 30s)) << kLog->all();
    EXPECT_TRUE(audited("fe1", "without a session")) << trailOf("fe1");
    EXPECT_THAT(openTo(kFrontEndSignal), testing::IsSupersetOf(signals)) << "those of the server go on";
    EXPECT_THAT(openTo(kFrontEnd), testing::IsSupersetOf(messages)) << "also where nothing is sent";
    EXPECT_TRUE(reaches()) << kLog->all();
    EXPECT_EQ(refused(*es1), 0);
}

TEST_F(FloodOfLinks, WithoutTlsIsBoundedToo) {
    auto its = settings(ServerRole::FrontEnd, "fe1");
    its.topic_endpoint = loopbackAddress() + ":" + std::to_string(kFrontEnd);
    its.topic_signal_endpoint = loopbackAddress() + ":" + std::to_string(kFrontEndSignal);
    its.topic_manager = "IceStorm/TopicManager:tcp -h 127.0.0.1 -p 10430";
    fe1 = std::make_unique<server::Server>(its);
    const auto neighbour = communicator({});
    const auto proxy = neighbour->stringToProxy("FrontEndServerStraight/fe1:tcp -h " + loopbackAddress() +
                                                " -p " + std::to_string(kFrontEnd));
    proxy->ice_ping();
    const auto connection = proxy->ice_getConnection();
    floodOf(200, kFrontEnd);
    EXPECT_TRUE(waitUntil([&] { return open() <= kOfOneAddress; }, 30s)) << open();
    EXPECT_TRUE(waitUntil([&] { return open() == 0; }, 40s)) << open();
    EXPECT_NO_THROW(connection->throwException()) << "who has called is a server";
    proxy->ice_ping();
    EXPECT_EQ(proxy->ice_getConnection(), connection);
}

/// What comes to every port of a front-end server and of an entity server that speaks TLS, and is no
/// handshake.
class AbuseOfPorts : public FloodOfLinks {
  protected:
    struct Port {
        std::string name, server;  // of the audit trail
        int number;
    };
    static int portOf(const std::string& address) {
        return std::stoi(address.substr(address.rfind(':') + 1));
    }
    std::vector<Port> ports() const {
        return {{"other servers", "fe1", kFrontEnd},
                {"signals of other servers", "fe1", kFrontEndSignal},
                {"other servers", "es1", kEntityServer},
                {"signals of other servers", "es1", kEntityServerSignal},
                {"clients", "fe1", portOf(fe1->clientAddress(Lane::Data))},
                {"signals of clients", "fe1", portOf(fe1->clientAddress(Lane::Signal))},
                {"Entity Managers", "es1", portOf(es1->entityAddress(Lane::Data))},
                {"signals of Entity Managers", "es1", portOf(es1->entityAddress(Lane::Signal))}};
    }
    /// Nothing that is accepted: what other protocols say, broken records of TLS, and noise.
    static std::vector<std::string> rubbish() {
        const auto record = [](const std::string& head, const std::string& rest) { return head + rest; };
        std::vector<std::string> all{
            std::string("IceP\x01\x00\x01\x00\x00\x00\x20\x00\x00\x00", 14),
            "GET / HTTP/1.1\r\nHost: lab\r\n\r\n",
            std::string("\x80\x2e\x01\x00\x02\x00\x15\x00\x00\x00\x10", 11),  // SSL 2
            record(std::string("\x16\x03\x01\xff\xff", 5),
                   std::string(70000, 'x')),                                       // longer than any record
            record(std::string("\x16\x03\x01\x00\x00", 5), ""),                    // empty
            record(std::string("\x15\x03\x03\x00\x02\x02\x28", 7), ""),            // an alert
            record(std::string("\x17\x03\x03\x00\x10", 5), std::string(16, 'x')),  // data before a handshake
            std::string(1, '\0'),
            ""};
        std::mt19937 random(7);
        const auto noise = [&random](std::size_t bytes) {
            std::string its;
            for (std::size_t i = 0; i < bytes; ++i) its += static_cast<char>(random());
            return its;
        };
        for (int i = 0; i < 20; ++i) all.push_back(noise(1 + random() % 600));
        for (int i = 0; i < 20; ++i) {
            const auto body = noise(4 + random() % 500);
            const auto length = body.size() - random() % 4;  // and a little more than it says
            all.push_back(record(std::string("\x16\x03\x01", 3), "") + static_cast<char>(length >> 8U) +
                          static_cast<char>(length & 0xFFU) + "\x01" + body);
        }
        return all;
    }
    /// Sends it and nothing more; the own address, as the server sees it. Empty where the server goes on
    /// talking.
    static std::string refusedAddress(int port, const std::string& sent) {
        const int its = connectedTo(port);
        if (its < 0) return {};
        sockaddr_in own{};
        socklen_t size = sizeof own;
        ::getsockname(its, reinterpret_cast<sockaddr*>(&own), &size);
        char host[INET_ADDRSTRLEN] = {};
        inet_ntop(AF_INET, &own.sin_addr, host, sizeof host);
        ::send(its, sent.data(), sent.size(), MSG_NOSIGNAL);
        ::shutdown(its, SHUT_WR);
        const timeval patience{30, 0};
        ::setsockopt(its, SOL_SOCKET, SO_RCVTIMEO, &patience, sizeof patience);
        std::string said;
        char byte = 0;
        ssize_t got = 0;
        while ((got = ::recv(its, &byte, 1, 0)) == 1) said += byte;
        const bool closed = got == 0 || errno == ECONNRESET;
        ::close(its);
        if (!closed || said.find("IceP") != std::string::npos) return {};
        return std::string(host) + ":" + std::to_string(ntohs(own.sin_port));
    }
};

TEST_F(AbuseOfPorts, NoRubbishComesInAndEachIsRecordedWithItsAddress) {
    ASSERT_NO_FATAL_FAILURE(startAll());
    const auto all = rubbish();
    for (const auto& port : ports()) {
        SCOPED_TRACE("the port for " + port.name + " of " + port.server);
        floodOf(2, port.number);  // half-open, one of them a byte at a time
        std::vector<std::string> addresses;
        for (std::size_t i = 0; i < all.size(); ++i) {
            addresses.push_back(refusedAddress(port.number, all[i]));
            EXPECT_FALSE(addresses.back().empty()) << "case " << i << " of " << all[i].size() << " bytes";
        }
        std::string missing;
        EXPECT_TRUE(waitUntil(
            [&] {
                const auto trail = trailOf(port.server);
                missing.clear();
                for (std::size_t i = 0; i < all.size(); ++i)
                    if (trail.find('"' + addresses[i] + '"') == std::string::npos)
                        missing += " " + std::to_string(i);
                return missing.empty();
            },
            20s))
            << "not recorded:" << missing;
        EXPECT_TRUE(reaches()) << kLog->all();
    }
    EXPECT_TRUE(waitUntil([&] { return open() == 0; }, 40s)) << open() << " half-open ones stand";
    EXPECT_TRUE(reaches()) << "honest peers go on\n" << kLog->all();
}

TEST_F(AbuseOfPorts, NoCertificateThatIsNotValidComesIn) {
    ASSERT_NO_FATAL_FAILURE(startAll());
    const auto ca = (ours.path() / "ca.cert.pem").string();
    const auto expired = [&](Kind kind, const std::string& name) {
        std::vector<std::string> names{name};
        if (isNamedServer(kind)) names.push_back(loopbackAddress());
        const auto properties = Ice::createProperties();
        properties->load(
            ours.issue({kind, names}, now() - std::chrono::days{400}, true).files.back().string());
        return properties->getPropertiesForPrefix("Ice");
    };
    const auto foreign = [&](Kind kind, const std::string& name) {
        auto its = issued(others, kind, name);
        its["IceSSL.CAs"] = ca;
        return its;
    };
    const Properties none{{"Ice.Plugin.IceSSL", "IceSSL:createIceSSL"}, {"IceSSL.CAs", ca}};
    for (const auto& port : ports()) {
        SCOPED_TRACE("the port for " + port.name + " of " + port.server);
        const auto right = port.name.find("servers") != std::string::npos ? Kind::EntityServer
                           : port.server == "fe1"                         ? Kind::Client
                                                                          : Kind::Entity;
        const struct {
            const char* what;
            Properties shown;
            std::string why;
        } cases[] = {{"expired", expired(right, "old"), "expired"},
                     {"foreign", foreign(right, "stranger"), "the certificate is of another CA"},
                     {"none", none, "no certificate was shown"}};
        for (const auto& one : cases) {
            SCOPED_TRACE(one.what);
            kLog->clear();
            EXPECT_TRUE(waitUntil(
                [&] {
                    EXPECT_FALSE(comesIn(one.shown, "somebody", ssl(port.number)));
                    return waitUntil([&] { return kLog->has(one.why); }, 200ms);
                },
                10s))
                << kLog->all();
            EXPECT_TRUE(audited(port.server, one.why)) << trailOf(port.server);
        }
    }
    EXPECT_TRUE(reaches()) << "honest peers go on\n" << kLog->all();
}

TEST_F(AbuseOfPorts, AMessageThatIsTooLongEndsTheConnectionOfItsSenderOnly) {
    ASSERT_NO_FATAL_FAILURE(startAll());
    for (const auto& port : ports()) {
        SCOPED_TRACE("the port for " + port.name + " of " + port.server);
        const auto right = port.name.find("servers") != std::string::npos
                               ? port.server == "fe1" ? Kind::EntityServer : Kind::FrontEnd
                           : port.server == "fe1" ? Kind::Client
                                                  : Kind::Entity;
        auto shown = issued(right, "sender");
        shown["Ice.MessageSizeMax"] = "0";  // it sends what it likes
        const auto its = communicator(shown);
        const auto proxy = its->stringToProxy("somebody:" + ssl(port.number))->ice_invocationTimeout(20000);
        Ice::ByteSeq out;
        EXPECT_THROW(
            proxy->ice_invoke("ice_ping", Ice::OperationMode::Normal, Ice::ByteSeq(5 * 1024 * 1024), out),
            Ice::ConnectionLostException);
    }
    EXPECT_TRUE(reaches()) << "honest peers go on\n" << kLog->all();
}

/// Two front-end servers, each asked by routers for sessions of clients, which know each other by
/// Server.Peer.
class LinksOfPeers : public Links {
  protected:
    ~LinksOfPeers() override { fe2.reset(); }
    server::ServerSettings forRouters(const std::string& name) const {
        auto its = settings(ServerRole::FrontEnd, name);
        its.client_router_endpoint = "ssl://" + loopbackAddress() + ":0";
        if (name != "fe1") its.topic_endpoint = its.topic_signal_endpoint = ssl(0);
        return its;
    }
    static std::string manager(const std::string& address) {
        return "SessionManager:" + transport::tcpEndpoint(address);
    }
    /// What a router is told that asks fe2 for a session with this token.
    std::string refusalOf(const std::string& token) const {
        const auto router = communicator(issued(Kind::Router, loopbackAddress()));
        const auto nobody =
            Ice::uncheckedCast<Glacier2::SessionControlPrx>(router->stringToProxy("nobody:" + ssl(9)));
        auto context = transport::contractContext();
        context[transport::kContextToken] = token;
        try {
            Ice::uncheckedCast<Glacier2::SessionManagerPrx>(
                router->stringToProxy(manager(fe2->clientRouterAddress())))
                ->create("client1", nobody, context);
        } catch (const Glacier2::CannotCreateSessionException& refused) {
            return refused.reason;
        } catch (const Ice::Exception& error) {
            return error.ice_id();
        }
        return "created";
    }
#ifdef GLACIER2ROUTER
    /// A glacier2router in front of this server; the proxy of it.
    std::string startRouter(const server::Server& server, int port) {
        const auto at = ssl(port);
        const auto its = transport::tcpEndpoint(server.clientRouterAddress());
        const auto config = folder / ("router-" + std::to_string(port) + ".cfg");
        std::ofstream out(config);
        out << "Glacier2.InstanceName=Axon.Clients\nGlacier2.Client.Endpoints=" << at
            << "\nGlacier2.Server.Endpoints=" << ssl(port + 1)
            << "\nGlacier2.SessionManager=SessionManager:" << its
            << "\nGlacier2.PermissionsVerifier=PermissionsVerifier:" << its
            << "\nGlacier2.Filter.Identity.Accept=Axon.Clients/none\nGlacier2.Client.Buffered=0\n"
               "Glacier2.Server.Buffered=0\nGlacier2.Client.ForwardContext=1\n"
               "Glacier2.Server.ForwardContext=1\nIce.ThreadPool.Server.Size=4\n"
               "Ice.ThreadPool.Server.Serialize=1\nIce.ThreadPool.Client.Size=4\n"
               "Ice.ThreadPool.Client.Serialize=1\nIce.ACM.Client.Close=0\nIce.MessageSizeMax=4096\n";
        for (const auto& [key, value] : issued(Kind::Router, loopbackAddress()))
            out << key << '=' << value << '\n';
        out.close();
        routers.push_back(std::make_unique<LoggedProgram>(
            std::vector<std::string>{GLACIER2ROUTER, "--Ice.Config=" + config.string()},
            folder / ("router-" + std::to_string(port) + ".log")));
        EXPECT_TRUE(waitUntil([port] { return listens(port); }, 10s)) << routers.back()->text();
        return "Axon.Clients/router:" + at;
    }
    std::vector<std::unique_ptr<LoggedProgram>> routers;
#endif
    std::unique_ptr<server::Server> fe2;
};

/// Takes any request for a session, and counts them.
class AnySessionManager final : public Glacier2::SessionManager {
  public:
    std::shared_ptr<Glacier2::SessionPrx> create(std::string, std::shared_ptr<Glacier2::SessionControlPrx>,
                                                 const Ice::Current&) override {
        ++asked;
        throw Glacier2::CannotCreateSessionException("it was asked");
    }
    std::atomic<int> asked{0};
};

TEST_F(LinksOfPeers, OnlyTheServerOfThatKindAndNameIsAskedForASession) {
    const auto impostor = [&](Kind kind, const std::string& name) {
        return communicator(issued(kind, name));
    };
    struct Case {
        Kind kind;
        std::string name, why;
    };
    const std::vector<Case> cases{
        {Kind::Server, loopbackAddress(), "is that of the server '" + loopbackAddress()},
        {Kind::EntityServer, "fe1", "is that of the entity-server 'fe1'"},
        {Kind::FrontEnd, "fe9", "is that of the front-end 'fe9'; expected that of the front-end 'fe1'"},
        {Kind::Router, loopbackAddress(), "is that of the router"},
        {Kind::FrontEnd, "fe1", ""}};
    for (const auto& one : cases) {
        SCOPED_TRACE(toString(one.kind) + (" " + one.name));
        const auto its = impostor(one.kind, one.name);
        const auto adapter = its->createObjectAdapterWithEndpoints("Impostor", ssl(0));
        const auto asked = std::make_shared<AnySessionManager>();
        adapter->add(asked, Ice::stringToIdentity("SessionManager"));
        adapter->activate();
        auto of_second = forRouters("fe2");
        of_second.neighbours["fe1"] = manager(transport::addressOf(*adapter));
        fe2 = std::make_unique<server::Server>(of_second);
        const auto told = refusalOf("fe1/token");
        if (one.why.empty()) {
            EXPECT_EQ(told, "it was asked");
            EXPECT_EQ(asked->asked, 1);
            EXPECT_EQ(refused(*fe2), 0);
        } else {
            EXPECT_THAT(told,
                        HasSubstr("the server at Server.Peer.fe1 is not used: the certificate that it"));
            EXPECT_THAT(told, HasSubstr(one.why));
            EXPECT_THAT(told, HasSubstr("whose Server.Name is fe1"));
            EXPECT_EQ(asked->asked, 0);
            EXPECT_EQ(refused(*fe2), 1);
            EXPECT_TRUE(audited("fe2", one.why)) << trailOf("fe2");
        }
        fe2.reset();
    }
}

TEST_F(LinksOfPeers, TwoNamesAtOneAddressAreRefused) {
    auto its = forRouters("fe2");
    its.neighbours["fe1"] = "SessionManager:" + ssl(10434);
    its.neighbours["fe3"] = "SessionManager:" + ssl(10435) + ":" + ssl(10434);
    const auto complaint = [&]() -> std::string {
        try {
            const server::Server server(its);
        } catch (const std::runtime_error& error) {
            return error.what();
        }
        return "accepted";
    };
    EXPECT_THAT(complaint(), HasSubstr("Server.Peer.fe1 and Server.Peer.fe3 have one address"));
    EXPECT_THAT(complaint(),
                HasSubstr("fix: give each the address of its own FrontEndServerRouter.Endpoints"));
    its.neighbours["fe3"] = "SessionManager:" + ssl(10435);
    EXPECT_EQ(complaint(), "accepted");
}

TEST_F(LinksOfPeers, TheNameIsCheckedAlsoWhereTwoLeadToOneServerByOtherNamesOfItsMachine) {
    in_addr address{};
    inet_pton(AF_INET, loopbackAddress().c_str(), &address);
    std::ostringstream other_name;
    other_name << "0x" << std::hex << ntohl(address.s_addr);
    fe1 = std::make_unique<server::Server>(forRouters("fe1"));
    auto of_second = forRouters("fe2");
    of_second.ice_properties["IceSSL.CheckCertName"] = "0";  // the certificate has not that name
    const auto right = manager(fe1->clientRouterAddress());
    auto alias = right;
    alias.replace(alias.find(loopbackAddress()), loopbackAddress().size(), other_name.str());
    of_second.neighbours = {{"fe1", right}, {"fe3", alias}};
    fe2 = std::make_unique<server::Server>(of_second);
    // The router cannot be called back, which fe1 finds out: it was asked.
    const auto of_first = [&] { return refusalOf("fe1/token"); };
    EXPECT_THAT(of_first(), testing::Not(HasSubstr("Server.Peer"))) << kLog->all();
    EXPECT_THAT(refusalOf("fe3/token"),
                HasSubstr("the front-end 'fe1'; expected that of the front-end 'fe3'"));
    EXPECT_THAT(of_first(), testing::Not(HasSubstr("Server.Peer"))) << "the other's connection is its own";
}

#ifdef GLACIER2ROUTER
TEST_F(LinksOfPeers, TheSecondSessionBehindARouterGoesToTheServerThatHasTheFirst) {
    fe1 = std::make_unique<server::Server>(forRouters("fe1"));
    auto of_second = forRouters("fe2");
    of_second.neighbours["fe1"] = manager(fe1->clientRouterAddress());
    fe2 = std::make_unique<server::Server>(of_second);
    const auto to_first = startRouter(*fe1, 10440);
    const auto to_second = startRouter(*fe2, 10442);
    RawClient mine(RawClient::Routers{to_first, to_second}, issued(Kind::Client, "client1"));
    EXPECT_EQ(mine.facts.token.rfind("fe1/", 0), 0U) << mine.facts.token;
    // Where servers send what is for its clients, by the file of its certificate.
    EXPECT_FALSE(comesIn(issued(Kind::Client, "client1"), "nobody", ssl(10441))) << routers.front()->text();
    mine.stop("");
    EXPECT_TRUE(waitUntil([&] { return mine.log.has("signal stop accepted for 0"); })) << kLog->all();
    EXPECT_EQ(refused(*fe1), 0) << kLog->all();
    EXPECT_EQ(refused(*fe2), 0) << kLog->all();
}
#endif

TEST_F(Links, ListenOnEveryAddressWithoutUsersWhereClientsDoNot) {
    auto its = settings(ServerRole::Entity, "es1");
    its.topic_endpoint = its.topic_signal_endpoint = "ssl -h 0.0.0.0 -p 0";
    EXPECT_NO_THROW(const server::Server server(its));
}

}  // namespace
}  // namespace axon::test
