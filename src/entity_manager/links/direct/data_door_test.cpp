// SPDX-License-Identifier: GPL-2.0-or-later
// The port of data lanes on a strand, beside strangers and holders that the test plays over loopback.
#include "entity_manager/links/direct/data_door.hpp"

#include <gtest/gtest.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <asio/post.hpp>
#include <asio/strand.hpp>
#include <asio/thread_pool.hpp>
#include <atomic>
#include <future>
#include <mutex>
#include <vector>

#include "support/certificate_folder.hpp"
#include "support/lane_stranger.hpp"
#include "support/log_lines.hpp"
#include "support/loopback.hpp"
#include "support/moved_clock.hpp"
#include "support/recorded_audit.hpp"
#include "support/tcp_silence.hpp"

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using direct::Keeping;
using test::LaneStranger;
using test::waitUntil;

const std::string kKey = "0123456789abcdef";

/// Admits whoever has the key; takes messages while there is room.
struct Events final : DirectEvents {
    void directOpening(DirectOpening opening) override {
        const std::lock_guard lock(mutex);
        ++openings;
        if (!direct::proves(opening.proof, opening.claim, direct::Prover::Client, kKey))
            return opening.refuse({RefusalCode::PermissionDenied, "no", {}});
        if (!answers) {
            pending = std::move(opening);
            return;
        }
        admit(opening);
    }
    void admit(DirectOpening& opening) {
        lane =
            opening.admit({"holder", "ann@lab", Role::Operator}, std::make_shared<DirectSigns>(TimePoint{}),
                          direct::proofOf(opening.claim, direct::Prover::EntityManager, kKey));
    }
    bool directMsg(const Id128&, Keeping keeping, Header& head, std::string& bytes) override {
        const std::lock_guard lock(mutex);
        if (came.size() >= room) return false;
        EXPECT_EQ(head.sender.id, "holder");
        EXPECT_EQ(head.entity, "the entity");
        came.push_back(head.sequence);
        data += keeping == Keeping::Droppable ? 1 : 0;
        if (echoes) lane->send(keeping, head, std::make_shared<const std::string>(bytes));
        if (came.size() % 3 == 0) {  // who holds a message back takes it
            const auto taken = std::move(head);
            const auto taken_bytes = std::move(bytes);
        }
        return true;
    }
    void directTurnEnded() override { ++turns; }
    void directStop(Header, StopCause) override {}
    void directReset(Header) override {}
    void directClear(Header) override {}
    void directPace() override {}
    void directClosed(const Id128&, const std::string& why) override {
        const std::lock_guard lock(mutex);
        closed.push_back(why);
    }
    std::size_t count() {
        const std::lock_guard lock(mutex);
        return came.size();
    }
    std::size_t ends() {
        const std::lock_guard lock(mutex);
        return closed.size();
    }

    std::mutex mutex;
    std::vector<std::int64_t> came;
    std::vector<std::string> closed;
    std::size_t room = 1'000'000;
    int openings = 0, data = 0;
    bool answers = true, echoes = false;
    DirectOpening pending;
    std::shared_ptr<DirectLane> lane;
    std::atomic<int> turns{0};
};

using certificates::Kind;
using direct::lane::Tls;

const test::CertificateFolder kLaboratory;
const std::shared_ptr<const Tls> kEntity =
    Tls::of(kLaboratory.credentials(Kind::Entity, "robot"), test::CertificateFolder::now);
const std::shared_ptr<const Tls> kClient =
    Tls::of(kLaboratory.credentials(Kind::Client, "ann"), test::CertificateFolder::now);

enum class Speaks { Plain, Tls };
/// What is spoken, and whether the door's thread spins.
struct Kinds {
    Speaks speaks;
    std::chrono::microseconds spin;
};
std::string nameOf(const testing::TestParamInfo<Kinds>& one) {
    return std::string(one.param.speaks == Speaks::Tls ? "Tls" : "Plain") +
           (one.param.spin == 0us ? "Sleeping" : "Spinning");
}

class DataDoorTest : public ::testing::TestWithParam<Kinds> {
  protected:
    ~DataDoorTest() override {
        onStrand([&] { door.shut(); });
        executor.join();
    }
    template <class Use>
    void onStrand(Use use) {
        std::promise<void> done;
        asio::post(strand, [&] {
            use();
            done.set_value();
        });
        done.get_future().wait();
    }
    std::unique_ptr<LaneStranger> knock() {
        auto stranger = std::make_unique<LaneStranger>(endpoint, tls() ? kClient.get() : nullptr, "robot");
        EXPECT_TRUE(stranger->channelOpen());
        stranger->claim = {Lane::Data, {1, 2}, Id128::random(random), Id128::random(random), {}};
        return stranger;
    }
    std::unique_ptr<LaneStranger> holder() {
        auto its = knock();
        its->awaitNonce();
        EXPECT_EQ(its->open(kKey), RefusalCode::Ok);
        return its;
    }
    static void send(LaneStranger& from, std::int64_t sequence, Keeping keeping = Keeping::Kept,
                     const std::string& content = "content") {
        Header head;
        head.sequence = sequence;
        head.msg_type = kMsgText;
        from.send(keeping, head, content);
    }
    bool inOrder() {
        const std::lock_guard lock(events->mutex);
        for (std::size_t i = 0; i < events->came.size(); ++i)
            if (events->came[i] != static_cast<std::int64_t>(i) + 1) return false;
        return true;
    }

    static bool tls() { return GetParam().speaks == Speaks::Tls; }

    SeededRandom random{1};
    test::MovedClock clock;
    asio::thread_pool executor{1};
    asio::strand<asio::any_io_executor> strand{executor.get_executor()};
    std::shared_ptr<Events> events = std::make_shared<Events>();
    test::RecordedAudit trail;
    DataDoor door{strand,
                  "127.0.0.1",
                  0,
                  "the entity",
                  GetParam().spin,
                  clock,
                  events,
                  tls() ? kEntity : nullptr,
                  std::make_shared<DirectRefusals>(&trail)};
    const std::string endpoint = "127.0.0.1:" + std::to_string(door.port());
};

TEST_P(DataDoorTest, MessagesOfAHolderComeInOrderAndThoseToItGoOut) {
    const auto its = holder();
    EXPECT_TRUE(direct::proves(its->proof, its->claim, direct::Prover::EntityManager, kKey));
    for (std::int64_t i = 1; i <= 1000; ++i)
        send(*its, i, i % 10 == 0 ? Keeping::Droppable : Keeping::Kept,
             std::string(static_cast<std::size_t>(i * i % 5000), 'x'));
    ASSERT_TRUE(waitUntil([&] { return events->count() == 1000; }));
    EXPECT_TRUE(inOrder());
    EXPECT_EQ(events->data, 100);
    EXPECT_GT(events->turns, 0);
    onStrand([&] {
        Header head;
        head.sequence = 9;
        events->lane->send(Keeping::Kept, head, std::make_shared<const std::string>("to the client"));
    });
    const auto frame = its->awaitFrame().value();
    EXPECT_EQ(direct::lane::messageIn(frame).value().content, "to the client");
}

TEST_P(DataDoorTest, WhoFindsNoRoomIsNotReadUntilThereIsSome) {
    events->room = 100;
    const auto its = holder();
    for (std::int64_t i = 1; i <= 500; ++i) send(*its, i);
    ASSERT_TRUE(waitUntil([&] { return events->count() == 100; }));
    onStrand([] {});
    EXPECT_EQ(events->count(), 100U);
    for (std::size_t room = 200; room <= 500; room += 100) {
        onStrand([&] {
            events->room = room;
            door.roomAgain();
        });
        ASSERT_TRUE(waitUntil([&] { return events->count() == room; }));
    }
    EXPECT_TRUE(inOrder());
}

TEST_P(DataDoorTest, WhoFindsNoRoomIsDisconnectedWhenTheDoorIsShutAndNothingOfItComesAnyMore) {
    events->room = 100;
    const auto its = holder();
    for (std::int64_t i = 1; i <= 500; ++i) send(*its, i);
    ASSERT_TRUE(waitUntil([&] { return events->count() == 100; }));
    onStrand([&] {
        events->room = 1'000'000;
        door.shut();
        door.roomAgain();  // it is late
    });
    EXPECT_TRUE(its->awaitClosed());
    onStrand([] {});
    EXPECT_EQ(events->count(), 100U);
    EXPECT_EQ(events->ends(), 1U);
}

TEST_P(DataDoorTest, AHolderWhoHearsNothingIsGivenUpByTheKernel) {
    const auto its = holder();
    const int here = test::socketBetween(endpoint, its->address());
    ASSERT_GE(here, 0);
    unsigned patience = 0;
    socklen_t size = sizeof patience;
    ::getsockopt(here, IPPROTO_TCP, TCP_USER_TIMEOUT, &patience, &size);
    EXPECT_EQ(patience, 30'000U);
    ASSERT_TRUE(test::losePatienceAfter(here, 100ms));
    ASSERT_TRUE(its->fallSilent());
    onStrand([&] {
        Header head;
        head.sequence = 1;
        events->lane->send(Keeping::Kept, head, std::make_shared<const std::string>("to nobody"));
    });
    ASSERT_TRUE(waitUntil([&] { return events->ends() == 1; }));
}

TEST_P(DataDoorTest, WhatIsSaidBeforeTheClaimIsJudgedIsReadAfterIt) {
    events->answers = false;
    const auto its = knock();
    its->awaitNonce();
    const auto proof = direct::proofOf(its->claim, direct::Prover::Client, kKey);
    its->say(its->claimFrame(proof));
    for (std::int64_t i = 1; i <= 3; ++i) send(*its, i);
    ASSERT_TRUE(waitUntil([&] {
        const std::lock_guard lock(events->mutex);
        return events->pending.admit != nullptr;
    }));
    onStrand([] {});
    EXPECT_EQ(events->count(), 0U);
    onStrand([&] { events->admit(events->pending); });
    EXPECT_EQ(its->awaitAnswer(), RefusalCode::Ok);
    ASSERT_TRUE(waitUntil([&] { return events->count() == 3; }));
}

TEST_P(DataDoorTest, WhoHasGoneWhileTheClaimWasJudgedHasNoPath) {
    events->answers = false;
    {
        const auto its = knock();
        its->awaitNonce();
        its->say(its->claimFrame(direct::proofOf(its->claim, direct::Prover::Client, kKey)));
        ASSERT_TRUE(waitUntil([&] {
            const std::lock_guard lock(events->mutex);
            return events->pending.admit != nullptr;
        }));
    }
    onStrand([&] { events->admit(events->pending); });
    ASSERT_TRUE(waitUntil([&] { return events->ends() == 1; })) << "and whoever thinks so is told";
}

TEST_P(DataDoorTest, StrangersAreClosedForWhatIsNoClaim) {
    using direct::lane::frameOf;
    using direct::lane::Kind;
    for (const auto& said :
         {std::string(4, '\0'), std::string("GET / HTTP/1.1\r\n\r\n"),
          frameOf(Kind::Kept, std::string(40, 'x')), frameOf(Kind::Claim, std::string(75, 'c')),
          frameOf(Kind::Claim, std::string(300, 'c')), frameOf(Kind::Proof, std::string(32, 'p'))}) {
        const auto stranger = knock();
        stranger->awaitNonce();
        stranger->say(said);
        EXPECT_NE(stranger->awaitAnswer(), RefusalCode::Ok);
        EXPECT_TRUE(stranger->awaitClosed());
    }
    const auto wrong = knock();
    wrong->awaitNonce();
    EXPECT_EQ(wrong->open("another key 16 b"), RefusalCode::PermissionDenied);
    EXPECT_TRUE(wrong->awaitClosed());
    EXPECT_EQ(events->ends(), 0U) << "no path has ended";
}

TEST_P(DataDoorTest, WhoIsTurnedAwayIsRecordedByItsAddress) {
    const auto recorded = [&](const LaneStranger& who, const std::string& what, const char* outcome) {
        return waitUntil([&] {
            return trail.has("@" + who.address() + "|refusal|||the entity|direct path: " + what) &&
                   trail.last().ends_with(outcome);
        });
    };
    const auto rubbish = knock();
    rubbish->awaitNonce();
    rubbish->say(std::string(4, '\0'));
    EXPECT_TRUE(recorded(*rubbish, "a data lane: it broke the protocol", "|MALFORMED")) << trail.last();
    const auto wrong = knock();
    wrong->awaitNonce();
    wrong->open("another key 16 b");
    EXPECT_TRUE(recorded(*wrong, "a data lane: no", "|PERMISSION_DENIED")) << trail.last();
    const auto its = holder();
    its->say(std::string("\x7f\0\0\0\5", 5));
    EXPECT_TRUE(recorded(*its, "a data lane: it broke the protocol", "|MALFORMED")) << trail.last();
    const LaneStranger silent(endpoint);
    EXPECT_TRUE(waitUntil([&] {
        clock.advance(100ms);
        return trail.has(
            "refusal|||the entity|direct path: 1 connection from 127.0.0.1 was closed: no session");
    })) << trail.last();
    EXPECT_TRUE(trail.last().ends_with("|OVERLOADED")) << trail.last();
    const auto before = trail.notes().size();
    knock()->awaitNonce();  // and it leaves: nobody has turned it away
    holder();
    EXPECT_EQ(trail.notes().size(), before) << trail.last();
}

TEST_P(DataDoorTest, AClaimMayComeByteByByte) {
    const auto its = knock();
    its->awaitNonce();
    for (const char byte : its->claimFrame(direct::proofOf(its->claim, direct::Prover::Client, kKey)))
        its->say(std::string(1, byte));
    EXPECT_EQ(its->awaitAnswer(), RefusalCode::Ok);
}

TEST_P(DataDoorTest, StrangersAreFewAndHaveTenSeconds) {
    const auto its = holder();
    std::vector<std::unique_ptr<LaneStranger>> silent;
    // With TLS, in the middle of its handshake.
    for (int i = 0; i < 70; ++i) silent.push_back(std::make_unique<LaneStranger>(endpoint));
    const auto began = clock.now();
    ASSERT_TRUE(waitUntil([&] {
        clock.advance(10ms);  // or no more of them are taken
        return silent.front()->isClosed();
    })) << "the oldest of more than 64";
    ASSERT_LT(clock.now() - began, 10s);
    EXPECT_FALSE(silent.back()->isClosed());
    ASSERT_TRUE(waitUntil([&] {
        clock.advance(100ms);
        return silent.back()->isClosed();
    }));
    EXPECT_GT(clock.now() - began, 10s);
    send(*its, 1);
    EXPECT_TRUE(waitUntil([&] { return events->count() == 1; })) << "who has a path is not meant";
}

TEST_P(DataDoorTest, ImproperFramesEndThePath) {
    const std::string too_long("\x7f\0\0\0\5", 5);
    std::size_t ended = 0;
    for (const auto& wrong : {direct::lane::frameOf(direct::lane::Kind::Claim, std::string(76, 'c')),
                              direct::lane::frameOf(direct::lane::Kind::Kept, "cut"), too_long}) {
        const auto its = holder();
        its->say(wrong);
        EXPECT_TRUE(its->awaitClosed());
        ASSERT_TRUE(waitUntil([&] { return events->ends() == ended + 1; }));
        ++ended;
        const std::lock_guard lock(events->mutex);
        EXPECT_NE(events->closed.back().find("broke the protocol"), std::string::npos);
    }
}

TEST_P(DataDoorTest, WhoDoesNotReadIsDisconnectedAndWhoReadsLateGetsEverything) {
    const auto content = std::make_shared<const std::string>(1'000'000, 'x');
    const auto flood = [&](int messages) {
        onStrand([&] {
            for (std::int64_t i = 1; i <= messages; ++i) {
                Header head;
                head.sequence = i;
                events->lane->send(Keeping::Kept, head, content);
            }
        });
    };
    const auto late = holder();
    flood(8);
    for (std::int64_t i = 1; i <= 8; ++i)
        ASSERT_EQ(direct::lane::messageIn(late->awaitFrame().value()).value().sequence, i);
    const auto never = holder();
    flood(60);
    ASSERT_TRUE(waitUntil([&] { return events->ends() == 1; }));
    const std::lock_guard lock(events->mutex);
    EXPECT_EQ(events->closed.back(), "it does not read its messages");
}

TEST_P(DataDoorTest, AfterItIsShutNobodyIsThere) {
    const auto its = holder();
    const auto stranger = knock();
    stranger->awaitNonce();
    onStrand([&] { door.shut(); });
    EXPECT_TRUE(its->awaitClosed());
    EXPECT_TRUE(stranger->awaitClosed());
    EXPECT_EQ(events->ends(), 1U);
}

TEST_P(DataDoorTest, MessagesInQuickSuccessionAreAnsweredOneByOne) {
    const auto its = holder();
    {
        const std::lock_guard lock(events->mutex);
        events->echoes = true;
    }
    for (std::int64_t i = 1; i <= 2000; ++i) {
        send(*its, i);
        ASSERT_EQ(direct::lane::messageIn(its->awaitFrame().value()).value().sequence, i);
    }
    EXPECT_TRUE(inOrder());
}

INSTANTIATE_TEST_SUITE_P(, DataDoorTest,
                         testing::Values(Kinds{Speaks::Plain, 0us}, Kinds{Speaks::Plain, 50us},
                                         Kinds{Speaks::Tls, 0us}),
                         nameOf);

class TlsDoorTest : public DataDoorTest {};
INSTANTIATE_TEST_SUITE_P(, TlsDoorTest, testing::Values(Kinds{Speaks::Tls, 0us}), nameOf);

TEST_P(TlsDoorTest, ACertificateOfAnotherCaOrNoneIsTurnedAwayAndTheLogSaysWhy) {
    const auto log = std::make_shared<test::LogLines>();
    const auto before = spdlog::default_logger();
    spdlog::set_default_logger(std::make_shared<spdlog::logger>("", log));
    const test::CertificateFolder others;
    auto stranger = others.credentials(Kind::Client, "ann");
    stranger.authorities = kLaboratory.credentials(Kind::Client, "ann").authorities;
    certificates::Credentials none;
    none.authorities = stranger.authorities;
    for (const auto& [its, why] : {std::pair{stranger, "of another CA"}, std::pair{none, "shown"}}) {
        const auto tls = Tls::of(its, test::CertificateFolder::now);
        LaneStranger knocks(endpoint, tls.get(), "robot");
        EXPECT_TRUE(knocks.awaitClosed());
        EXPECT_TRUE(waitUntil([&, expected = std::string(why)] { return log->has(expected); })) << log->all();
        EXPECT_TRUE(waitUntil([&, expected = std::string(why)] {
            return trail.last().find(expected) != std::string::npos;
        })) << trail.last();
        EXPECT_TRUE(trail.has("@" + knocks.address() + "|")) << trail.last();
    }
    spdlog::set_default_logger(before);
    EXPECT_EQ(events->openings, 0);
}

TEST_P(TlsDoorTest, WhoeverDoesNotSpeakTlsHearsNothingOfTheOpening) {
    LaneStranger plain(endpoint);
    plain.say(direct::lane::frameOf(direct::lane::Kind::Claim, std::string(92, 'c')));
    EXPECT_FALSE(plain.awaitFrame()) << "no nonce";
    EXPECT_EQ(events->openings, 0);
}

TEST_P(TlsDoorTest, HandshakesThatAreNotFinishedHoldUpNoHolder) {
    const auto its = holder();
    std::vector<std::unique_ptr<LaneStranger>> half;
    for (std::int64_t i = 1; i <= 40; ++i) {
        half.push_back(std::make_unique<LaneStranger>(endpoint));
        half.back()->say(std::string("\x16\x03\x01\x02\0", 5));  // of a record that does not follow
        send(*its, i);
        ASSERT_TRUE(waitUntil([&] { return events->count() == static_cast<std::size_t>(i); }));
    }
    EXPECT_TRUE(inOrder());
    onStrand([&] { door.shut(); });
    for (const auto& one : half) EXPECT_TRUE(one->awaitClosed());
}

TEST_P(TlsDoorTest, ARecordThatWasNotSealedByTheHolderEndsThePath) {
    const auto its = holder();
    its->sayInClear(std::string("\x17\x03\x03\0\x20", 5) + std::string(32, 'x'));
    EXPECT_TRUE(its->awaitClosed());
    ASSERT_TRUE(waitUntil([&] { return events->ends() == 1; }));
    EXPECT_EQ(events->count(), 0U);
}

}  // namespace
}  // namespace axon::entity_manager
