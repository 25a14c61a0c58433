// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/news_desk.hpp"

#include <gtest/gtest.h>

#include <chrono>
#include <future>
#include <stdexcept>
#include <string>
#include <vector>

namespace axon::client::test {
namespace {

using namespace std::chrono_literals;
using Noted = std::vector<std::string>;

/// A program whose callback thread does not return from its first callback until it is told to.
class NewsDeskTest : public ::testing::Test, public LeaseOffers {
  protected:
    NewsDeskTest() {
        std::promise<void> entered;
        auto inside = entered.get_future();
        news.post(
            [this, &entered] {
                entered.set_value();
                back_.get_future().wait();
            },
            false);
        inside.wait();
    }
    ~NewsDeskTest() override {
        if (!returned_) back_.set_value();
        news.close();
    }
    /// It returns; everything that waits is called.
    void comeBack() {
        std::promise<void> last;
        auto done = last.get_future();
        news.post([&last] { last.set_value(); }, false);
        returned_ = true;
        back_.set_value();
        done.wait();
    }
    void onDirect(const Held& held, const std::string& data_endpoint, const std::string&,
                  const std::string&) override {
        offered.push_back(held.entity + " " + data_endpoint);
    }
    void onDatagrams(const Held& held, const std::string& endpoint, const std::string&) override {
        offered.push_back(held.entity + " " + endpoint);
    }
    static TaskReport report(const std::string& id, TaskState state) {
        TaskReport report;
        report.id = id;
        report.state = state;
        return report;
    }
    std::shared_ptr<CheckOut::Shared> holds(const Held& held) {
        auto check_out = std::make_shared<CheckOut::Shared>(held, std::weak_ptr<Client::Session>(), Entity{});
        news.add(check_out);
        return check_out;
    }

    Noted called;  // on its thread, until comeBack() has returned
    Noted offered;
    int overflows = 0;
    bool returned_ = false;
    std::promise<void> back_;
    NewsDesk news{*this, [this] { ++overflows; }};  // last: its thread uses the others
};

TEST_F(NewsDeskTest, WhatTheCoreTellsWakesTheCallbackThreadOnceItsLockIsFree) {
    EXPECT_FALSE(news.takeTold());
    news.tell([this] { called.push_back("text"); }, true);
    EXPECT_TRUE(news.takeTold());
    EXPECT_FALSE(news.takeTold()) << "it is woken once";
    news.post([this] { called.push_back("posted"); }, true);
    EXPECT_FALSE(news.takeTold()) << "that one was woken for at once";
    comeBack();
    EXPECT_EQ(called, (Noted{"text", "posted"}));
}

TEST_F(NewsDeskTest, AReportIsThereAtOnceAndThenTold) {
    const auto id = *Id128::fromBytes(std::string(16, 'a'));
    const auto task = std::make_shared<Task::Shared>(id, std::weak_ptr<Client::Session>(),
                                                     report(id.toString(), TaskState::Queued));
    task->callbacks.push_back([this](const TaskReport& told) { called.push_back(toString(told.state)); });
    news.add(task);
    news.onTask(report(task->text, TaskState::Running));
    EXPECT_EQ(task->report.state, TaskState::Running);
    news.onTask(report(task->text, TaskState::Succeeded));
    news.onTask(report(task->text, TaskState::Failed));
    EXPECT_EQ(task->report.state, TaskState::Succeeded) << "nobody is told after the end";
    comeBack();
    EXPECT_EQ(called, (Noted{"RUNNING", "SUCCEEDED"}));
}

TEST_F(NewsDeskTest, AWaitEndsWhenTheCallbacksHaveBeenCalledWithTheEnd) {
    const auto id = *Id128::fromBytes(std::string(16, 'a'));
    const auto task = std::make_shared<Task::Shared>(id, std::weak_ptr<Client::Session>(),
                                                     report(id.toString(), TaskState::Running));
    task->callbacks.push_back([this](const TaskReport& told) { called.push_back(toString(told.state)); });
    news.add(task);
    news.onTask(report(task->text, TaskState::Succeeded));
    auto waited = std::async(std::launch::async, [&] {
        std::unique_lock lock(task->mutex);
        task->changed.wait(lock, [&] { return task->over(); });
        return called;
    });
    EXPECT_EQ(waited.wait_for(20ms), std::future_status::timeout) << "the callback has not been called";
    comeBack();
    EXPECT_EQ(waited.get(), Noted{"SUCCEEDED"});
}

TEST_F(NewsDeskTest, AWaitEndsWhenACallbackThrowsOrIsDiscarded) {
    const auto id = *Id128::fromBytes(std::string(16, 'a'));
    const auto task = [&] {
        auto made = std::make_shared<Task::Shared>(id, std::weak_ptr<Client::Session>(),
                                                   report(id.toString(), TaskState::Running));
        made->callbacks.emplace_back([](const TaskReport&) { throw std::runtime_error("mine"); });
        news.add(made);
        news.onTask(report(made->text, TaskState::Succeeded));
        return made;
    };
    const auto throws = task();
    EXPECT_FALSE(throws->over());
    comeBack();
    EXPECT_TRUE(throws->over());
    news.close();
    EXPECT_TRUE(task()->over()) << "nothing is called after the client has been closed";
}

TEST_F(NewsDeskTest, AHandleThatWasDroppedIsNotTold) {
    const auto id = *Id128::fromBytes(std::string(16, 'a'));
    auto task = std::make_shared<Task::Shared>(id, std::weak_ptr<Client::Session>(),
                                               report(id.toString(), TaskState::Queued));
    const auto text = task->text;
    task->callbacks.push_back([this](const TaskReport&) { called.push_back("dropped"); });
    news.add(task);
    task.reset();
    news.onTask(report(text, TaskState::Succeeded));
    comeBack();
    EXPECT_TRUE(called.empty());
}

TEST_F(NewsDeskTest, NewsOfALeaseGoesToItsOwnHandleOnly) {
    const auto before = holds({"robot", {1, 1}});
    const auto now = holds({"robot", {1, 2}});
    before->text = [this](const std::string& text) { called.push_back("before: " + text); };
    now->text = [this](const std::string& text) { called.push_back("now: " + text); };
    news.onText({"robot", {1, 2}}, "hello");
    news.onText({"robot", {1, 3}}, "nobody's");
    comeBack();
    EXPECT_EQ(called, Noted{"now: hello"});
}

TEST_F(NewsDeskTest, ALostLeaseIsToldOnceAndItsHandleKnowsWhy) {
    const auto check_out = holds({"robot", {1, 1}});
    check_out->lost = [this](const Refusal& why) { called.push_back(why.message); };
    news.onLost({"robot", {1, 1}}, {RefusalCode::RevokedLease, "taken", {}});
    news.onLost({"robot", {1, 1}}, {RefusalCode::RevokedLease, "taken again", {}});
    EXPECT_EQ(check_out->lost_why->message, "taken");
    EXPECT_TRUE(news.checkOuts().empty());
    comeBack();
    EXPECT_EQ(called, Noted{"taken"});
}

TEST_F(NewsDeskTest, AWatchGetsItsStreamsAndNothingAfterItsEnd) {
    const auto note = [this](const std::string& who) {
        return [this, who](const Sample& sample) { called.push_back(who + " " + sample.stream); };
    };
    news.addWatch("robot", {"sonar"}, note("some"));
    news.addWatch("robot", {}, note("all"));
    const auto ended = news.addWatch("robot", {"sonar"}, note("ended"));
    for (const auto* stream : {"sonar", "laser"}) news.onSample({"robot", stream, 1, {}});
    news.onSample({"another", "sonar", 1, {}});
    EXPECT_EQ(news.removeWatch(ended), (std::pair<std::string, Noted>{"robot", {"sonar"}}));
    EXPECT_TRUE(news.removeWatch(ended).first.empty());
    comeBack();
    EXPECT_EQ(called, (Noted{"some sonar", "all sonar", "all laser"}))
        << "what waited for the ended one is dropped";
}

TEST_F(NewsDeskTest, CreditsGoToTheirUploadWhileItRuns) {
    const auto id = *Id128::fromBytes(std::string(16, 'a'));
    const auto window = std::make_shared<UploadWindow>();
    news.add(id, window);
    news.onTransferCredit(id, 10, 100);
    const auto turn = window->next(std::nullopt, 1000);
    EXPECT_EQ(turn.from, 10U);
    EXPECT_EQ(turn.to, 100U);
    news.removeUpload(id);
    news.onTransferCredit(id, 10, 500);
    window->credit(10, 200);
    EXPECT_EQ(window->next(100, 1000).to, 200U) << "the credit after its end is nobody's";
}

TEST_F(NewsDeskTest, OtherWaysToAnEntityAreNotForTheProgram) {
    news.onDirect({"robot", {1, 1}}, "127.0.0.1:1", "127.0.0.1:2", "key");
    news.onDatagrams({"robot", {1, 1}}, "127.0.0.1:3", "key");
    EXPECT_EQ(offered, (Noted{"robot 127.0.0.1:1", "robot 127.0.0.1:3"}));
}

TEST_F(NewsDeskTest, AProgramThatDoesNotReturnFromItsCallbacksIsNoticed) {
    for (std::size_t i = 0; i < CallbackQueue::kMost; ++i) news.tell([] {}, false);
    EXPECT_EQ(overflows, 0);
    news.tell([] {}, false);
    EXPECT_EQ(overflows, 1);
}

}  // namespace
}  // namespace axon::client::test
