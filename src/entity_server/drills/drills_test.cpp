// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/drills/drills.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <string>
#include <vector>

namespace axon::entity_server {
namespace {

using namespace std::chrono_literals;
using testing::IsEmpty;
using testing::SizeIs;

class DrillsTest : public testing::Test {
  protected:
    Drills::SubjectRef join(const std::string& entity) {
        auto subject = std::make_shared<Drills::Subject>(entity);
        drills.join(subject);
        Drills::setReady(*subject, true);
        return subject;
    }
    /// Gives the only entity its drill, and sends it.
    Header give() {
        drills.next();
        clock.advance(10s);
        auto orders = drills.next();
        EXPECT_THAT(orders, SizeIs(1));
        if (orders.empty()) return {};
        drills.begin(orders.front());
        return orders.front().head;
    }

    ManualClock clock;
    SeededRandom random{1};
    Drills drills{{10s, 1s}, clock, random};
};

TEST_F(DrillsTest, TheTimeFromItsSendingToItsAnswerIsHowLongAStopTakes) {
    const auto subject = join("e1");
    const auto drill = give();
    EXPECT_EQ(drill.sent_at_us, toMicroseconds(clock.now()));
    clock.advance(700us);
    EXPECT_TRUE(drills.answer(*subject, drill));
    clock.advance(5s);
    const auto done = drills.settle();
    ASSERT_THAT(done, SizeIs(1));
    EXPECT_TRUE(done.front().answered && done.front().changed);
    EXPECT_EQ(subject->stopLatencyUs(), 700);
    EXPECT_THAT(drills.settle(), IsEmpty()) << "a drill is settled once";
}

TEST_F(DrillsTest, AnAnswerCountsOnceAndForTheDrillThatIsOutOnly) {
    const auto subject = join("e1");
    const auto other = join("e2");
    Header early;
    early.msg_type = kMsgDrill;
    EXPECT_FALSE(drills.answer(*subject, early)) << "nothing was given, and the sender is no drill";
    drills.leave(other);
    const auto drill = give();
    auto receipt = drill;
    receipt.msg_type = kMsgReceipt;
    EXPECT_FALSE(drills.answer(*subject, receipt)) << "an earlier stage of it";
    EXPECT_FALSE(drills.answer(*other, drill)) << "given to another one";
    auto guessed = drill;
    guessed.sender.id += "0";
    EXPECT_FALSE(drills.answer(*subject, guessed));
    guessed.sender.id = drill.sender.id.substr(0, drill.sender.id.rfind('-') + 1) + "x";
    EXPECT_FALSE(drills.answer(*subject, guessed));
    EXPECT_TRUE(drills.answer(*subject, drill));
    EXPECT_FALSE(drills.answer(*subject, drill)) << "twice";
    drills.settle();
    EXPECT_FALSE(drills.answer(*subject, drill)) << "after it was settled";
    EXPECT_EQ(subject->stopLatencyUs(), 1) << "unmeasurably fast is not unknown";
}

TEST_F(DrillsTest, WithoutAnAnswerInTimeItIsUnknown) {
    const auto subject = join("e1");
    auto drill = give();
    EXPECT_EQ(drills.nextDeadline(), clock.now() + 1s);
    drills.answer(*subject, drill);
    drills.settle();
    drill = give();
    clock.advance(999ms);
    EXPECT_THAT(drills.settle(), IsEmpty());
    EXPECT_EQ(subject->stopLatencyUs(), 1) << "the last result holds meanwhile";
    clock.advance(1ms);
    const auto done = drills.settle();
    ASSERT_THAT(done, SizeIs(1));
    EXPECT_TRUE(!done.front().answered && done.front().changed);
    EXPECT_EQ(subject->stopLatencyUs(), 0);
}

TEST_F(DrillsTest, EveryEntityGetsOneInAPeriodAndAfterAPauseThereIsNoBurst) {
    std::vector<Drills::SubjectRef> subjects;
    for (int i = 0; i < 100; ++i) subjects.push_back(join("e" + std::to_string(i)));
    drills.next();
    std::vector<std::string> drilled;
    for (int i = 0; i < 100; ++i) {
        clock.advance(100ms);
        const auto orders = drills.next();
        ASSERT_THAT(orders, SizeIs(1));
        drilled.push_back(orders.front().to->entity());
    }
    std::sort(drilled.begin(), drilled.end());
    EXPECT_EQ(std::unique(drilled.begin(), drilled.end()), drilled.end());
    clock.advance(1h);
    drills.settle();
    EXPECT_THAT(drills.next(), SizeIs(testing::Le(1U)));
}

TEST_F(DrillsTest, WhoIsNotReadyHasLeftOrOwesAnAnswerGetsNone) {
    const auto subject = join("e1");
    Drills::setReady(*subject, false);
    const auto waited = [&](Duration time) {
        std::size_t given = 0;
        for (const auto end = clock.now() + time; clock.now() < end; clock.advance(1s))
            given += drills.next().size();
        return given;
    };
    EXPECT_EQ(waited(30s), 0U);
    Drills::setReady(*subject, true);
    EXPECT_EQ(waited(30s), 1U) << "it is not settled, so it is still out";
    drills.leave(subject);
    drills.leave(subject);
    clock.advance(10s);
    EXPECT_THAT(drills.settle(), IsEmpty()) << "nobody waits for the answer of one that has left";
    EXPECT_EQ(waited(30s), 0U);
}

TEST_F(DrillsTest, WhoLeavesLateTakesNobodyElseWithIt) {
    const auto before = join("e1");
    drills.leave(before);
    const auto now = join("e1");
    drills.leave(before);
    EXPECT_EQ(give().entity, "e1");
}

TEST_F(DrillsTest, WithoutAPeriodThereAreNone) {
    Drills off{{}, clock, random};
    off.join(std::make_shared<Drills::Subject>("e1"));
    clock.advance(1h);
    EXPECT_THAT(off.next(), IsEmpty());
    EXPECT_EQ(off.nextDeadline(), TimePoint::max());
    EXPECT_FALSE(off.isDrill({}));
}

}  // namespace
}  // namespace axon::entity_server
