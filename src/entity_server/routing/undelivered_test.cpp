// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/routing/undelivered.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <utility>

namespace axon::entity_server {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

class FakeTopic final : public FrontEndTopic {
  public:
    void entityBasicPrflUpdate(Presence, const Registration&, std::string_view) override {}
    void entityUpdate(const EntityStatus&, std::int64_t) override {}
    void entityMsg(Lane, const Header&, std::string_view) override {}
    void entityMsgDataSeq(const Header&, std::string_view) override {}
    void entityRefusal(Lane lane, const Header& head, const Refusal& refusal) override {
        lines.push_back((lane == Lane::Signal ? "signal " : "data ") +
                        std::string(refusalName(refusal.code)) + " of " + head.entity + " to " +
                        head.sender.id);
    }
    std::vector<std::string> take() { return std::exchange(lines, {}); }

    std::vector<std::string> lines;
};

class UndeliveredTest : public testing::Test {
  protected:
    static Header head(const std::string& entity, const std::string& client = "c1") {
        Header out;
        out.entity = entity;
        out.sender.id = client;
        return out;
    }

    ManualClock clock;
    FakeTopic topic;
    std::vector<std::string> notes;
    Undelivered::Note note = [this](const std::string& line) { notes.push_back(line); };
    Undelivered alone{true, clock, topic, note};
    Undelivered one_of_several{false, clock, topic, note};
};

TEST_F(UndeliveredTest, OneOfSeveralIsSilentAboutWhatAnotherMayHave) {
    alone.unknown(Lane::Signal, head("e1"));
    one_of_several.unknown(Lane::Signal, head("e1"));
    EXPECT_THAT(topic.take(), ElementsAre("signal UNKNOWN_ENTITY of e1 to c1"));
    one_of_several.unknown(Lane::Data, head("e1"), Via::Straight);
    EXPECT_THAT(topic.take(), ElementsAre("data UNKNOWN_ENTITY of e1 to c1"));
}

TEST_F(UndeliveredTest, DataForNobodyIsRefusedOnceASecondToEachClient) {
    for (int i = 0; i < 100; ++i) alone.unknownData(head("e1"), Via::Topic);
    alone.unknownData(head("e1", "c2"), Via::Topic);
    EXPECT_THAT(topic.take(), SizeIs(2));
    clock.advance(1s);
    alone.unknownData(head("e1"), Via::Topic);
    EXPECT_THAT(topic.take(), SizeIs(1));
    for (int i = 0; i < 10'000; ++i) alone.unknownData(head("e1", "guest" + std::to_string(i)), Via::Topic);
    EXPECT_THAT(topic.take(), SizeIs(10'000)) << "however many there are";
}

TEST_F(UndeliveredTest, WhoSendsTooMuchIsToldForEachEntityAndTheLogIsNotFilled) {
    alone.slow(Lane::Data, head("e1"));
    alone.slow(head(""), {"e2", "e3"});
    EXPECT_THAT(topic.take(), ElementsAre("data OVERLOADED of e1 to c1", "signal OVERLOADED of e2 to c1",
                                          "signal OVERLOADED of e3 to c1"));
    EXPECT_THAT(notes, SizeIs(3));
    EXPECT_THAT(notes.front(), HasSubstr("entity e1 reads slowly"));
    for (int i = 0; i < 1000; ++i) alone.noteSlow(head("e1"));
    EXPECT_THAT(topic.take(), IsEmpty());
    EXPECT_THAT(notes, SizeIs(20));
}

}  // namespace
}  // namespace axon::entity_server
