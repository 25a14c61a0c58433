// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/queues.hpp"

#include <gtest/gtest.h>

namespace axon::partner {
namespace {

using Verdict = ClientShares::Verdict;

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
    ClientShares shares;
    EXPECT_EQ(shares.take("eve", ClientShares::kShare, 512), Verdict::Take);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Refuse);
    EXPECT_EQ(shares.take("ann", 1, 512), Verdict::Take);
    std::size_t refused = 1;
    while (shares.take("eve", 1, 512) == Verdict::Refuse) ++refused;
    EXPECT_EQ(refused, ClientShares::kRefusals / 512);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Drop);
    for (std::size_t i = 0; i < refused; ++i) shares.give("eve", 512);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Refuse);
    shares.give("eve", ClientShares::kShare);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Take);
}

TEST(ClientSharesTest, AMessageOfAnySizePassesWhenNothingWaits) {
    ClientShares shares;
    EXPECT_EQ(shares.take("ann", 2 * ClientShares::kShare, 512), Verdict::Take);
    shares.give("ann", 2 * ClientShares::kShare);
    shares.give("ann", 1);  // of nothing
    EXPECT_EQ(shares.take("ann", 2 * ClientShares::kShare, 512), Verdict::Take);
}

}  // namespace
}  // namespace axon::partner
