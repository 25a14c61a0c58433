// SPDX-License-Identifier: GPL-2.0-or-later
// Both servers over IceSSL on loopback, with certificates of a CA that the test makes: who comes in, who does
// not, and what each side says of it.
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <spdlog/spdlog.h>
#include <sys/stat.h>
#include <axon/client.hpp>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <functional>

#include "audit/reader.hpp"
#include "certificates/folder.hpp"
#include "component/raw_peers.hpp"
#include "server/server.hpp"
#include "support/log_lines.hpp"
#include "support/loopback.hpp"
#include "users/users_file.hpp"

namespace axon::test {
namespace {

using namespace std::chrono_literals;
using certificates::Kind;
using testing::HasSubstr;
namespace fs = std::filesystem;
using Properties = std::map<std::string, std::string>;

constexpr const char* kEntity = "00000000-0000-4000-8000-000000000001";

/// The client library's logger, and thereby IceSSL's of the whole process, is the one that is there before
/// it.
std::shared_ptr<LogLines> catchLog() {
    auto lines = std::make_shared<LogLines>();
    spdlog::set_default_logger(std::make_shared<spdlog::logger>("", lines));
    spdlog::register_logger(std::make_shared<spdlog::logger>("axon", lines));
    return lines;
}
const std::shared_ptr<LogLines> kLog = catchLog();

class Tls : public testing::Test {
  protected:
    static fs::path newFolder() {
        std::string name = fs::temp_directory_path() / "axon-tls-XXXXXX";
        return ::mkdtemp(name.data());
    }
    static certificates::WallTime now() {
        return std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now());
    }
    Tls() {
        kLog->clear();
        ours.init(now(), false);
        others.init(now(), false);
    }
    ~Tls() override { fs::remove_all(folder); }

    static Properties issued(const certificates::Folder& by, Kind kind, std::vector<std::string> names,
                             certificates::WallTime at = now(), int days = 365) {
        const auto file = by.issue({kind, std::move(names), std::chrono::days{days}}, at, true).files.back();
        const auto properties = Ice::createProperties();
        properties->load(file.string());
        return properties->getPropertiesForPrefix("Ice");
    }
    server::ServerSettings settings(const std::vector<std::string>& names = {loopbackAddress()}) const {
        server::ServerSettings its;
        its.client_endpoint = its.client_signal_endpoint = its.entity_endpoint = its.entity_signal_endpoint =
            "ssl://" + loopbackAddress() + ":0";
        its.ice_properties = issued(ours, Kind::Server, names);
        return its;
    }
    Properties clientCertificate(const std::string& name = "client1") const {
        return issued(ours, Kind::Client, {name});
    }
    Properties entityCertificate(const std::string& name) const { return issued(ours, Kind::Entity, {name}); }

    static client::Options options(const server::Server& server, Properties properties) {
        client::Options its;
        its.server = server.clientAddress(Lane::Data);
        its.properties = std::move(properties);
        its.timeout = client::Seconds{2};
        its.reconnect = false;
        return its;
    }
    static Refusal refusalOf(client::Options its) {
        const auto connected = client::Client::connect(std::move(its));
        return connected ? Refusal{} : connected.refusal();
    }
    static std::string refusalOf(const std::function<void()>& action) {
        try {
            action();
        } catch (const std::exception&) {
            const auto refusal = transport::translate(std::current_exception(), true);
            return std::string(refusalName(refusal.code)) + ": " + refusal.message;
        }
        return "accepted";
    }
    static bool logged(const std::string& part) {
        return waitUntil([&] { return kLog->has(part); }, 3s);
    }

    const fs::path folder = newFolder();
    const certificates::Folder ours{folder / "ours"};
    const certificates::Folder others{folder / "others"};
};

TEST_F(Tls, TheRightCertificatesListAndStop) {
    const server::Server server(settings());
    EXPECT_THAT(server.readyLine(), HasSubstr("ready client=ssl://" + loopbackAddress() + ":"));
    RawEntity robot(server.entityAddress(Lane::Data), kEntity, "PeopleBot", "", "",
                    entityCertificate("PeopleBot"));
    robot.join();
    robot.status(EntityState::IDLE);
    auto connected = client::Client::connect(options(server, clientCertificate()));
    ASSERT_TRUE(connected) << connected.refusal().message;
    const auto client = std::move(connected).value();
    ASSERT_EQ(client->entities().size(), 1U);
    EXPECT_EQ(client->self().name.rfind("client1@", 0), 0U) << client->self().name;
    static_cast<void>(client->stop({"PeopleBot"}, client::Seconds{0.2}));
    EXPECT_TRUE(waitUntil([&] { return robot.log.has("signal stop requested client1@"); }));
}

/// With the revocation list of our CA.
server::ServerSettings revoking(server::ServerSettings its) {
    its.ice_properties["IceSSL.RevocationCheck"] = "1";
    its.ice_properties["IceSSL.CertificateRevocationListFiles"] = "revoked.crl.pem";
    return its;
}

TEST_F(Tls, ARevokedCertificateIsRefusedAndAnotherOneIsNot) {
    const auto thief = clientCertificate("thief");
    ours.revoke({"client-thief"}, std::nullopt, now());
    const server::Server server(revoking(settings()));
    EXPECT_EQ(refusalOf(options(server, clientCertificate())).message, "");
    EXPECT_NE(refusalOf(options(server, thief)).message, "");
    EXPECT_TRUE(logged("was refused: the certificate has been revoked")) << kLog->all();
}

TEST_F(Tls, AListThatHasEndedShutsEverybodyOutAndTheLogSaysWhatToDo) {
    ours.init(now() - std::chrono::days{41}, true);
    ours.revoke({}, std::chrono::days{30}, now() - std::chrono::days{40});
    const server::Server server(revoking(settings()));
    EXPECT_NE(refusalOf(options(server, clientCertificate())).message, "");
    EXPECT_TRUE(logged("was refused: the revocation list of this program has ended")) << kLog->all();
}

TEST_F(Tls, AListOfAnotherCaShutsEverybodyOutAndTheLogSaysWhatToDo) {
    others.revoke({}, std::nullopt, now());
    fs::copy_file(others.path() / "revoked.crl.pem", ours.path() / "revoked.crl.pem");
    const server::Server server(revoking(settings()));
    EXPECT_NE(refusalOf(options(server, clientCertificate())).message, "");
    EXPECT_TRUE(logged("was refused: there is no revocation list of its CA here")) << kLog->all();
}

TEST_F(Tls, AnEntityThatIsNotReadyGoesByTheNameOfItsCertificate) {
    const server::Server server(settings());
    RawEntity robot(server.entityAddress(Lane::Data), kEntity, "name-of-its-application", "", "",
                    entityCertificate("PeopleBot"));
    robot.data()->sendBasicPrfl(transport::toIce(robot.registration), transport::toRange(""), {});
    robot.status(EntityState::INIT);
    auto connected = client::Client::connect(options(server, clientCertificate()));
    ASSERT_TRUE(connected) << connected.refusal().message;
    const auto client = std::move(connected).value();
    EXPECT_TRUE(client->entities().empty());
    const auto all = client->entities(client::Listed::All);
    ASSERT_EQ(all.size(), 1U);
    EXPECT_EQ(all.front().name, "PeopleBot");
    EXPECT_FALSE(all.front().ready);
}

TEST_F(Tls, EachPeerIsToldASignalLaneOfTheProtocolThatItCameBy) {
    auto its = settings();
    const auto both = "ssl -h " + loopbackAddress() + " -p 0:tcp -h " + loopbackAddress() + " -p 0";
    its.client_endpoint = its.client_signal_endpoint = both;
    const server::Server server(its);
    const auto addresses = server.clientAddress(Lane::Data);
    const auto comma = addresses.find(',');
    ASSERT_NE(comma, std::string::npos) << addresses;
    const RawClient by_tls(addresses.substr(0, comma), "a@lab", true, "", "", clientCertificate());
    EXPECT_EQ(by_tls.facts.signalEndpoint.rfind("ssl -h ", 0), 0U) << by_tls.facts.signalEndpoint;
    const RawClient plain(addresses.substr(comma + 1), "b@lab", true);
    EXPECT_EQ(plain.facts.signalEndpoint.rfind("tcp -h ", 0), 0U) << plain.facts.signalEndpoint;
}

TEST_F(Tls, ACertificateOfAnotherCaIsRefusedAndBothSidesSayWhy) {
    auto audited = settings();
    audited.audit.folder = folder / "audit";
    const server::Server server(audited);
    // Who trusts another CA refuses the server.
    const auto mistrusted = refusalOf(options(server, issued(others, Kind::Client, {"client1"})));
    EXPECT_EQ(mistrusted.code, RefusalCode::PermissionDenied);
    EXPECT_THAT(mistrusted.message, HasSubstr("of another CA"));
    // Who trusts the server and shows another CA's certificate is refused by it.
    auto stranger = issued(others, Kind::Client, {"client1"});
    stranger["IceSSL.CAs"] = (ours.path() / "ca.cert.pem").string();
    kLog->clear();
    const auto refused = refusalOf(options(server, stranger));
    EXPECT_TRUE(waitUntil([&] {
        bool recorded = false;
        audit::readTrails(folder / "audit", {}, [&](const std::string&, const audit::Record& record) {
            recorded = recorded || (record.kind == "refusal" && record.peer.starts_with("127.") &&
                                    record.what.find("TLS handshake: the certificate is of another CA") !=
                                        std::string::npos);
        });
        return recorded;
    })) << "it is not in the audit";
    EXPECT_EQ(refused.code, RefusalCode::PermissionDenied);
    EXPECT_THAT(refused.message, HasSubstr("see the server's log"));
    EXPECT_TRUE(logged("was refused: the certificate is of another CA")) << kLog->all();
}

TEST_F(Tls, AServerWithoutTheNameThatWasCalledIsRefused) {
    const server::Server server(settings({"other.example"}));
    const auto refused = refusalOf(options(server, clientCertificate()));
    EXPECT_EQ(refused.code, RefusalCode::PermissionDenied);
    EXPECT_THAT(refused.message, HasSubstr("for other"));
    EXPECT_THAT(refused.message, HasSubstr("axon certs issue --server"));
}

TEST_F(Tls, WhoShowsNoCertificateIsRefused) {
    const server::Server server(settings());
    EXPECT_THAT(refusalOf(options(server, {})).message, HasSubstr("axon certs issue --client NAME"));
    // One that does not look after itself:
    const Properties nothing{{"Ice.Plugin.IceSSL", "IceSSL:createIceSSL"},
                             {"IceSSL.CAs", (ours.path() / "ca.cert.pem").string()}};
    const auto said = refusalOf(
        [&] { const RawClient client(server.clientAddress(Lane::Data), "x", false, "", "", nothing); });
    EXPECT_THAT(said, HasSubstr("see the server's log"));
    EXPECT_TRUE(logged("no certificate was shown")) << kLog->all();
}

TEST_F(Tls, AnExpiredCertificateIsRefused) {
    const certificates::Folder old(folder / "old");
    old.init(now() - std::chrono::days{400}, false);
    auto its = settings();
    its.ice_properties = issued(old, Kind::Server, {loopbackAddress()});
    const server::Server theirs(its);
    const auto expired = issued(old, Kind::Client, {"client1"}, now() - std::chrono::days{400}, 365);
    EXPECT_EQ(refusalOf(options(theirs, expired)).code, RefusalCode::PermissionDenied);
    EXPECT_TRUE(logged("was refused: the certificate has expired")) << kLog->all();
}

TEST_F(Tls, AClientsCertificateCannotPassForAServers) {
    auto its = settings();
    its.ice_properties = clientCertificate("impostor");
    const server::Server server(its);
    const auto refused = refusalOf(options(server, clientCertificate()));
    EXPECT_EQ(refused.code, RefusalCode::PermissionDenied);
    EXPECT_THAT(refused.message, HasSubstr("the server's certificate is not accepted"));
}

TEST_F(Tls, TheWrongKindIsRefusedAtEitherDoor) {
    const server::Server server(settings());
    const auto at_clients = refusalOf(options(server, entityCertificate("PeopleBot")));
    EXPECT_EQ(at_clients.code, RefusalCode::PermissionDenied);
    EXPECT_THAT(at_clients.message, HasSubstr("expected one of the kind 'client'"));
    EXPECT_TRUE(logged("PeopleBot, has OU=entity; expected OU=client")) << kLog->all();
    const auto at_entities = refusalOf([&] {
        const RawEntity robot(server.entityAddress(Lane::Data), kEntity, "client1", "", "",
                              clientCertificate());
    });
    EXPECT_THAT(at_entities, HasSubstr("PERMISSION_DENIED"));
    EXPECT_THAT(at_entities, HasSubstr("expected one of the kind 'entity'"));
    EXPECT_TRUE(logged("client1, has OU=client; expected OU=entity")) << kLog->all();
}

TEST_F(Tls, AnEntityRegistersUnderTheNameOfItsCertificateOnly) {
    const server::Server server(settings());
    const auto said = refusalOf([&] {
        RawEntity robot(server.entityAddress(Lane::Data), kEntity, "right", "", "",
                        entityCertificate("left"));
        robot.join();
    });
    EXPECT_THAT(said, HasSubstr("PERMISSION_DENIED"));
    EXPECT_THAT(said, HasSubstr("the entity 'left's"));
    EXPECT_TRUE(logged("registration refused")) << kLog->all();
    RawEntity robot(server.entityAddress(Lane::Data), kEntity, "left", "", "", entityCertificate("left"));
    EXPECT_NO_THROW(robot.join());
}

TEST_F(Tls, WithUsersTheCertificateStandsForThePasswordOfItsUser) {
    auto its = settings();
    its.users_file = folder / "users.cfg";
    users::writeUser(its.users_file, "client1", users::UserRole::Observer, "secret1");
    users::writeUser(its.users_file, "client2", users::UserRole::Operator, "secret2");
    users::writeUser(its.users_file, "robots", users::UserRole::Entity, "secret3");
    const server::Server server(its);
    const auto connected = client::Client::connect(options(server, clientCertificate()));
    ASSERT_TRUE(connected) << connected.refusal().message;
    EXPECT_EQ(connected.value()->self().role, Role::Observer);

    auto as_another = options(server, clientCertificate());
    as_another.user = "client2";
    as_another.password = "secret2";
    EXPECT_THAT(refusalOf(as_another).message, HasSubstr("belongs to the user 'client1'"));
    EXPECT_THAT(refusalOf(options(server, clientCertificate("client3"))).message,
                HasSubstr("no user 'client3'"));
    EXPECT_TRUE(logged("failed log-in of 'client3'")) << kLog->all();
    EXPECT_THAT(refusalOf(options(server, clientCertificate("robots"))).message, HasSubstr("role entity"));
    // An entity needs no line: it may do nothing but be itself.
    RawEntity robot(server.entityAddress(Lane::Data), kEntity, "left", "", "", entityCertificate("left"));
    EXPECT_NO_THROW(robot.join());
}

TEST_F(Tls, ProtocolsThatDoNotFitAreTold) {
    const server::Server by_tls(settings());
    auto its = options(by_tls, {});
    its.server = its.server.substr(std::string("ssl://").size());
    its.timeout = client::Seconds{0.5};
    EXPECT_THAT(refusalOf(its).message, HasSubstr("ssl://"));
    auto plain_settings = settings();
    plain_settings.client_endpoint = plain_settings.client_signal_endpoint = loopbackAddress() + ":0";
    const server::Server plain(plain_settings);
    its = options(plain, clientCertificate());
    its.server = "ssl://" + its.server;
    EXPECT_THAT(refusalOf(its).message, HasSubstr("does not speak TLS"));
}

TEST_F(Tls, MisconfigurationIsToldWithItsMend) {
    const auto complaint = [](const server::ServerSettings& wrong) -> std::string {
        try {
            const server::Server server(wrong);
        } catch (const std::runtime_error& error) {
            return error.what();
        }
        return "accepted";
    };
    auto its = settings();
    its.ice_properties.clear();
    EXPECT_THAT(complaint(its), HasSubstr("axon certs issue --server NAME"));
    its = settings();
    its.client_signal_endpoint = loopbackAddress() + ":0";
    EXPECT_THAT(complaint(its), HasSubstr("has no endpoint of ssl"));
    its = settings();
    its.ice_properties["IceSSL.CertFile"] = "none.pem";
    EXPECT_THAT(complaint(its), HasSubstr("none.pem"));
    EXPECT_THAT(complaint(its), HasSubstr("axon certs show"));
    its = settings();
    std::ofstream(folder / "bad.pem") << "nonsense";
    its.ice_properties["IceSSL.KeyFile"] = (folder / "bad.pem").string();
    EXPECT_THAT(complaint(its), HasSubstr("TLS cannot be used"));
}

}  // namespace
}  // namespace axon::test
