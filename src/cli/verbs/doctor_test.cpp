// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>
#include <sys/timex.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>
#include <vector>

#include "certificates/folder.hpp"
#include "cli/fake_station.hpp"
#include "cli/verbs/doctor_report.hpp"

using namespace axon;
using namespace axon::cli;
using testing::HasSubstr;
using testing::Not;

namespace {

/// One finding of `axon doctor`.
struct Finding : testing::Test {
    Recorded seen;
    Report report{seen};
    std::string operator[](const char* member) const { return seen.last("finding")->value(member, ""); }
};

constexpr std::time_t kNow = 1790000000;  // 2026

}  // namespace

TEST_F(Finding, AnUnknownNameIsToldFromANameServiceThatIsDown) {
    Network network;
    network.addresses = [](const std::string&, std::uint16_t) { return Addresses{{}, Reach::UnknownHost}; };
    explainNoServer(report, "lab.example.org:10410", network);
    EXPECT_THAT((*this)["message"], HasSubstr("no machine is called \"lab.example.org\""));
    network.addresses = [](const std::string&, std::uint16_t) { return Addresses{{}, Reach::NoResolver}; };
    explainNoServer(report, "lab.example.org:10410", network);
    EXPECT_THAT((*this)["message"], HasSubstr("name service (DNS) does not answer"));
    EXPECT_THAT((*this)["message"], Not(HasSubstr("no machine")));
    EXPECT_EQ((*this)["level"], "bad");
}

TEST_F(Finding, RealTimeIsForOneUserAndNotForAGroupThatMayReadMore) {
    reportRealTime(report, false, "ana");
    EXPECT_EQ((*this)["level"], "warn");
    EXPECT_THAT((*this)["fix"], HasSubstr("'ana - rtprio 20'"));
    EXPECT_THAT((*this)["fix"], Not(HasSubstr("group")));
    reportRealTime(report, true, "ana");
    EXPECT_EQ((*this)["level"], "ok");
}

TEST_F(Finding, OfTimeServersNothingIsSaidWhereNothingIsKnown) {
    reportClock(report, kNow, -1, 0);
    EXPECT_EQ((*this)["level"], "ok");
    EXPECT_THAT((*this)["message"], HasSubstr(" UTC"));
    EXPECT_THAT((*this)["message"], Not(HasSubstr("time server")));
    reportClock(report, kNow, TIME_OK, 0);
    EXPECT_THAT((*this)["message"], HasSubstr("a time server corrects"));
    reportClock(report, kNow, TIME_ERROR, STA_UNSYNC);
    EXPECT_THAT((*this)["message"], HasSubstr("no time server corrects"));
    reportClock(report, 0, -1, 0);
    EXPECT_EQ((*this)["level"], "bad") << "1970";
}

namespace {

/// `axon doctor --security` of links between servers.
struct Links : testing::Test {
    Links() {
        std::string name = std::filesystem::temp_directory_path() / "axon-doctor-links-XXXXXX";
        folder = ::mkdtemp(name.data());
    }
    ~Links() override { std::filesystem::remove_all(folder); }

    /// The level of each finding and what follows the setting, and its fix, in the order of the file's keys.
    std::vector<std::string> findings(const std::string& configuration) {
        const auto file = folder / "server.cfg";
        std::ofstream(file) << configuration;
        seen.events.clear();
        checkLinks(report, file);
        std::vector<std::string> all;
        for (const auto& event : seen.events)
            all.push_back(event.value("level", "") + ": " + event.value("message", "") + "; " +
                          event.value("fix", ""));
        return all;
    }
    std::string only(const std::string& configuration) {
        const auto all = findings(configuration);
        return all.size() == 1 ? all.front() : std::to_string(all.size()) + " findings";
    }
    /// The lines that axon certs issue writes for it.
    std::string issued(certificates::Kind kind, const std::vector<std::string>& names) {
        using namespace certificates;
        const auto now = std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now());
        const Folder lab(folder / "lab");
        if (!std::filesystem::exists(folder / "lab")) lab.init(now, false);
        return readFile(lab.issue({kind, names}, now, true).files.back(), "");
    }

    std::filesystem::path folder;
    Recorded seen;
    Report report{seen};
};

}  // namespace

TEST_F(Links, OnLoopbackAreFine) {
    for (const auto* link : {"FrontEndServerTopic.Endpoints=tcp -h 127.0.0.1 -p 0",
                             "EntityServerTopicSignal.Endpoints=127.0.0.1:0",
                             "Server.TopicManager=IceStorm/TopicManager:tcp -h localhost -p 10430",
                             "Server.Peer.fe2 = SessionManager:tcp -h 127.0.0.1 -p 10426  # of the other one",
                             "IceStorm.Publish.Endpoints=tcp -p 10431 -h 127.0.0.1",
                             "Glacier2.Server.Endpoints=tcp -h 127.0.0.1"})
        EXPECT_THAT(only(link), testing::AllOf(testing::StartsWith("ok"), HasSubstr("loopback only")))
            << link;
    EXPECT_FALSE(report.anyBad());
}

TEST_F(Links, ThatAreOpenAreErrorsWithAFix) {
    for (const auto* link :
         {"FrontEndServerTopic.Endpoints=tcp -h 0.0.0.0 -p 0", "EntityServerTopic.Endpoints=tcp -p 10427",
          "FrontEndServerTopicSignal.Endpoints=127.0.0.1:0,192.0.2.7:1",
          "FrontEndServerTopicSignal.Endpoints=ssl://127.0.0.1:0,192.0.2.7:1",
          "EntityServerRouter.Endpoints=tcp -h 127.0.0.1 -p 1:tcp -h 192.0.2.7 -p 1",
          "EntityServerRouter.Endpoints=tcp -p 1 -h 127.0.0.1:tcp -p 2",
          "Server.TopicManager=IceStorm/TopicManager:ssl -h 192.0.2.7 -p 1:tcp -h 192.0.2.7 -p 2",
          "Server.Peer.fe2=SessionManager:tcp -h 192.0.2.7 -p 1", "Server.Peer.fe2=nonsense",
          "IceStorm.TopicManager.Endpoints=default -p 1",
          "Glacier2.SessionManager=SessionManager:tcp -h lab"}) {
        const auto found = only(link);
        EXPECT_THAT(found, testing::StartsWith("bad")) << link;
        EXPECT_THAT(found, HasSubstr(": open: ")) << link;
        EXPECT_THAT(found, HasSubstr("axon certs issue --")) << link;
    }
    EXPECT_TRUE(report.anyBad());
    EXPECT_THAT(only("IceStorm.Publish.Endpoints=tcp -h lab -p 1"),
                HasSubstr("axon certs issue --storm HOST"));
    EXPECT_THAT(only("Glacier2.Server.Endpoints=tcp -h lab -p 1"),
                HasSubstr("axon certs issue --router HOST"));
}

TEST_F(Links, UnderTlsNeedACertificateOfTheKindAndNameOfTheServer) {
    using certificates::Kind;
    const std::string link = "FrontEndServerTopic.Endpoints=ssl -h lab -p 10425\n";
    EXPECT_THAT(only(link), HasSubstr("no certificate is configured"));
    const auto own = issued(Kind::FrontEnd, {"fe1", "lab"});
    EXPECT_THAT(only(link + own + "Server.Name=fe1\n"),
                testing::AllOf(testing::StartsWith("ok"),
                               HasSubstr("TLS; only entity servers and IceStorm may connect")));
    EXPECT_FALSE(report.anyBad() && seen.last("finding")->at("level") != "ok");
    EXPECT_THAT(only(link + own + "Server.Name=fe2\n"),
                HasSubstr("that of 'fe1'; expected that of Server.Name"));
    EXPECT_THAT(only(link + own + "Server.Name=fe1\nIceSSL.VerifyPeer=0\n"),
                HasSubstr("IceSSL.VerifyPeer=0"));
    EXPECT_THAT(
        only(link + issued(Kind::Server, {"lab"}) + "Server.Name=lab\n"),
        testing::AllOf(testing::StartsWith("bad"), HasSubstr("is of the kind 'server'; expected front-end")));
    EXPECT_THAT(only(link + "IceSSL.CertFile=none.pem\n"), HasSubstr("none.pem"));
    const auto alone = issued(Kind::Server, {"lab"});
    EXPECT_THAT(only("FrontEndServerRouter.Endpoints=ssl -h lab -p 1\n" + alone), testing::StartsWith("ok"))
        << "a server that is the only one, behind a router";
    EXPECT_THAT(only("EntityServerTopic.Endpoints=ssl -h lab -p 1\n" + own + "Server.Name=fe1\n"),
                HasSubstr("is of the kind 'front-end'; expected entity-server"));
}

TEST_F(Links, OfIceStormAndOfRoutersMustNameTheKindsThatMayConnect) {
    using certificates::Kind;
    const struct {
        Kind kind;
        std::string link, bound_by;
    } cases[] = {{Kind::Storm, "IceStorm.Publish.Endpoints=ssl -h lab -p 1\n", "IceSSL.TrustOnly.Server"},
                 {Kind::Router, "Glacier2.Server.Endpoints=ssl -h lab -p 1\n",
                  "IceSSL.TrustOnly.Server.Glacier2.Server"},
                 {Kind::Router, "Glacier2.SessionManager=SessionManager:ssl -h lab -p 1\n",
                  "IceSSL.TrustOnly.Client"}};
    for (const auto& one : cases) {
        SCOPED_TRACE(one.link);
        const auto lines = one.link + issued(one.kind, {"lab"});
        EXPECT_THAT(only(lines), testing::AllOf(testing::StartsWith("ok"), HasSubstr(one.bound_by)));
        EXPECT_THAT(only(lines + one.bound_by + "=\n"),
                    testing::AllOf(testing::StartsWith("bad"), HasSubstr("such as a client, is let in")));
        EXPECT_THAT(only(lines + one.bound_by + "=OU=front-end,O=Axon;OU=client,O=Axon\n"),
                    HasSubstr("lets in more than servers"));
        EXPECT_THAT(only(lines + one.bound_by + "=OU=entity-server,O=Axon\n"), testing::StartsWith("ok"));
        for (const char* wide : {"OU=entity,O=Axon", "OU=front-end,O=Axon;O=Axon", "O=Axon", "OU = client"})
            EXPECT_THAT(only(lines + one.bound_by + "=" + wide + "\n"), testing::StartsWith("bad")) << wide;
        const auto everywhere = one.link + issued(one.kind, {"lab"}) + one.bound_by + "=\nIceSSL.TrustOnly=";
        EXPECT_THAT(only(everywhere + "!CN=lost;OU=entity-server,O=Axon\n"), testing::StartsWith("ok"));
        EXPECT_THAT(only(everywhere + "OU=client,O=Axon\n"), testing::StartsWith("bad"));
        EXPECT_THAT(only(lines + "IceSSL.VerifyPeer=1\n"), HasSubstr("IceSSL.VerifyPeer=1"));
        EXPECT_THAT(only(one.link + issued(Kind::Client, {"ana"})), HasSubstr("is of the kind 'client'"));
    }
}

TEST_F(Links, OfAFileWithoutAnyAndOfNoFileSomethingIsSaid) {
    EXPECT_THAT(only("# FrontEndServerTopic.Endpoints=tcp -p 1\nServer.Users=users.cfg\n"),
                HasSubstr("sets no link between servers"));
    EXPECT_EQ(findings("FrontEndServerTopic.Endpoints=127.0.0.1:0\nServer.Peer.a=S:tcp -h lab\n").size(), 2U);
    seen.events.clear();
    checkLinks(report, folder / "none.cfg");
    EXPECT_EQ(seen.last("finding")->at("level"), "bad");
    EXPECT_THAT(seen.last("finding")->at("fix").get<std::string>(), HasSubstr("--links FILE"));
}
