// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>

#include <filesystem>
#include <fstream>
#include <sstream>

#include "certificates/folder.hpp"
#include "cli/command_line.hpp"
#include "cli/fake_station.hpp"
#include "cli/view.hpp"

using namespace axon;
using namespace axon::cli;
using testing::HasSubstr;

namespace {

struct Certs : testing::Test {
    Certs() {
        std::string name = std::filesystem::temp_directory_path() / "axon-certs-XXXXXX";
        folder = ::mkdtemp(name.data());
    }
    ~Certs() override { std::filesystem::remove_all(folder); }

    /// As the user writes it.
    int axon(std::vector<std::string> words) {
        words.insert(words.begin(), "certs");
        words.insert(words.end(), {"--folder", folder + "/lab"});
        const auto parsed = parseCommandLine(words, [](const char*) -> const char* { return nullptr; });
        EXPECT_TRUE(parsed.line) << parsed.err;
        if (!parsed.line) return parsed.exit;
        Session session{parsed.line->args, seen, nullptr, nullptr, parsed.line->settings};
        return parsed.line->verb->perform(session);
    }
    std::string folder;
    Recorded seen;
};

}  // namespace

TEST_F(Certs, MakesACaAndIssuesCertificatesForAllKinds) {
    EXPECT_EQ(axon({"init"}), kDone);
    EXPECT_EQ(axon({"issue", "--server", "lab", "127.0.0.1"}), kDone);
    EXPECT_EQ(seen.last("issued")->at("certificate").at("names"), Json({"lab", "127.0.0.1"}));
    EXPECT_EQ(axon({"issue", "--router", "127.0.0.1"}), kDone);
    EXPECT_EQ(axon({"issue", "--front-end", "fe1", "lab"}), kDone);
    EXPECT_EQ(seen.last("issued")->at("certificate").at("kind"), "front-end");
    EXPECT_EQ(seen.last("issued")->at("certificate").at("names"), Json::array({"lab"}));
    EXPECT_EQ(axon({"issue", "--entity-server", "es1", "lab", "127.0.0.1"}), kDone);
    EXPECT_EQ(axon({"issue", "--storm", "lab"}), kDone);
    EXPECT_EQ(axon({"issue", "--registry", "lab"}), kDone);
    EXPECT_EQ(axon({"issue", "--entity", "Cyton Arm"}), kDone);
    EXPECT_EQ(axon({"issue", "--client", "client1", "--days", "40"}), kDone);
    EXPECT_EQ(seen.last("issued")->at("certificate").at("kind"), "client");
    EXPECT_EQ(seen.last("issued")->at("files").back(), folder + "/lab/client-client1.cfg");
    EXPECT_EQ(axon({"show"}), kDone);
    EXPECT_EQ(seen.last("certificates")->at("certificates").size(), 9U);
    EXPECT_EQ(seen.last("finding"), nullptr);
}

TEST_F(Certs, ShowWarnsOfWhatExpiresWithin30Days) {
    ASSERT_EQ(axon({"init"}), kDone);
    ASSERT_EQ(axon({"issue", "--client", "client1", "--days", "29"}), kDone);
    EXPECT_EQ(axon({"show"}), kDone);
    EXPECT_EQ(seen.last("finding")->at("level"), "warn");
    EXPECT_EQ(seen.last("finding")->at("fix"),
              "axon certs issue --client client1 --force, then restart the program that uses it");
    std::ostringstream out;
    std::ostringstream err;
    PersonView(out, err, {}, ManualClock()).emit(*seen.last("certificates"));
    EXPECT_THAT(out.str(), HasSubstr("client-client1.cert.pem"));
}

TEST_F(Certs, ShowFailsForWhatHasExpired) {
    using namespace certificates;
    const auto then =
        std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now()) - std::chrono::days{400};
    const Folder lab(folder + "/lab");
    lab.init(then, false);
    const auto old = lab.issue({Kind::Client, {"client1"}, std::chrono::days{365}}, then, false);
    EXPECT_EQ(axon({"show", old.files.front()}), kRefused);
    EXPECT_EQ(seen.last("finding")->at("level"), "bad");
    EXPECT_EQ(seen.last("certificates")->at("certificates").size(), 1U);
}

TEST_F(Certs, SaysWhatIsWrongAndHowToFixIt) {
    EXPECT_EQ(axon({"issue", "--client", "client1"}), kUsage);
    EXPECT_THAT(seen.last("error")->at("fix").get<std::string>(), HasSubstr("axon certs init"));
    ASSERT_EQ(axon({"init"}), kDone);
    EXPECT_EQ(axon({"init"}), kUsage);
    EXPECT_EQ(axon({"init", "lab"}), kUsage);
    EXPECT_EQ(axon({"issue", "client1"}), kUsage);
    EXPECT_EQ(axon({"issue", "--client", "--entity", "client1"}), kUsage);
    EXPECT_EQ(axon({"issue", "--server"}), kUsage);
    EXPECT_EQ(axon({"issue", "--front-end", "fe1"}), kUsage);
    EXPECT_THAT(seen.last("error")->at("fix").get<std::string>(), HasSubstr("--front-end NAME HOST"));
    EXPECT_EQ(axon({"issue", "--server", "not a host"}), kUsage);
    EXPECT_EQ(axon({"show", folder + "/none.pem"}), kUsage);
    std::ofstream(folder + "/bad.pem") << "nonsense";
    EXPECT_EQ(axon({"show", folder + "/bad.pem"}), kUsage);
    EXPECT_THAT(seen.last("error")->at("message").get<std::string>(), HasSubstr("PEM"));
}

TEST_F(Certs, RevokesByKindAndName) {
    ASSERT_EQ(axon({"init"}), kDone);
    ASSERT_EQ(axon({"issue", "--client", "client1"}), kDone);
    ASSERT_EQ(axon({"issue", "--entity", "Cyton Arm"}), kDone);
    EXPECT_EQ(axon({"revoke", "--client", "client1"}), kDone);
    const auto& event = *seen.last("revoked");
    EXPECT_EQ(event.at("added"), 1);
    EXPECT_EQ(event.at("file"), folder + "/lab/revoked.crl.pem");
    EXPECT_EQ(event.at("lines").at(1), "IceSSL.CertificateRevocationListFiles=revoked.crl.pem");
    EXPECT_EQ(axon({"revoke", "--entity", "Cyton Arm"}), kDone);
    EXPECT_EQ(seen.last("revoked")->at("revoked"), 2);
    EXPECT_EQ(axon({"revoke"}), kDone);
    EXPECT_EQ(seen.last("revoked")->at("added"), 0);
    std::ostringstream out;
    std::ostringstream err;
    PersonView(out, err, {}, ManualClock()).emit(*seen.last("revoked"));
    EXPECT_THAT(out.str(), HasSubstr("0 revoked now, 2 in the list"));
    EXPECT_THAT(out.str(), HasSubstr("IceSSL.RevocationCheck=1"));

    EXPECT_EQ(axon({"show"}), kDone);
    for (const auto& one : seen.last("certificates")->at("certificates"))
        EXPECT_EQ(one.at("validity"), one.at("kind") == "ca" ? "valid" : "revoked");
    PersonView(out, err, {}, ManualClock()).emit(*seen.last("certificates"));
    EXPECT_THAT(out.str(), testing::ContainsRegex("revoked +client-client1.cert.pem"));
    EXPECT_EQ(seen.last("finding"), nullptr);
}

TEST_F(Certs, ShowWarnsBeforeTheListEndsAndFailsAfterwards) {
    ASSERT_EQ(axon({"init"}), kDone);
    ASSERT_EQ(axon({"revoke", "--days", "29"}), kDone);
    EXPECT_EQ(axon({"show"}), kDone);
    EXPECT_EQ(seen.last("finding")->at("level"), "warn");
    EXPECT_THAT(seen.last("finding")->at("message").get<std::string>(), HasSubstr("refuse everybody"));
    using namespace certificates;
    Folder(folder + "/lab")
        .init(std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now()) -
                  std::chrono::days{40},
              true);
    Folder(folder + "/lab")
        .revoke({}, std::chrono::days{30},
                std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now()) -
                    std::chrono::days{40});
    EXPECT_EQ(axon({"show"}), kRefused);
    EXPECT_EQ(seen.last("finding")->at("level"), "bad");
    EXPECT_THAT(seen.last("finding")->at("message").get<std::string>(), HasSubstr("ended on"));
}

TEST_F(Certs, ShowSaysThatTheListIsFromTheFuture) {
    using namespace certificates;
    const auto future =
        std::chrono::floor<std::chrono::seconds>(std::chrono::system_clock::now()) + std::chrono::days{3};
    ASSERT_EQ(axon({"init"}), kDone);
    Folder(folder + "/lab").revoke({}, std::nullopt, future);
    EXPECT_EQ(axon({"show"}), kRefused);
    EXPECT_EQ(seen.last("finding")->at("level"), "bad");
    EXPECT_THAT(seen.last("finding")->at("message").get<std::string>(), HasSubstr("is valid from "));
    EXPECT_THAT(seen.last("finding")->at("fix").get<std::string>(), HasSubstr("set the clock"));
}

TEST_F(Certs, ShowOfAFileDoesWithoutTheListOfTheFolder) {
    ASSERT_EQ(axon({"init"}), kDone);
    ASSERT_EQ(axon({"issue", "--client", "client1"}), kDone);
    std::ofstream(folder + "/lab/revoked.crl.pem") << "nonsense";
    EXPECT_EQ(axon({"show", folder + "/lab/client-client1.cert.pem"}), kDone);
    EXPECT_EQ(seen.last("certificates")->at("certificates").at(0).at("validity"), "valid");
    EXPECT_EQ(seen.last("finding")->at("level"), "warn");
    EXPECT_THAT(seen.last("finding")->at("message").get<std::string>(), HasSubstr("not known whether"));
    EXPECT_EQ(axon({"show"}), kUsage) << "there it is one of the things that are asked for";
}

TEST_F(Certs, RevokesAServerByItsFirstNameOnly) {
    ASSERT_EQ(axon({"init"}), kDone);
    ASSERT_EQ(axon({"issue", "--server", "lab.example", "192.168.0.5"}), kDone);
    ASSERT_EQ(axon({"issue", "--server", "192.168.0.5"}), kDone);
    EXPECT_EQ(axon({"revoke", "--server", "lab.example", "192.168.0.5"}), kUsage);
    EXPECT_THAT(seen.last("error")->at("message").get<std::string>(), HasSubstr("one name after --server"));
    EXPECT_EQ(axon({"revoke", "--server", "lab.example"}), kDone);
    EXPECT_EQ(seen.last("revoked")->at("added"), 1);
    ASSERT_EQ(axon({"issue", "--client", "client1"}), kDone);
    ASSERT_EQ(axon({"issue", "--client", "client2"}), kDone);
    EXPECT_EQ(axon({"revoke", "--client", "client1", "client2"}), kDone);
    EXPECT_EQ(seen.last("revoked")->at("added"), 2);
}

TEST_F(Certs, SaysThatANewCaNeedsANewList) {
    const auto next = [this] { return seen.last("issued")->at("next").get<std::string>(); };
    ASSERT_EQ(axon({"init"}), kDone);
    EXPECT_THAT(next(), testing::Not(HasSubstr("RevocationCheck")));
    ASSERT_EQ(axon({"init", "--force"}), kDone);
    EXPECT_THAT(next(), HasSubstr("RevocationCheck"));
}

TEST_F(Certs, SaysWhyNothingIsRevoked) {
    const auto message = [this] { return seen.last("error")->at("message").get<std::string>(); };
    EXPECT_EQ(axon({"revoke", "--client", "client1"}), kUsage);
    EXPECT_THAT(seen.last("error")->at("fix").get<std::string>(), HasSubstr("axon certs init"));
    ASSERT_EQ(axon({"init"}), kDone);
    ASSERT_EQ(axon({"issue", "--client", "client1"}), kDone);
    EXPECT_EQ(axon({"revoke", "client1"}), kUsage);
    EXPECT_THAT(message(), HasSubstr("was issued as 'client1'"));
    EXPECT_EQ(axon({"revoke", "--client"}), kUsage);
    EXPECT_EQ(axon({"revoke", "--client", "--entity", "client1"}), kUsage);
    EXPECT_EQ(axon({"revoke", folder + "/none.pem"}), kUsage);
    EXPECT_EQ(axon({"revoke", folder + "/lab/ca.cert.pem"}), kUsage);
    EXPECT_EQ(axon({"revoke", "client-client1", "--days", "4000"}), kUsage);
    EXPECT_EQ(axon({"revoke", "client-client1"}), kDone);
    EXPECT_EQ(axon({"revoke", "client-client1"}), kUsage);
    EXPECT_THAT(message(), HasSubstr("revoked already"));
}
