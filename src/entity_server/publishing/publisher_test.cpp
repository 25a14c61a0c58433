// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/publishing/publisher.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <utility>

namespace axon::entity_server {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::IsEmpty;
using testing::SizeIs;

class FakeTopic final : public FrontEndTopic {
  public:
    void entityBasicPrflUpdate(Presence presence, const Registration& registration,
                               std::string_view) override {
        const char* text[] = {"joined ", "changed ", "left "};
        say(text[static_cast<int>(presence)] + registration.entity);
    }
    void entityUpdate(const EntityStatus& status, std::int64_t) override {
        say(std::string("status ") + toString(status.state));
    }
    void entityMsg(Lane, const Header&, std::string_view) override {}
    void entityMsgDataSeq(const Header&, std::string_view) override {}
    void entityRefusal(Lane, const Header&, const Refusal&) override {}
    void entityServerEntities(const std::string& server, const std::vector<std::string>& entities) override {
        say("all of " + server + ": " + std::to_string(entities.size()));
    }
    void entityServerUpdate(Lane, const ServerAnnouncement& self) override {
        say(self.name + " published " + std::to_string(self.published));
    }
    std::vector<std::string> take() { return std::exchange(lines, {}); }

    std::vector<std::string> lines;
    std::function<void()> meanwhile;  ///< what another thread does while this one is told something

  private:
    void say(std::string line) {
        lines.push_back(std::move(line));
        if (meanwhile) std::exchange(meanwhile, nullptr)();
    }
};

class PublisherTest : public testing::Test {
  protected:
    static RecordRef record(const std::string& entity, EntityState state, std::uint64_t session = 1) {
        Record out;
        out.registration.entity = entity;
        out.profile = std::make_shared<const std::string>("profile");
        out.status.state = state;
        out.heard = true;
        out.session = session;
        return std::make_shared<const Record>(std::move(out));
    }
    std::vector<std::string> told() {
        publisher.publishPending();
        return topic.take();
    }

    ManualClock clock;
    FakeTopic topic;
    int woken = 0;
    ServerAnnouncement self{"e1", "instance", {}};
    Publisher publisher{self, clock, topic, [](const std::string&) {}, [this] { ++woken; }};
};

TEST_F(PublisherTest, TellsWhatHoldsNowAndNothingThatHeldBetween) {
    publisher.set(record("a", EntityState::UNAV));
    publisher.set(record("a", EntityState::IDLE));
    EXPECT_THAT(told(), ElementsAre("joined a", "status IDLE"));
    publisher.set(record("a", EntityState::BUSY));
    publisher.set(record("a", EntityState::IDLE));
    EXPECT_THAT(told(), IsEmpty());
    publisher.left("a");
    publisher.set(record("a", EntityState::IDLE, 2));
    EXPECT_THAT(told(), ElementsAre("left a", "joined a", "status IDLE")) << "another session is another one";
}

TEST_F(PublisherTest, WhoLeftBeforeAnybodyHeardOfItIsNotToldOf) {
    publisher.left("never here");
    publisher.set(record("a", EntityState::IDLE));
    publisher.left("a");
    publisher.left("a");
    EXPECT_THAT(told(), IsEmpty());
}

TEST_F(PublisherTest, WhatChangesWhileOneThreadTellsIsToldByThatThreadAndInOrder) {
    topic.meanwhile = [&] {
        publisher.left("a");
        publisher.set(record("b", EntityState::IDLE));
        publisher.publishPending();  // finds the first one at it
        EXPECT_THAT(topic.lines, SizeIs(1));
    };
    publisher.set(record("a", EntityState::IDLE));
    EXPECT_THAT(told(), ElementsAre("joined a", "status IDLE", "left a", "joined b", "status IDLE"));
}

TEST_F(PublisherTest, TheListAndItsOwnWordComeWhenEverythingElseHasBeenSaid) {
    publisher.announce();
    publisher.again();
    publisher.set(record("a", EntityState::IDLE));
    EXPECT_THAT(told(), ElementsAre("joined a", "status IDLE", "all of e1: 1", "e1 published 2"));
    publisher.again();
    EXPECT_THAT(told(), ElementsAre("changed a", "status IDLE", "all of e1: 1"));
}

TEST_F(PublisherTest, TheOnlyServerListsNothing) {
    self.name.clear();
    publisher.set(record("a", EntityState::IDLE));
    publisher.again();
    EXPECT_THAT(told(), ElementsAre("joined a", "status IDLE"));
}

TEST_F(PublisherTest, AnEntityThatChangesTooFastIsToldOfWhenItsPauseIsOver) {
    publisher.set(record("a", EntityState::IDLE));
    publisher.publishPending();
    for (int i = 0; i < 1000; ++i) {
        publisher.set(record("a", i % 2 == 0 ? EntityState::BUSY : EntityState::IDLE));
        publisher.publishPending();
    }
    publisher.set(record("a", EntityState::REG));
    topic.take();
    publisher.again();
    EXPECT_THAT(told(), ElementsAre("all of e1: 1")) << "nobody waits for it";
    EXPECT_EQ(woken, 1);
    EXPECT_FALSE(publisher.endPauses());
    EXPECT_EQ(publisher.nextPause(), clock.now() + 5ms);
    clock.advance(5ms);
    EXPECT_TRUE(publisher.endPauses());
    EXPECT_EQ(publisher.nextPause(), TimePoint::max());
    EXPECT_THAT(told(), ElementsAre("changed a", "status REG")) << "again, as was asked for in its pause";
}

TEST_F(PublisherTest, ItsLeavingAndItsNextSessionDoNotWaitForAPause) {
    for (int i = 0; i < 1000; ++i) {
        publisher.set(record("a", i % 2 == 0 ? EntityState::BUSY : EntityState::IDLE));
        publisher.publishPending();
    }
    topic.take();
    publisher.left("a");
    EXPECT_THAT(told(), ElementsAre("left a"));
    publisher.set(record("a", EntityState::REG, 2));
    EXPECT_THAT(told(), ElementsAre("joined a", "status REG"));
    clock.advance(1s);
    publisher.endPauses();
    EXPECT_THAT(told(), IsEmpty());
}

}  // namespace
}  // namespace axon::entity_server
