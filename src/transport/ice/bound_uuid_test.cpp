// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/bound_uuid.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cctype>

#include "common/ids.hpp"

namespace axon::transport {
namespace {

const std::string kSecret(kSecretBytes, 's');

TEST(BoundUuid, IsThatOfItsSecret) {
    // As Python has it: hashlib.sha256(b"axon entity" + b"s" * 32), with version and variant set.
    EXPECT_EQ(boundUuid(kSecret), "7599710c-0a7b-8759-af9d-93524fc89954");
    EXPECT_NE(boundUuid(kSecret), boundUuid(std::string(kSecretBytes, 't')));
    const auto uuid = boundUuid(kSecret);
    EXPECT_TRUE(isBoundUuid(uuid)) << uuid;
    EXPECT_EQ(uuid[14], '8');
    EXPECT_NE(std::string("89ab").find(uuid[19]), std::string::npos) << uuid;
}

TEST(BoundUuid, OnlyWhoKnowsTheSecretMayRegisterIt) {
    const auto uuid = boundUuid(kSecret);
    EXPECT_TRUE(mayRegister(uuid, kSecret));
    EXPECT_FALSE(mayRegister(uuid, {}));
    EXPECT_FALSE(mayRegister(uuid, std::string(kSecretBytes, 't')));
    EXPECT_FALSE(mayRegister(uuid, kSecret + "s"));
    auto upper = uuid;
    std::transform(upper.begin(), upper.end(), upper.begin(),
                   [](unsigned char c) { return std::toupper(c); });
    EXPECT_TRUE(isBoundUuid(upper));
    EXPECT_FALSE(upper != uuid && mayRegister(upper, kSecret)) << "another text for the same UUID";
}

TEST(BoundUuid, OneThatIsNotBoundIsAnybodys) {
    SeededRandom random(1);
    const auto uuid = Id128::uuid(random).toString();
    EXPECT_FALSE(isBoundUuid(uuid));
    EXPECT_TRUE(mayRegister(uuid, {}));
    EXPECT_FALSE(isBoundUuid("no uuid at all8"));
    EXPECT_FALSE(isBoundUuid({}));
}

}  // namespace
}  // namespace axon::transport
