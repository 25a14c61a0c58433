// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/login_desk.hpp"

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
using transport::LoginRequest;

const std::string kHash =
    "$6$saltsalt$jCP90RmSIIja2o9FRs25ASQaR1lMN6uKHmNcHaoNCpAXgV3n5NfAlQdZQcvMVQO1BTCOFF0LzoHFZBt9E45NW0";

class LoginDeskTest : public testing::Test {
  protected:
    LoginDesk& withUsers() {
        return make(users::Users::parse("watcher observer " + kHash + "\nclient1 operator " + kHash +
                                            "\nboss admin " + kHash + "\nleft entity " + kHash,
                                        "users.cfg"));
    }
    LoginDesk& make(std::optional<users::Users> its_users) {
        desk.emplace(
            its_users ? std::make_shared<const users::Users>(std::move(*its_users)) : nullptr, clock,
            [this](const std::string& line) { notes.push_back(line); },
            [this](const std::string&, const std::string&) { return owner; }, &trail);
        return *desk;
    }
    Result<LoggedIn> client(const std::string& user, const std::string& password,
                            const std::string& host = "10.0.0.1", const std::string& behind_router = {}) {
        std::promise<Result<LoggedIn>> promise;
        desk->client({user, password, host + ":50122", "10.0.0.9:10410", {}, {}, behind_router},
                     [&](Result<LoggedIn> who) { promise.set_value(std::move(who)); });
        return promise.get_future().get();
    }
    Result<LoggedIn> certified(const std::string& name, const std::string& unit, const std::string& user = {},
                               const std::string& password = {}) {
        std::promise<Result<LoggedIn>> promise;
        desk->client(
            {user, password, "10.0.0.1:50122", "10.0.0.9:10410", transport::PeerCertificate{name, unit}},
            [&](Result<LoggedIn> who) { promise.set_value(std::move(who)); });
        return promise.get_future().get();
    }
    Result<LoggedIn> certifiedEntity(const std::string& name, const std::string& unit,
                                     const std::string& user = {}, const std::string& password = {}) {
        std::promise<Result<LoggedIn>> promise;
        desk->entity(
            {user, password, "10.0.0.2:50122", "10.0.0.9:10412", transport::PeerCertificate{name, unit}},
            [&](Result<LoggedIn> who) { promise.set_value(std::move(who)); });
        return promise.get_future().get();
    }
    Result<LoggedIn> entity(const std::string& user, const std::string& password) {
        std::promise<Result<LoggedIn>> promise;
        desk->entity({user, password, "10.0.0.2:50122", "10.0.0.9:10412"},
                     [&](Result<LoggedIn> who) { promise.set_value(std::move(who)); });
        return promise.get_future().get();
    }

    ManualClock clock;
    std::optional<std::uint32_t> owner;
    test::RecordedAudit trail;
    std::vector<std::string> notes;  // of the desk's thread, read after its answer
    std::optional<LoginDesk> desk;
};

TEST_F(LoginDeskTest, EachLogInAndEachRefusalIsRecordedAndNoPasswordIs) {
    withUsers();
    EXPECT_TRUE(client("client1", "secret1").ok());
    EXPECT_EQ(trail.last(), "client1@10.0.0.1:50122|login||||log-in of a client as operator|OK");
    EXPECT_FALSE(client("client1", "sesame").ok());
    EXPECT_THAT(trail.last(), HasSubstr("client1@10.0.0.1:50122|refusal||||log-in of a client: wrong user"));
    EXPECT_THAT(trail.last(), testing::EndsWith("|PERMISSION_DENIED"));
    for (int i = 0; i < 10; ++i) EXPECT_FALSE(client("client1", "sesame").ok());
    EXPECT_THAT(trail.last(), HasSubstr("too many wrong passwords"));
    EXPECT_FALSE(certified("client1", "entity").ok());
    EXPECT_THAT(trail.last(), HasSubstr("client1@10.0.0.1:50122|refusal|"));
    EXPECT_TRUE(entity("left", "secret1").ok());
    EXPECT_EQ(trail.last(), "left@10.0.0.2:50122|login||||log-in of an Entity Manager|OK");
    EXPECT_TRUE(certifiedEntity("Cart", "entity").ok());
    EXPECT_EQ(trail.last(), "Cart@10.0.0.2:50122|login|Cart|||log-in of an Entity Manager|OK");
    EXPECT_TRUE(desk->vouchedClient("boss").ok());
    EXPECT_EQ(trail.last(), "boss@a router or the web console|login||||log-in of a client as admin|OK");
    EXPECT_FALSE(desk->vouchedEntity("boss").ok());
    EXPECT_THAT(trail.last(), HasSubstr("|refusal|"));
    desk->turnedAway("10.0.0.3:4", "a session of a client", {RefusalCode::Overloaded, "it is full", {}});
    EXPECT_EQ(trail.last(), "@10.0.0.3:4|refusal||||a session of a client: it is full|OVERLOADED");
    EXPECT_FALSE(trail.has("secret"));
    EXPECT_FALSE(trail.has("sesame"));
}

TEST_F(LoginDeskTest, WhoARouterVouchesForHasTheRoleOfTheFileAtTheRightDoor) {
    withUsers();
    EXPECT_EQ(desk->vouchedClient("boss").value().role, Role::Admin);
    EXPECT_EQ(desk->vouchedClient("boss").value().user, "boss");
    EXPECT_TRUE(desk->vouchedEntity("left").ok());
    EXPECT_EQ(desk->vouchedClient("left").refusal().code, RefusalCode::PermissionDenied);
    EXPECT_EQ(desk->vouchedEntity("boss").refusal().code, RefusalCode::PermissionDenied);
    EXPECT_THAT(desk->vouchedClient("nobody").refusal().message, HasSubstr("users.cfg"));
}

TEST_F(LoginDeskTest, ACertificateThatARouterHasSeenIsWhoItSays) {
    withUsers();
    using Certificate = transport::PeerCertificate;
    EXPECT_EQ(desk->vouchedClient({}, Certificate{"boss", "client"}).value().role, Role::Admin);
    EXPECT_EQ(desk->vouchedEntity({}, Certificate{"PeopleBot", "entity"}).value().entity, "PeopleBot");
    EXPECT_THAT(desk->vouchedClient({}, Certificate{"boss", "entity"}).refusal().message,
                HasSubstr("'client'"));
    EXPECT_FALSE(desk->vouchedClient({}, Certificate{"nobody", "client"}).ok());
}

TEST_F(LoginDeskTest, BehindARouterWithoutUsersEverybodyIsOperator) {
    make(std::nullopt);
    owner = 0;  // of the router's process, not of the client's
    EXPECT_EQ(desk->vouchedClient("boss").value().role, Role::Operator);
    EXPECT_EQ(desk->vouchedClient("boss").value().user, "");
}

TEST_F(LoginDeskTest, ARouterIsAProcessOfTheServersUserOrOfRoot) {
    withUsers();
    EXPECT_FALSE(desk->mayVouch("127.0.0.1:1", "127.0.0.1:2")) << "nobody knows whose it is";
    owner = ::geteuid() + 1;
    EXPECT_FALSE(desk->mayVouch("127.0.0.1:1", "127.0.0.1:2"));
    owner = ::geteuid();
    EXPECT_TRUE(desk->mayVouch("127.0.0.1:1", "127.0.0.1:2"));
    owner = 0;
    EXPECT_TRUE(desk->mayVouch("127.0.0.1:1", "127.0.0.1:2"));
}

TEST_F(LoginDeskTest, TheRoleIsThatOfTheFile) {
    withUsers();
    EXPECT_EQ(client("watcher", "secret1").value().role, Role::Observer);
    EXPECT_EQ(client("client1", "secret1").value().role, Role::Operator);
    EXPECT_EQ(client("boss", "secret1").value().role, Role::Admin);
    EXPECT_EQ(client("boss", "secret1").value().user, "boss");  // now by its digest
    EXPECT_FALSE(client("boss", "secret2").ok());
    EXPECT_TRUE(entity("left", "secret1").ok());
}

TEST_F(LoginDeskTest, WhoWasRightBeforeDoesNotWaitBehindThoseThatMustBeVerified) {
    withUsers();
    ASSERT_TRUE(client("client1", "secret1").ok());
    constexpr int kTries = 100;
    std::atomic<int> tried{0};
    std::promise<void> all;
    for (int i = 0; i < kTries; ++i)
        desk->client(
            {"user" + std::to_string(i), "a guess", "10.0.0.1:" + std::to_string(i + 1), "10.0.0.9:10410"},
            [&](const Result<LoggedIn>& who) {
                EXPECT_FALSE(who.ok());
                if (++tried == kTries) all.set_value();
            });
    EXPECT_TRUE(client("client1", "secret1").ok());
    EXPECT_LT(tried, kTries / 2) << "each took the time of a hash";
    EXPECT_FALSE(client("client1", "secret2").ok());
    all.get_future().wait();
}

TEST_F(LoginDeskTest, AClientsCertificateIsItsUserAndTheFileSaysWhatItMayDo) {
    withUsers();
    EXPECT_EQ(certified("boss", "client").value().user, "boss");
    EXPECT_EQ(certified("watcher", "client", "watcher").value().role, Role::Observer);
    EXPECT_THAT(certified("client1", "client", "boss", "secret1").refusal().message,
                HasSubstr("belongs to the user 'client1'"));
    EXPECT_THAT(certified("nobody", "client").refusal().message, HasSubstr("no user 'nobody'"));
    EXPECT_THAT(notes.back(), HasSubstr("failed log-in of 'nobody'"));
    EXPECT_THAT(certified("left", "client").refusal().message, HasSubstr("for Entity Managers"));
    make(std::nullopt);
    EXPECT_EQ(certified("anybody", "client").value().user, "anybody");
    EXPECT_EQ(certified("anybody", "client").value().role, Role::Operator);
}

TEST_F(LoginDeskTest, WhoGuessesAPasswordDoesNotHoldUpTheCertificateOfThatUser) {
    withUsers();
    for (int i = 0; i < 4; ++i) static_cast<void>(client("boss", "guess").ok());
    EXPECT_THAT(client("boss", "secret1").refusal().message, HasSubstr("try again in"));
    EXPECT_TRUE(certified("boss", "client").ok());
}

TEST_F(LoginDeskTest, AnEntitysCertificateBindsItToItsName) {
    withUsers();
    EXPECT_EQ(certifiedEntity("Cyton Arm", "entity").value().entity, "Cyton Arm");
    EXPECT_EQ(certifiedEntity("Cyton Arm", "entity", "left", "secret1").value().entity, "Cyton Arm");
    EXPECT_FALSE(certifiedEntity("Cyton Arm", "entity", "left", "guess").ok());
    EXPECT_EQ(entity("left", "secret1").value().entity, "");
    make(std::nullopt);
    EXPECT_EQ(certifiedEntity("right", "entity").value().entity, "right");
}

TEST_F(LoginDeskTest, ACertificateOfAnotherKindOpensNeitherDoor) {
    withUsers();
    for (const auto* unit : {"entity", "server", "router", "", "Client"}) {
        const auto refusal = certified("boss", unit, "boss", "secret1").refusal();
        EXPECT_EQ(refusal.code, RefusalCode::PermissionDenied) << unit;
        EXPECT_THAT(refusal.message, HasSubstr("expected one of the kind 'client'"));
    }
    EXPECT_FALSE(certified("", "client").ok()) << "of nobody";
    EXPECT_FALSE(certifiedEntity("", "entity").ok());
    EXPECT_THAT(certifiedEntity("boss", "client").refusal().message, HasSubstr("axon certs issue --entity"));
    EXPECT_THAT(notes.back(), HasSubstr("OU=client; expected OU=entity"));
}

TEST_F(LoginDeskTest, SaysNoInASentenceAndNotesItForTheAudit) {
    withUsers();
    for (const auto& [user, password] : {std::pair{"client1", "guess"}, std::pair{"nobody", "secret1"}}) {
        const auto answer = client(user, password);
        ASSERT_FALSE(answer.ok());
        EXPECT_EQ(answer.refusal().code, RefusalCode::PermissionDenied);
        EXPECT_THAT(answer.refusal().message, HasSubstr("wrong user or password"));
        EXPECT_THAT(notes.back(),
                    HasSubstr(std::string("audit: failed log-in of '") + user + "' from 10.0.0.1:50122"));
    }
    EXPECT_THAT(client("", "").refusal().message, HasSubstr("asks for a user"));
}

TEST_F(LoginDeskTest, EachDoorIsForItsRoles) {
    withUsers();
    EXPECT_THAT(client("left", "secret1").refusal().message, HasSubstr("for Entity Managers"));
    EXPECT_THAT(entity("boss", "secret1").refusal().message, HasSubstr("role entity (Axon.User)"));
    EXPECT_EQ(entity("", "").refusal().code, RefusalCode::PermissionDenied);
}

TEST_F(LoginDeskTest, WhoGuessesWaitsAndNobodyElseDoes) {
    withUsers();
    for (int i = 0; i < 3; ++i)
        EXPECT_THAT(client("boss", "guess").refusal().message, HasSubstr("wrong user"));
    // Even the right password is not looked at before its time.
    EXPECT_THAT(client("boss", "secret1").refusal().message, HasSubstr("try again in 1 s"));
    EXPECT_TRUE(client("client1", "secret1").ok());
    EXPECT_TRUE(client("boss", "secret1", "10.0.0.7").ok());
    clock.advance(1s);
    EXPECT_THAT(client("boss", "guess").refusal().message, HasSubstr("wrong user"));
    clock.advance(1s);
    EXPECT_THAT(client("boss", "guess").refusal().message, HasSubstr("try again in 1 s"));
    clock.advance(1s);
    EXPECT_TRUE(client("boss", "secret1").ok());
    EXPECT_THAT(client("boss", "guess").refusal().message, HasSubstr("wrong user"));
}

TEST_F(LoginDeskTest, BehindARouterAnAddressIsThatWhichTheRouterSees) {
    withUsers();
    for (int i = 0; i < 3; ++i) client("boss", "guess", "10.0.0.1", "10.7.0.1:" + std::to_string(i + 1));
    EXPECT_THAT(trail.last(), HasSubstr("boss@10.7.0.1:3|refusal|"));
    EXPECT_THAT(notes.back(), HasSubstr("from 10.7.0.1:3"));
    EXPECT_THAT(client("boss", "secret1", "10.0.0.1", "10.7.0.1:9").refusal().message,
                HasSubstr("try again in 1 s"));
    EXPECT_TRUE(client("boss", "secret1", "10.0.0.1", "10.7.0.2:9").ok());
    EXPECT_TRUE(client("boss", "secret1").ok());
}

TEST_F(LoginDeskTest, WithoutUsersTheServersOwnUserAndRootAreAdmin) {
    make(std::nullopt);
    const auto role = [&](std::optional<std::uint32_t> uid) {
        owner = uid;
        return client("", "").value().role;
    };
    EXPECT_EQ(role(::geteuid()), Role::Admin);
    EXPECT_EQ(role(0), Role::Admin);
    EXPECT_EQ(role(::geteuid() + 12345), Role::Operator);
    EXPECT_EQ(role(std::nullopt), Role::Operator);
    EXPECT_TRUE(entity("", "").ok());
}

TEST_F(LoginDeskTest, AnswersEverybodyWhenItClosesAndTakesNotTooMany) {
    auto& its = withUsers();
    std::promise<void> looked_at;
    std::promise<void> go_on;
    const auto guess = [](int i) {
        return LoginRequest{"boss", "guess" + std::to_string(i), "10.0.0.1:1", "10.0.0.9:10410"};
    };
    // The desk's thread stands at the first of them, so that all others wait or are refused.
    its.client(guess(0), [&](const auto&) {
        looked_at.set_value();
        go_on.get_future().wait();
    });
    looked_at.get_future().wait();
    std::atomic<int> answers{0};
    std::atomic<int> overloaded{0};
    for (int i = 1; i <= 1000; ++i) {
        its.client(guess(i), [&](const auto& who) {
            if (who.refusal().code == RefusalCode::Overloaded) ++overloaded;
            ++answers;
        });
    }
    EXPECT_EQ(overloaded, 1000 - 256) << "of one address at most 256 wait";
    EXPECT_EQ(answers, 1000 - 256);
    go_on.set_value();
    its.close();
    EXPECT_EQ(answers, 1000);
    EXPECT_EQ(client("boss", "secret1").refusal().code, RefusalCode::Unavailable);
}

TEST_F(LoginDeskTest, NobodyWaitsThereWithALongName) {
    withUsers();
    for (const auto& [user, password] : {std::pair{std::string(1025, 'u'), std::string("secret1")},
                                         std::pair{std::string("boss"), std::string(4U << 20U, 'p')}}) {
        EXPECT_EQ(client(user, password).refusal().code, RefusalCode::Malformed);
        EXPECT_EQ(entity(user, password).refusal().code, RefusalCode::Malformed);
    }
    EXPECT_THAT(client("boss", std::string(1024, 'p')).refusal().message, HasSubstr("wrong user"));
    EXPECT_TRUE(client("boss", "secret1").ok()) << "and that is not a guess for which anybody waits";
}

TEST_F(LoginDeskTest, WhoTriesManyPasswordsHoldsUpHimself) {
    auto& its = withUsers();
    std::promise<void> looked_at;
    std::promise<void> go_on;
    std::promise<std::pair<bool, int>> let_in;
    std::atomic<int> guesses{0};
    // The desk's thread stands at the first of them while the others queue.
    its.client({"user0", "guess", "10.0.0.1:1", "10.0.0.9:10410"}, [&](const auto&) {
        looked_at.set_value();
        go_on.get_future().wait();
        ++guesses;
    });
    looked_at.get_future().wait();
    for (int i = 1; i < 200; ++i)
        its.client({"user" + std::to_string(i), "guess", "10.0.0.1:1", "10.0.0.9:10410"},
                   [&](const auto&) { ++guesses; });
    its.client({"boss", "secret1", "10.0.0.7:1", "10.0.0.9:10410"}, [&](const auto& who) {
        let_in.set_value({who.ok(), guesses});
    });
    go_on.set_value();
    const auto [ok, before] = let_in.get_future().get();
    EXPECT_TRUE(ok);
    EXPECT_LE(before, 2) << "each address has its turn";
    its.close();
    EXPECT_EQ(guesses, 200);
}

TEST(LoginGuard, DoublesUpToAMinuteAndForgetsWhoSucceeds) {
    ManualClock clock;
    LoginGuard guard(clock);
    std::vector<int> waits;
    for (int i = 0; i < 11; ++i) {
        guard.failed("a", "client1");
        waits.push_back(static_cast<int>(
            std::chrono::ceil<std::chrono::seconds>(guard.mustWait("a", "client1")).count()));
    }
    EXPECT_THAT(waits, testing::ElementsAre(0, 0, 1, 2, 4, 8, 16, 32, 60, 60, 60));
    guard.succeeded("a", "client1");
    EXPECT_EQ(guard.mustWait("a", "client1"), Duration{});
}

TEST(LoginGuard, RemembersABoundedNumber) {
    ManualClock clock;
    LoginGuard guard(clock);
    for (int i = 0; i < 3; ++i) guard.failed("a", "client1");
    for (int i = 0; i < 100'000; ++i) guard.failed("b", std::to_string(i));
    EXPECT_GT(guard.mustWait("a", "client1"), Duration{});  // those that do not wait go first
}

TEST_F(LoginDeskTest, FromTheMomentOfAChangeTheNewUsersCount) {
    const auto parsed = [](const std::string& text) {
        return std::make_shared<const users::Users>(users::Users::parse(text, "users.cfg"));
    };
    auto& its = withUsers();
    EXPECT_TRUE(client("client1", "secret1").ok());  // and is known from now on
    EXPECT_EQ(its.clientRole("client1"), Role::Operator);
    EXPECT_TRUE(its.mayBeEntityManager("left"));
    EXPECT_FALSE(its.mayBeEntityManager("client1"));
    EXPECT_FALSE(its.clientRole("left"));

    its.setUsers(parsed("client1 observer " + kHash + "\nclient2 operator " + kHash));
    EXPECT_EQ(client("client1", "secret1").value().role, Role::Observer);
    EXPECT_TRUE(client("client2", "secret1").ok());
    EXPECT_EQ(its.clientRole("client1"), Role::Observer);
    EXPECT_FALSE(its.clientRole("boss"));
    EXPECT_FALSE(client("boss", "secret1").ok());
    EXPECT_FALSE(its.vouchedClient("boss").ok());
    EXPECT_FALSE(its.mayBeEntityManager("left"));
    EXPECT_FALSE(entity("left", "secret1").ok());
    EXPECT_FALSE(certified("boss", "client").ok());

    // What was known of a password is forgotten with it.
    its.setUsers(parsed("client1 operator " + users::hashPassword("secret2")));
    EXPECT_FALSE(client("client1", "secret1").ok());
    EXPECT_EQ(client("client1", "secret2").value().role, Role::Operator);
    its.setUsers(parsed("client2 operator " + kHash));
    its.setUsers(parsed("client1 operator " + kHash));
    EXPECT_FALSE(client("client1", "secret2").ok());
}

}  // namespace
}  // namespace axon::server
