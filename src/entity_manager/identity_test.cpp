// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/identity.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>

#include "tests/support/core_rig.hpp"
#include "transport/ice/bound_uuid.hpp"

namespace axon::entity_manager {
namespace {

using testing::HasSubstr;

struct IdentityTest : testing::Test {
    void expectUnusable(const std::string& why) {
        try {
            identityIn(storage, random);
            ADD_FAILURE() << why;
        } catch (const std::runtime_error& error) {
            EXPECT_THAT(error.what(), HasSubstr(why));
            EXPECT_THAT(error.what(), HasSubstr("backup"));
        }
    }
    test::MemoryStorage storage;
    SeededRandom random{1};
};

TEST_F(IdentityTest, AnEmptyFolderGetsASecretAndKeepsIt) {
    const auto first = identityIn(storage, random);
    EXPECT_TRUE(transport::mayRegister(first.uuid, first.secret));
    EXPECT_TRUE(transport::isBoundUuid(first.uuid));
    const auto again = identityIn(storage, random);
    EXPECT_EQ(again.secret, first.secret) << "also where the first life ended before it had its UUID";
    storage.save("uuid", first.uuid);
    EXPECT_EQ(identityIn(storage, random).uuid, first.uuid);
}

TEST_F(IdentityTest, ARobotOfAnEarlierReleaseKeepsItsUuid) {
    storage.save("uuid", Id128::uuid(random).toString());
    EXPECT_EQ(identityIn(storage, random).secret, "");
    EXPECT_FALSE(storage.load("secret"));
}

TEST_F(IdentityTest, ALostOrDamagedSecretIsAnErrorWithItsMend) {
    const auto first = identityIn(storage, random);
    storage.save("uuid", first.uuid);
    auto values = storage.values;
    values.erase("secret");
    std::swap(values, storage.values);
    expectUnusable("is missing");
    storage.values = values;
    auto other = first.uuid;
    other[14] = '4';
    storage.save("uuid", other);
    expectUnusable("is not that of the stored \"uuid\"");
    storage.save("uuid", first.uuid);
    for (std::size_t size = 0; size < first.secret.size(); ++size) {
        storage.save("secret", first.secret.substr(0, size));
        expectUnusable("is damaged");
    }
    for (std::size_t bit = 0; bit < 8 * first.secret.size(); ++bit) {
        auto flipped = first.secret;
        flipped[bit / 8] = static_cast<char>(flipped[bit / 8] ^ (1 << (bit % 8)));
        storage.save("secret", flipped);
        expectUnusable("is not that of the stored \"uuid\"");
    }
}

}  // namespace
}  // namespace axon::entity_manager
