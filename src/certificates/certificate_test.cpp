// SPDX-License-Identifier: GPL-2.0-or-later
#include "certificates/certificate.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <functional>

namespace axon::certificates {
namespace {

using namespace std::chrono;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;

constexpr WallTime kNow{sys_days{year{2026} / 11 / 21}};

struct Complaint {
    std::string what = "accepted", fix;
};
Complaint complaint(const std::function<void()>& action) {
    try {
        action();
    } catch (const Unusable& unusable) {
        return {unusable.what(), unusable.fix()};
    }
    return {};
}

class Certificates : public testing::Test {
  protected:
    Certificate issued(const Request& request, WallTime now = kNow) const {
        return readCertificates(issue(authority, request, now).certificate, "it").front();
    }
    std::string refused(const Request& request) const {
        return complaint([&] { issue(authority, request, kNow); }).what;
    }
    const Issued authority = makeAuthority(kNow);
};

TEST_F(Certificates, AnAuthorityIsOneForTenYears) {
    const auto it = readCertificates(authority.certificate, "it").front();
    EXPECT_TRUE(it.authority);
    EXPECT_EQ(it.issuer, it.name);
    EXPECT_EQ(it.organisation, "Axon");
    EXPECT_EQ(it.from, kNow - 1h) << "clocks differ";
    EXPECT_EQ(day(it.until), "2036-11-21");
    EXPECT_THAT(authority.key, HasSubstr("-----BEGIN PRIVATE KEY-----"));
    EXPECT_THAT(authority.certificate, Not(HasSubstr("PRIVATE")));
    EXPECT_NE(makeAuthority(kNow).key, authority.key);
}

TEST_F(Certificates, AServerHasAllItsNames) {
    const auto it = issued({Kind::Server, {"lab.example", "192.168.0.5", "::1", "fe1"}});
    EXPECT_EQ(it.name, "lab.example");
    EXPECT_EQ(it.unit, "server");
    EXPECT_THAT(it.names, ElementsAre("lab.example", "192.168.0.5", "::1", "fe1"));
    EXPECT_FALSE(it.authority);
    EXPECT_EQ(it.issuer, readCertificates(authority.certificate, "ca").front().name);
    EXPECT_EQ(it.until, kNow + days{365});
}

TEST_F(Certificates, ClientsAndEntitiesHaveOneNameAndTheirKind) {
    const auto client = issued({Kind::Client, {"client1"}, days{7}});
    EXPECT_EQ(client.name, "client1");
    EXPECT_EQ(client.unit, "client");
    EXPECT_THAT(client.names, IsEmpty());
    EXPECT_EQ(client.until, kNow + days{7});
    EXPECT_EQ(issued({Kind::Entity, {"Cyton Ärm #2"}}).name, "Cyton Ärm #2");
    EXPECT_EQ(issued({Kind::Router, {"127.0.0.1"}}).unit, "router");
}

TEST_F(Certificates, OneOfSeveralServersHasItsNameAndItsHosts) {
    for (const auto kind : {Kind::FrontEnd, Kind::EntityServer}) {
        const auto it = issued({kind, {"fe_1", "lab.example", "192.168.0.5"}});
        EXPECT_EQ(it.name, "fe_1");
        EXPECT_EQ(it.unit, toString(kind));
        EXPECT_THAT(it.names, ElementsAre("lab.example", "192.168.0.5")) << "its name is no host";
        EXPECT_THAT(refused({kind, {"fe1"}}), HasSubstr("by which 'fe1' is called"));
        EXPECT_THAT(refused({kind, {"fe 1", "lab"}}), HasSubstr("Server.Name"));
        EXPECT_THAT(refused({kind, {"lab.example", "lab"}}), HasSubstr("Server.Name"));
        EXPECT_THAT(refused({kind, {"fe1", "not a host"}}), HasSubstr("DNS name or an IP address"));
        EXPECT_THAT(refused({kind, {}}), HasSubstr("expected the name"));
    }
    EXPECT_THAT(issued({Kind::Storm, {"lab.example", "127.0.0.1"}}).names,
                ElementsAre("lab.example", "127.0.0.1"));
}

TEST_F(Certificates, EveryKindIsReadBackFromItsUnit) {
    for (const auto kind : kKinds) EXPECT_EQ(kindOf(toString(kind)), kind);
    EXPECT_FALSE(kindOf("printer"));
    EXPECT_FALSE(isCalled(Kind::Client));
    EXPECT_FALSE(isCalled(Kind::Entity));
    EXPECT_TRUE(isCalled(Kind::Storm));
    EXPECT_TRUE(isCalled(Kind::Registry));
}

TEST_F(Certificates, RefuseNamesThatNobodyCouldCheck) {
    for (const auto* name : {"lab example", "-lab", "lab-", "lab..example", ".lab", "lab.", "1.2.3",
                             "1.2.3.256", "lab_1", "*.lab", "lab\n", "Ünï"})
        EXPECT_THAT(refused({Kind::Server, {name}}), HasSubstr("DNS name or an IP address")) << name;
    EXPECT_THAT(refused({Kind::Server, {"lab", "not good"}}), HasSubstr("'not good'"));
    EXPECT_THAT(refused({Kind::Server, {}}), HasSubstr("expected the name of the server"));
    EXPECT_THAT(refused({Kind::Client, {""}}), HasSubstr("expected the name of the client"));
    EXPECT_THAT(refused({Kind::Client, {"client 1"}}), HasSubstr("users.cfg"));
    EXPECT_THAT(refused({Kind::Client, {"client1", "client2"}}), HasSubstr("expected one name"));
    EXPECT_THAT(refused({Kind::Entity, {"Peo\nple"}}), HasSubstr("on one line"));
    EXPECT_THAT(refused({Kind::Entity, {"\xff"}}), HasSubstr("UTF-8"));
    EXPECT_THAT(refused({Kind::Entity, {std::string(65, 'x')}}), HasSubstr("at most 64 bytes"));
    EXPECT_THAT(refused({Kind::Server, std::vector<std::string>(65, "lab")}), HasSubstr("at most 64 names"));
    EXPECT_THAT(refused({Kind::Client, {"client1"}, days{0}}), HasSubstr("1 to 3650 days"));
    EXPECT_THAT(refused({Kind::Client, {"client1"}, days{4000}}), HasSubstr("1 to 3650 days"));
    EXPECT_THAT(refused({Kind::Client, {"\x1b[2J"}}), Not(HasSubstr("\x1b")));
}

TEST_F(Certificates, NothingOutlivesTheAuthorityThatSignedIt) {
    const auto end = readCertificates(authority.certificate, "ca").front().until;
    EXPECT_EQ(issued({Kind::Client, {"client1"}, days{365}}, end - days{10}).until, end);
    const auto late = complaint([&] { issue(authority, {Kind::Client, {"client1"}}, end); });
    EXPECT_THAT(late.what, HasSubstr("the CA expired on 2036-11-21"));
    EXPECT_THAT(late.fix, HasSubstr("axon certs init --force"));
    EXPECT_THAT(complaint([&] {
                    issue(authority, {Kind::Client, {"client1"}}, kNow - days{1});
                }).fix,
                HasSubstr("clock"));
}

TEST_F(Certificates, OnlyAnAuthorityWithItsOwnKeyIssues) {
    const Request request{Kind::Client, {"client1"}};
    const auto client = issue(authority, request, kNow);
    EXPECT_THAT(complaint([&] { issue(client, request, kNow); }).what, HasSubstr("no CA's"));
    EXPECT_THAT(complaint([&] {
                    issue({authority.certificate, client.key}, request, kNow);
                }).what,
                HasSubstr("not the one of its certificate"));
    EXPECT_THAT(complaint([&] {
                    issue({authority.certificate, "nonsense"}, request, kNow);
                }).what,
                HasSubstr("no private key in PEM form"));
    EXPECT_THAT(complaint([&] {
                    issue({"", authority.key}, request, kNow);
                }).what,
                HasSubstr("expected a certificate in PEM form"));
}

TEST_F(Certificates, AreReadFromAnyTextOrRefused) {
    const auto client = issue(authority, {Kind::Client, {"client1"}}, kNow);
    EXPECT_EQ(readCertificates("a comment\n" + client.certificate + authority.certificate, "two").size(), 2U);
    const std::string no_end(client.certificate.substr(0, client.certificate.size() / 2));
    auto broken = client.certificate;
    broken[client.certificate.size() / 2] = '!';
    for (const auto& text :
         {std::string(), std::string("nonsense"), std::string("\0\0", 2), client.key, no_end, broken,
          std::string("-----BEGIN CERTIFICATE-----\nAAAA\n-----END CERTIFICATE-----\n"),
          std::string(100'000, '-')}) {
        const auto said = complaint([&] { readCertificates(text, "f.pem"); });
        EXPECT_THAT(said.what, HasSubstr("f.pem: expected a certificate in PEM form"));
        EXPECT_THAT(said.fix, HasSubstr(".cert.pem"));
    }
}

TEST_F(Certificates, SayInTimeThatTheyExpire) {
    const auto it = issued({Kind::Client, {"client1"}, days{365}});
    EXPECT_EQ(validity(it, kNow - 2h), Validity::NotYetValid);
    EXPECT_EQ(validity(it, kNow), Validity::Valid);
    EXPECT_EQ(validity(it, it.until - days{30}), Validity::Valid);
    EXPECT_EQ(validity(it, it.until - days{30} + 1s), Validity::ExpiresSoon);
    EXPECT_EQ(validity(it, it.until - 1s), Validity::ExpiresSoon);
    EXPECT_EQ(validity(it, it.until), Validity::Expired);
}

TEST(Kinds, AreThoseOfTheUnit) {
    for (const auto kind : {Kind::Server, Kind::Router, Kind::Entity, Kind::Client})
        EXPECT_EQ(kindOf(toString(kind)), kind);
    EXPECT_FALSE(kindOf("Server"));
    EXPECT_FALSE(kindOf(""));
}

}  // namespace
}  // namespace axon::certificates
