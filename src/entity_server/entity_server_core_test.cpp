// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/entity_server_core.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <new>
#include <string>
#include <vector>

#include "support/recorded_audit.hpp"

// Counted, so that the cost of a join is known without a clock.
static std::atomic<std::size_t> allocations{0};
void* operator new(std::size_t size) {
    ++allocations;
    if (void* memory = std::malloc(size == 0 ? 1 : size)) return memory;
    throw std::bad_alloc();
}
void* operator new(std::size_t size, const std::nothrow_t&) noexcept {
    ++allocations;
    return std::malloc(size == 0 ? 1 : size);
}
void operator delete(void* memory) noexcept {
    std::free(memory);
}
void operator delete(void* memory, std::size_t) noexcept {
    std::free(memory);
}

namespace axon::entity_server {
namespace {

using namespace std::chrono_literals;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

constexpr const char* kFirst = "00000000-0000-4000-8000-000000000001";
constexpr const char* kSecond = "00000000-0000-4000-8000-000000000002";

class FakeOutbox final : public EntityOutbox {
  public:
    bool newClientMsg(const Header& head, std::string_view message, QueueShare share) override {
        if (slow && share == QueueShare::OfSender) return false;
        lines.push_back("msg " + head.sender.name + " " + std::string(message));
        return true;
    }
    void newClientMsgDataSeq(const Header&, std::string_view data) override {
        lines.push_back("data " + std::string(data));
    }
    bool stopSignal(const Header& head, StopCause cause) override {
        if (!slow) lines.push_back(std::string("stop ") + toString(cause));
        last = head;
        return !slow;
    }
    bool resetSignal(const Header&) override {
        if (!slow) lines.emplace_back("reset");
        return !slow;
    }
    bool clearSignal(const Header&) override {
        if (!slow) lines.emplace_back("clear");
        return !slow;
    }
    void newClientUpdate(const Header& head, ClientChange) override {
        lines.push_back("client " + head.sender.id);
        if (on_client) on_client();
    }
    void newRefusalMsg(const Header&, const Refusal& refusal) override {
        lines.push_back("refused " + std::string(refusalName(refusal.code)));
    }
    void newHeartbeat(std::int64_t) override { ++heartbeats; }
    void disconnect(bool, const std::string& why) override { disconnected = why; }

    std::vector<std::string> lines;
    Header last;  // of the last stop
    int heartbeats = 0;
    std::string disconnected;
    bool slow = false;  ///< the sender has its share of what waits here
    std::function<void()> on_client;
};

class FakeTopic final : public FrontEndTopic {
  public:
    void entityBasicPrflUpdate(Presence presence, const Registration& registration,
                               std::string_view) override {
        const char* text[] = {"joined ", "changed ", "left "};
        lines.push_back(text[static_cast<int>(presence)] + registration.name);
    }
    void entityUpdate(const EntityStatus& status, std::int64_t) override {
        lines.push_back(std::string("status ") + toString(status.state));
        last = status;
    }
    void entityMsg(Lane lane, const Header& head, std::string_view message) override {
        lines.push_back((lane == Lane::Signal ? "signal " : "data ") + head.entity.substr(35) + " to " +
                        head.sender.id + " " + std::string(message));
    }
    void entityMsgDataSeq(const Header&, std::string_view) override { lines.emplace_back("samples"); }
    void entityRefusal(Lane, const Header& head, const Refusal& refusal) override {
        lines.push_back("refused " + std::string(refusalName(refusal.code)) + " to " + head.sender.id +
                        " of " + std::to_string(head.sequence));
    }
    void entityServerEntities(const std::string& server, const std::vector<std::string>& entities) override {
        lines.push_back("all of " + server + ": " + std::to_string(entities.size()));
    }
    void entityServerUpdate(Lane lane, const ServerAnnouncement& self) override {
        if (lane == Lane::Signal) {
            ++beats;
        } else {
            lines.push_back(self.name + " published " + std::to_string(self.published));
        }
    }
    void reach(const std::vector<ServerAnnouncement>& servers) override {
        reached.clear();
        for (const auto& server : servers) reached.push_back(server.signals);
    }
    void peersUpdate(Lane lane, const ServerAnnouncement&,
                     const std::vector<std::string>& entities) override {
        if (lane == Lane::Data) told_peers = entities;
    }
    void reachPeers(const std::vector<ServerAnnouncement>& servers) override {
        peers.clear();
        for (const auto& server : servers) peers.push_back(server.messages);
    }
    Result<void> peerMsg(Lane lane, const std::string& server, const Header& head,
                         std::string_view message) override {
        if (!reaches_peers) return Refusal{RefusalCode::NotConnected, "out of reach", {}};
        lines.push_back((lane == Lane::Signal ? "signal peer at " : "peer at ") + server + " " +
                        head.sender.name + " " + std::string(message));
        return {};
    }
    void peerRefusal(Lane lane, const std::string& server, const Header& head,
                     const Refusal& refusal) override {
        lines.push_back((lane == Lane::Signal ? "signal refused " : "refused ") +
                        std::string(refusalName(refusal.code)) + " to " + head.sender.id + " at " + server);
    }
    std::vector<std::string> take() { return std::exchange(lines, {}); }

    std::vector<std::string> lines;
    std::vector<std::string> reached;
    std::vector<std::string> peers;
    std::vector<std::string> told_peers;
    bool reaches_peers = true;
    int beats = 0;
    EntityStatus last;
};

class FakeUsers final : public users::PresentUsers {
  public:
    std::optional<Role> clientRole(const std::string&) const override { return std::nullopt; }
    bool mayBeEntityManager(const std::string& user) const override { return user != gone; }
    std::shared_ptr<const users::Access> access() const override { return nullptr; }
    std::string fingerprint() const override { return "11111111"; }

    std::string gone;
};

class EntityServerTest : public testing::Test {
  protected:
    struct Peer {
        std::shared_ptr<FakeOutbox> data = std::make_shared<FakeOutbox>();
        std::shared_ptr<FakeOutbox> signal = std::make_shared<FakeOutbox>();
        EntityServerCore::SessionRef session;
    };

    Peer connect(const std::string& user = {}) {
        Peer peer;
        peer.session = core.open(peer.data, user);
        EXPECT_TRUE(core.attach(EntityServerCore::token(*peer.session), peer.signal).ok());
        return peer;
    }
    Registration registration(const std::string& uuid, const std::string& name = "Robot") {
        Registration out;
        out.entity = uuid;
        out.name = name;
        out.heartbeat_busy_ms = 50;
        out.heartbeat_idle_ms = 2000;
        return out;
    }
    Peer join(const std::string& uuid, const std::string& name = "Robot") {
        auto peer = connect();
        EXPECT_TRUE(core.sendBasicPrfl(peer.session, registration(uuid, name), "profile").ok());
        return peer;
    }
    void status(const Peer& peer, EntityState state, const std::string& holder = {}, bool orphaned = false) {
        EntityStatus out;
        out.state = state;
        out.holder = {holder, holder, Role::Operator};
        out.orphaned = orphaned;
        core.sendStatus(peer.session, out);
    }
    /// Lets time pass in small steps, as the timer thread does.
    void pass(Duration time) {
        const auto end = clock.now() + time;
        while (clock.now() < end) {
            const auto next = core.onTimer();
            clock.set(std::min(std::max(next, clock.now() + 1ms), end));
        }
        core.onTimer();
    }
    static Header head(const std::string& entity, const std::string& client = "c1") {
        Header out;
        out.entity = entity;
        out.sender = {client, client, Role::Operator};
        out.sequence = 9;
        return out;
    }

    static Header toPeer(const std::string& entity, const std::string& client = "c1") {
        auto out = head(entity, client);
        out.msg_type = kMsgCollaboration;
        return out;
    }

    ManualClock clock;
    SeededRandom random{1};
    FakeTopic topic;
    std::vector<std::string> notes;
    int woken = 0;
    int pending = 0;
    bool publish_at_once = true;
    EntityServerCoreSettings settings;
    explicit EntityServerTest(EntityServerCoreSettings its = {}) : settings(std::move(its)) {}
    test::RecordedAudit trail;
    FakeUsers users;
    EntityServerCore core{settings,
                          clock,
                          random,
                          topic,
                          [this](const std::string& line) { notes.push_back(line); },
                          [this] { ++woken; },
                          [this] {
                              ++pending;
                              if (publish_at_once) core.publishPending();
                          },
                          &trail,
                          &users};
};

TEST_F(EntityServerTest, TheSessionOfARemovedUserEnds) {
    auto left = connect("left"), right = connect("right"), certified = connect();
    const char* uuids[] = {kFirst, kSecond, "00000000-0000-4000-8000-000000000003"};
    int at = 0;
    for (auto* peer : {&left, &right, &certified})
        ASSERT_TRUE(core.sendBasicPrfl(peer->session, registration(uuids[at++]), "profile").ok());
    auto late = connect("left");
    topic.take();
    users.gone = "left";
    core.usersChanged();
    EXPECT_EQ(core.entities(), 2U);
    EXPECT_THAT(left.data->disconnected, HasSubstr("was removed"));
    EXPECT_THAT(left.signal->disconnected, HasSubstr("was removed"));
    EXPECT_THAT(right.data->disconnected, IsEmpty());
    EXPECT_THAT(certified.data->disconnected, IsEmpty());
    EXPECT_THAT(topic.take(), Contains("left Robot"));
    EXPECT_THAT(notes.back(), HasSubstr("the user 'left' was removed"));
    const auto refused = core.sendBasicPrfl(late.session, registration(kFirst), "profile");
    EXPECT_EQ(refused.refusal().code, RefusalCode::PermissionDenied);
}

TEST_F(EntityServerTest, AnEntityWithoutAProfileIsPublishedAndCanBeStoppedAndJoinsWhenItHasOne) {
    auto peer = connect();
    ASSERT_TRUE(core.sendBasicPrfl(peer.session, registration(kFirst, "application"), "").ok());
    EXPECT_THAT(topic.take(), ElementsAre("joined application")) << "no status that it has not sent";
    EXPECT_THAT(notes.back(), HasSubstr("application is connected and not ready"));
    Header head;
    head.sender.id = "somebody";
    core.stopSignal(head, StopCause::Requested);
    EXPECT_THAT(peer.signal->lines, Contains(HasSubstr("stop")));
    ASSERT_TRUE(core.sendBasicPrfl(peer.session, registration(kFirst, "Robot"), "profile").ok());
    EXPECT_THAT(topic.take(), ElementsAre("changed Robot"));
    EXPECT_THAT(notes.back(), HasSubstr("Robot joined"));
    // By its present name, too, where it speaks to others.
    const auto other = join(kSecond);
    core.sendToPeer(peer.session, Lane::Data, toPeer(kSecond), "hello");
    EXPECT_THAT(other.data->lines, Contains("msg Robot hello"));
}

TEST_F(EntityServerTest, WhoComesGoesAndHoldsIsRecordedOnce) {
    const auto peer = join(kFirst);
    status(peer, EntityState::IDLE);
    EntityStatus held;
    held.state = EntityState::REG;
    held.holder = {"c1", "ann", Role::Operator};
    core.sendStatus(peer.session, held);
    core.sendStatus(peer.session, held);
    // The front-end server beside it records this.
    core.stopSignal({}, StopCause::Requested);
    core.leave(peer.session, true, "over");
    core.leave(peer.session, true, "over again");
    const std::string id = kFirst;
    EXPECT_THAT(trail.notes(), ElementsAre("session|Robot||" + id + "|entity joined|OK",
                                           "ownership|ann|c1|" + id + "|Robot is checked out|",
                                           "session|Robot||" + id + "|entity left: over|"));
}

TEST_F(EntityServerTest, PublishesJoiningChangingAndLeaving) {
    const auto peer = join(kFirst);
    EXPECT_THAT(topic.take(), ElementsAre("joined Robot"));
    status(peer, EntityState::UNAV);
    EXPECT_THAT(topic.take(), ElementsAre("status UNAV"));
    status(peer, EntityState::IDLE);
    status(peer, EntityState::IDLE);
    EXPECT_THAT(topic.take(), ElementsAre("status IDLE"));
    ASSERT_TRUE(core.sendBasicPrfl(peer.session, registration(kFirst), "another profile").ok());
    EXPECT_THAT(topic.take(), ElementsAre("changed Robot"));
    core.leave(peer.session, true, "over");
    core.leave(peer.session, true, "over again");
    EXPECT_THAT(topic.take(), ElementsAre("left Robot"));
    EXPECT_EQ(core.entities(), 0U);
}

TEST_F(EntityServerTest, RegistersNobodyWhoCouldNotBeStopped) {
    const auto data = std::make_shared<FakeOutbox>();
    const auto session = core.open(data);
    const auto result = core.sendBasicPrfl(session, registration(kFirst), "profile");
    ASSERT_FALSE(result.ok());
    EXPECT_EQ(result.refusal().code, RefusalCode::WrongState);
    EXPECT_THAT(topic.lines, IsEmpty());
}

TEST_F(EntityServerTest, RefusesBadRegistrations) {
    const auto peer = connect();
    const auto refusal = [&](Registration registration, std::size_t profile = 1) {
        return core.sendBasicPrfl(peer.session, std::move(registration), std::string(profile, 'p'))
            .refusal()
            .code;
    };
    EXPECT_EQ(refusal(registration("no uuid")), RefusalCode::Malformed);
    EXPECT_EQ(refusal(registration(kFirst, "")), RefusalCode::BadName);
    EXPECT_EQ(refusal(registration(kFirst, std::string(257, 'x'))), RefusalCode::BadName);
    EXPECT_EQ(refusal(registration(kFirst, "PeopleBot#2")), RefusalCode::BadName)
        << "the second that is called PeopleBot";
    EXPECT_EQ(refusal(registration(kFirst, kSecond)), RefusalCode::BadName) << "another entity's UUID";
    auto frantic = registration(kFirst);
    frantic.heartbeat_busy_ms = 1;
    EXPECT_EQ(refusal(frantic), RefusalCode::OutOfRange);
    EXPECT_EQ(refusal(registration(kFirst), 2U << 20U), RefusalCode::TooLarge);
    EXPECT_EQ(core.entities(), 0U);
}

TEST_F(EntityServerTest, RefusesASecondOneOfTheSameUuidUntilTheFirstIsGone) {
    const auto first = join(kFirst);
    const auto copy = connect();
    const auto result = core.sendBasicPrfl(copy.session, registration(kFirst), "profile");
    ASSERT_FALSE(result.ok());
    EXPECT_EQ(result.refusal().code, RefusalCode::Duplicate);
    EXPECT_THAT(result.refusal().message, HasSubstr("give the copy an empty one (--state)"));
    core.leave(first.session, false, "connection lost");
    EXPECT_TRUE(core.sendBasicPrfl(copy.session, registration(kFirst), "profile").ok());
}

TEST_F(EntityServerTest, ATokenIsForOneUse) {
    const auto peer = connect();
    EXPECT_FALSE(core.attach(EntityServerCore::token(*peer.session), peer.signal).ok());
    EXPECT_FALSE(core.attach("guessed", peer.signal).ok());
}

TEST_F(EntityServerTest, RoutesToTheEntityAddressedAndRefusesTheUnknown) {
    const auto first = join(kFirst);
    const auto second = join(kSecond);
    topic.take();
    core.clientMsg(head(kFirst), "hello");
    core.clientMsgDataSeq(head(kSecond), "bytes");
    EXPECT_THAT(first.data->lines, ElementsAre("msg c1 hello"));
    EXPECT_THAT(second.data->lines, ElementsAre("data bytes"));
    core.clientMsg(head("nobody"), "hello");
    core.stopSignal(head("nobody"), StopCause::Requested);
    EXPECT_THAT(topic.take(),
                ElementsAre("refused UNKNOWN_ENTITY to c1 of 9", "refused UNKNOWN_ENTITY to c1 of 9"));
}

TEST_F(EntityServerTest, SignalsTakeTheSignalLaneAndAllMeansAll) {
    const auto first = join(kFirst);
    const auto second = join(kSecond);
    core.stopSignal(head(""), StopCause::Requested);
    core.resetSignal(head(kFirst));
    core.clearSignal(head(kSecond));
    core.clientUpdate(head(kSecond), ClientChange::Lost);
    EXPECT_THAT(first.signal->lines, ElementsAre("stop requested", "reset"));
    EXPECT_THAT(second.signal->lines, ElementsAre("stop requested", "clear", "client c1"));
    EXPECT_THAT(first.data->lines, IsEmpty());
}

TEST_F(EntityServerTest, AStopOfSeveralReachesThoseThatAreThereAndRefusesTheOthers) {
    const auto first = join(kFirst);
    const auto second = join(kSecond);
    topic.take();
    core.stopSignals(head(""), {"nobody", kSecond}, StopCause::Requested);
    EXPECT_THAT(first.signal->lines, IsEmpty());
    EXPECT_THAT(second.signal->lines, ElementsAre("stop requested"));
    EXPECT_THAT(second.data->lines, IsEmpty());
    EXPECT_THAT(topic.take(), ElementsAre("refused UNKNOWN_ENTITY to c1 of 9"));
}

TEST_F(EntityServerTest, AnEntitySpeaksUnderItsOwnName) {
    const auto first = join(kFirst, "Master");
    const auto second = join(kSecond, "Slave");
    topic.take();
    core.sendToClient(first.session, Lane::Signal, head("forged", "c7"), "receipt");
    EXPECT_THAT(topic.take(), ElementsAre("signal 1 to c7 receipt"));
    core.sendToPeer(first.session, Lane::Data, toPeer(kSecond, "forged"), "step");
    EXPECT_THAT(second.data->lines, ElementsAre("msg Master step"));
    core.sendToPeer(first.session, Lane::Data, toPeer("nobody"), "step");
    EXPECT_THAT(first.data->lines, ElementsAre("refused UNKNOWN_ENTITY"));
    core.sendToPeer(first.session, Lane::Signal, toPeer(kSecond), "beat");
    EXPECT_THAT(second.signal->lines, ElementsAre("msg Master beat"));
    core.sendToPeer(first.session, Lane::Signal, toPeer("nobody"), "beat");
    EXPECT_THAT(first.signal->lines, ElementsAre("refused UNKNOWN_ENTITY"));
}

TEST_F(EntityServerTest, AnEntityCommandsNoOther) {
    const auto first = join(kFirst, "Master");
    const auto second = join(kSecond, "Slave");
    for (const auto* type :
         {"", kMsgCheckOut, kMsgTask, kMsgRearm, kMsgRelease, kMsgParam, kMsgRun, kMsgStatus, kMsgWay}) {
        auto sent = head(kSecond);
        sent.msg_type = type;
        for (const auto lane : {Lane::Data, Lane::Signal})
            core.sendToPeer(first.session, lane, sent, "take it");
    }
    EXPECT_THAT(first.data->lines, testing::Each("refused PERMISSION_DENIED"));
    EXPECT_THAT(first.data->lines, testing::SizeIs(9));
    EXPECT_THAT(first.signal->lines, testing::SizeIs(9));
    EXPECT_THAT(second.data->lines, IsEmpty());
    EXPECT_THAT(second.signal->lines, IsEmpty());
    auto raw = head(kSecond);
    raw.msg_type = kMsgRaw;
    core.sendToPeer(first.session, Lane::Data, raw, "laser");
    EXPECT_THAT(second.data->lines, testing::SizeIs(1));
}

TEST_F(EntityServerTest, AnEntityDoesNotFillTheQueueOfAnother) {
    const auto first = join(kFirst, "Master");
    const auto second = join(kSecond, "Slave");
    auto raw = toPeer(kSecond);
    raw.msg_type = kMsgRaw;
    const std::string large(1089 * 1024, 'x');
    core.sendToPeer(first.session, Lane::Data, toPeer(kSecond), large);
    core.sendToPeer(first.session, Lane::Data, raw, large);
    EXPECT_THAT(first.data->lines, ElementsAre("refused TOO_LARGE", "refused TOO_LARGE"));
    for (int i = 0; i < 100; ++i)
        core.sendToPeer(first.session, Lane::Data, toPeer(kSecond), std::string(1024 * 1024, 'x'));
    EXPECT_THAT(second.data->lines, testing::SizeIs(8));
    EXPECT_EQ(first.data->lines.back(), "refused OVERLOADED");
    core.sendToPeer(first.session, Lane::Data, raw, std::string(1024 * 1024, 'x'));
    EXPECT_THAT(second.data->lines, testing::SizeIs(9)) << "which gives way to what is not raw";
    core.sendToPeer(first.session, Lane::Signal, toPeer(kSecond), "end");
    EXPECT_THAT(second.signal->lines, testing::SizeIs(1)) << "the end of a run waits for nothing";
}

TEST_F(EntityServerTest, ASignalLaneIsNotFilledByAnEntity) {
    const auto first = join(kFirst, "Master");
    const auto second = join(kSecond, "Slave");
    auto raw = toPeer(kSecond);
    raw.msg_type = kMsgRaw;
    const std::string large(16 * 1024 + 1, 'x');
    core.sendToPeer(first.session, Lane::Signal, raw, "laser");
    core.sendToPeer(first.session, Lane::Signal, toPeer(kSecond), large);
    core.sendToClient(first.session, Lane::Signal, head(kSecond), large);
    EXPECT_THAT(first.signal->lines,
                ElementsAre("refused OVERLOADED", "refused OVERLOADED", "refused OVERLOADED"));
    for (int i = 0; i < 1000; ++i)
        core.sendToPeer(first.session, Lane::Signal, toPeer(kSecond), std::string(16 * 1024, 'x'));
    EXPECT_THAT(second.signal->lines, testing::SizeIs(64)) << "1 MiB in a second";
}

TEST_F(EntityServerTest, WhoLeavesTooMuchAtAnEntityThatReadsSlowlyIsToldAndNamed) {
    const auto slow = join(kFirst);
    const auto other = join(kSecond);
    slow.data->slow = slow.signal->slow = true;
    topic.take();
    core.clientMsg(head(kFirst), "work");
    EXPECT_THAT(topic.take(), ElementsAre("refused OVERLOADED to c1 of 9"));
    EXPECT_THAT(notes.back(), HasSubstr("and c1 (c1) sends it more than its share"));
    status(slow, EntityState::REG, "c1");
    core.clientMsg(head(kFirst), "release");
    EXPECT_THAT(slow.data->lines, ElementsAre("msg c1 release")) << "its holder has the whole queue";
    topic.take();
    const auto lines = notes.size();
    core.stopSignal(head(kFirst), StopCause::Requested);
    core.resetSignal(head(kFirst));
    core.clearSignal(head(kFirst));
    core.stopSignals(head({}), {kFirst, kSecond}, StopCause::Requested);
    core.stopSignal(head({}), StopCause::Requested);
    EXPECT_THAT(topic.take(),
                testing::AllOf(testing::SizeIs(5), testing::Each("refused OVERLOADED to c1 of 9")));
    EXPECT_THAT(other.signal->lines, ElementsAre("stop requested", "stop requested"))
        << "and those of nobody else";
    core.sendToPeer(other.session, Lane::Data, toPeer(kFirst), "step");
    EXPECT_THAT(other.data->lines, ElementsAre("refused OVERLOADED"));
    EXPECT_THAT(notes.back(), HasSubstr("and Robot (" + std::string(kSecond) + ")"));
    for (int i = 0; i < 1000; ++i) core.resetSignal(head(kFirst));
    EXPECT_THAT(notes, testing::SizeIs(testing::Le(lines + 20))) << "lines in a second";
    EXPECT_TRUE(slow.data->disconnected.empty() && slow.signal->disconnected.empty());
}

TEST_F(EntityServerTest, AnEntityThatChangesWithoutEndIsToldOfEvenlyAndAsItIs) {
    const auto peer = join(kFirst);
    topic.take();
    for (int i = 0; i < 2000; ++i) status(peer, i % 2 == 0 ? EntityState::BUSY : EntityState::IDLE);
    EXPECT_EQ(topic.take().size(), 200U);
    const auto others = join(kSecond);
    EXPECT_THAT(topic.take(), ElementsAre("joined Robot")) << "nobody waits for it";
    status(peer, EntityState::BUSY);
    EXPECT_GT(woken, 0);
    pass(6ms);
    EXPECT_THAT(topic.take(), ElementsAre("status BUSY")) << "the last word, not later than a step";
    for (int i = 0; i < 1000; ++i) {
        status(peer, i % 2 == 0 ? EntityState::IDLE : EntityState::BUSY);
        core.keepAlive(peer.session);
        pass(1ms);
    }
    EXPECT_THAT(topic.take(), testing::SizeIs(testing::AllOf(testing::Ge(199U), testing::Le(201U))));
    status(peer, EntityState::IDLE);
    pass(1s);
    topic.take();
    const auto large = [](int i) { return std::string(512 * 1024, static_cast<char>('a' + i % 26)); };
    for (int i = 0; i < 300; ++i) {  // the first second is a burst
        ASSERT_TRUE(core.sendBasicPrfl(peer.session, registration(kFirst), large(i)).ok());
        core.keepAlive(peer.session);
        pass(10ms);
        if (i != 99) continue;
        EXPECT_THAT(topic.take(), testing::SizeIs(testing::Le(14U)));
    }
    EXPECT_THAT(topic.take(),
                testing::AllOf(testing::Each("changed Robot"),
                               testing::SizeIs(testing::AllOf(testing::Ge(10U), testing::Le(14U)))))
        << "3.2 MiB of profiles in a second";
    core.leave(peer.session, true, "over");
    pass(1s);
    EXPECT_THAT(topic.take(), ElementsAre("left Robot"));
}

TEST_F(EntityServerTest, TheLogIsNotFilledByAnEntity) {
    const auto peer = join(kFirst);
    const auto before = notes.size();
    for (int i = 0; i < 1000; ++i) status(peer, EntityState::IDLE, i % 2 == 0 ? "ann" : "bob");
    EXPECT_EQ(notes.size(), before + 20);
    clock.advance(1s);
    status(peer, EntityState::IDLE, "ann");
    EXPECT_THAT(notes.back(), HasSubstr("980 changes of its holder before this one are not in the log"));
    for (int i = 0; i < 100; ++i) status(peer, EntityState::IDLE, i % 2 == 0 ? "bob" : "ann");
    core.leave(peer.session, true, "over");
    EXPECT_THAT(notes.back(), HasSubstr("left: over (81 changes of its holder are not in the log)"));
}

TEST_F(EntityServerTest, WhoIsNotRegisteredSaysNothing) {
    const auto peer = connect();
    core.sendToClient(peer.session, Lane::Data, head(kFirst), "hello");
    core.sendToPeer(peer.session, Lane::Data, toPeer(kFirst), "hello");
    status(peer, EntityState::BUSY);
    EXPECT_THAT(topic.lines, IsEmpty());
}

TEST_F(EntityServerTest, HeartbeatsComeInTheRegisteredPeriodAndAtOnceWhenBusy) {
    const auto peer = join(kFirst);
    for (int i = 0; i < 10; ++i) {
        core.keepAlive(peer.session);
        pass(1s);
    }
    EXPECT_GE(peer.signal->heartbeats, 5);
    EXPECT_LE(peer.signal->heartbeats, 6);
    peer.signal->heartbeats = 0;
    status(peer, EntityState::BUSY);
    EXPECT_EQ(peer.signal->heartbeats, 1);
    for (int i = 0; i < 10; ++i) {
        core.keepAlive(peer.session);
        pass(100ms);
    }
    EXPECT_EQ(peer.signal->heartbeats, 21);
}

TEST_F(EntityServerTest, HeartbeatsOfManyComeInTurnsThatStayApartThoughTheTimerIsLate) {
    clock.advance(1234567ns);  // not on the grid
    std::vector<Peer> peers;
    for (int i = 0; i < 64; ++i) {
        peers.push_back(join(Id128::uuid(random).toString(), "Robot" + std::to_string(i)));
        status(peers.back(), EntityState::BUSY);
    }
    int most = 0;
    for (int tick = 0; tick < 400; ++tick) {
        for (auto& peer : peers) {
            core.keepAlive(peer.session);
            peer.signal->heartbeats = 0;
        }
        clock.advance(5ms);  // one turn is 3.125 ms: each is late, and some are late for the next one too
        core.onTimer();
        int sent = 0;
        for (const auto& peer : peers) {
            EXPECT_LE(peer.signal->heartbeats, 1);
            sent += peer.signal->heartbeats;
        }
        most = std::max(most, sent);
    }
    EXPECT_LE(most, 16) << "of 64, in a tenth of the period";
}

TEST_F(EntityServerTest, GivesUpASilentEntityAfterFivePeriods) {
    const auto peer = join(kFirst);
    status(peer, EntityState::BUSY);
    topic.take();
    pass(249ms);
    EXPECT_EQ(core.entities(), 1U);
    pass(1ms);
    EXPECT_EQ(core.entities(), 0U);
    EXPECT_THAT(topic.take(), ElementsAre("left Robot"));
    EXPECT_THAT(peer.signal->disconnected, HasSubstr("250 ms"));
}

TEST_F(EntityServerTest, WhoGivesUpAnEntityLeavesThePublishingToAnother) {
    publish_at_once = false;
    const auto peer = join(kFirst);
    status(peer, EntityState::BUSY);
    topic.take();
    pass(250ms);
    EXPECT_EQ(core.entities(), 0U);
    EXPECT_THAT(topic.lines, IsEmpty());
    EXPECT_EQ(pending, 1);
    core.publishPending();
    EXPECT_THAT(topic.take(), ElementsAre("left Robot"));
}

TEST_F(EntityServerTest, ASignOfLifeBeforeATaskBeganDoesNotShortenItsTimeOut) {
    const auto peer = join(kFirst);
    core.keepAlive(peer.session);
    clock.advance(1s);
    status(peer, EntityState::BUSY);
    pass(249ms);
    EXPECT_EQ(core.entities(), 1U);
    core.keepAlive(peer.session);
    pass(249ms);
    EXPECT_EQ(core.entities(), 1U);
    pass(1ms);
    EXPECT_EQ(core.entities(), 0U);
}

TEST_F(EntityServerTest, DataForNobodyIsRefusedOnceASecondForEachSender) {
    for (int i = 0; i < 1000; ++i) core.clientMsgDataSeq(head("nobody", i % 2 == 0 ? "c1" : "c2"), "bytes");
    EXPECT_THAT(topic.take(),
                ElementsAre("refused UNKNOWN_ENTITY to c1 of 9", "refused UNKNOWN_ENTITY to c2 of 9"));
    clock.advance(1s);
    core.clientMsgDataSeq(head("nobody"), "bytes");
    EXPECT_EQ(topic.take().size(), 1U);
}

/// Random bytes are drawn while the registry is locked: what happens then happens to a locked registry.
class WhileLocked final : public RandomSource {
  public:
    void fill(void* bytes, std::size_t count) override {
        if (now) std::exchange(now, nullptr)();
        random.fill(bytes, count);
    }
    std::function<void()> now;
    SeededRandom random{1};
};

TEST(EntityServerLocks, SignsOfLifeAndStopsDoNotWaitForTheRegistry) {
    ManualClock clock;
    WhileLocked random;
    FakeTopic topic;
    EntityServerCore core(
        {}, clock, random, topic, [](const std::string&) {}, [] {}, [] {});
    const auto signal = std::make_shared<FakeOutbox>();
    const auto session = core.open(std::make_shared<FakeOutbox>());
    ASSERT_TRUE(core.attach(EntityServerCore::token(*session), signal).ok());
    Registration registration;
    registration.entity = kFirst;
    registration.name = "Robot";
    ASSERT_TRUE(core.sendBasicPrfl(session, registration, "").ok());
    random.now = [&] {
        core.keepAlive(session);
        core.stopSignal({}, StopCause::Requested);
    };
    core.open(std::make_shared<FakeOutbox>());
    EXPECT_THAT(signal->lines, ElementsAre("stop requested"));
}

TEST_F(EntityServerTest, PublishesEverythingAgainOnRequest) {
    status(join(kFirst, "A"), EntityState::IDLE);
    status(join(kSecond, "B"), EntityState::IDLE);
    topic.take();
    auto request = head("");
    request.msg_type = kMsgStatus;
    core.clientRequest(request);
    EXPECT_EQ(topic.take().size(), 4U);
}

TEST_F(EntityServerTest, FourThousandJoinsAreNotQuadratic) {
    constexpr int kJoins = 4096;
    char uuid[37];
    std::vector<Peer> peers;
    peers.reserve(kJoins);
    const auto before = allocations.load();
    for (int i = 0; i < kJoins; ++i) {
        std::snprintf(uuid, sizeof uuid, "00000000-0000-4000-8000-%012d", i);
        peers.push_back(join(uuid));
    }
    // A table that is copied whole costs 2048 allocations for each join on the average.
    EXPECT_LT(allocations - before, kJoins * 200U);
    EXPECT_EQ(core.entities(), static_cast<std::size_t>(kJoins));
    core.stopSignal(head(""), StopCause::Requested);
    for (const auto& peer : peers) EXPECT_EQ(peer.signal->lines.size(), 1U);
}

TEST_F(EntityServerTest, TheTextsOfAStatusAreMendedAndThoseOfARegistrationRefused) {
    const auto peer = join(kFirst);
    EntityStatus status;
    status.reason = std::string(2000, 'x') + "\xff";
    status.holder.name = "Zo\xc3";
    core.sendStatus(peer.session, status);
    EXPECT_EQ(topic.last.reason, std::string(1024, 'x'));
    EXPECT_EQ(topic.last.holder.name, "Zo\xef\xbf\xbd");

    const auto other = connect();
    auto bad = registration(kSecond, "Zo\xc3");
    EXPECT_EQ(core.sendBasicPrfl(other.session, bad, "").refusal().code, RefusalCode::Malformed);
    bad = registration(kSecond);
    bad.category = std::string(1025, 'x');
    EXPECT_EQ(core.sendBasicPrfl(other.session, bad, "").refusal().code, RefusalCode::Malformed);
    EXPECT_EQ(core.entities(), 1U);
}

TEST_F(EntityServerTest, AStatusOnTheSignalLaneIsRefused) {
    const auto peer = join(kFirst);
    core.refuseOnSignalLane(peer.session, kMsgStatus);
    EXPECT_THAT(peer.data->lines, ElementsAre("refused WRONG_STATE"));
}

TEST_F(EntityServerTest, WhoLostAnEntityToWhomIsAudited) {
    const auto peer = join(kFirst);
    const auto tell = [&](EntityState state, const char* holder, const char* reason) {
        EntityStatus out;
        out.state = state;
        out.reason = reason;
        if (*holder != '\0') out.holder = {std::string("session of ") + holder, holder, Role::Operator};
        core.sendStatus(peer.session, out);
    };
    notes.clear();
    tell(EntityState::REG, "client1", "");
    tell(EntityState::IDLE, "", "admin@lab took it over: fire");
    tell(EntityState::REG, "admin@lab", "");
    tell(EntityState::IDLE, "", "");
    EXPECT_THAT(notes,
                ElementsAre("Robot is checked out by client1",
                            "audit: Robot is taken from client1: admin@lab took it over: fire",
                            "Robot is checked out by admin@lab", "Robot is free, released by admin@lab"));
}

TEST_F(EntityServerTest, WarnsOnceAMinuteOfAnEntityThatIsNearlyLost) {
    const auto peer = join(kFirst);
    status(peer, EntityState::BUSY);
    notes.clear();
    const auto beat = [&](Duration period, int times) {
        for (int i = 0; i < times; ++i) {
            pass(period);
            core.keepAlive(peer.session);
        }
    };
    beat(100ms, 20);
    EXPECT_THAT(notes, IsEmpty());
    beat(160ms, 200);  // 32 s
    ASSERT_EQ(notes.size(), 1U);
    EXPECT_THAT(notes.front(), HasSubstr("Robot is late: 1"));
    EXPECT_THAT(core.margins(), ElementsAre(HasSubstr("Robot: 160 ms of 250 ms")));
    beat(160ms, 200);
    EXPECT_EQ(notes.size(), 2U);
}

class DrillTest : public EntityServerTest {
  protected:
    /// The receipt of the drill that the peer was given last, as its Entity Manager sends it.
    void answer(const Peer& peer, const char* msg_type = kMsgDrill) {
        auto receipt = head("", peer.signal->last.sender.id);
        receipt.msg_type = msg_type;
        drilled.sendToClient(peer.session, Lane::Signal, receipt, "a receipt");
    }
    Peer ready(const std::string& uuid, EntityState state = EntityState::IDLE, bool latched = false) {
        Peer peer;
        peer.session = drilled.open(peer.data);
        EXPECT_TRUE(drilled.attach(EntityServerCore::token(*peer.session), peer.signal).ok());
        auto its = registration(uuid);
        its.heartbeat_idle_ms = 60'000;
        EXPECT_TRUE(drilled.sendBasicPrfl(peer.session, its, "profile").ok());
        EntityStatus out;
        out.state = state;
        out.latched = latched;
        drilled.sendStatus(peer.session, out);
        return peer;
    }
    void let(Duration time) {
        const auto end = clock.now() + time;
        while (clock.now() < end) {
            const auto next = drilled.onTimer();
            clock.set(std::min(std::max(next, clock.now() + 1ms), end));
        }
        drilled.onTimer();
    }
    EntityServerCore drilled{[] {
                                 EntityServerCoreSettings its;
                                 its.drill_period = 10s;
                                 return its;
                             }(),
                             clock,
                             random,
                             topic,
                             [this](const std::string& line) { notes.push_back(line); },
                             [] {},
                             [this] { drilled.publishPending(); }};
};

TEST_F(DrillTest, PublishesHowLongAStopTook) {
    const auto peer = ready(kFirst);
    let(9s);
    EXPECT_THAT(peer.signal->lines, IsEmpty());
    let(1s);
    ASSERT_THAT(peer.signal->lines, ElementsAre("stop drill"));
    EXPECT_EQ(peer.signal->last.msg_type, kMsgDrill);
    EXPECT_GT(peer.signal->last.sequence, 0);
    topic.take();
    answer(peer, kMsgReceipt);  // the manager's stage: not yet
    clock.advance(700us);
    answer(peer);
    clock.advance(1ms);
    answer(peer);  // standstill
    drilled.onTimer();
    EXPECT_THAT(topic.take(), ElementsAre("status IDLE"));
    EXPECT_EQ(topic.last.stop_latency_us, 700);
    // The Entity Manager's own statuses do not say it.
    EntityStatus own;
    own.state = EntityState::BUSY;
    own.stop_latency_us = 5;
    drilled.sendStatus(peer.session, own);
    EXPECT_EQ(topic.last.stop_latency_us, 700);
    EXPECT_THAT(drilled.margins(), ElementsAre(HasSubstr("a stop takes 700 us")));
}

TEST_F(DrillTest, AnUnansweredOneIsLoggedAndUnknown) {
    const auto peer = ready(kFirst);
    let(10s);
    answer(peer);
    drilled.onTimer();
    EXPECT_EQ(topic.last.stop_latency_us, 1);  // unmeasurably fast is not unknown
    let(10s);
    const auto late = peer.signal->last;
    ASSERT_EQ(peer.signal->lines.size(), 2U);
    notes.clear();
    let(999ms);
    EXPECT_THAT(notes, IsEmpty());
    let(1ms);
    ASSERT_EQ(notes.size(), 1U);
    EXPECT_THAT(notes.front(), HasSubstr("Robot has not answered a drill within 1000 ms"));
    EXPECT_EQ(topic.last.stop_latency_us, 0);
    answer(peer);
    drilled.onTimer();
    EXPECT_EQ(topic.last.stop_latency_us, 0);
    EXPECT_EQ(peer.signal->last.sender.id, late.sender.id);
}

TEST_F(DrillTest, IsSpreadOverThePeriodAndReachesEveryOneOnce) {
    std::vector<Peer> peers;
    char uuid[37];
    for (int i = 0; i < 100; ++i) {
        std::snprintf(uuid, sizeof uuid, "00000000-0000-4000-8000-%012d", i);
        peers.push_back(ready(uuid));
    }
    let(100ms);
    const auto given = [&] {
        std::size_t all = 0;
        for (const auto& peer : peers) all += peer.signal->lines.size();
        return all;
    };
    EXPECT_EQ(given(), 1U);
    let(5s);
    EXPECT_EQ(given(), 51U);
    let(4900ms);
    for (const auto& peer : peers) EXPECT_EQ(peer.signal->lines.size(), 1U);
}

TEST_F(DrillTest, LeavesAloneWhoIsStoppedOrHasNoApplication) {
    const auto latched = ready(kFirst, EntityState::REG, true);
    const auto lost = ready(kSecond, EntityState::UNAV);
    let(30s);
    EXPECT_THAT(latched.signal->lines, IsEmpty());
    EXPECT_THAT(lost.signal->lines, IsEmpty());
    EXPECT_THAT(topic.lines, testing::Not(testing::Contains(HasSubstr("drill"))));
}

TEST_F(EntityServerTest, DrillsAreOffByDefault) {
    const auto peer = join(kFirst);
    status(peer, EntityState::IDLE);
    for (int i = 0; i < 100; ++i) {
        core.keepAlive(peer.session);
        pass(1s);
    }
    EXPECT_THAT(peer.signal->lines, IsEmpty());
}

TEST(EntityServerFlood, DropsAnEntityThatFloods) {
    ManualClock clock;
    SeededRandom random{1};
    FakeTopic topic;
    EntityServerCoreSettings settings;
    settings.messages_per_second = 3;
    EntityServerCore core(
        settings, clock, random, topic, [](const std::string&) {}, [] {}, [] {});
    const auto data = std::make_shared<FakeOutbox>();
    const auto session = core.open(data);
    ASSERT_TRUE(core.attach(EntityServerCore::token(*session), std::make_shared<FakeOutbox>()).ok());
    Registration registration;
    registration.entity = kFirst;
    registration.name = "Robot";
    ASSERT_TRUE(core.sendBasicPrfl(session, registration, "").ok());
    topic.take();
    clock.advance(1s);  // a registration counts, too
    for (int i = 0; i < 4; ++i) core.sendToClient(session, Lane::Data, {}, "x");
    EXPECT_EQ(topic.lines.size(), 3U);
    EXPECT_THAT(data->disconnected, HasSubstr("flooded"));
}

class OneOfSeveral : public EntityServerTest {
  protected:
    static EntityServerCoreSettings named() {
        EntityServerCoreSettings settings;
        settings.name = "es1";
        settings.heartbeats_missed = 1'000'000;
        return settings;
    }
    OneOfSeveral() : EntityServerTest(named()) {}
    void announce(Lane lane, const std::string& server, const char* instance = "one") {
        core.frontEndServerUpdate(lane, {server, instance, "signals of " + server, 0});
    }
    /// fe1 and fe2 live for so long.
    void bothLive(Duration time) {
        for (const auto end = clock.now() + time; clock.now() < end; pass(50ms)) {
            announce(Lane::Signal, "fe1");
            announce(Lane::Signal, "fe2");
        }
    }
};

TEST_F(OneOfSeveral, SaysWhichFrontEndServerHasOtherUsers) {
    const auto hear = [&](const std::string& server, const std::string& its_users) {
        core.frontEndServerUpdate(Lane::Data, {server, "one", "signals of " + server, 0}, its_users);
    };
    notes.clear();
    for (int i = 0; i < 2; ++i) {
        hear("fe1", users.fingerprint());
        hear("fe2", "22222222");
        hear("fe3", "");
        pass(users::UsersAgreement::kPatience);
    }
    EXPECT_THAT(notes, Contains(HasSubstr("users: front-end server fe2 has other users")));
    EXPECT_THAT(
        notes,
        testing::Not(Contains(testing::AnyOf(HasSubstr("server fe1 has"), HasSubstr("server fe3 has")))));
    hear("no name of a server", "22222222");
    pass(users::UsersAgreement::kPatience);
    notes.clear();
    hear("no name of a server", "22222222");
    EXPECT_THAT(notes, IsEmpty());
}

TEST_F(OneOfSeveral, AFrontEndServerThatFallsSilentHasLostItsClientsAndTheOtherHasNot) {
    const auto mine = join(kFirst);
    const auto others = join(kSecond, "Other");
    status(mine, EntityState::BUSY, "fe1:one:c1");
    status(others, EntityState::BUSY, "fe2:one:c2");
    bothLive(1s);
    EXPECT_THAT(mine.signal->lines, IsEmpty());
    for (int i = 0; i < 4; ++i) {
        EXPECT_THAT(mine.signal->lines, IsEmpty()) << "not before 250 ms have passed";
        announce(Lane::Signal, "fe2");
        pass(50ms);
    }
    EXPECT_THAT(mine.signal->lines, ElementsAre("stop client lost", "client fe1:one:c1"));
    EXPECT_THAT(others.signal->lines, IsEmpty());
    EXPECT_GT(mine.signal->last.sequence, kEntityServerSequences);
    EXPECT_EQ(mine.signal->last.sender.id, "fe1:one:c1");
}

TEST_F(OneOfSeveral, AFrontEndServerThatRefusesConnectionsHasLostItsClientsWithTheNextHeartbeat) {
    const auto mine = join(kFirst);
    const auto others = join(kSecond, "Other");
    status(mine, EntityState::BUSY, "fe1:one:c1");
    status(others, EntityState::BUSY, "fe2:one:c2");
    bothLive(1s);  // fe1 was heard 50 ms ago
    const int before = woken;
    core.serverRefused("fe1", "signals of fe1");
    EXPECT_EQ(woken, before + 1);
    pass(24ms);
    EXPECT_THAT(mine.signal->lines, IsEmpty());
    pass(1ms);
    EXPECT_THAT(mine.signal->lines, ElementsAre("stop client lost", "client fe1:one:c1"));
    EXPECT_THAT(others.signal->lines, IsEmpty());
}

TEST_F(OneOfSeveral, AllThatAFrontEndServerLeavesBehindStopBeforeAnythingElseIsSaid) {
    const auto first = join(kFirst);
    const auto second = join(kSecond, "Other");
    for (const auto* one : {&first, &second}) {
        status(*one, EntityState::BUSY, "fe1:one:c1");
        one->signal->on_client = [&] {
            EXPECT_THAT(first.signal->lines, Contains("stop client lost"));
            EXPECT_THAT(second.signal->lines, Contains("stop client lost"));
        };
    }
    bothLive(1s);
    pass(250ms);
    for (const auto* one : {&first, &second})
        EXPECT_THAT(one->signal->lines, ElementsAre("stop client lost", "client fe1:one:c1"));
}

TEST_F(OneOfSeveral, AFrontEndServerThatStartedAnewHasLostItsClientsOfBefore) {
    const auto before = join(kFirst);
    const auto since = join(kSecond, "Other");
    announce(Lane::Signal, "fe1");
    status(before, EntityState::BUSY, "fe1:one:c1");
    status(since, EntityState::BUSY, "fe1:two:c2");
    announce(Lane::Data, "fe1", "two");
    pass(1ms);
    EXPECT_THAT(before.signal->lines, ElementsAre("stop client lost", "client fe1:one:c1"));
    EXPECT_THAT(since.signal->lines, IsEmpty());
}

TEST_F(OneOfSeveral, RecordsCommandsThatPassItAsItDoesStops) {
    join(kFirst);
    const auto before = trail.notes().size();
    auto its = head(kFirst, "c1");
    its.msg_type = kMsgTask;
    core.clientMsg(its, "task", Via::Topic);
    ASSERT_EQ(trail.notes().size(), before + 1);
    EXPECT_EQ(trail.last(), "command|c1|c1|" + std::string(kFirst) + "|TASK|OK");
    its.msg_type = kMsgText;
    core.clientMsg(its, "hello", Via::Topic);
    its.msg_type = kMsgTask;
    its.entity = kSecond;  // is not there: the front-end server records its refusal
    core.clientMsg(its, "task", Via::Topic);
    EXPECT_EQ(trail.notes().size(), before + 1);
}

TEST_F(OneOfSeveral, RecordsTheSignalsThatItPassesOnAndNotThoseForEntitiesElsewhere) {
    join(kFirst);
    const auto before = trail.notes().size();
    auto its = head(kFirst, "c1");
    core.stopSignal(its, StopCause::Requested);
    core.resetSignal(its);
    core.clearSignal(its);
    its.entity.clear();
    core.stopSignals(its, {kFirst, kSecond}, StopCause::Requested);
    ASSERT_EQ(trail.notes().size(), before + 4);
    EXPECT_EQ(trail.last(), "stop|c1|c1||stop to 1 entities|");
    its.entity = kSecond;
    core.stopSignal(its, StopCause::Requested);
    core.resetSignal(its);
    core.clearSignal(its);
    its.entity.clear();
    core.stopSignals(its, {kSecond}, StopCause::Requested);
    EXPECT_EQ(trail.notes().size(), before + 4);
}

TEST_F(OneOfSeveral, AGrantToAClientOfAServerThatIsGoneIsTakenBackAtOnce) {
    const auto peer = join(kFirst);
    announce(Lane::Signal, "fe1");
    pass(5s);
    status(peer, EntityState::REG, "fe1:one:c1");
    EXPECT_THAT(peer.signal->lines, ElementsAre("stop client lost", "client fe1:one:c1"));
    status(peer, EntityState::REG, "fe1:one:c9", true);
    EXPECT_EQ(peer.signal->lines.size(), 2U) << "it knows already";
}

TEST_F(OneOfSeveral, ALeaseThatIsResumedByAClientOfAServerThatIsGoneIsTakenBackEachTime) {
    const auto peer = join(kFirst);
    announce(Lane::Signal, "fe1");
    status(peer, EntityState::REG, "fe1:one:c1");
    pass(5s);
    ASSERT_THAT(peer.signal->lines, ElementsAre("stop client lost", "client fe1:one:c1"));
    status(peer, EntityState::REG, "fe1:one:c1", true);
    EXPECT_EQ(peer.signal->lines.size(), 2U) << "it knows already";
    status(peer, EntityState::REG, "fe1:one:c1");
    EXPECT_EQ(peer.signal->lines.size(), 4U) << "that server's loss is not noticed a second time";
}

TEST_F(OneOfSeveral, AnswersAStatusOfItsNameWithEverythingAndTheListAtTheEnd) {
    status(join(kFirst), EntityState::IDLE);
    status(join(kSecond, "Other"), EntityState::ERR);
    topic.take();
    Header request;
    request.msg_type = kMsgStatus;
    request.entity = "es2";
    core.clientRequest(request);
    EXPECT_THAT(topic.take(), IsEmpty());
    request.entity = "es1";
    core.clientRequest(request);
    const auto lines = topic.take();
    ASSERT_EQ(lines.size(), 5U);
    EXPECT_THAT(lines,
                testing::IsSupersetOf({"changed Robot", "changed Other", "status IDLE", "status ERR"}));
    EXPECT_EQ(lines.back(), "all of es1: 2");
    EXPECT_EQ(topic.last.server, "es1");
}

TEST_F(OneOfSeveral, SaysHowMuchItHasPublishedWhenAllOfItIsSaid) {
    core.topicFound();
    EXPECT_THAT(topic.take(), ElementsAre("all of es1: 0", "es1 published 0"));
    const auto peer = join(kFirst);
    status(peer, EntityState::IDLE);
    topic.take();
    pass(1s);
    EXPECT_THAT(topic.lines, testing::Contains("es1 published 2"));
    EXPECT_GE(topic.beats, 20);
}

TEST_F(OneOfSeveral, RefusesNothingThatAnotherMayHave) {
    const auto peer = join(kFirst, "Master");
    topic.take();
    core.clientMsg(head(kSecond), "hello");
    core.clientMsgDataSeq(head(kSecond), "data");
    core.stopSignal(head(kSecond), StopCause::Requested);
    core.stopSignals(head(""), {kSecond}, StopCause::Requested);
    EXPECT_THAT(topic.take(), IsEmpty());
    core.clientMsg(head(kSecond), "hello", Via::Straight);
    EXPECT_THAT(topic.take(), ElementsAre("refused UNKNOWN_ENTITY to c1 of 9")) << "it has left since";
}

class OtherEntityServers : public OneOfSeveral {
  protected:
    void hear(Lane lane, const std::string& server, const std::vector<std::string>& entities = {}) {
        core.entityServerUpdate(lane, {server, "one", "signals of " + server, 0, "messages of " + server},
                                entities);
    }
};

TEST_F(OtherEntityServers, AMessageToAnEntityOfAnotherGoesThereOnItsLane) {
    const auto master = join(kFirst, "Master");
    hear(Lane::Data, "es2", {kSecond});
    topic.take();
    core.sendToPeer(master.session, Lane::Data, toPeer(kSecond), "step");
    core.sendToPeer(master.session, Lane::Signal, toPeer(kSecond), "beat");
    EXPECT_THAT(topic.take(), ElementsAre("peer at es2 Master step", "signal peer at es2 Master beat"));
    topic.reaches_peers = false;
    core.sendToPeer(master.session, Lane::Data, toPeer(kSecond), "step");
    EXPECT_THAT(master.data->lines, ElementsAre("refused NOT_CONNECTED"));
}

TEST_F(OtherEntityServers, AMessageToAnEntityThatNobodyHasIsRefusedOnItsLane) {
    const auto master = join(kFirst, "Master");
    core.sendToPeer(master.session, Lane::Data, toPeer(kSecond), "step");
    EXPECT_THAT(master.data->lines, ElementsAre("refused UNKNOWN_ENTITY"));
    core.sendToPeer(master.session, Lane::Signal, toPeer(kSecond), "beat");
    EXPECT_THAT(master.signal->lines, ElementsAre("refused UNKNOWN_ENTITY"));
    hear(Lane::Data, "es2", {kSecond});
    hear(Lane::Data, "es2", {});
    core.sendToPeer(master.session, Lane::Data, toPeer(kSecond), "step");
    EXPECT_EQ(master.data->lines.size(), 2U) << "it left";
}

TEST_F(OtherEntityServers, WhatComesForAnEntityThatHasLeftIsRefusedToItsSender) {
    const auto here = join(kFirst);
    hear(Lane::Data, "es2", {kSecond});
    topic.take();
    core.peerMsg(Lane::Data, head(kFirst, kSecond), "step");
    EXPECT_THAT(here.data->lines, ElementsAre(std::string("msg ") + kSecond + " step"));
    core.leave(here.session, true, "it left");
    topic.take();
    core.peerMsg(Lane::Signal, head(kFirst, kSecond), "beat");
    EXPECT_THAT(topic.take(),
                ElementsAre(std::string("signal refused UNKNOWN_ENTITY to ") + kSecond + " at es2"));

    const auto sender = join(kFirst);
    core.peerRefusal(Lane::Data, head(kSecond, kFirst), {RefusalCode::UnknownEntity, "", {}});
    EXPECT_THAT(sender.data->lines, ElementsAre("refused UNKNOWN_ENTITY"));
}

TEST_F(OtherEntityServers, KnowsForBothLanesWhichServerHasAnEntityItselfIncluded) {
    const auto here = join(kFirst);
    hear(Lane::Data, "es2", {kSecond});
    for (const auto lane : {Lane::Data, Lane::Signal}) {
        EXPECT_EQ(*core.serverOf(kFirst, lane), "es1");
        EXPECT_EQ(*core.serverOf(kSecond, lane), "es2");
        EXPECT_EQ(core.serverOf("nobody", lane), nullptr);
    }
    hear(Lane::Data, "es2", {kFirst, kSecond});
    EXPECT_EQ(*core.serverOf(kFirst, Lane::Data), "es1") << "another server announces an entity that is here";
    core.leave(here.session, true, "it left");
    hear(Lane::Data, "es2", {});
    hear(Lane::Data, "es3", {kFirst});
    EXPECT_EQ(*core.serverOf(kFirst, Lane::Data), "es3") << "it moved";
    EXPECT_EQ(core.serverOf(kSecond, Lane::Data), nullptr);
}

TEST_F(OtherEntityServers, TheLastWhoSaysSoHasTheEntity) {
    const auto master = join(kFirst, "Master");
    hear(Lane::Data, "es2", {kSecond});
    hear(Lane::Data, "es3", {kSecond});
    hear(Lane::Data, "es2", {});
    topic.take();
    core.sendToPeer(master.session, Lane::Data, toPeer(kSecond), "step");
    EXPECT_THAT(topic.take(), ElementsAre("peer at es3 Master step"));
}

TEST_F(OtherEntityServers, AServerThatFallsSilentHasNoEntities) {
    const auto master = join(kFirst, "Master");
    hear(Lane::Signal, "es2");
    hear(Lane::Data, "es2", {kSecond});
    pass(1ms);
    EXPECT_THAT(topic.peers, ElementsAre("messages of es2"));
    pass(3s);
    hear(Lane::Data, "es2", {kSecond});
    core.sendToPeer(master.session, Lane::Data, toPeer(kSecond), "step");
    EXPECT_THAT(master.data->lines, ElementsAre("refused UNKNOWN_ENTITY")) << "the topic was late";
}

TEST_F(OtherEntityServers, HearSoonWhoHasComeAndGone) {
    pass(1s);
    const auto peer = join(kFirst);
    pass(50ms);
    EXPECT_THAT(topic.told_peers, ElementsAre(kFirst));
    core.leave(peer.session, true, "it left");
    pass(50ms);
    EXPECT_THAT(topic.told_peers, IsEmpty());
}

TEST_F(OtherEntityServers, AnEntityThatALivingOneHasIsADuplicate) {
    hear(Lane::Signal, "es2");
    hear(Lane::Data, "es2", {kFirst});
    auto copy = connect();
    const auto refused = core.sendBasicPrfl(copy.session, registration(kFirst), "profile");
    ASSERT_FALSE(refused.ok());
    EXPECT_EQ(refused.refusal().code, RefusalCode::Duplicate);
    EXPECT_THAT(refused.refusal().message, HasSubstr("es2"));
    pass(300ms);
    EXPECT_TRUE(core.sendBasicPrfl(copy.session, registration(kFirst), "profile").ok()) << "es2 may be dead";
}

TEST_F(OneOfSeveral, ReachesTheFrontEndServersThatItHears) {
    announce(Lane::Data, "fe1");
    announce(Lane::Data, "fe2");
    pass(1ms);
    EXPECT_THAT(topic.reached, ElementsAre("signals of fe1", "signals of fe2"));
    pass(4s);
    EXPECT_THAT(topic.reached, IsEmpty());
}

}  // namespace
}  // namespace axon::entity_server
