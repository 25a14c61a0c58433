// SPDX-License-Identifier: MIT
#include "entity_interfacer/task_threads.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include <atomic>
#include <future>

namespace axon {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::IsEmpty;

struct FakeTask {
    std::string id, id_bytes, service;
};

struct TheTaskThreads : testing::Test {
    ~TheTaskThreads() override {
        if (!let_go) returns.set_value();
        EXPECT_TRUE(threads.waitForAll(10s));
        threads.reap();
    }
    /// A task whose handler returns when letAllReturn() is called.
    RefusalCode start(const std::string& id, const std::string& service = "Driving") {
        const auto task = std::make_shared<FakeTask>(FakeTask{id, "bytes of " + id, service});
        return threads.start(task, [until = until] { until.wait(); }).code;
    }
    void letAllReturn() {
        let_go = true;
        returns.set_value();
        ASSERT_TRUE(threads.waitForAll(10s));
    }
    bool dataThreadIsWoken(int wait_ms) const {
        pollfd wait{woken.fd(), POLLIN, 0};
        return ::poll(&wait, 1, wait_ms) == 1;
    }

    bool let_go = false;
    std::promise<void> returns;
    std::shared_future<void> until{returns.get_future().share()};
    WakeUp woken;
    TaskThreads<FakeTask> threads{woken};
};

TEST_F(TheTaskThreads, ATaskIsFoundByItsIdAndItsServiceUntilItsThreadIsJoined) {
    EXPECT_EQ(start("a", "Driving"), RefusalCode::Ok);
    EXPECT_EQ(start("b", "Looking"), RefusalCode::Ok);
    ASSERT_NE(threads.find("bytes of a"), nullptr);
    EXPECT_EQ(threads.find("bytes of a")->id, "a");
    EXPECT_EQ(threads.find("bytes of c"), nullptr);
    ASSERT_EQ(threads.ofService("Looking").size(), 1U);
    EXPECT_EQ(threads.ofService("Looking")[0]->id, "b");
    threads.reap();
    EXPECT_NE(threads.find("bytes of a"), nullptr) << "its handler runs";
    letAllReturn();
    EXPECT_NE(threads.find("bytes of a"), nullptr) << "nobody has joined its thread";
    threads.reap();
    EXPECT_EQ(threads.find("bytes of a"), nullptr);
}

TEST_F(TheTaskThreads, TheDataThreadIsWokenWhenAHandlerHasReturned) {
    start("a");
    EXPECT_FALSE(dataThreadIsWoken(0));
    letAllReturn();
    EXPECT_TRUE(dataThreadIsWoken(10'000));
}

TEST_F(TheTaskThreads, WhoWaitsForAllIsToldWhetherAHandlerStillRuns) {
    EXPECT_TRUE(threads.waitForAll(0ms)) << "none has been started";
    start("a", "Driving");
    EXPECT_FALSE(threads.waitForAll(0ms));
    EXPECT_THAT(threads.services(), ElementsAre("Driving"));
    letAllReturn();
    EXPECT_THAT(threads.services(), IsEmpty());
}

TEST_F(TheTaskThreads, SixtyFourTasksRunAndTheNextIsRefused) {
    for (std::size_t i = 0; i < TaskThreads<FakeTask>::kMax; ++i)
        ASSERT_EQ(start("task " + std::to_string(i)), RefusalCode::Ok);
    EXPECT_EQ(start("one too many"), RefusalCode::QueueFull);
    EXPECT_FALSE(threads.wasStarted("one too many")) << "it may come again";
    letAllReturn();
    EXPECT_EQ(start("before the threads are joined"), RefusalCode::QueueFull);
    threads.reap();
    EXPECT_EQ(start("one too many"), RefusalCode::Ok);
}

TEST_F(TheTaskThreads, TheLast256IdsAreRememberedBeyondTheEndOfTheirTasks) {
    letAllReturn();
    const auto runOne = [this](const std::string& id) {
        EXPECT_EQ(start(id), RefusalCode::Ok);
        EXPECT_TRUE(threads.waitForAll(10s));
        threads.reap();
    };
    runOne("first");
    for (int i = 1; i < 256; ++i) runOne("task " + std::to_string(i));
    EXPECT_TRUE(threads.wasStarted("first"));
    runOne("task 256");
    EXPECT_FALSE(threads.wasStarted("first"));
    EXPECT_TRUE(threads.wasStarted("task 1"));
}

TEST_F(TheTaskThreads, AtTheEndNoneStartsAndThoseThatRunGoOn) {
    start("a", "Driving");
    threads.startNoMore();
    EXPECT_EQ(start("b"), RefusalCode::Unavailable);
    EXPECT_FALSE(threads.wasStarted("b"));
    EXPECT_THAT(threads.services(), ElementsAre("Driving"));
}

TEST_F(TheTaskThreads, AHandlerMayAskForTheTasksOfAService) {
    std::promise<std::size_t> found;
    const auto task = std::make_shared<FakeTask>(FakeTask{"a", "bytes of a", "Driving"});
    threads.start(task, [&] { found.set_value(threads.ofService("Looking").size()); });
    EXPECT_EQ(found.get_future().get(), 0U) << "the mutex is not held while a handler runs";
    EXPECT_TRUE(threads.waitForAll(10s));
}

}  // namespace
}  // namespace axon
