// SPDX-License-Identifier: GPL-2.0-or-later
#include "certificates/trust.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon::certificates {
namespace {

using namespace std::chrono;
using testing::HasSubstr;

constexpr WallTime kNow{sys_days{year{2026} / 11 / 21}};

class TrustTest : public testing::Test {
  protected:
    std::string issued(const Request& request, const Issued& by, WallTime at = kNow) const {
        return issue(by, request, at).certificate;
    }
    /// Empty: it is accepted.
    static std::string refusal(const Trust& trust, const std::string& pem, WallTime now = kNow) {
        const auto verdict = trust.judgePem(pem, now);
        const auto* why = std::get_if<std::string>(&verdict);
        return why != nullptr ? *why : std::string();
    }
    const Issued ours = makeAuthority(kNow - days{10});
    const Issued others = makeAuthority(kNow - days{10});
    const Trust trust{ours.certificate};
};

TEST_F(TrustTest, EveryKindOfTheLaboratorysOwnCaIsAccepted) {
    for (const auto kind : {Kind::Server, Kind::Router, Kind::Entity, Kind::Client}) {
        const auto verdict = trust.judgePem(issued({kind, {"name"}}, ours), kNow);
        ASSERT_EQ(verdict.index(), 0U) << std::get<1>(verdict);
        EXPECT_EQ(std::get<0>(verdict).name, "name");
        EXPECT_EQ(kindOf(std::get<0>(verdict).unit), kind);
    }
}

// Both authorities have the same name, so only the signature tells them apart.
TEST_F(TrustTest, ThoseOfAnotherCaAreNot) {
    EXPECT_EQ(refusal(trust, issued({Kind::Entity, {"robot"}}, others)), "is of another CA");
    EXPECT_EQ(refusal(trust, others.certificate), "is of another CA");
    EXPECT_EQ(refusal(trust, issued({Kind::Entity, {"robot"}}, others) + ours.certificate),
              "is of another CA")
        << "a chain that does not hang together";
}

TEST_F(TrustTest, TheCallersClockDecidesWhetherItIsValid) {
    const auto it = issued({Kind::Client, {"ann"}, days{5}}, ours);
    EXPECT_EQ(refusal(trust, it), "");
    EXPECT_EQ(refusal(trust, it, kNow + days{5} - seconds{1}), "");
    EXPECT_THAT(refusal(trust, it, kNow + days{5}), HasSubstr("expired on 2026-11-26"));
    EXPECT_THAT(refusal(trust, it, kNow - hours{2}), HasSubstr("is valid from 2026-11-20"));
}

TEST_F(TrustTest, AnExpiredCaNextToAValidOneDoesNoHarm) {
    const auto old = makeAuthority(kNow - days{4000});
    const Trust both(old.certificate + ours.certificate);
    EXPECT_EQ(refusal(both, issued({Kind::Entity, {"robot"}}, ours)), "");
    EXPECT_THAT(refusal(both, issued({Kind::Entity, {"robot"}}, old, kNow - days{1000})),
                HasSubstr("expired"));
}

TEST_F(TrustTest, WhatIsNoCertificateIsRefused) {
    EXPECT_EQ(refusal(trust, ""), "cannot be read");
    EXPECT_EQ(refusal(trust, ours.key), "cannot be read");
    EXPECT_EQ(std::get<1>(trust.judgeDer({}, kNow)), "was not shown");
    EXPECT_EQ(std::get<1>(trust.judgeDer({"\x30\x03\x02\x01\x01", "x"}, kNow)), "cannot be read");
    const auto it = issued({Kind::Client, {"ann"}}, ours);
    std::string many;
    for (int i = 0; i < 9; ++i) many += it;
    EXPECT_EQ(refusal(trust, many), "comes with too many others");
    EXPECT_THROW(Trust("nonsense"), Unusable);
}

TEST_F(TrustTest, KindAndNameMustBothBeThoseThatAreExpected) {
    const auto it = readCertificates(issued({Kind::Entity, {"left"}}, ours), "it").front();
    EXPECT_EQ(mismatch(it, Kind::Entity, "left"), "");
    EXPECT_THAT(mismatch(it, Kind::Entity, "right"),
                HasSubstr("is that of the entity 'left'; expected that of the entity 'right'"));
    EXPECT_THAT(mismatch(it, Kind::Client, "left"), HasSubstr("expected that of the client 'left'"));
}

}  // namespace
}  // namespace axon::certificates
