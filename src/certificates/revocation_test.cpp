// SPDX-License-Identifier: GPL-2.0-or-later
#include "certificates/revocation.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <array>
#include <fstream>
#include <map>
#include <set>
#include <thread>
#include <vector>

#include "certificates/folder.hpp"
#include "certificates/testing.hpp"

namespace axon::certificates {
namespace {

using namespace std::chrono;
using testing::HasSubstr;
namespace fs = std::filesystem;

constexpr WallTime kNow{sys_days{year{2026} / 11 / 21}};

class Revocation : public testing::Test {
  protected:
    ~Revocation() override { fs::remove_all(above); }
    static fs::path newFolder() {
        std::string name = fs::temp_directory_path() / "axon-revoke-XXXXXX";
        return ::mkdtemp(name.data());
    }
    std::string issue(const std::string& name, bool force = false, days valid = days{365}) const {
        return folder.issue({Kind::Client, {name}, valid}, kNow, force).certificate.serial;
    }
    std::string refused(const std::string& name) const {
        return complaint([&] { folder.revoke({name}, std::nullopt, kNow); });
    }
    std::set<std::string> list() const {
        std::set<std::string> serials;
        const auto its = folder.revocationList().value();
        for (const auto& [serial, _] : its.serials) serials.insert(serial);
        return serials;
    }

    const fs::path above = newFolder();
    const Folder folder{above / "certs"};
};

TEST_F(Revocation, IsInTheListOfTheFolder) {
    const auto ca = folder.init(kNow, false).certificate;
    EXPECT_EQ(folder.revocationList(), std::nullopt);
    const auto one = issue("client1");
    const auto other = issue("client2");
    issue("client3");
    EXPECT_EQ(one.size(), 32U);
    const auto done = folder.revoke({"client-client1"}, std::nullopt, kNow);
    EXPECT_EQ(done.list, folder.path() / "revoked.crl.pem");
    EXPECT_EQ(done.added, 1U);
    EXPECT_EQ(done.until, ca.until) << "a list that ends shuts everybody out";
    EXPECT_EQ(list(), std::set{one});
    folder.revoke({(folder.path() / "client-client2.cert.pem").string()}, days{10}, kNow);
    EXPECT_EQ(list(), (std::set{one, other}));
    EXPECT_EQ(folder.revocationList()->until, kNow + days{10});
    EXPECT_EQ(validity(*folder.revocationList(), kNow), Validity::ExpiresSoon);
    EXPECT_EQ(validity(*folder.revocationList(), kNow + days{10}), Validity::Expired);
    const auto renewed = folder.revoke({}, days{100}, kNow + days{5});
    EXPECT_EQ(renewed.until, kNow + days{105});
    EXPECT_EQ(list(), (std::set{one, other}));
}

TEST_F(Revocation, OfANameIsThatOfAllCertificatesThatWereIssuedUnderIt) {
    folder.init(kNow, false);
    const auto stolen = issue("client1");
    const auto newer = issue("client1", true);
    issue("client1x");
    EXPECT_EQ(folder.revoke({"client-client1"}, std::nullopt, kNow).added, 2U);
    EXPECT_EQ(list(), (std::set{stolen, newer}));
    const auto newest = issue("client1", true);
    EXPECT_FALSE(list().contains(newest)) << "what is issued afterwards is valid";
    EXPECT_EQ(folder.revoke({"client-client1"}, std::nullopt, kNow).added, 1U);
}

TEST_F(Revocation, IsRefusedAsAWholeWhereOneCannotBeRevoked) {
    folder.init(kNow, false);
    issue("client1");
    EXPECT_THAT(complaint([&] {
                    folder.revoke({"client-client1", "client-nobody"}, std::nullopt, kNow);
                }),
                HasSubstr("'client-nobody'"));
    EXPECT_EQ(folder.revocationList(), std::nullopt);
    folder.revoke({"client-client1"}, std::nullopt, kNow);
    EXPECT_THAT(refused("client-client1"), HasSubstr("revoked already"));
    EXPECT_THAT(refused((folder.path() / "ca.cert.pem").string()), HasSubstr("certificate of a CA"));
    EXPECT_THAT(refused("../../x"), HasSubstr("cannot be read"));
    issue("short", false, days{1});
    EXPECT_THAT(complaint([&] { folder.revoke({"client-short"}, std::nullopt, kNow + days{2}); }),
                HasSubstr("still valid"));
    EXPECT_THAT(complaint([&] { folder.revoke({}, days{0}, kNow); }), HasSubstr("1 to 3650"));
}

TEST_F(Revocation, IsOfTheOwnCaOnly) {
    folder.init(kNow, false);
    const Folder others(above / "others");
    EXPECT_THAT(complaint([&] { others.revoke({}, std::nullopt, kNow); }), HasSubstr("axon certs init"));
    others.init(kNow, false);
    const auto theirs = others.issue({Kind::Client, {"client1"}}, kNow, false).files.front();
    EXPECT_THAT(refused(theirs.string()), HasSubstr("not a certificate of this CA"));
    const auto list = others.revoke({}, std::nullopt, kNow).list;
    fs::copy_file(list, folder.path() / "revoked.crl.pem");
    issue("client1");
    EXPECT_THAT(refused("client-client1"), HasSubstr("not a list of this CA"));
    // Also one that ended long ago, of another year than this test runs in.
    const auto long_ago = kNow - days{3000};
    others.init(long_ago, true);
    fs::copy_file(others.revoke({}, days{1}, long_ago).list, folder.path() / "revoked.crl.pem",
                  fs::copy_options::overwrite_existing);
    EXPECT_EQ(others.revocationList().value().until, long_ago + days{1});
    EXPECT_THAT(refused("client-client1"), HasSubstr("not a list of this CA"));
}

TEST_F(Revocation, ThatWasTamperedWithIsNoList) {
    folder.init(kNow, false);
    issue("client1");
    const auto file = folder.revoke({"client-client1"}, std::nullopt, kNow).list;
    auto text = readFile(file, "");
    const auto at = text.find("\n", text.size() / 2) - 3;  // within the signature, or what is signed
    text[at] = text[at] == 'A' ? 'B' : 'A';
    std::ofstream(file) << text;
    EXPECT_THAT(complaint([&] { folder.revoke({}, std::nullopt, kNow); }),
                testing::AnyOf(HasSubstr("not a list of this CA"), HasSubstr("expected a revocation list")));
}

TEST_F(Revocation, DoesNotForgetWhatAFileThatCannotBeReadHad) {
    folder.init(kNow, false);
    issue("client1");
    std::ofstream(folder.path() / "revoked.crl.pem") << "nonsense";
    EXPECT_THAT(refused("client-client1"), HasSubstr("expected a revocation list"));
    fs::remove(folder.path() / "revoked.crl.pem");
    std::ofstream(folder.path() / "issued.txt", std::ios::app) << "XYZ 1 client-client1\n";
    EXPECT_THAT(refused("client-client1"), HasSubstr("'XYZ 1 client-client1'"));
}

TEST_F(Revocation, ByTwoAtOnceLosesNothing) {
    folder.init(kNow, false);
    constexpr int kEach = 10;
    std::vector<std::thread> both;
    std::array<std::string, 2> failed;
    for (std::size_t who = 0; who < failed.size(); ++who)
        both.emplace_back([this, who, &failed] {
            const Folder same(folder.path());
            failed.at(who) = complaint([&] {
                for (int i = 0; i < kEach; ++i) {
                    const auto name = "u" + std::to_string(who) + "-" + std::to_string(i);
                    same.issue({Kind::Client, {name}}, kNow, false);
                    same.revoke({"client-" + name}, std::nullopt, kNow);
                }
            });
        });
    for (auto& one : both) one.join();
    EXPECT_THAT(failed, testing::Each("accepted"));
    EXPECT_EQ(list().size(), 2U * kEach);
    std::size_t certificates = 0;
    for (const auto& file : fs::directory_iterator(folder.path())) {
        const auto name = file.path().filename().string();
        certificates += name.ends_with(".cert.pem") ? 1 : 0;
        EXPECT_TRUE(name.ends_with(".pem") || name.ends_with(".cfg") || name.ends_with(".txt")) << name;
    }
    EXPECT_EQ(certificates, 2U * kEach + 1);
    EXPECT_EQ(folder.revocationList()->number, std::uint64_t(kNow.time_since_epoch().count()) + 2 * kEach - 1)
        << "each list has a number of its own";
}

TEST_F(Revocation, KeepsItsTimeInTheNextListsWhoseNumbersGrow) {
    folder.init(kNow, false);
    const auto first = issue("client1");
    const auto second = issue("client2");
    folder.revoke({"client-client1"}, std::nullopt, kNow);
    const auto number = folder.revocationList()->number;
    folder.revoke({"client-client2"}, std::nullopt, kNow + days{3});
    folder.revoke({}, std::nullopt, kNow + days{2});
    const auto its = folder.revocationList().value();
    EXPECT_EQ(its.serials, (std::map<std::string, WallTime>{{first, kNow}, {second, kNow + days{3}}}));
    EXPECT_EQ(number, std::uint64_t(kNow.time_since_epoch().count()));
    EXPECT_EQ(its.number, number + std::uint64_t(seconds(days{3}).count()) + 1) << "the clock was set back";
}

TEST_F(Revocation, ReachesACertificateThatWasReplacedWithoutBeingInTheIndex) {
    folder.init(kNow, false);
    const auto stolen = issue("client1");
    fs::remove(folder.path() / "issued.txt");
    const auto newer = issue("client1", true);
    folder.revoke({"client-client1"}, std::nullopt, kNow);
    EXPECT_EQ(list(), (std::set{stolen, newer}));
    // What stands in its place and is no certificate of this CA is of no interest.
    std::ofstream(folder.path() / "client-client1.cert.pem") << "nonsense";
    issue("client1", true);
    EXPECT_EQ(folder.revoke({"client-client1"}, std::nullopt, kNow).added, 1U);
}

TEST_F(Revocation, OfANameReachesACertificateWhoseIssueFailedHalfWay) {
    folder.init(kNow, false);
    fs::create_directory(folder.path() / "client-client1.cfg");  // no file can replace a folder
    EXPECT_THAT(complaint([&] { issue("client1", true); }),
                HasSubstr("client-client1.cfg cannot be written"));
    ASSERT_TRUE(fs::remove(folder.path() / "client-client1.cert.pem")) << "somebody has taken it along";
    EXPECT_EQ(folder.revoke({"client-client1"}, std::nullopt, kNow).added, 1U);
}

TEST_F(Revocation, ReachesWhatAClockThatWasAheadTookForEnded) {
    folder.init(kNow, false);
    const auto early = issue("client1", false, days{365});
    folder.issue({Kind::Client, {"client2"}}, kNow + days{1000}, false);
    fs::remove(folder.path() / "client-client1.cert.pem");
    folder.revoke({"client-client1"}, std::nullopt, kNow);
    EXPECT_EQ(list(), std::set{early});
}

TEST_F(Revocation, OfAnIndexThatIsTooLongSaysWhatMayGo) {
    folder.init(kNow, false);
    const std::string line(32, 'a');
    std::ofstream index(folder.path() / "issued.txt");
    for (int i = 0; i < 20000; ++i) index << line << " 1800000000 client-client1\n";
    index.close();
    EXPECT_THAT(complaint([&] { issue("client2"); }),
                HasSubstr("delete the lines of certificates that have ended"));
    EXPECT_THAT(refused("client-client1"), HasSubstr("expected at most 1 MiB"));
    EXPECT_FALSE(fs::exists(folder.path() / "client-client2.cert.pem"));
}

TEST_F(Revocation, IsForgottenBeforeANewCaIsInPlace) {
    folder.init(kNow, false);
    folder.revoke({}, std::nullopt, kNow);
    // The new certificate cannot be placed over a folder.
    fs::remove(folder.path() / "ca.cert.pem");
    fs::create_directory(folder.path() / "ca.cert.pem");
    EXPECT_THAT(complaint([&] { folder.init(kNow, true); }), HasSubstr("ca.cert.pem cannot be written"));
    EXPECT_FALSE(fs::exists(folder.path() / "revoked.crl.pem"));
}

TEST_F(Revocation, EndsWithItsCa) {
    folder.init(kNow, false);
    issue("client1");
    folder.revoke({"client-client1"}, std::nullopt, kNow);
    folder.init(kNow, true);
    EXPECT_EQ(folder.revocationList(), std::nullopt);
    EXPECT_THAT(complaint([&] { folder.revoke({}, std::nullopt, kNow + days{4000}); }),
                HasSubstr("the CA expired"));
}

}  // namespace
}  // namespace axon::certificates
