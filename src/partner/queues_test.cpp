// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/queues.hpp"

#include <gtest/gtest.h>

namespace axon::partner {
namespace {

using Verdict = ClientShares::Verdict;

constexpr std::size_t kAll = std::size_t{20} * 1024 * 1024;
constexpr std::size_t kShare = kAll / 9 + 1;  // more than an eighth of what is free then

TEST(OpeningsTest, TwoAreOpenedAtATimeInOrder) {
    Openings openings;
    for (SessionNumber session = 1; session <= 3; ++session) openings.add(session);
    EXPECT_EQ(openings.next(), 1U);
    EXPECT_EQ(openings.next(), 2U);
    EXPECT_FALSE(openings.next());
    openings.done();
    EXPECT_EQ(openings.next(), 3U);
    openings.done();
    EXPECT_FALSE(openings.next());
}

TEST(OpeningsTest, WhoComesAndGoesAllTheTimeLeavesNothingBehind) {
    Openings openings;
    openings.add(1);
    openings.add(2);
    openings.next();
    openings.next();  // both wait for a server that does not answer
    for (SessionNumber session = 3; session < 1000; ++session) {
        openings.add(session);
        openings.forget(session);
    }
    openings.add(1000);
    EXPECT_EQ(openings.waiting(), 1U);
    openings.done();
    EXPECT_EQ(openings.next(), 1000U);
    openings.forget(77);  // unknown
}

TEST(ClientSharesTest, OneClientIsRefusedAndThenDroppedWhileOthersGoOn) {
    ClientShares shares(kAll);
    EXPECT_EQ(shares.take("eve", kShare, 512), Verdict::Take);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Refuse);
    EXPECT_EQ(shares.take("ann", 1, 512), Verdict::Take);
    std::size_t refused = 1;
    while (shares.take("eve", 1, 512) == Verdict::Refuse) ++refused;
    EXPECT_EQ(refused, ClientShares::kRefusals / 512);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Drop);
    for (std::size_t i = 0; i < refused; ++i) shares.give("eve", 512, Verdict::Refuse);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Refuse);
    shares.give("eve", kShare, Verdict::Take);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Take);
    EXPECT_EQ(shares.take("bob", kAll, ClientShares::kNone), Verdict::Drop);
    EXPECT_EQ(shares.take("eve", kAll, ClientShares::kNone), Verdict::Drop);
}

TEST(ClientSharesTest, HoweverManyFloodOneOfWhichLittleWaitsHasRoom) {
    ClientShares shares(kAll);
    std::size_t taken = 0, refused = 0;
    for (int flooder = 0; flooder < 4096; ++flooder) {
        // As much as it may have, in big pieces first.
        for (std::size_t size = kShare; size > 0; size /= 2) {
            const auto name = "flooder" + std::to_string(flooder);
            auto verdict = Verdict::Take;
            while ((verdict = shares.take(name, size, 512)) == Verdict::Take) taken += size;
            if (verdict == Verdict::Refuse) refused += 512;
        }
        const auto its = shares.take("ann", 1024, 512);
        ASSERT_EQ(its, Verdict::Take) << "beside " << flooder + 1;
        shares.give("ann", 1024, its);
    }
    EXPECT_LE(taken, kAll + 4096 * ClientShares::kLeast);
    EXPECT_LE(refused, ClientShares::kAllRefusals);
}

/// Ice.MessageSizeMax of Axon, and what a message costs besides.
constexpr std::size_t kBiggest = 4096 * 1024 + 1024;

TEST(ClientSharesTest, ABigMessagePassesWhenNothingWaits) {
    ClientShares shares(kAll);
    EXPECT_EQ(shares.take("ann", kBiggest, 512), Verdict::Take);
    shares.give("ann", kBiggest, Verdict::Take);
    shares.give("ann", 1, Verdict::Take);  // of nothing
    EXPECT_EQ(shares.take("ann", kBiggest, 512), Verdict::Take);
}

}  // namespace
}  // namespace axon::partner
