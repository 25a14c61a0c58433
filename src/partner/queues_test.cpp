// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/queues.hpp"

#include <gtest/gtest.h>

namespace axon::partner {
namespace {

using Verdict = StrandShares::Verdict;

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

TEST(StrandSharesTest, OneClientIsRefusedAndThenDroppedWhileOthersGoOn) {
    StrandShares shares(kAll);
    EXPECT_EQ(shares.take("eve", kShare, 512), Verdict::Take);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Refuse);
    EXPECT_EQ(shares.take("ann", 1, 512), Verdict::Take);
    std::size_t refused = 1;
    while (shares.take("eve", 1, 512) == Verdict::Refuse) ++refused;
    EXPECT_EQ(refused, StrandShares::kRefusals / 512);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Drop);
    for (std::size_t i = 0; i < refused; ++i) shares.give("eve", 512, Verdict::Refuse);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Refuse);
    shares.give("eve", kShare, Verdict::Take);
    EXPECT_EQ(shares.take("eve", 1, 512), Verdict::Take);
    EXPECT_EQ(shares.take("bob", kAll, StrandShares::kNone), Verdict::Drop);
    EXPECT_EQ(shares.take("eve", kAll, StrandShares::kNone), Verdict::Drop);
}

TEST(StrandSharesTest, HoweverManyFloodOneOfWhichLittleWaitsHasRoom) {
    StrandShares shares(kAll);
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
    EXPECT_LE(taken, kAll + 4096 * StrandShares::kLeast);
    EXPECT_LE(refused, StrandShares::kAllRefusals);
}

/// Ice.MessageSizeMax of Axon, and what a message costs besides.
constexpr std::size_t kBiggest = 4096 * 1024 + 1024;

TEST(StrandSharesTest, ABigMessagePassesWhenNothingWaits) {
    StrandShares shares(kAll);
    EXPECT_EQ(shares.take("ann", kBiggest, 512), Verdict::Take);
    shares.give("ann", kBiggest, Verdict::Take);
    shares.give("ann", 1, Verdict::Take);  // of nothing
    EXPECT_EQ(shares.take("ann", kBiggest, 512), Verdict::Take);
}

TEST(StrandSharesTest, AStreamTakesNothingFromWhatMayNotBeDropped) {
    StrandShares shares(kAll);
    std::size_t streamed = 0;
    while (shares.takeDroppable("eve", 1024) == Verdict::TakeDroppable) streamed += 1024;
    EXPECT_LE(streamed, kAll / 16);
    EXPECT_GT(streamed, kAll / 32);
    EXPECT_EQ(shares.take("eve", 512, StrandShares::kNone), Verdict::Take);
    const auto its = streamed;
    // Nor do those of others, however many.
    for (int other = 0; other < 4096; ++other)
        for (std::size_t size = kShare; size > 0; size /= 2)
            while (shares.takeDroppable("other" + std::to_string(other), size) == Verdict::TakeDroppable)
                streamed += size;
    EXPECT_LE(streamed, kAll + 4096 * StrandShares::kLeast);
    EXPECT_EQ(shares.take("eve", 512, StrandShares::kNone), Verdict::Take);
    EXPECT_EQ(shares.takeDroppable("eve", 1024), Verdict::Drop);
    shares.give("eve", its, Verdict::TakeDroppable);
    EXPECT_EQ(shares.takeDroppable("eve", 1024), Verdict::TakeDroppable);
}

TEST(SessionShareTest, AVisitorsSessionEndsOnceForWhatMayNotBeDroppedAndTheOneThatWatchesDoesNot) {
    using Fate = SessionShare::Fate;
    StrandShares shares(kAll);
    SessionShare visitor("1", true), watch("2", false);
    auto verdict = Verdict::Drop;
    for (auto* one : {&visitor, &watch}) {
        EXPECT_EQ(one->admit(shares, kShare / 2, true, verdict), Fate::Post);
        EXPECT_EQ(verdict, Verdict::TakeDroppable);
        EXPECT_EQ(one->admit(shares, kShare / 2, true, verdict), Fate::Drop) << "a stream ends no session";
        EXPECT_EQ(one->admit(shares, kShare, false, verdict), Fate::Post);
        EXPECT_EQ(verdict, Verdict::Take);
    }
    EXPECT_EQ(visitor.admit(shares, kShare, false, verdict), Fate::End);
    EXPECT_EQ(visitor.admit(shares, kShare, false, verdict), Fate::Drop);
    for (int receipt = 0; receipt < 3; ++receipt)
        EXPECT_EQ(watch.admit(shares, kShare, false, verdict), Fate::Drop);
    shares.give(watch.name(), kShare, Verdict::Take);
    EXPECT_EQ(watch.admit(shares, 512, false, verdict), Fate::Post);
}

}  // namespace
}  // namespace axon::partner
