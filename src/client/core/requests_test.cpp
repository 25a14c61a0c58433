// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/requests.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;

const Refusal kDenied{RefusalCode::Denied, "no", {}};

struct RequestsTest : testing::Test {
    Id128 id(char number) { return *Id128::fromBytes(std::string(15, '\0') + number); }
    void ask(char number, request::Kind what, std::int64_t sequence = 0,
             const std::string& entity = "robot") {
        requests.await(id(number),
                       {.entity = entity, .lease = {1, 1}, .sequence = sequence, .what = std::move(what)});
    }
    Done noted() {
        return [this](const Result<void>& answer) {
            answers.push_back(answer.refusal().code);
            left = requests.size();
        };
    }

    ManualClock clock;
    std::vector<RefusalCode> answers, refused;
    std::size_t left = 99;
    Requests requests{clock, 5s, [this](const std::string& entity, LeaseNumber under, const Refusal& why) {
                          EXPECT_EQ(entity, "robot");
                          EXPECT_EQ(under, (LeaseNumber{1, 1}));
                          refused.push_back(why.code);
                      }};
};

TEST_F(RequestsTest, ARequestIsAnsweredOnceAndIsOutOfEverythingBeforeItIs) {
    ask(1, request::Confirmed{noted()}, 7);
    EXPECT_TRUE(requests.settle<request::Confirmed>(id(1), {}));
    EXPECT_EQ(left, 0U) << "whoever is told may ask for something else";
    EXPECT_FALSE(requests.settle<request::Confirmed>(id(1), kDenied));
    EXPECT_EQ(answers, std::vector{RefusalCode::Ok});
    EXPECT_FALSE(requests.bySequence(7));
    EXPECT_TRUE(requests.of("robot").empty());
    EXPECT_EQ(requests.nextDeadline(), TimePoint::max());
    EXPECT_TRUE(refused.empty());
}

TEST_F(RequestsTest, TheSameNumberOfAnotherKindIsAnotherRequest) {
    ask(1, request::StartTask{});
    ask(1, request::Control{{noted()}, proto::PAUSE});
    EXPECT_FALSE(requests.settle<request::Confirmed>(id(1), {}));
    EXPECT_TRUE(requests.settle<request::Control>(id(1), {}));
    EXPECT_TRUE(requests.contains(Requests::keyOf<request::StartTask>(id(1))));
}

TEST_F(RequestsTest, ARefusalIsToldAndMayMeanThatTheLeaseIsGone) {
    ask(1, request::Confirmed{noted()});
    requests.settle<request::Confirmed>(id(1), kDenied);
    EXPECT_EQ(answers, std::vector{RefusalCode::Denied});
    EXPECT_EQ(refused, std::vector{RefusalCode::Denied});
}

TEST_F(RequestsTest, AReleaseIsDoneWhateverComesBack) {
    ask(1, request::Release{noted()});
    requests.settle<request::Release>(id(1), kDenied);
    EXPECT_EQ(answers, std::vector{RefusalCode::Ok});
    EXPECT_TRUE(refused.empty()) << "its lease is over already";
}

TEST_F(RequestsTest, WhatHasAnAnswerOfItsOwnIsRefusedLikeTheRest) {
    Result<Details> answer = Details{};
    ask(1, request::FetchDetails{[&](Result<Details> details) { answer = std::move(details); }});
    requests.settle<request::FetchDetails>(id(1), kDenied);
    ASSERT_FALSE(answer);
    EXPECT_EQ(answer.refusal().code, RefusalCode::Denied);
}

TEST_F(RequestsTest, ItIsDueAfterTheTimeOutOrWhenItSays) {
    ask(1, request::Confirmed{noted()});
    requests.await(id(2), {.entity = "robot", .deadline = clock.now() + 1s, .what = request::ResumeLease{}});
    EXPECT_EQ(requests.nextDeadline(), clock.now() + 1s);
    EXPECT_FALSE(requests.due(clock.now()));
    clock.advance(1s);
    EXPECT_EQ(requests.due(clock.now()), Requests::keyOf<request::ResumeLease>(id(2)));
    requests.postpone(Requests::keyOf<request::ResumeLease>(id(2)), clock.now() + 1h);
    EXPECT_FALSE(requests.due(clock.now()));
    clock.advance(4s);
    EXPECT_EQ(requests.due(clock.now()), Requests::keyOf<request::Confirmed>(id(1)));
}

TEST_F(RequestsTest, OneThatIsSentAgainIsKnownByItsNewNumberOnly) {
    ask(1, request::ResumeLease{}, 7);
    requests.resend(Requests::keyOf<request::ResumeLease>(id(1)), 8);
    EXPECT_FALSE(requests.bySequence(7));
    EXPECT_EQ(requests.bySequence(8), Requests::keyOf<request::ResumeLease>(id(1)));
}

TEST_F(RequestsTest, ThoseOfOneEntityAreFoundInTheOrderOfTheirKinds) {
    ask(1, request::Upload{noted()});
    ask(2, request::Release{noted()});
    ask(3, request::Confirmed{noted()}, 0, "another");
    EXPECT_EQ(requests.of("robot"), (std::vector{Requests::keyOf<request::Release>(id(2)),
                                                 Requests::keyOf<request::Upload>(id(1))}));
    EXPECT_EQ(requests.all().size(), 3U);
}

TEST(ControlTest, AStateAnswersWhatWasAskedForAndNothingElse) {
    const request::Control pause{{}, proto::PAUSE}, resume{{}, proto::RESUME}, cancel{{}, proto::CANCEL};
    EXPECT_FALSE(pause.answerTo(TaskState::Running, "task"));
    EXPECT_TRUE(pause.answerTo(TaskState::Paused, "task")->ok());
    EXPECT_FALSE(resume.answerTo(TaskState::Paused, "task"));
    EXPECT_TRUE(resume.answerTo(RunState::Running, "run")->ok());
    EXPECT_FALSE(cancel.answerTo(TaskState::Paused, "task"));
    EXPECT_TRUE(cancel.answerTo(TaskState::Cancelled, "task")->ok());
    EXPECT_TRUE(cancel.answerTo(TaskState::Succeeded, "task")->ok());
}

TEST(ControlTest, AnEndRefusesWhatCannotBeAnyMore) {
    const request::Control pause{{}, proto::PAUSE}, cancel{{}, proto::CANCEL};
    EXPECT_EQ(pause.answerTo(TaskState::Failed, "task")->refusal().code, RefusalCode::WrongState);
    EXPECT_EQ(pause.answerTo(RunState::Failed, "run")->refusal().message,
              "The run has ended meanwhile: FAILED.");
    EXPECT_EQ(cancel.answerTo(TaskState::Unknown, "task")->refusal().code, RefusalCode::OutcomeUnknown);
}

}  // namespace
}  // namespace axon::client::test
