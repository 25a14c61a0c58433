// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/lease_book.hpp"

#include <gtest/gtest.h>

#include "tests/support/core_rig.hpp"

namespace axon::entity_manager {
namespace {

const Sender kAlice{"a", "client1", Role::Operator};
const Sender kBob{"b", "client2", Role::Operator};

TEST(LeaseBook, ACommandIsCheckedAgainstSenderEpochAndNumber) {
    test::MemoryStorage storage;
    SeededRandom random(1);
    LeaseBook book(storage, random);
    EXPECT_EQ(book.check(kAlice, {}).code, RefusalCode::NotHolder);
    const auto first = book.grant(kAlice, "r1").number;
    EXPECT_TRUE(book.check(kAlice, first).ok());
    EXPECT_EQ(book.check(kBob, first).code, RefusalCode::NotHolder) << "the number alone is no proof";
    EXPECT_EQ(book.check(kBob, first).holder, "client1");
    EXPECT_EQ(book.check(kAlice, {first.epoch + 1, first.number}).code, RefusalCode::WrongEpoch);
    EXPECT_EQ(book.check(kAlice, {first.epoch - 1, first.number}).code, RefusalCode::WrongEpoch);
    book.end(RefusalCode::RevokedLease, "why");
    EXPECT_EQ(book.check(kAlice, first).code, RefusalCode::RevokedLease);
    EXPECT_EQ(book.check(kBob, first).code, RefusalCode::NotHolder);
    const auto second = book.grant(kBob, "r2").number;
    EXPECT_GT(second, first);
    EXPECT_EQ(book.check(kAlice, first).code, RefusalCode::OlderLease);
    EXPECT_EQ(book.check(kBob, first).code, RefusalCode::OlderLease);
}

TEST(LeaseBook, EveryStartHasAHigherEpochAndEveryKeyIsNew) {
    test::MemoryStorage storage;
    SeededRandom random(1);
    LeaseNumber last;
    Id128 key;
    for (int start = 0; start < 3; ++start) {
        LeaseBook book(storage, random);
        const auto& held = book.grant(kAlice, "r");
        EXPECT_GT(held.number.epoch, last.epoch);
        EXPECT_NE(held.key, key);
        last = held.number;
        key = held.key;
    }
}

TEST(LeaseBook, ADamagedStoreIsAMisconfigurationWithItsMend) {
    test::MemoryStorage storage;
    storage.save("lease", "garbage");
    SeededRandom random(1);
    EXPECT_THROW(LeaseBook(storage, random), std::runtime_error);
}

}  // namespace
}  // namespace axon::entity_manager
