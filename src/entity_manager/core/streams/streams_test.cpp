// SPDX-License-Identifier: GPL-2.0-or-later
// Who is sent which samples, and what the robot application is told to send, without the rest of the Entity
// Manager.
#include "entity_manager/core/streams/streams.hpp"

#include <axon/link.pb.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <initializer_list>

#include "tests/support/fake_turn.hpp"

namespace axon::entity_manager {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;

struct TheStreams : testing::Test {
    TheStreams() { streams.linkUp(); }
    RefusalCode watch(const std::string& client, std::initializer_list<std::string> names, bool on = true) {
        proto::Watch message;
        message.set_on(on);
        for (const auto& name : names) message.add_streams(name);
        const auto taken = streams.watch(client, message);
        return taken ? RefusalCode::Ok : taken.refusal().code;
    }
    void holdBy(const std::string& client) {
        turn.lease.emplace().holder.id = client;
        streams.holderBegan();
    }
    void sample(const std::string& stream) {
        proto::StreamSample sample;
        sample.set_stream(stream);
        streams.pass(sample);
    }
    /// Who has been sent samples since it was asked last.
    std::vector<std::string> sentTo() {
        std::vector<std::string> clients;
        for (const auto& told : std::exchange(turn.told, {})) clients.push_back(told.to.id);
        return clients;
    }
    /// What the application has been told since it was asked last: "+name" on, "-name" off.
    std::vector<std::string> switched() {
        std::vector<std::string> switches;
        for (const auto& message : std::exchange(turn.to_application, {}))
            switches.push_back((message.stream().on() ? "+" : "-") + message.stream().stream());
        return switches;
    }

    test::FakeTurn turn;
    Streams streams{turn};
};

TEST_F(TheStreams, ASampleGoesToTheHolderAndToThoseWhoWatchItsStream) {
    holdBy("holder");
    watch("a", {"camera"});
    watch("b", {});
    sample("camera");
    EXPECT_THAT(sentTo(), ElementsAre("holder", "a", "b"));
    sample("laser");
    EXPECT_THAT(sentTo(), ElementsAre("holder", "b"));
    EXPECT_EQ(turn.counted.undelivered, 0U);
}

TEST_F(TheStreams, AHolderThatWatchesAStreamByNameIsSentItsSampleOnce) {
    holdBy("holder");
    watch("holder", {"camera"});
    sample("camera");
    EXPECT_THAT(sentTo(), ElementsAre("holder"));
}

TEST_F(TheStreams, ASampleThatNobodyWatchesIsCounted) {
    sample("camera");
    watch("a", {"camera"});
    turn.session = false;
    sample("camera");
    EXPECT_THAT(sentTo(), IsEmpty());
    EXPECT_EQ(turn.counted.undelivered, 2U);
}

TEST_F(TheStreams, TheApplicationIsToldWhenTheFirstBeginsAndTheLastEndsToWatch) {
    watch("a", {"camera"});
    EXPECT_THAT(switched(), ElementsAre("+camera"));
    watch("b", {"camera"});
    watch("a", {"camera"}, false);
    EXPECT_THAT(switched(), IsEmpty()) << "somebody watches it";
    streams.forget("b");
    EXPECT_THAT(switched(), ElementsAre("-camera"));
    streams.forget("b");
    EXPECT_THAT(switched(), IsEmpty());
}

TEST_F(TheStreams, AStreamWatchedByNameStaysOnWhenNobodyWatchesAllOfThem) {
    watch("a", {"camera"});
    watch("b", {});
    switched();
    watch("b", {}, false);
    EXPECT_THAT(switched(), ElementsAre("-", "+camera"));
}

TEST_F(TheStreams, AllStreamsStayOnForAHolderWhoeverEndsToWatch) {
    watch("b", {});
    switched();
    holdBy("holder");
    streams.forget("b");
    EXPECT_THAT(switched(), IsEmpty());
}

TEST_F(TheStreams, ANewHolderIsSentAllStreamsAgain) {
    watch("b", {});
    streams.forget("b");
    EXPECT_THAT(switched(), ElementsAre("+", "-"));
    holdBy("holder");
    EXPECT_THAT(switched(), ElementsAre("+"));
    holdBy("another");
    EXPECT_THAT(switched(), IsEmpty()) << "they are on";
}

TEST_F(TheStreams, AnApplicationThatComesIsToldWhatIsWatchedAndNothingBefore) {
    turn.link = false;
    watch("a", {"camera", "laser"});
    EXPECT_THAT(switched(), IsEmpty());
    turn.link = true;
    streams.linkUp();
    streams.tellPresent();
    EXPECT_THAT(switched(), ElementsAre("+camera", "+laser"));
}

TEST_F(TheStreams, AClientWatches64StreamsByNameAtMost) {
    for (int i = 0; i < 64; ++i) EXPECT_EQ(watch("a", {std::to_string(i)}), RefusalCode::Ok);
    EXPECT_EQ(watch("a", {"one more"}), RefusalCode::Overloaded);
    EXPECT_EQ(watch("b", {"one more"}), RefusalCode::Ok);
    watch("a", {"0"}, false);
    EXPECT_EQ(watch("a", {"one more"}), RefusalCode::Ok);
}

TEST_F(TheStreams, ANameOfMoreThan255BytesIsRefused) {
    EXPECT_EQ(watch("a", {std::string(255, 'x')}), RefusalCode::Ok);
    EXPECT_EQ(watch("a", {std::string(256, 'x')}), RefusalCode::BadName);
    EXPECT_EQ(watch("a", {std::string(256, 'x')}, false), RefusalCode::BadName);
}

TEST_F(TheStreams, Of257WhoWatchTheOneThatBeganFirstIsDroppedUnlessItIsTheHolder) {
    watch("holder", {"camera"});
    watch("first", {"camera"});
    for (int i = 0; i < 254; ++i) watch("client " + std::to_string(i), {"laser"});
    holdBy("holder");
    sample("camera");
    EXPECT_THAT(sentTo(), ElementsAre("holder", "first"));
    watch("last", {"laser"});
    sample("camera");
    EXPECT_THAT(sentTo(), ElementsAre("holder"));
    turn.lease.reset();
    sample("camera");
    EXPECT_THAT(sentTo(), ElementsAre("holder")) << "it watches as before";
}

}  // namespace
}  // namespace axon::entity_manager
