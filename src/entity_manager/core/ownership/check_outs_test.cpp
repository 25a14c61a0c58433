// SPDX-License-Identifier: GPL-2.0-or-later
// Who holds the entity and who wants it: what the scenarios in tests/scenarios do not show.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "entity_manager/core/entity_manager_core.hpp"
#include "tests/support/core_rig.hpp"

namespace axon::entity_manager {
namespace {

using test::CoreRig;
using test::idOf;

struct Ownership : testing::Test {
    Ownership() { rig.makeIdle(); }

    void checkOut(const std::string& client, const std::string& request,
                  const std::function<void(proto::CheckOutRequest&)>& with = {}) {
        proto::ToEntity message;
        auto& check_out = *message.mutable_check_out();
        check_out.set_phase(proto::TAKE);
        check_out.set_request_id(idOf(request));
        if (with) with(check_out);
        rig.send(client, message);
    }
    static void wait(proto::CheckOutRequest& request) { request.set_wait(true); }
    static void ask(proto::CheckOutRequest& request) { request.set_ask(true); }
    static void force(proto::CheckOutRequest& request) { request.set_force(true); }

    void lose(const std::string& client) {
        rig.core().onClientUpdate(rig.headOf(client), ClientChange::Lost);
    }
    void standStill() { rig.stopDone(rig.stop_generations.generation()); }
    /// The last answer to this client's check-out.
    const proto::CheckOutReply& answer(const std::string& client) {
        for (auto at = rig.to_clients.rbegin(); at != rig.to_clients.rend(); ++at)
            if (at->head.sender.id == client && at->message.has_check_out()) return at->message.check_out();
        static const proto::CheckOutReply kNone;
        return kNone;
    }
    proto::RefusalCode code(const std::string& client) { return answer(client).refusal().code(); }
    const proto::LeaseEnded* ended(const std::string& client) {
        for (auto at = rig.to_clients.rbegin(); at != rig.to_clients.rend(); ++at)
            if (at->head.sender.id == client && at->message.has_lease_ended())
                return &at->message.lease_ended();
        return nullptr;
    }
    std::string holder() { return rig.core().status().holder.id; }
    proto::RefusalCode rearm(const std::string& client) {
        rig.rearm(client, "rearm");
        return rig.to_clients.back().message.reply().refusal().code();
    }

    CoreRig rig;
};

TEST_F(Ownership, AGrantTellsTheGraceAndGivesTheRootBack) {
    checkOut("client1", "r1", [](auto& request) { request.set_root(idOf("root")); });
    EXPECT_EQ(answer("client1").grace_ms(), 5000U);
    EXPECT_EQ(answer("client1").lease().root(), idOf("root"));
    checkOut("client1", "r1");
    EXPECT_EQ(answer("client1").lease().root(), idOf("root")) << "asked again";
    lose("client1");
    standStill();
    rig.resumeLease("client1b", "r2", "client1");
    EXPECT_EQ(answer("client1b").lease().root(), idOf("root"));
    EXPECT_EQ(answer("client1b").lease().key(), answer("client1").lease().key()) << "the same lease";
}

TEST_F(Ownership, MalformedCheckOutsAreRefused) {
    const auto refused = [&](const std::function<void(proto::CheckOutRequest&)>& with) {
        checkOut("client1", "r1", with);
        return code("client1");
    };
    EXPECT_EQ(refused([](auto& r) { r.set_request_id("short"); }), proto::MALFORMED);
    EXPECT_EQ(refused([](auto& r) { r.set_root("short"); }), proto::MALFORMED);
    EXPECT_EQ(refused([](auto& r) { r.set_phase(proto::CHECK_OUT_UNSPECIFIED); }), proto::MALFORMED);
    EXPECT_EQ(refused([](auto& r) { r.set_phase(static_cast<proto::CheckOutPhase>(77)); }), proto::MALFORMED);
    EXPECT_EQ(refused([](auto& r) { r.set_phase(proto::RESUME_LEASE); }), proto::MALFORMED);
    EXPECT_EQ(refused([](auto& r) {
                  r.set_phase(proto::RESUME_LEASE);
                  r.mutable_resume()->set_key(std::string(15, 'k'));
              }),
              proto::MALFORMED);
    EXPECT_EQ(refused([](auto& r) {
                  r.set_phase(proto::RESUME_LEASE);
                  r.mutable_resume()->set_key(std::string(17, 'k'));
              }),
              proto::MALFORMED);
    for (const double seconds : {-1.0, 601.0, std::numeric_limits<double>::infinity(), std::nan("")})
        EXPECT_EQ(refused([&](auto& r) { r.mutable_hand_over()->set_answer_within_s(seconds); }),
                  proto::OUT_OF_RANGE)
            << seconds;
    EXPECT_EQ(holder(), "");
}

TEST_F(Ownership, ALostClientComesBackAsAnotherSessionOnlyAfterTheRobotStands) {
    rig.take("client1", "r1");
    const auto before = rig.core().status().held;
    lose("client1");
    EXPECT_TRUE(rig.core().status().orphaned);
    EXPECT_TRUE(rig.core().latched());
    rig.resumeLease("client1b", "r2", "client1");
    EXPECT_TRUE(rig.core().status().orphaned) << "the stop is not confirmed yet";
    rig.resumeLease("client1b", "r2", "client1");  // asked again: one answer
    standStill();
    EXPECT_FALSE(rig.core().status().orphaned);
    EXPECT_EQ(holder(), "client1b");
    EXPECT_EQ(rig.core().status().held, before);
    EXPECT_EQ(std::count_if(rig.to_clients.begin(), rig.to_clients.end(),
                            [](const auto& record) {
                                return record.head.sender.id == "client1b" && record.message.has_check_out();
                            }),
              1);
    // The news of the loss comes late, or twice.
    const auto generation = rig.stop_generations.generation();
    lose("client1");
    EXPECT_EQ(holder(), "client1b");
    EXPECT_EQ(rig.stop_generations.generation(), generation);
    EXPECT_EQ(rearm("client1b"), proto::OK);
    EXPECT_EQ(rearm("client1"), proto::NOT_HOLDER);
}

TEST_F(Ownership, ARightKeyBeforeTheNewsOfTheLossIsLossAndResumption) {
    rig.take("client1", "r1");
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    rig.resumeLease("client1b", "r2", "client1");
    EXPECT_EQ(holder(), "client1") << "not before it stands still";
    EXPECT_TRUE(rig.core().latched());
    EXPECT_EQ(rig.stops.back().second, StopCause::ClientLost);
    ASSERT_NE(ended("client1"), nullptr);
    EXPECT_EQ(ended("client1")->reason().code(), proto::REVOKED_LEASE);
    EXPECT_EQ(ended("client1")->reason().holder(), "client1b@lab");
    rig.task("client1", "t2", "Turning");
    EXPECT_EQ(rig.to_clients.back().message.task().state(), proto::TASK_REFUSED);
    standStill();
    EXPECT_EQ(holder(), "client1b");
}

TEST_F(Ownership, OfTwoSessionsWithTheKeyTheLaterOneGetsIt) {
    rig.take("client1", "r1");
    lose("client1");
    rig.resumeLease("client1b", "r2", "client1");
    rig.resumeLease("client1c", "r3", "client1");
    EXPECT_EQ(code("client1b"), proto::REVOKED_LEASE);
    standStill();
    EXPECT_EQ(holder(), "client1c");
}

TEST_F(Ownership, AnOrderlyEndOfTheLostSessionEndsAResumptionThatWaits) {
    rig.take("client1", "r1");
    lose("client1");
    rig.resumeLease("client1b", "r2", "client1");
    rig.core().onClientUpdate(rig.headOf("client1"), ClientChange::Ended);
    EXPECT_EQ(code("client1b"), proto::NOT_HOLDER);
    standStill();
    EXPECT_EQ(rig.core().state(), EntityState::IDLE);
    EXPECT_EQ(rig.core().counters().unexpected, 0U);
}

TEST_F(Ownership, AnObserverDoesNotResume) {
    rig.take("client1", "r1");
    lose("client1");
    rig.resumeLease("observer", "r2", "client1");
    EXPECT_EQ(code("observer"), proto::PERMISSION_DENIED);
    EXPECT_EQ(holder(), "client1");
}

TEST_F(Ownership, AResumptionIsInTimeWhenItArrivesInTimeAndNotWhenTheTimerIsLate) {
    rig.take("client1", "r1");
    lose("client1");
    standStill();
    rig.clock.advance(std::chrono::seconds{5});  // nobody has called onTimer
    rig.resumeLease("client1b", "r2", "client1");
    EXPECT_EQ(code("client1b"), proto::EXPIRED);
    EXPECT_EQ(holder(), "");

    standStill();
    rig.take("client2", "r3");
    lose("client2");
    rig.advance(std::chrono::milliseconds{4900});
    rig.resumeLease("client2b", "r4", "client2");  // waits for the robot beyond the grace
    rig.advance(std::chrono::milliseconds{1000});
    standStill();
    EXPECT_EQ(holder(), "client2b");
}

TEST_F(Ownership, AResumptionOfARobotThatNeverConfirmsEndsTheLease) {
    rig.take("client1", "r1");
    lose("client1");
    rig.resumeLease("client1b", "r2", "client1");
    rig.advance(std::chrono::milliseconds{5100});
    EXPECT_EQ(code("client1b"), proto::TIMED_OUT);
    EXPECT_EQ(holder(), "");
    EXPECT_EQ(rig.core().state(), EntityState::IDLE);
}

TEST_F(Ownership, WithoutAGraceTheLeaseEndsAtOnceAndNothingIsResumed) {
    rig.settings().lease_grace = Duration::zero();
    rig.restart();
    rig.makeIdle();
    rig.take("client1", "r1");
    EXPECT_EQ(answer("client1").grace_ms(), 0U);
    rig.resumeLease("client1b", "r2", "client1");
    EXPECT_EQ(code("client1b"), proto::NOT_SUPPORTED);
    EXPECT_EQ(holder(), "client1");
    lose("client1");
    EXPECT_EQ(rig.core().state(), EntityState::IDLE);
    EXPECT_TRUE(rig.core().latched());
    rig.resumeLease("client1b", "r3", "client1");
    EXPECT_EQ(code("client1b"), proto::REVOKED_LEASE);
}

TEST_F(Ownership, ALeaseOutlivesAShortLossOfTheServerAndNotALongOne) {
    for (const bool in_time : {true, false}) {
        rig.take("client1", in_time ? "r1" : "r5");
        const auto held = rig.core().status().held;
        rig.core().onServerDown("cut");
        EXPECT_EQ(rig.core().state(), EntityState::ENVCONN);
        standStill();
        if (!in_time) rig.advance(std::chrono::milliseconds{5100});
        rig.core().onServerUp();
        standStill();
        rig.resumeLease("client1b", in_time ? "r2" : "r6", "client1");
        if (in_time) {
            EXPECT_EQ(holder(), "client1b");
            EXPECT_EQ(rig.core().status().held, held);
            rig.core().onClientUpdate(rig.headOf("client1b"), ClientChange::Ended);
            standStill();
        } else {
            EXPECT_EQ(code("client1b"), proto::EXPIRED);
            EXPECT_EQ(rig.core().state(), EntityState::IDLE);
        }
    }
}

TEST_F(Ownership, ALeaseOutlivesNewProfilesWhileTheServerIsAway) {
    rig.take("client1", "r1");
    rig.core().onServerDown("cut");
    standStill();
    rig.uploadProfiles();
    EXPECT_EQ(rig.core().state(), EntityState::ENVCONN);
    rig.core().onServerUp();
    EXPECT_EQ(rig.core().state(), EntityState::REG);
    EXPECT_TRUE(rig.core().status().orphaned);

    rig.core().onServerDown("cut again");
    rig.upload(false, "no profile");
    ASSERT_EQ(rig.core().state(), EntityState::ERR);
    rig.advance(std::chrono::milliseconds{5100});
    EXPECT_EQ(holder(), "");
}

TEST_F(Ownership, TheWaitListIsServedInItsOrderAndOnlyWhenTheRobotStands) {
    rig.take("client1", "r1");
    checkOut("client2", "r2", wait);
    checkOut("client3", "r3", wait);
    EXPECT_EQ(answer("client2").place(), 1U);
    EXPECT_EQ(answer("client3").place(), 2U);
    EXPECT_EQ(rig.core().status().waiting, 2);
    proto::ToEntity release;
    release.mutable_release();
    rig.send("client1", release);
    EXPECT_EQ(holder(), "");
    checkOut("client4", "r4");
    EXPECT_EQ(code("client4"), proto::RESERVED) << "nobody overtakes the list";
    EXPECT_EQ(answer("client4").refusal().holder(), "client2@lab");
    checkOut("client4", "r4", [](auto& request) { request.set_phase(proto::RESERVE); });
    EXPECT_EQ(code("client4"), proto::RESERVED);
    standStill();
    EXPECT_EQ(holder(), "client2");
    EXPECT_EQ(answer("client3").place(), 1U);
    EXPECT_EQ(rig.core().status().waiting, 1);
}

TEST_F(Ownership, APlaceIsKeptByAskingAgainAndGivenUpOtherwise) {
    rig.take("client1", "r1");
    checkOut("client2", "r2", wait);
    checkOut("client3", "r3", wait);
    for (int i = 0; i < 4; ++i) {
        rig.advance(std::chrono::seconds{5});
        checkOut("client3", "r3", wait);
    }
    EXPECT_EQ(code("client2"), proto::EXPIRED);
    EXPECT_EQ(answer("client3").place(), 1U);
    EXPECT_EQ(code("client3"), proto::OK);
}

TEST_F(Ownership, WhoMayNotHoldMayNotWaitAndTheHolderDoesNotWaitForItself) {
    rig.take("client1", "r1");
    checkOut("observer", "r2", wait);
    EXPECT_EQ(code("observer"), proto::PERMISSION_DENIED);
    for (const auto& with : {wait, ask}) {
        checkOut("client1", "r3", with);
        EXPECT_EQ(code("client1"), proto::ALREADY_HELD);
    }
    EXPECT_EQ(rig.core().status().waiting, 0);
}

TEST_F(Ownership, AWaitingClientThatIsLostLeavesTheList) {
    rig.take("client1", "r1");
    checkOut("client2", "r2", wait);
    checkOut("client3", "r3", wait);
    lose("client2");
    EXPECT_EQ(answer("client3").place(), 1U);
    EXPECT_EQ(holder(), "client1");
    EXPECT_FALSE(rig.core().latched());
}

TEST_F(Ownership, AnAbortIsOfTheOwnRequestAlone) {
    rig.take("client1", "r1");
    checkOut("client2", "r2", wait);
    const auto abort = [](auto& request) { request.set_phase(proto::ABORT); };
    checkOut("client3", "r2", abort);
    checkOut("client3", "r1", abort);
    EXPECT_EQ(code("client3"), proto::OK) << "what is not there is aborted already";
    EXPECT_EQ(holder(), "client1");
    EXPECT_EQ(rig.core().status().waiting, 1);
    checkOut("client2", "r1", abort);
    EXPECT_EQ(holder(), "client1");
    checkOut("client2", "r2", [](auto& request) {
        request.set_phase(proto::ABORT);
        request.set_force(true);
    });
    EXPECT_EQ(code("client2"), proto::OK) << "to give up takes no administrator";
    EXPECT_EQ(rig.core().status().waiting, 0);
}

TEST_F(Ownership, ALostHolderMayComeBackWhileOthersWait) {
    rig.take("client1", "r1");
    checkOut("client2", "r2", wait);
    lose("client1");
    standStill();
    EXPECT_TRUE(rig.core().status().orphaned);
    rig.resumeLease("client1b", "r3", "client1");
    EXPECT_EQ(holder(), "client1b");
    EXPECT_EQ(rig.core().status().waiting, 1);
    lose("client1b");
    standStill();
    rig.advance(std::chrono::milliseconds{5100});
    EXPECT_EQ(holder(), "") << "the end of the grace is a stop, too";
    standStill();
    EXPECT_EQ(holder(), "client2");
    EXPECT_TRUE(rig.core().latched());
}

TEST_F(Ownership, TheListIsToldWhenTheRobotIsGone) {
    rig.take("client1", "r1");
    checkOut("client2", "r2", wait);
    rig.core().onLinkDown("pulled");
    EXPECT_EQ(code("client2"), proto::UNAVAILABLE);
    EXPECT_EQ(rig.core().status().waiting, 0);
}

TEST_F(Ownership, TheHolderDecidesWhoeverAsksFirst) {
    rig.take("client1", "r1");
    checkOut("client2", "r2", [](auto& request) {
        request.set_ask(true);
        request.set_reason("lunch");
    });
    const auto question = rig.to_clients[rig.to_clients.size() - 2];
    ASSERT_TRUE(question.message.has_hand_over());
    EXPECT_EQ(question.head.sender.id, "client1");
    EXPECT_EQ(question.head.msg_type, kMsgHandOver);
    EXPECT_EQ(question.message.hand_over().by(), "client2@lab");
    EXPECT_EQ(question.message.hand_over().reason(), "lunch");
    EXPECT_DOUBLE_EQ(question.message.hand_over().answer_within_s(), 30);
    checkOut("client3", "r3", ask);
    EXPECT_EQ(code("client3"), proto::RESERVED);
    EXPECT_NE(answer("client3").refusal().message().find("client2@lab"), std::string::npos);

    proto::ToEntity message;
    message.mutable_hand_over_answer()->set_request_id(idOf("r3"));
    message.mutable_hand_over_answer()->set_accept(true);
    rig.send("client1", message);
    EXPECT_EQ(rig.to_clients.back().message.reply().refusal().code(), proto::EXPIRED) << "nobody asked so";
    message.mutable_hand_over_answer()->set_request_id(idOf("r2"));
    rig.send("client2", message);
    EXPECT_EQ(rig.to_clients.back().message.reply().refusal().code(), proto::NOT_HOLDER)
        << "not for the asker to say";
    EXPECT_EQ(holder(), "client1");
    rig.send("client1", message);
    ASSERT_NE(ended("client1"), nullptr);
    EXPECT_EQ(ended("client1")->reason().code(), proto::REVOKED_LEASE);
    EXPECT_EQ(ended("client1")->reason().holder(), "client2@lab");
    EXPECT_EQ(holder(), "");
    standStill();
    EXPECT_EQ(holder(), "client2");
    EXPECT_FALSE(rig.core().latched());
}

TEST_F(Ownership, WhoAsksAndWaitsIsToldThatTheHolderKeepsItAndWhatItSaid) {
    rig.take("client1", "r1");
    checkOut("client2", "r2", [](auto& request) {
        request.set_ask(true);
        request.set_wait(true);
    });
    EXPECT_EQ(answer("client2").kept(), "");
    proto::ToEntity no;
    no.mutable_hand_over_answer()->set_request_id(idOf("r2"));
    no.mutable_hand_over_answer()->set_reason("ten more minutes");
    rig.send("client1", no);
    EXPECT_EQ(answer("client2").place(), 1U);
    EXPECT_EQ(answer("client2").kept(), "client1@lab keeps it: ten more minutes");
}

TEST_F(Ownership, AQuestionIsPutAnewToAHolderThatHasComeBack) {
    rig.take("client1", "r1");
    checkOut("client2", "r2", ask);
    lose("client1");
    standStill();
    rig.advance(std::chrono::seconds{2});
    rig.resumeLease("client1b", "r3", "client1");
    ASSERT_TRUE(rig.to_clients.back().message.has_hand_over());
    EXPECT_EQ(rig.to_clients.back().head.sender.id, "client1b");
    EXPECT_DOUBLE_EQ(rig.to_clients.back().message.hand_over().answer_within_s(), 28);
}

TEST_F(Ownership, TheSilenceOfALostHolderIsNoConsent) {
    checkOut("client1", "r1", [](proto::CheckOutRequest& request) {
        request.mutable_hand_over()->set_answer_within_s(1);
        request.mutable_hand_over()->set_yield(true);
    });
    checkOut("client2", "r2", ask);
    lose("client1");
    standStill();
    rig.advance(std::chrono::seconds{3});
    EXPECT_EQ(holder(), rig.headOf("client1").sender.id);
    rig.resumeLease("client1b", "r3", "client1");
    EXPECT_EQ(code("client1b"), proto::OK);
}

TEST_F(Ownership, WhoAsksAndThenHoldsItByItsKeyIsNotAskedItself) {
    rig.take("client1", "r1");
    checkOut("client2", "r2", ask);
    lose("client1");
    standStill();
    rig.resumeLease("client2", "r3", "client1");
    EXPECT_EQ(holder(), "client2");
    EXPECT_FALSE(rig.to_clients.back().message.has_hand_over());
    const auto answered =
        std::find_if(rig.to_clients.rbegin(), rig.to_clients.rend(), [](const auto& record) {
            return record.message.has_check_out() && record.message.check_out().request_id() == idOf("r2");
        });
    ASSERT_NE(answered, rig.to_clients.rend());
    EXPECT_EQ(answered->message.check_out().refusal().code(), proto::ALREADY_HELD);
    checkOut("client3", "r4", ask);
    EXPECT_EQ(code("client3"), proto::OK) << "there is room for another question";
}

TEST_F(Ownership, OnlyAdministratorsTakeOverAndTheLoserIsToldAtOnce) {
    rig.take("client1", "r1");
    rig.task("client1", "t1", "Turning");
    rig.grant("t1");
    checkOut("client2", "r2", force);
    EXPECT_EQ(code("client2"), proto::PERMISSION_DENIED);
    EXPECT_EQ(answer("client2").refusal().holder(), "client1@lab");
    EXPECT_EQ(rig.core().state(), EntityState::BUSY);
    checkOut("admin", "r3", [](auto& request) {
        request.set_force(true);
        request.set_reason("fire");
    });
    ASSERT_NE(ended("client1"), nullptr);
    EXPECT_EQ(ended("client1")->reason().code(), proto::REVOKED_LEASE);
    EXPECT_EQ(ended("client1")->reason().holder(), "admin@lab");
    EXPECT_NE(ended("client1")->reason().message().find("fire"), std::string::npos);
    EXPECT_EQ(holder(), "");
    EXPECT_EQ(rig.statuses.back().reason, "admin@lab took it over: fire") << "for the server's log";
    checkOut("client2", "r4");
    EXPECT_EQ(code("client2"), proto::RESERVED);
    standStill();
    EXPECT_EQ(holder(), "admin");
    EXPECT_EQ(rig.statuses.back().reason, "");
    EXPECT_EQ(std::count_if(rig.journal.records.begin(), rig.journal.records.end(),
                            [](const JournalRecord& record) {
                                return record.kind == JournalRecord::Kind::TakenOver &&
                                       record.who == "admin@lab" &&
                                       record.text.find("fire") != std::string::npos;
                            }),
              1)
        << "audited";
    rig.task("client1", "t2", "Turning");
    EXPECT_EQ(rig.to_clients.back().message.task().reason().code(), proto::OLDER_LEASE);
    EXPECT_EQ(rig.to_clients.back().message.task().reason().holder(), "admin@lab");
}

TEST_F(Ownership, AForcedReservationHurtsNobodyBeforeItsCommit) {
    const auto with = [](proto::CheckOutPhase phase) {
        return [phase](proto::CheckOutRequest& request) {
            request.set_phase(phase);
            request.set_force(true);
        };
    };
    rig.take("client1", "r1");
    checkOut("admin", "r2", with(proto::RESERVE));
    EXPECT_EQ(code("admin"), proto::OK);
    EXPECT_EQ(holder(), "client1");
    checkOut("admin", "r2", with(proto::ABORT));
    EXPECT_EQ(holder(), "client1");
    checkOut("admin", "r2", with(proto::COMMIT));
    EXPECT_EQ(code("admin"), proto::ALREADY_HELD);
    checkOut("admin", "r3", with(proto::RESERVE));
    rig.advance(std::chrono::milliseconds{2100});
    checkOut("admin", "r3", with(proto::COMMIT));
    EXPECT_EQ(code("admin"), proto::ALREADY_HELD) << "the reservation has run out";
    EXPECT_EQ(holder(), "client1");
    checkOut("admin", "r4", with(proto::RESERVE));
    checkOut("admin", "r4", with(proto::COMMIT));
    ASSERT_NE(ended("client1"), nullptr);
    EXPECT_EQ(holder(), "");
    standStill();
    EXPECT_EQ(holder(), "admin");
}

TEST_F(Ownership, ATakeOverIsBeforeAQuestionAListAndAResumption) {
    rig.take("client1", "r1");
    checkOut("client2", "r2", ask);
    checkOut("client3", "r3", wait);
    lose("client1");
    rig.resumeLease("client1b", "r4", "client1");
    checkOut("admin", "r5", force);
    EXPECT_EQ(code("client2"), proto::ALREADY_HELD);
    EXPECT_EQ(code("client1b"), proto::RESERVED);
    standStill();
    EXPECT_EQ(holder(), "admin");
    EXPECT_EQ(answer("client3").place(), 1U);
    EXPECT_EQ(code("client3"), proto::OK);
}

TEST_F(Ownership, ARobotThatDoesNotConfirmIsNotHandedOverByForceEither) {
    rig.take("client1", "r1");
    checkOut("admin", "r2", force);
    rig.advance(std::chrono::milliseconds{5100});
    EXPECT_EQ(code("admin"), proto::TIMED_OUT);
    EXPECT_EQ(holder(), "");
}

TEST_F(Ownership, AReservationThatWaitsForTheRobotIsNotShortenedByReservingAgain) {
    rig.stop("client2");
    checkOut("client1", "r1");
    checkOut("client1", "r1", [](auto& request) {
        request.set_phase(proto::RESERVE);
        request.set_reserve_s(0.1);
    });
    EXPECT_EQ(code("client1"), proto::WRONG_STATE);
    rig.advance(std::chrono::milliseconds{200});
    checkOut("client2", "r2");
    EXPECT_EQ(code("client2"), proto::RESERVED);
    standStill();
    EXPECT_EQ(holder(), "client1");
}

TEST_F(Ownership, ACommitAfterTheReservationsTimeIsRefusedHoweverLateTheTimer) {
    checkOut("client1", "r1", [](auto& request) { request.set_phase(proto::RESERVE); });
    rig.clock.advance(std::chrono::seconds{2});
    checkOut("client1", "r1", [](auto& request) { request.set_phase(proto::COMMIT); });
    EXPECT_EQ(code("client1"), proto::EXPIRED);
}

}  // namespace
}  // namespace axon::entity_manager
