// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/console_desk.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <atomic>
#include <future>
#include <vector>

#include "support/recorded_audit.hpp"

namespace axon::server {
namespace {

using namespace std::chrono_literals;
using testing::HasSubstr;
using transport::LoggedIn;

const std::string kHash =
    "$6$saltsalt$jCP90RmSIIja2o9FRs25ASQaR1lMN6uKHmNcHaoNCpAXgV3n5NfAlQdZQcvMVQO1BTCOFF0LzoHFZBt9E45NW0";

class ConsoleDeskTest : public testing::Test {
  protected:
    explicit ConsoleDeskTest(bool has_users = true)
        : logins(
              has_users
                  ? std::make_shared<const users::Users>(users::Users::parse(
                        "watcher observer " + kHash + "\nboss admin " + kHash + "\nleft entity " + kHash,
                        "users.cfg"))
                  : nullptr,
              clock, [](const auto&) {}, [](const auto&, const auto&) { return ::geteuid(); }, &trail),
          desk(logins, has_users, visitors, [this](const std::string& line) { notes.push_back(line); }) {
        desk.setSites(console::Sites({false, 10417, 10418, 10419, {}, {"https://lab.example"}}));
    }
    ~ConsoleDeskTest() override { logins.close(); }

    Result<LoggedIn> open(const std::string& password,
                          std::optional<std::string> origin = "http://127.0.0.1:10417") {
        std::promise<Result<LoggedIn>> promise;
        transport::LoginRequest request{"anybody", password, "127.0.0.1:50122", "127.0.0.1:10418"};
        request.origin = std::move(origin);
        desk.client(std::move(request), [&](Result<LoggedIn> who) { promise.set_value(std::move(who)); });
        return promise.get_future().get();
    }
    Result<console::LoginPort::Visitor> logIn(const std::string& user, const std::string& password) {
        std::promise<Result<console::LoginPort::Visitor>> promise;
        console::Request request;
        request.peer = "127.0.0.1:50122";
        request.local = "127.0.0.1:10417";
        desk.login(user, password, request, [&](auto who) { promise.set_value(std::move(who)); });
        return promise.get_future().get();
    }

    ManualClock clock;
    SeededRandom random{1};
    console::Visitors visitors{clock, random};
    std::vector<std::string> notes;
    test::RecordedAudit trail;
    LoginDesk logins;
    ConsoleDesk desk;
};

class ConsoleWithoutUsers : public ConsoleDeskTest {
  protected:
    ConsoleWithoutUsers() : ConsoleDeskTest(false) {}
};

TEST_F(ConsoleDeskTest, ATicketOpensOneSessionAsItsUser) {
    const auto ticket = visitors.ticket("watcher");
    const auto who = open(ticket);
    ASSERT_TRUE(who) << who.refusal().message;
    EXPECT_EQ(who->user, "watcher");
    EXPECT_EQ(who->role, Role::Observer);
    EXPECT_FALSE(open(ticket)) << "a second one";
}

TEST_F(ConsoleDeskTest, AnOldTicketOpensNone) {
    const auto ticket = visitors.ticket("boss");
    clock.advance(31s);
    EXPECT_THAT(open(ticket).refusal().message, HasSubstr("ask for a new one"));
}

TEST_F(ConsoleDeskTest, WhoIsRemovedOrHasANewPasswordHasToLogInAgain) {
    const auto of = [](const std::string& text) { return users::Users::parse(text, "users.cfg"); };
    const auto one = of("ann operator " + kHash + "\nbob operator " + kHash);
    const auto anns = visitors.enter("ann"), bobs = visitors.enter("bob");
    const auto ticket = visitors.ticket("ann");
    desk.usersChanged(one, of("ann admin " + kHash + "\nbob operator " + kHash));
    EXPECT_TRUE(visitors.userOf(anns)) << "another role is no other user";
    const auto without = of("bob operator " + kHash);
    desk.usersChanged(one, without);
    desk.usersChanged(without, one);  // ann is added again
    EXPECT_FALSE(visitors.userOf(anns));
    EXPECT_FALSE(visitors.redeem(ticket));
    EXPECT_TRUE(visitors.userOf(bobs));
    desk.usersChanged(one, of("ann operator " + kHash + "\nbob operator " + users::hashPassword("new")));
    EXPECT_FALSE(visitors.userOf(bobs));
}

TEST_F(ConsoleDeskTest, APasswordIsNoTicket) {
    EXPECT_FALSE(open("secret1"));
    EXPECT_FALSE(open(""));
    EXPECT_FALSE(open(visitors.enter("boss"))) << "nor is the cookie";
    ASSERT_EQ(notes.size(), 3U);
    EXPECT_THAT(notes[0], HasSubstr("audit: console: failed log-in from 127.0.0.1:50122"));
    EXPECT_EQ(trail.notes().size(), 3U);
    EXPECT_THAT(trail.last(), HasSubstr("@127.0.0.1:50122|refusal||||a session of the web console: "));
}

TEST_F(ConsoleDeskTest, AForeignPageOpensNoSessionWhateverItShows) {
    for (const auto* origin :
         {"http://other.example", "null", "", "http://127.0.0.1:3000", "https://127.0.0.1:10417"}) {
        const auto who = open(visitors.ticket("boss"), origin);
        ASSERT_FALSE(who) << origin;
        EXPECT_EQ(who.refusal().code, RefusalCode::PermissionDenied);
        EXPECT_THAT(trail.last(), HasSubstr("is not this server's console"));
    }
    EXPECT_TRUE(open(visitors.ticket("boss"), "https://lab.example")) << "the proxy's page";
}

TEST_F(ConsoleDeskTest, WhatIsNoBrowserNeedsATicketToo) {
    EXPECT_FALSE(open("", std::nullopt));
    EXPECT_TRUE(open(visitors.ticket("boss"), std::nullopt));
}

TEST_F(ConsoleDeskTest, NobodyElseComesInHere) {
    bool refused = false;
    desk.entity({"left", "secret1", "127.0.0.1:1", "127.0.0.1:2"}, [&](auto who) { refused = !who; });
    EXPECT_TRUE(refused);
    EXPECT_FALSE(desk.vouchedClient("boss"));
    EXPECT_FALSE(desk.vouchedEntity("left"));
    EXPECT_FALSE(desk.mayVouch("127.0.0.1:1", "127.0.0.1:2"));
    EXPECT_FALSE(open(visitors.ticket("left"))) << "the role entity is for Entity Managers";
}

TEST_F(ConsoleDeskTest, WhoGuessesPasswordsIsSlowedDown) {
    for (int i = 0; i < 3; ++i)
        EXPECT_THAT(logIn("boss", "wrong").refusal().message, HasSubstr("wrong user or password"));
    const auto refused = logIn("boss", "wrong");
    EXPECT_THAT(refused.refusal().message, HasSubstr("try again in 1 s"));
}

TEST_F(ConsoleDeskTest, ItsSignalsNeedNoTicketAndNoForeignPageSendsAny) {
    const auto open_signals = [&](std::optional<std::string> origin) {
        std::optional<Result<LoggedIn>> got;
        transport::LoginRequest request{"", "", "127.0.0.1:50122", "127.0.0.1:10419"};
        request.origin = std::move(origin);
        desk.signals().client(std::move(request), [&](Result<LoggedIn> who) { got.emplace(std::move(who)); });
        return got && *got;  // at once
    };
    EXPECT_TRUE(open_signals("http://127.0.0.1:10417"));
    EXPECT_TRUE(open_signals("https://lab.example"));
    EXPECT_TRUE(open_signals(std::nullopt)) << "no browser";
    for (const auto* foreign : {"http://other.example", "null", "", "http://127.0.0.1:10419"})
        EXPECT_FALSE(open_signals(foreign)) << foreign;
    EXPECT_FALSE(desk.signals().vouchedClient("boss"));
}

TEST(ConsoleDeskBounds, SoManyLogInsWaitAndNoMore) {
    ManualClock clock;
    SeededRandom random{1};
    console::Visitors visitors{clock, random};
    std::promise<void> go, all;
    const auto gone = go.get_future().share();
    LoginDesk logins(
        nullptr, clock, [](const auto&) {},
        [gone](const auto&, const auto&) {
            gone.wait();
            return ::geteuid();
        });
    ConsoleDesk desk(logins, false, visitors, [](const auto&) {});
    std::atomic<int> opened{0}, overloaded{0};
    const auto open = [&] {
        desk.client({"", "", "127.0.0.1:50122", "127.0.0.1:10418"}, [&](Result<LoggedIn> who) {
            if (!who && who.refusal().code == RefusalCode::Overloaded) ++overloaded;
            if (who && ++opened == ConsoleDesk::kWaitingMax) all.set_value();
        });
    };
    for (int i = 0; i < ConsoleDesk::kWaitingMax + 5; ++i) open();
    EXPECT_EQ(overloaded, 5);
    go.set_value();
    all.get_future().wait();
    open();
    EXPECT_EQ(overloaded, 5) << "there is room again";
    logins.close();
}

TEST_F(ConsoleWithoutUsers, TheServersOwnUserIsAdminAndForeignPagesAreRefusedAllTheSame) {
    EXPECT_FALSE(desk.needed());
    EXPECT_EQ(open("")->role, Role::Admin);
    EXPECT_EQ(open("", std::nullopt)->role, Role::Admin);
    EXPECT_FALSE(open("", "http://other.example"));
}

}  // namespace
}  // namespace axon::server
