// SPDX-License-Identifier: GPL-2.0-or-later
#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "direct/incoming_way.hpp"
#include "direct/outgoing_way.hpp"

namespace axon::direct {
namespace {

using Out = OutgoingWay<std::string>;
using In = IncomingWay<std::string>;

const Id128 kPath = *Id128::parse("22222222-2222-4222-8222-222222222222");
const Id128 kOther = *Id128::parse("33333333-3333-4333-8333-333333333333");

Verdict direct(In& in, std::int64_t sequence, Keeping keeping = Keeping::Kept, const Id128& path = kPath) {
    std::string message = std::to_string(sequence);
    return in.direct(path, keeping, sequence, 100, message);
}

std::vector<std::string> mark(In& in, const Id128& path = kPath) {
    std::vector<std::string> passed;
    in.mark(path, [&](std::string message) { passed.push_back(std::move(message)); });
    return passed;
}

using Strings = std::vector<std::string>;

TEST(OutgoingWay, KeepsWhatIsNotAcknowledgedAndGivesItBackInOrder) {
    Out out;
    EXPECT_FALSE(out.direct());
    EXPECT_TRUE(out.end().empty());
    out.begin();
    EXPECT_TRUE(out.direct());
    for (const int sequence : {3, 4, 7, 9}) out.keep(sequence, 10, std::to_string(sequence));
    out.acknowledged(5);
    EXPECT_EQ(out.keptMessages(), 2U);
    EXPECT_EQ(out.keptBytes(), 20U);
    const auto left = out.end();
    ASSERT_EQ(left.size(), 2U);
    EXPECT_EQ(left[0].message, "7");
    EXPECT_EQ(left[1].message, "9");
    EXPECT_FALSE(out.direct());
    EXPECT_TRUE(out.end().empty());
}

TEST(OutgoingWay, HasABoundAndTakesOneLargeMessageAlone) {
    Out out({2, 100});
    out.begin();
    EXPECT_TRUE(out.hasRoom(1000));
    out.keep(1, 60, "a");
    EXPECT_TRUE(out.hasRoom(40));
    EXPECT_FALSE(out.hasRoom(41));
    out.keep(2, 1, "b");
    EXPECT_FALSE(out.hasRoom(1));
    out.acknowledged(2);
    EXPECT_TRUE(out.hasRoom(1000));
}

TEST(IncomingWay, PassesEverythingBeforeThereIsAPath) {
    In in;
    // Not even by number: a peer without a direct path may not count.
    for (const int sequence : {5, 5, 2, 0}) EXPECT_EQ(in.relayed(Keeping::Kept, sequence), Verdict::Pass);
}

TEST(IncomingWay, HoldsBackWhatOvertakesTheMark) {
    In in;
    EXPECT_EQ(direct(in, 3), Verdict::LeftOut) << "no path";
    in.open(kPath);
    EXPECT_EQ(direct(in, 3), Verdict::HeldBack);
    EXPECT_EQ(direct(in, 4, Keeping::Droppable), Verdict::HeldBack);
    EXPECT_TRUE(in.holdsBack());
    EXPECT_EQ(in.relayed(Keeping::Kept, 2), Verdict::Pass);
    EXPECT_EQ(in.passed(), 2) << "what is held back may not be acknowledged";
    EXPECT_EQ(mark(in, kOther), Strings());
    EXPECT_EQ(mark(in), (Strings{"3", "4"}));
    EXPECT_FALSE(in.holdsBack());
    EXPECT_EQ(in.passed(), 3);
    EXPECT_EQ(direct(in, 5), Verdict::Pass);
    EXPECT_EQ(mark(in), Strings());
}

TEST(IncomingWay, LeavesOutWhatIsSentAgainAfterABreak) {
    In in;
    in.open(kPath);
    mark(in);
    EXPECT_EQ(direct(in, 1), Verdict::Pass);
    EXPECT_EQ(direct(in, 2), Verdict::Pass);
    // 2, 3 and 4 come again by the relayed way, while 3 is still in the socket.
    EXPECT_EQ(in.relayed(Keeping::Kept, 2), Verdict::LeftOut);
    EXPECT_EQ(direct(in, 3), Verdict::Pass);
    EXPECT_EQ(in.relayed(Keeping::Kept, 3), Verdict::LeftOut);
    EXPECT_EQ(in.relayed(Keeping::Kept, 4), Verdict::Pass);
    EXPECT_EQ(direct(in, 4), Verdict::LeftOut);
    EXPECT_EQ(in.relayed(Keeping::Kept, 5), Verdict::Pass);
    in.close(kPath);
    EXPECT_EQ(direct(in, 6), Verdict::LeftOut);
    EXPECT_EQ(in.relayed(Keeping::Kept, 5), Verdict::LeftOut) << "by number for ever";
}

TEST(IncomingWay, OldDataComesNotBehindNewAndNeverKeepsAMessageOut) {
    In in;
    in.open(kPath);
    mark(in);
    EXPECT_EQ(direct(in, 1), Verdict::Pass);
    EXPECT_EQ(direct(in, 5, Keeping::Droppable), Verdict::Pass);
    EXPECT_EQ(in.relayed(Keeping::Droppable, 5), Verdict::LeftOut);
    EXPECT_EQ(in.relayed(Keeping::Droppable, 4), Verdict::LeftOut);
    EXPECT_EQ(in.relayed(Keeping::Kept, 4), Verdict::Pass);
    EXPECT_EQ(in.passed(), 4);
    EXPECT_EQ(in.relayed(Keeping::Droppable, 6), Verdict::Pass);
}

TEST(IncomingWay, ANewPathTakesThePlaceOfTheOldOneAndWaitsForItsOwnMark) {
    In in;
    in.open(kPath);
    mark(in);
    EXPECT_EQ(direct(in, 1), Verdict::Pass);
    in.open(kOther);
    EXPECT_EQ(direct(in, 2), Verdict::LeftOut);
    EXPECT_EQ(direct(in, 3, Keeping::Kept, kOther), Verdict::HeldBack);
    EXPECT_EQ(mark(in, kPath), Strings()) << "of the old one";
    EXPECT_EQ(in.relayed(Keeping::Kept, 2), Verdict::Pass);
    in.close(kPath);  // late, of the old one
    EXPECT_EQ(mark(in, kOther), Strings{"3"});
}

TEST(IncomingWay, GivesThePathUpWhenTooMuchIsHeldBack) {
    In in({2, 250});
    in.open(kPath);
    EXPECT_EQ(direct(in, 1), Verdict::HeldBack);
    EXPECT_EQ(direct(in, 2), Verdict::HeldBack);
    EXPECT_EQ(direct(in, 3), Verdict::Overflow);
    EXPECT_FALSE(in.holdsBack());
    EXPECT_EQ(direct(in, 4), Verdict::LeftOut);
    EXPECT_EQ(mark(in), Strings());
    for (const int sequence : {1, 2, 3}) EXPECT_EQ(in.relayed(Keeping::Kept, sequence), Verdict::Pass);
}

}  // namespace
}  // namespace axon::direct
