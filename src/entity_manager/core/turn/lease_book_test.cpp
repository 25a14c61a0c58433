// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/turn/lease_book.hpp"

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
    const auto first = book.grant({kAlice, "r1", {}}).number;
    EXPECT_TRUE(book.check(kAlice, first).ok());
    EXPECT_EQ(book.check(kBob, first).code, RefusalCode::NotHolder) << "the number alone is no proof";
    EXPECT_EQ(book.check(kBob, first).holder, "client1");
    EXPECT_EQ(book.check(kAlice, {first.epoch + 1, first.number}).code, RefusalCode::WrongEpoch);
    EXPECT_EQ(book.check(kAlice, {first.epoch - 1, first.number}).code, RefusalCode::WrongEpoch);
    book.end(RefusalCode::RevokedLease, "why");
    EXPECT_EQ(book.check(kAlice, first).code, RefusalCode::RevokedLease);
    EXPECT_EQ(book.check(kBob, first).code, RefusalCode::NotHolder);
    const auto second = book.grant({kBob, "r2", {}}).number;
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
        const auto& held = book.grant({kAlice, "r", {}});
        EXPECT_GT(held.number.epoch, last.epoch);
        EXPECT_NE(held.key, key);
        last = held.number;
        key = held.key;
    }
}

TEST(LeaseBook, ADamagedStoreIsAMisconfigurationWithItsMend) {
    for (const char* damaged :
         {"garbage", "", "1", "1 ", "1 0x", "-1 0", "7garbage 0", "2147483647 0", "99999999999 0"}) {
        test::MemoryStorage storage;
        storage.save("lease", damaged);
        SeededRandom random(1);
        EXPECT_THROW(LeaseBook(storage, random), std::runtime_error) << damaged;
    }
}

TEST(LeaseBook, OnlyTheKeyOfThePresentLeaseResumesIt) {
    test::MemoryStorage storage;
    SeededRandom random(1);
    LeaseBook book(storage, random);
    const auto older = book.grant({kAlice, "r1", {}});
    book.end(RefusalCode::NotHolder, "it was released.");
    const auto held = book.grant({kAlice, "r2", {}});
    const auto now = ManualClock().now();
    book.orphan(now);
    const Sender anew{"a2", "client1", Role::Operator};
    EXPECT_EQ(book.check(kAlice, held.number).code, RefusalCode::ClientLost);
    EXPECT_EQ(book.check(kBob, held.number).code, RefusalCode::NotHolder);
    EXPECT_TRUE(book.mayResume(held.number, held.key.bytes()).ok());
    EXPECT_EQ(book.mayResume(held.number, older.key.bytes()).code, RefusalCode::NotHolder);
    EXPECT_EQ(book.mayResume(older.number, older.key.bytes()).code, RefusalCode::OlderLease);
    EXPECT_EQ(book.mayResume(older.number, held.key.bytes()).code, RefusalCode::OlderLease);
    EXPECT_EQ(book.mayResume(held.number, {}).code, RefusalCode::NotHolder);
    EXPECT_EQ(book.mayResume(held.number, held.key.bytes().substr(1)).code, RefusalCode::NotHolder);
    for (std::size_t i = 0; i < 16; ++i) {
        auto near = held.key.bytes();
        near[i] = static_cast<char>(near[i] ^ 1);
        EXPECT_EQ(book.mayResume(held.number, near).code, RefusalCode::NotHolder) << i;
    }
    EXPECT_EQ(book.mayResume({held.number.epoch + 1, held.number.number}, held.key.bytes()).code,
              RefusalCode::WrongEpoch);
    EXPECT_EQ(book.mayResume({held.number.epoch, held.number.number + 1}, held.key.bytes()).code,
              RefusalCode::NotHolder);
    EXPECT_EQ(book.mayResume({held.number.epoch, -1}, held.key.bytes()).code, RefusalCode::NotHolder);
    EXPECT_EQ(book.mayResume({}, held.key.bytes()).code, RefusalCode::NotHolder);

    book.resume(anew, "r3");
    EXPECT_FALSE(book.orphaned());
    EXPECT_EQ(book.held()->number, held.number);
    EXPECT_EQ(book.held()->key, held.key);
    EXPECT_TRUE(book.check(anew, held.number).ok());
    EXPECT_EQ(book.check(kAlice, held.number).code, RefusalCode::NotHolder) << "the session that was lost";
    book.end(RefusalCode::Expired, "why.");
    EXPECT_EQ(book.mayResume(held.number, held.key.bytes()).code, RefusalCode::Expired);
}

TEST(LeaseBook, ASecondLossDoesNotProlongTheGrace) {
    test::MemoryStorage storage;
    SeededRandom random(1);
    LeaseBook book(storage, random);
    book.grant({kAlice, "r1", {}});
    const auto now = ManualClock().now();
    book.orphan(now);
    book.orphan(now + std::chrono::seconds{5});
    EXPECT_EQ(book.held()->grace_until, now);
}

TEST(LeaseBook, OnlyTheVeryRequestThatReservedCommits) {
    test::MemoryStorage storage;
    SeededRandom random(1);
    LeaseBook book(storage, random);
    const auto now = ManualClock().now();
    EXPECT_EQ(book.mayCommit(kAlice, "r1").code, RefusalCode::Expired);
    book.reserve(kAlice, "r1", now);
    EXPECT_TRUE(book.mayCommit(kAlice, "r1").ok());
    EXPECT_EQ(book.mayCommit(kAlice, "r2").code, RefusalCode::Reserved);
    EXPECT_EQ(book.mayCommit(kBob, "r1").code, RefusalCode::Reserved);
    EXPECT_FALSE(book.expire(now - Duration{1}));
    EXPECT_TRUE(book.expire(now));
    EXPECT_EQ(book.mayCommit(kAlice, "r1").code, RefusalCode::Expired);
}

}  // namespace
}  // namespace axon::entity_manager
