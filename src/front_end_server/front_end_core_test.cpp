// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/front_end_core.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <cstdlib>
#include <map>
#include <new>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "common/rights.hpp"
#include "support/recorded_audit.hpp"

// Counted, so that the cost of a join is known without a clock.
static std::atomic<std::size_t> allocations{0};
void* operator new(std::size_t size) {
    ++allocations;
    if (void* memory = std::malloc(size == 0 ? 1 : size)) return memory;
    throw std::bad_alloc();
}
void operator delete(void* memory) noexcept {
    std::free(memory);
}
void operator delete(void* memory, std::size_t) noexcept {
    std::free(memory);
}

namespace axon::front_end_server {
namespace {

using namespace std::chrono_literals;
using testing::AllOf;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::Not;
using testing::SizeIs;
using testing::UnorderedElementsAre;

class FakeOutbox final : public ClientOutbox {
  public:
    void newBasicPrflMsg(Presence presence, const Registration& registration, std::string_view) override {
        const char* text[] = {"joined ", "changed ", "left "};
        lines.push_back(text[static_cast<int>(presence)] + registration.name);
        if (while_told) std::exchange(while_told, nullptr)();
    }
    void newStatusMsg(const EntityStatus& status) override {
        lines.push_back(status.entity + " " + toString(status.state));
        if (while_status_told) std::exchange(while_status_told, nullptr)();
    }
    bool newEntityMsg(Lane, const Header& head, std::string_view message, QueueShare share) override {
        last_head = head;
        if (slow && share == QueueShare::OfSender) return false;
        lines.push_back("msg " + std::string(message));
        return true;
    }
    void newEntityMsgDataSeq(const Header&, std::string_view) override { lines.emplace_back("samples"); }
    void newRefusalMsg(const Header& head, const Refusal& refusal) override {
        refused_head = head;
        lines.push_back("refused " + std::string(refusalName(refusal.code)));
    }
    void newStopAccepted(const Header&, std::int32_t entities) override {
        lines.push_back("stop accepted " + std::to_string(entities));
    }
    void newUpdateMsg(RefusalCode, const std::string& text) override { lines.push_back("update " + text); }
    void newHeartbeat(std::int64_t) override { ++heartbeats; }
    void disconnect(bool, const std::string&) override { disconnected = true; }
    const void* connection() const override { return router ? router : this; }
    std::vector<std::string> take() { return std::exchange(lines, {}); }

    std::vector<std::string> lines;
    int heartbeats = 0;
    bool disconnected = false;
    bool slow = false;             ///< each entity has its share of what waits here
    const void* router = nullptr;  ///< null: there is none between
    Header last_head, refused_head;
    std::function<void()> while_told, while_status_told;
};

class FakeTopic final : public EntityTopic {
  public:
    Result<void> clientMsg(const std::string& server, const Header& head, std::string_view message) override {
        if (down) return Refusal{RefusalCode::NotConnected, "down", {}};
        at = server;
        role = head.sender.role;
        lines.push_back(head.sender.name + " to " + head.entity + " " + std::string(message));
        return {};
    }
    void clientMsgDataSeq(const std::string&, const Header& head, std::string_view) override {
        lines.push_back("data to " + head.entity);
    }
    void clientRequest(const Header& head) override { lines.push_back("request" + head.entity); }
    void frontEndServerUpdate(Lane lane, const ServerAnnouncement& self, const std::string& users) override {
        ++(lane == Lane::Signal ? beats : announcements);
        announced = self;
        announced_users = users;
    }
    void reach(const std::vector<ServerAnnouncement>& servers) override {
        reached.clear();
        for (const auto& server : servers) reached.push_back(server.signals);
    }
    void clientUpdate(const Header& head, ClientChange change) override {
        lines.push_back((change == ClientChange::Lost ? "lost to " : "ended to ") + head.entity);
    }
    void stopSignal(const Header& head, StopCause cause) override {
        lines.push_back(std::string("stop (") + toString(cause) + ") by " + head.sender.name + " to " +
                        head.entity);
        numbers.push_back(head.sequence);
    }
    void stopSignals(const Header& head, const std::vector<std::string>& entities, StopCause cause) override {
        std::string line = std::string("stop (") + toString(cause) + ") by " + head.sender.name + " to";
        for (const auto& entity : entities) line += " " + entity;
        lines.push_back(line);
        numbers.push_back(head.sequence);
    }
    void resetSignal(const Header& head) override { lines.push_back("reset to " + head.entity); }
    void clearSignal(const Header& head) override { lines.push_back("clear to " + head.entity); }
    std::vector<std::string> take() { return std::exchange(lines, {}); }

    std::vector<std::string> lines;
    std::vector<std::int64_t> numbers;  // of stops
    bool down = false;
    std::string at;              // whose the entity of the last message was
    Role role = Role::Observer;  // of its sender
    int beats = 0;
    int announcements = 0;
    ServerAnnouncement announced;
    std::string announced_users;
    std::vector<std::string> reached;
};

class FakeUsers final : public users::PresentUsers {
  public:
    std::optional<Role> clientRole(const std::string& user) const override {
        const auto its = roles.find(user);
        return its == roles.end() ? Role::Admin : its->second;
    }
    bool mayBeEntityManager(const std::string&) const override { return false; }
    std::shared_ptr<const users::Access> access() const override { return lists; }
    std::string fingerprint() const override { return "11111111"; }
    /// Lines of a file of users, without their '@'.
    void list(const std::vector<std::vector<std::string_view>>& lines) {
        auto next = std::make_shared<users::Access>();
        for (auto words : lines) {
            const auto first = "@" + std::string(words.at(0));
            words[0] = first;
            EXPECT_EQ(next->add(words), "");
        }
        lists = next;
    }

    std::shared_ptr<const users::Access> lists = std::make_shared<users::Access>();
    std::map<std::string, std::optional<Role>> roles;  ///< of the others it is Admin
};

class FrontEndTest : public testing::Test {
  protected:
    struct Peer {
        std::shared_ptr<FakeOutbox> data = std::make_shared<FakeOutbox>();
        std::shared_ptr<FakeOutbox> signal = std::make_shared<FakeOutbox>();
        FrontEndCore::ClientRef client;
        std::string id() const { return FrontEndCore::me(*client).id; }
    };
    Peer join(const std::string& name = "client1", const std::string& user = {}, Role role = Role::Operator,
              const void* router = nullptr) {
        Peer peer;
        peer.data->router = router;
        peer.client = core.setCallback(name, role, peer.data, user).value();
        EXPECT_TRUE(core.attach(FrontEndCore::token(*peer.client), peer.signal).ok());
        here.emplace(peer.id(), peer.client);
        return peer;
    }
    /// The client wants a check-out.
    void ask(const FrontEndCore::ClientRef& client, const std::string& entity) {
        auto head = to(entity);
        head.msg_type = kMsgCheckOut;
        const auto before = topic.lines;
        core.sendToEntity(client, head, "check-out");
        topic.lines = before;
    }
    void entity(const std::string& id) {
        Registration registration;
        registration.entity = id;
        registration.name = id;
        core.entityBasicPrflUpdate(Presence::Joined, registration, "profile");
    }
    /// Of an entity that its holder has asked for, where there is one.
    void status(const std::string& id, EntityState state, const std::string& holder = {}) {
        if (const auto client = here.find(holder); client != here.end()) ask(client->second, id);
        tell(id, state, holder);
    }
    void tell(const std::string& id, EntityState state, const std::string& holder) {
        EntityStatus out;
        out.entity = id;
        out.state = state;
        out.holder = {holder, "somebody", Role::Operator};
        core.entityUpdate(out);
    }
    static Header to(const std::string& entity) {
        Header head;
        head.entity = entity;
        head.sender = {"forged", "forged", Role::Admin};
        return head;
    }
    void pass(Duration time) {
        const auto end = clock.now() + time;
        while (clock.now() < end) {
            const auto next = std::min(core.onTimer(), core.tellHeld());
            clock.set(std::min(std::max(next, clock.now() + 1ms), end));
        }
        core.onTimer();
        core.tellHeld();
    }

    ManualClock clock;
    SeededRandom random{1};
    FakeTopic topic;
    std::vector<std::string> notes;
    std::map<std::string, FrontEndCore::ClientRef> here;
    FrontEndCoreSettings settings;
    test::RecordedAudit trail;
    FakeUsers users;
    int wakes = 0;  ///< for what is held
    FrontEndCore core{settings,
                      clock,
                      random,
                      topic,
                      [this](const std::string& line) { notes.push_back(line); },
                      [this](FrontEndCore::Due due) { wakes += due == FrontEndCore::Due::TellHeld ? 1 : 0; },
                      nullptr,
                      &trail,
                      &users};
};

TEST_F(FrontEndTest, TellsAClientWhoIsThereAndWhatChanges) {
    entity("e1");
    status("e1", EntityState::UNAV);
    const auto peer = join();
    EXPECT_THAT(peer.data->take(), ElementsAre("joined e1", "e1 UNAV"));
    status("e1", EntityState::IDLE);
    status("e1", EntityState::IDLE);
    entity("e2");
    core.entityBasicPrflUpdate(Presence::Left, {"e1"}, {});
    status("e1", EntityState::BUSY);
    EXPECT_THAT(peer.data->take(), ElementsAre("e1 IDLE", "joined e2", "left e1"));
}

TEST_F(FrontEndTest, TheLastWordAboutAnEntityIsTheTrueOneThoughItChangesWhileAClientIsTold) {
    entity("e1");
    auto data = std::make_shared<FakeOutbox>();
    // As another thread would, in the middle of the first push.
    data->while_told = [&] { core.entityBasicPrflUpdate(Presence::Left, {"e1"}, {}); };
    ASSERT_TRUE(core.setCallback("client1", Role::Operator, data).ok());
    EXPECT_EQ(data->lines.back(), "left e1");

    entity("e2");
    auto other = std::make_shared<FakeOutbox>();
    other->while_told = [&] { status("e2", EntityState::ERR); };
    ASSERT_TRUE(core.setCallback("client2", Role::Operator, other).ok());
    EXPECT_EQ(other->lines.back(), "e2 ERR");
}

// Many changes at once (ADR 0048).
class ManyStatuses : public FrontEndTest {
  protected:
    static constexpr auto kFirst = EntityState::IDLE, kSecond = EntityState::ERR;
    static constexpr int kEntities = 20;
    ManyStatuses() {
        for (int i = 0; i < kEntities; ++i) {
            entity("e" + std::to_string(i));
            status("e" + std::to_string(i), EntityState::UNAV);
        }
        observer = joinAndUseUp("observer");
    }
    /// A client that has been told as many statuses at once as it may be.
    Peer joinAndUseUp(const std::string& name, const std::string& user = {}) {
        auto peer = join(name, user, Role::Observer);
        for (std::uint32_t i = 0; i < kStatusesAtOnce; ++i) status("e19", i % 2 == 0 ? kFirst : kSecond);
        peer.data->take();
        wakes = 0;
        return peer;
    }
    Peer observer;
};

TEST_F(ManyStatuses, AreToldALittleLaterAndOfEachEntityOnlyTheLast) {
    for (int i = 0; i < 5; ++i) {
        status("e1", kFirst);
        status("e0", i % 2 == 0 ? kFirst : kSecond);
        status("e1", kSecond);
    }
    EXPECT_THAT(observer.data->take(), IsEmpty());
    EXPECT_EQ(wakes, 1);
    EXPECT_LE(core.tellHeld(), clock.now() + kStatusesHeld);
    pass(kStatusesHeld);
    EXPECT_THAT(observer.data->take(), ElementsAre("e1 ERR", "e0 IDLE"));
    pass(1s);
    EXPECT_THAT(observer.data->take(), IsEmpty());
    status("e1", kFirst);
    EXPECT_THAT(observer.data->take(), ElementsAre("e1 IDLE"));
}

TEST_F(ManyStatuses, GoOnWhereTheTimeOfTheLaboratoryStands) {
    ManualClock machine;
    FrontEndCore its(
        settings, clock, random, topic, [](const std::string&) {}, [](auto) {}, nullptr, nullptr, nullptr,
        &machine);
    const auto data = std::make_shared<FakeOutbox>();
    ASSERT_TRUE(its.setCallback("client1", Role::Operator, data).ok());
    Registration registration;
    registration.entity = registration.name = "e1";
    its.entityBasicPrflUpdate(Presence::Joined, registration, "");
    EntityStatus out;
    out.entity = "e1";
    for (int i = 0; i < 20; ++i) {
        out.state = i % 2 == 0 ? kFirst : kSecond;
        its.entityUpdate(out);
    }
    data->take();
    machine.advance(kStatusesHeld);
    its.tellHeld();
    EXPECT_THAT(data->take(), ElementsAre("e1 ERR"));
}

TEST_F(ManyStatuses, AreToldAtOnceToWhoHoldsTheEntityOrDid) {
    const auto holder = joinAndUseUp("holder");
    status("e0", kFirst);
    EXPECT_THAT(holder.data->take(), IsEmpty());
    status("e0", EntityState::REG, holder.id());
    EXPECT_THAT(holder.data->take(), ElementsAre("e0 REG"));
    status("e0", kFirst);
    EXPECT_THAT(holder.data->take(), ElementsAre("e0 IDLE"));
    pass(kStatusesHeld);
    EXPECT_THAT(holder.data->take(), Not(Contains(HasSubstr("e0 "))));
}

// A watchdog waits for the one, and who resumes a lease for the other.
TEST_F(ManyStatuses, ThatAnEntityIsBusyOrBackIsToldAtOnce) {
    status("e0", kFirst);
    status("e0", EntityState::BUSY);
    EXPECT_THAT(observer.data->take(), ElementsAre("e0 BUSY"));
    status("e0", kFirst);
    core.entityBasicPrflUpdate(Presence::Left, {"e0"}, {});
    entity("e0");
    status("e0", kSecond);
    EXPECT_THAT(observer.data->take(), ElementsAre("left e0", "joined e0", "e0 ERR"));
    pass(kStatusesHeld);
    EXPECT_THAT(observer.data->take(), IsEmpty());
}

TEST_F(ManyStatuses, OfAnEntityThatHasLeftNoneIsTold) {
    status("e0", kFirst);
    status("e1", kFirst);
    core.entityBasicPrflUpdate(Presence::Left, {"e0"}, {});
    observer.data->take();
    pass(kStatusesHeld);
    EXPECT_THAT(observer.data->take(), ElementsAre("e1 IDLE"));
}

TEST_F(ManyStatuses, TheLastWordIsTheTrueOneThoughItChangesWhileAClientIsTold) {
    const auto leave = [&] { core.entityBasicPrflUpdate(Presence::Left, {"e0"}, {}); };
    const auto told = [&](std::function<void()> meanwhile) {  // as another thread would
        status("e0", kFirst);
        observer.data->take();
        observer.data->while_status_told = std::move(meanwhile);
        pass(kStatusesHeld);
        return observer.data->take();
    };
    EXPECT_EQ(told([&] { status("e0", kSecond); }).back(), "e0 ERR");
    // It has left, and comes back while that is told once more.
    const auto back = told([&] {
        leave();
        observer.data->while_told = [&] {
            entity("e0");
            status("e0", kSecond);
        };
    });
    EXPECT_EQ(back.back(), "e0 ERR");
    EXPECT_THAT(back, Contains("joined e0"));
    // It has left and come back, and has no status yet.
    EXPECT_EQ(told([&] {
                  leave();
                  entity("e0");
              }).back(),
              "joined e0");
    status("e0", kSecond);
    EXPECT_EQ(told(leave).back(), "left e0");
}

TEST_F(ManyStatuses, AreNotToldToWhoSeesTheEntityNoMore) {
    const auto guest = joinAndUseUp("guest", "guest");
    status("e0", kFirst);
    users.list({{"see", "e0", "ann"}});
    core.usersChanged();
    EXPECT_THAT(guest.data->take(), ElementsAre("left e0"));
    pass(kStatusesHeld);
    EXPECT_THAT(guest.data->take(), Not(Contains(HasSubstr("e0 "))));
    // The lists change while it is told.
    status("e1", kFirst);
    status("e2", kFirst);
    guest.data->take();
    guest.data->while_status_told = [&] {
        users.list({{"see", "e0", "ann"}, {"see", "e2", "ann"}});
        core.usersChanged();
    };
    pass(kStatusesHeld);
    EXPECT_EQ(guest.data->take().back(), "left e2");
}

TEST_F(FrontEndTest, AllStatusesAreToldAFewTimesInASecond) {
    entity("e1");
    const auto peer = join();
    peer.data->take();
    const auto ask = [&] {
        Header head;
        head.msg_type = kMsgStatus;
        core.sendRequest(peer.client, head, {});
    };
    for (int i = 0; i < 4; ++i) ask();
    EXPECT_THAT(peer.data->take(), testing::AllOf(SizeIs(4), testing::Each("joined e1")));
    ask();
    EXPECT_THAT(peer.data->take(), ElementsAre("refused OVERLOADED"));
    EXPECT_THAT(notes.back(), HasSubstr("client client1 (" + peer.id() + ") is refused: all statuses"));
    const auto lines = notes.size();
    for (int i = 0; i < 100; ++i) ask();
    EXPECT_EQ(notes.size(), lines + 7);
    peer.data->take();
    clock.advance(1s);
    ask();
    EXPECT_THAT(peer.data->take(), ElementsAre("joined e1"));
}

TEST_F(FrontEndTest, AnEntityThatAClientHasNotAskedMayLeaveLittleForIt) {
    entity("e1");
    const auto peer = join();
    const auto receipt = [&](Lane lane) {
        auto head = to("e1");
        head.sender = FrontEndCore::me(*peer.client);
        core.entityMsg(lane, head, "word");
    };
    peer.data->slow = peer.signal->slow = true;
    peer.data->take();
    receipt(Lane::Data);
    EXPECT_THAT(peer.data->take(), IsEmpty());
    EXPECT_THAT(notes.back(), HasSubstr("client1 reads slowly, and entity e1 sends it more than its share"));
    ask(peer.client, "e1");
    peer.data->take();
    receipt(Lane::Data);
    EXPECT_THAT(peer.data->take(), ElementsAre("msg word")) << "what it has asked for it must read";
    receipt(Lane::Signal);
    EXPECT_THAT(peer.signal->take(), IsEmpty());
    EXPECT_FALSE(peer.data->disconnected);
    const auto other = join("client2");
    other.data->slow = true;
    other.data->take();
    auto to_all = to("e1");
    to_all.sender = {};
    for (int i = 0; i < 100; ++i) core.entityMsg(Lane::Data, to_all, "word");
    EXPECT_THAT(other.data->take(), IsEmpty());
    EXPECT_THAT(notes.back(), HasSubstr("client2 reads slowly"));
    EXPECT_LE(std::count_if(notes.begin(), notes.end(),
                            [](const auto& line) { return line.find("slowly") != std::string::npos; }),
              8);
}

TEST_F(FrontEndTest, WhoAsksAnEntityThatIsJustJoiningIsItsHolderWhenItSaysSo) {
    const auto peer = join();
    for (int i = 0; i < 300; ++i) ask(peer.client, "nobody" + std::to_string(i));
    const auto other = join("client2");
    ask(other.client, "e1");
    entity("e1");
    tell("e1", EntityState::BUSY, other.id());
    for (const auto& note : notes) EXPECT_THAT(note, Not(HasSubstr("not believed")));
    pass(300ms);
    EXPECT_TRUE(other.data->disconnected) << "its watchdog is the short one";
    EXPECT_FALSE(peer.data->disconnected);
    topic.lines.clear();
    core.leave(peer.client, Ending::Ended, "done");
    EXPECT_THAT(topic.lines, SizeIs(256)) << "of names that nobody has, so many are kept";
}

TEST_F(FrontEndTest, ANameIsCutBetweenTwoCharacters) {
    const auto peer = join("x" + std::string(254, 'y') + "\xc3\xab");
    EXPECT_EQ(FrontEndCore::me(*peer.client).name, "x" + std::string(254, 'y'));
    EXPECT_EQ(FrontEndCore::me(*join("Zo\xc3").client).name, "Zo\xef\xbf\xbd");
}

TEST_F(FrontEndTest, AStatusThatNobodyHasHeardIsNotTold) {
    entity("e1");
    auto data = std::make_shared<FakeOutbox>();
    const auto client = core.setCallback("client1", Role::Operator, data).value();
    EXPECT_THAT(data->take(), ElementsAre("joined e1"));
    EXPECT_EQ(FrontEndCore::told(*client), 0U)
        << "whoever waits for all waits for no status that may never come";
    status("e1", EntityState::UNAV);
    EXPECT_THAT(data->take(), ElementsAre("e1 UNAV"));
    status("e1", EntityState::UNAV);
    EXPECT_THAT(data->take(), IsEmpty());
}

TEST_F(FrontEndTest, SessionsOfOneUserShareTheirPartOfEveryQueue) {
    const auto keyOf = [&](const std::string& user) {
        return senderKey(
            FrontEndCore::me(
                *core.setCallback("pc", Role::Operator, std::make_shared<FakeOutbox>(), user).value())
                .id);
    };
    EXPECT_EQ(keyOf("bob"), keyOf("bob"));
    EXPECT_NE(keyOf("bob"), keyOf("ann"));
    EXPECT_NE(keyOf(""), keyOf("")) << "where there are no users each session counts for itself";
}

TEST_F(FrontEndTest, AClientIsToldHowManyEntitiesItWasToldOf) {
    for (const auto* name : {"e1", "e2"}) {
        entity(name);
        status(name, EntityState::IDLE);
    }
    auto data = std::make_shared<FakeOutbox>();
    data->while_told = [&] { core.entityBasicPrflUpdate(Presence::Left, {"e1"}, {}); };
    const auto client = core.setCallback("client1", Role::Operator, data).value();
    EXPECT_EQ(FrontEndCore::told(*client), 1U);
}

TEST_F(FrontEndTest, ASignOfLifeBeforeATaskBeganDoesNotShortenItsTimeOut) {
    entity("e1");
    const auto peer = join();
    core.keepAlive(peer.client);
    clock.advance(1s);
    status("e1", EntityState::BUSY, peer.id());
    pass(249ms);
    EXPECT_EQ(core.clients(), 1U);
    pass(1ms);
    EXPECT_EQ(core.clients(), 0U);
}

/// Random bytes are drawn while the monitor is locked: what happens then happens to a locked monitor.
class WhileLocked final : public RandomSource {
  public:
    void fill(void* bytes, std::size_t count) override {
        if (now) std::exchange(now, nullptr)();
        random.fill(bytes, count);
    }
    std::function<void()> now;
    SeededRandom random{1};
};

TEST(FrontEndLocks, SignsOfLifeAndStopsDoNotWaitForTheMonitor) {
    ManualClock clock;
    WhileLocked random;
    FakeTopic topic;
    FrontEndCore core(
        {}, clock, random, topic, [](const std::string&) {}, [](auto) {});
    const auto client = core.setCallback("client1", Role::Operator, std::make_shared<FakeOutbox>()).value();
    Header head;
    head.entity = "e1";
    random.now = [&] {
        core.keepAlive(client);
        core.sendStopSignal(client, head, StopCause::Requested);
    };
    ASSERT_TRUE(core.setCallback("eve", Role::Operator, std::make_shared<FakeOutbox>()).ok());
    EXPECT_THAT(topic.take(), ElementsAre("stop (requested) by client1 to e1"));
}

TEST_F(FrontEndTest, AUserWhoIsRemovedIsLostAndTheRobotsStop) {
    entity("e1");
    const auto ann = join("tablet", "ann");
    const auto bob = join("laptop", "bob");
    status("e1", EntityState::BUSY, ann.id());
    topic.take();
    core.usersChanged();
    EXPECT_EQ(core.clients(), 2U);  // nobody has less than before
    users.roles["ann"] = std::nullopt;
    core.usersChanged();
    EXPECT_THAT(topic.take(), ElementsAre("stop (client lost) by tablet to e1", "lost to e1"));
    EXPECT_TRUE(ann.data->disconnected);
    EXPECT_TRUE(ann.signal->disconnected);
    EXPECT_FALSE(bob.data->disconnected);
    EXPECT_THAT(notes.back(),
                HasSubstr("client tablet is lost: the user 'ann' was removed; it held 1 entity"));
    // What it sends from now on goes nowhere, though its connection may still be open; only its stops do.
    for (const auto* type : {kMsgRearm, kMsgTask, kMsgCheckOut}) {
        auto head = to("e1");
        head.msg_type = type;
        core.sendToEntity(ann.client, head, "message");
        core.sendToEntityDataSeq(ann.client, head, "message");
    }
    core.sendResetSignal(ann.client, to("e1"));
    core.sendClearSignal(ann.client, to("e1"));
    core.sendStopSignal(ann.client, to("e1"), StopCause::Drill);
    core.sendStopSignals(ann.client, to(""), {"e1"}, StopCause::Drill);
    EXPECT_THAT(topic.take(), IsEmpty());
    ann.data->take();
    Header all;
    all.msg_type = kMsgStatus;
    core.sendRequest(ann.client, all, {});
    EXPECT_THAT(ann.data->take(), ElementsAre("refused NOT_CONNECTED"));
    core.sendStopSignal(ann.client, to("e1"), StopCause::Requested);
    core.sendStopSignals(ann.client, to(""), {"e1"}, StopCause::Requested);
    EXPECT_THAT(topic.take(),
                ElementsAre("stop (requested) by tablet to e1", "stop (requested) by tablet to e1"));
    EXPECT_EQ(
        core.setCallback("tablet", Role::Operator, std::make_shared<FakeOutbox>(), "ann").refusal().code,
        RefusalCode::PermissionDenied);
}

TEST_F(FrontEndTest, AUserWhoseRoleIsLowerIsLostAndOneWhoseRoleIsHigherStays) {
    const auto ann = join("tablet", "ann", Role::Admin);
    const auto bob = join("laptop", "bob", Role::Observer);
    const auto nobody = join("without users");
    users.roles = {{"ann", Role::Operator}, {"bob", Role::Admin}};
    core.usersChanged();
    EXPECT_TRUE(ann.data->disconnected);
    EXPECT_FALSE(bob.data->disconnected);
    EXPECT_EQ(FrontEndCore::me(*bob.client).role, Role::Observer);
    EXPECT_FALSE(nobody.data->disconnected);
    EXPECT_THAT(notes.back(), HasSubstr("the role of the user 'ann' became operator"));
    // One that was logged in before the change, and comes after it.
    EXPECT_THAT(
        core.setCallback("tablet", Role::Admin, std::make_shared<FakeOutbox>(), "ann").refusal().message,
        HasSubstr("log in again"));
    EXPECT_TRUE(core.setCallback("tablet", Role::Operator, std::make_shared<FakeOutbox>(), "ann").ok());
}

// The rows of the table of rights, each role, and each combination of what lists keep back.
TEST_F(FrontEndTest, ListsKeepBackWhatTheTableOfRightsSays) {
    entity("e1");
    entity("e2");
    for (const auto role : {Role::Observer, Role::Operator, Role::Admin}) {
        for (unsigned kept_back = 0; kept_back < 16; ++kept_back) {
            std::vector<std::vector<std::string_view>> lines;
            const auto has = [&](EntityRight right) {
                return (kept_back & (1U << static_cast<unsigned>(right))) == 0;
            };
            for (const auto right : kEntityRights)
                if (!has(right)) lines.push_back({toString(right), "e1", "-"});
            users.list(lines);
            core.usersChanged();
            const auto peer = join("client", "ann", role);
            const bool sees = has(EntityRight::See);
            EXPECT_EQ(testing::Value(peer.data->take(), Contains("joined e1")), sees);
            for (const auto& right : rights()) {
                SCOPED_TRACE(std::string(right.msg_type) + " as " + toString(role) + " without " +
                             std::to_string(kept_back));
                peer.data->take();
                peer.signal->take();
                topic.take();
                auto head = to("e1");
                head.msg_type = right.msg_type;
                if (right.msg_type == kStopOperation) {
                    core.sendStopSignal(peer.client, head, StopCause::Requested);
                    EXPECT_THAT(topic.take(), ElementsAre("stop (requested) by client to e1"));
                    EXPECT_THAT(peer.signal->take(), ElementsAre("stop accepted 1"));
                    continue;
                }
                if (right.number == 0) {
                    const bool resets = right.msg_type == kResetOperation;
                    resets ? core.sendResetSignal(peer.client, head)
                           : core.sendClearSignal(peer.client, head);
                    EXPECT_EQ(topic.take().size(), sees ? 1U : 0U);
                    EXPECT_EQ(peer.signal->take(), sees ? std::vector<std::string>{}
                                                        : std::vector<std::string>{"refused UNKNOWN_ENTITY"});
                    // Of every entity: it goes to those that the client sees.
                    head.entity.clear();
                    resets ? core.sendResetSignal(peer.client, head)
                           : core.sendClearSignal(peer.client, head);
                    const std::string verb = resets ? "reset to " : "clear to ";
                    if (kept_back == 0)
                        EXPECT_THAT(topic.take(), ElementsAre(verb));
                    else if (sees)
                        EXPECT_THAT(topic.take(), UnorderedElementsAre(verb + "e1", verb + "e2"));
                    else
                        EXPECT_THAT(topic.take(), ElementsAre(verb + "e2"));
                    EXPECT_THAT(peer.signal->take(), IsEmpty());
                    continue;
                }
                if (right.who == Who::Nobody) continue;
                core.sendToEntity(peer.client, head, "message");
                // RUN and RESOURCE have two rows each, and need the same.
                const bool may = sees && (!right.needs || has(*right.needs));
                EXPECT_EQ(peer.data->take(), may     ? std::vector<std::string>{}
                                             : !sees ? std::vector<std::string>{"refused UNKNOWN_ENTITY"}
                                                     : std::vector<std::string>{"refused PERMISSION_DENIED"});
                EXPECT_EQ(topic.take().size(), may ? 1U : 0U);
                if (!may) continue;
                const bool tamed = right.msg_type == kMsgCheckOut && !has(EntityRight::Force);
                EXPECT_EQ(topic.role, tamed ? std::min(role, Role::Operator) : role);
                // As droppable data the same is let through and kept back, without a word.
                core.sendToEntityDataSeq(peer.client, head, "message");
                EXPECT_EQ(topic.take().size(), 1U);
            }
            peer.data->take();
            topic.take();
            auto other = to("e2");
            other.msg_type = kMsgCheckOut;
            core.sendToEntity(peer.client, other, "message");
            EXPECT_THAT(topic.take(), SizeIs(1));
            core.leave(peer.client, Ending::Ended, "");
        }
    }
}

TEST_F(FrontEndTest, AnEntityThatIsNotSeenIsNotThereForItsClient) {
    users.list({{"see", "e1", "bob"}});
    core.usersChanged();
    entity("e1");
    entity("e2");
    status("e1", EntityState::IDLE);
    const auto ann = join("tablet", "ann");
    const auto bob = join("laptop", "bob");
    EXPECT_THAT(ann.data->take(), ElementsAre("joined e2"));
    EXPECT_THAT(bob.data->take(), UnorderedElementsAre("joined e1", "e1 IDLE", "joined e2"));
    status("e1", EntityState::UNAV);
    Header head;
    head.entity = "e1";
    head.sender.id = ann.id();
    core.entityMsg(Lane::Data, head, "answer");
    core.entityMsgDataSeq(head, "samples");
    Header all;
    all.msg_type = kMsgStatus;
    core.sendRequest(ann.client, all, {});
    core.entityBasicPrflUpdate(Presence::Left, {"e1"}, {});
    EXPECT_THAT(ann.data->take(), ElementsAre("joined e2"));
    EXPECT_THAT(bob.data->take(), ElementsAre("e1 UNAV", "left e1"));
    // The same text as of one that is not there.
    const auto refusal = [&](const std::string& name) {
        ann.data->take();
        core.sendToEntity(ann.client, to(name), "text");
        return ann.data->take();
    };
    EXPECT_THAT(refusal("e1"), ElementsAre("refused UNKNOWN_ENTITY"));
    EXPECT_EQ(refusal("e9"), refusal("e1"));
}

// Also of what its sender does not see: whoever stands beside a robot must be able to stop it.
TEST_F(FrontEndTest, NoStopAndNoReceiptIsKeptBack) {
    users.list({{"see", "*", "bob"}});
    core.usersChanged();
    entity("e1");
    entity("e2");
    const auto ann = join("tablet", "ann", Role::Observer);
    core.sendStopSignal(ann.client, to(""), StopCause::Requested);
    core.sendStopSignal(ann.client, to("e1"), StopCause::Requested);
    core.sendStopSignals(ann.client, to(""), {"e1", "e2"}, StopCause::Requested);
    EXPECT_THAT(topic.take(),
                ElementsAre("stop (requested) by tablet to ", "stop (requested) by tablet to e1",
                            "stop (requested) by tablet to e1 e2"));
    EXPECT_THAT(ann.signal->take(), ElementsAre("stop accepted 2", "stop accepted 1", "stop accepted 2"));
    Header head;
    head.entity = "e1";
    head.sender.id = ann.id();
    core.entityMsg(Lane::Signal, head, "receipt");
    EXPECT_THAT(ann.signal->take(), ElementsAre("msg receipt"));
}

TEST_F(FrontEndTest, DrillsGoOnlyToWhatIsSeen) {
    users.list({{"see", "e1", "bob"}});
    core.usersChanged();
    for (const auto* id : {"e1", "e2"}) entity(id);
    const auto ann = join("tablet", "ann");
    core.sendStopSignal(ann.client, to(""), StopCause::Drill);
    core.sendStopSignal(ann.client, to("e1"), StopCause::Drill);
    core.sendStopSignals(ann.client, to(""), {"e1", "e2"}, StopCause::Drill);
    EXPECT_THAT(topic.take(), ElementsAre("stop (drill) by tablet to e2", "stop (drill) by tablet to e2"));
    EXPECT_THAT(ann.signal->take(), ElementsAre("stop accepted 1", "refused UNKNOWN_ENTITY",
                                                "refused UNKNOWN_ENTITY", "stop accepted 1"));
}

TEST_F(FrontEndTest, ClientsAreToldWhatTheySeeAfterTheListsHaveChanged) {
    entity("e1");
    entity("e2");
    status("e1", EntityState::IDLE);
    const auto ann = join("tablet", "ann");
    const auto nobody = join("without users");
    ann.data->take();
    nobody.data->take();
    users.list({{"see", "e1", "bob"}});
    core.usersChanged();
    EXPECT_THAT(ann.data->take(), ElementsAre("left e1"));
    core.usersChanged();
    EXPECT_THAT(ann.data->take(), IsEmpty());
    users.list({{"see", "e2", "bob"}});
    core.usersChanged();
    EXPECT_THAT(ann.data->take(), UnorderedElementsAre("joined e1", "e1 IDLE", "left e2"));
    EXPECT_THAT(nobody.data->take(), IsEmpty());
    EXPECT_EQ(core.clients(), 2U);
}

TEST_F(FrontEndTest, WhoHoldsWhatItMayNoLongerCheckOutIsLost) {
    entity("e1");
    entity("e2");
    const auto ann = join("tablet", "ann");
    const auto bob = join("laptop", "bob");
    status("e1", EntityState::BUSY, ann.id());
    status("e2", EntityState::IDLE);
    ask(bob.client, "e2");  // and it was given back
    topic.take();
    users.list({{"rearm", "*", "-"}});
    core.usersChanged();
    EXPECT_EQ(core.clients(), 2U);
    users.list({{"checkout", "*", "-"}});
    core.usersChanged();
    EXPECT_TRUE(ann.data->disconnected);
    EXPECT_FALSE(bob.data->disconnected);
    EXPECT_THAT(topic.take(),
                UnorderedElementsAre("stop (client lost) by tablet to e1", "lost to e1", "ended to e2"));
    EXPECT_THAT(notes.back(), HasSubstr("the user 'ann' may no longer check out e1"));
}

TEST_F(FrontEndTest, WhoWaitsForWhatItMayNoLongerCheckOutIsRefusedAndStays) {
    entity("e1");
    entity("e2");
    const auto ann = join("tablet", "ann");
    const auto bob = join("laptop", "bob");
    const auto boss = join("desk", "boss");
    status("e1", EntityState::COLLAB, ann.id());
    status("e1", EntityState::IDLE);  // given back: it neither holds nor waits
    ask(bob.client, "e1");
    ask(boss.client, "e1");
    EntityStatus now;
    now.entity = "e1";
    now.state = EntityState::BUSY;
    now.holder = {boss.id(), "desk", Role::Operator};
    now.waiting = 1;
    core.entityUpdate(now);
    for (const auto* peer : {&ann, &bob, &boss}) peer->data->take();
    topic.take();
    users.list({{"checkout", "e1", "boss"}});
    core.usersChanged();
    EXPECT_EQ(core.clients(), 3U);
    EXPECT_THAT(topic.take(), ElementsAre("ended to e1", "ended to e1"));
    EXPECT_THAT(bob.data->take(), ElementsAre("refused PERMISSION_DENIED"));
    EXPECT_THAT(ann.data->take(), IsEmpty()) << "it has no check-out under way";
    EXPECT_THAT(boss.data->take(), IsEmpty());
    core.usersChanged();
    EXPECT_THAT(topic.take(), IsEmpty());
}

TEST_F(FrontEndTest, ARefusalOfWhoWaitsIsThatOfItsCheckOut) {
    entity("e1");
    const auto ann = join("tablet", "ann");
    auto head = to("e1");
    head.msg_type = kMsgCheckOut;
    head.sequence = 77;
    core.sendToEntity(ann.client, head, "check-out");
    users.list({{"checkout", "e1", "-"}});
    core.usersChanged();
    EXPECT_EQ(ann.data->refused_head.sequence, 77);
    EXPECT_EQ(ann.data->refused_head.entity, "e1");
}

// Its check-out was passed on while it had the right, and granted when it no longer had.
TEST_F(FrontEndTest, AHolderThatLostTheRightBeforeItsGrantIsLost) {
    entity("e1");
    const auto ann = join("tablet", "ann");
    ask(ann.client, "e1");
    users.list({{"checkout", "e1", "-"}});
    core.usersChanged();
    topic.take();
    EXPECT_FALSE(ann.data->disconnected);
    tell("e1", EntityState::BUSY, ann.id());
    EXPECT_TRUE(ann.data->disconnected);
    EXPECT_THAT(topic.take(), ElementsAre("stop (client lost) by tablet to e1", "lost to e1"));
    EXPECT_THAT(notes.back(), HasSubstr("the user 'ann' may no longer check out e1"));
}

TEST_F(FrontEndTest, AnEntityThatNamesAHolderWithoutTheRightWhoHasNotAskedCostsItNoSession) {
    entity("e1");
    users.list({{"checkout", "e1", "-"}});
    core.usersChanged();
    const auto ann = join("tablet", "ann");
    tell("e1", EntityState::BUSY, ann.id());
    users.list({{"checkout", "e1", "bob"}});
    core.usersChanged();
    EXPECT_FALSE(ann.data->disconnected);
}

TEST_F(FrontEndTest, AHolderThatLosesTheRightByTheEntitysNewNameIsLost) {
    users.list({{"checkout", "arm-*", "bob"}});
    core.usersChanged();
    entity("e1");
    const auto ann = join("tablet", "ann");
    const auto bob = join("laptop", "bob");
    const auto renamed = [&](const std::string& name) {
        Registration registration;
        registration.entity = "e1";
        registration.name = name;
        core.entityBasicPrflUpdate(Presence::Changed, registration, "profile");
    };
    status("e1", EntityState::BUSY, bob.id());
    renamed("arm-1");
    EXPECT_FALSE(bob.data->disconnected);
    renamed("e1");
    status("e1", EntityState::IDLE);
    status("e1", EntityState::BUSY, ann.id());
    topic.take();
    renamed("arm-1");
    EXPECT_TRUE(ann.data->disconnected);
    EXPECT_THAT(topic.take(), ElementsAre("stop (client lost) by tablet to e1", "lost to e1"));
}

TEST_F(FrontEndTest, AnEntityIsOnTheListOfItsPresentName) {
    users.list({{"see", "secret*", "bob"}});
    core.usersChanged();
    entity("e1");
    const auto ann = join("tablet", "ann");
    ann.data->take();
    const auto renamed = [&](const std::string& name) {
        Registration registration;
        registration.entity = "e1";
        registration.name = name;
        core.entityBasicPrflUpdate(Presence::Changed, registration, "profile");
        return ann.data->take();
    };
    EXPECT_THAT(renamed("arm"), ElementsAre("changed arm"));
    EXPECT_THAT(renamed("secret arm"), ElementsAre("left arm"));
    core.sendToEntity(ann.client, to("e1"), "text");
    EXPECT_THAT(ann.data->take(), ElementsAre("refused UNKNOWN_ENTITY"));
    EXPECT_THAT(renamed("arm"), ElementsAre("joined arm"));
}

class LimitedUsers : public FrontEndTest {
  protected:
    LimitedUsers() {
        few.clients_max = 40;
        few.user_sessions = 2;
        few.user_check_outs = 2;
        few.user_messages_per_second = 10;
        few.user_bytes_per_second = 1000;
        limited.emplace(
            few, clock, random, topic, [this](const std::string& line) { notes.push_back(line); },
            [](auto) {});
    }
    Peer enter(const std::string& user) {
        Peer peer;
        peer.client = limited->setCallback("c", Role::Operator, peer.data, user).value();
        return peer;
    }
    void send(const Peer& peer, const std::string& entity, const char* type = kMsgText,
              std::string_view bytes = "message") {
        auto head = to(entity);
        head.msg_type = type;
        limited->sendToEntity(peer.client, head, bytes);
    }
    void hold(const std::string& id, const std::string& holder) {
        EntityStatus now;
        now.entity = id;
        now.state = EntityState::COLLAB;
        now.holder = {holder, holder, Role::Operator};
        limited->entityUpdate(now);
    }
    FrontEndCoreSettings few;
    std::optional<FrontEndCore> limited;
};

TEST_F(LimitedUsers, AUserHasSoManySessionsAndOneMoreCanStillStop) {
    const auto first = enter("ann");
    const auto role = [](const Peer& peer) { return FrontEndCore::me(*peer.client).role; };
    EXPECT_EQ(role(enter("ann")), Role::Operator);
    const auto third = enter("ann");
    EXPECT_EQ(role(third), Role::Observer);
    EXPECT_THAT(third.data->take(),
                ElementsAre(AllOf(HasSubstr("update the user 'ann' has 2 sessions"), HasSubstr("and stop"))));
    limited->sendStopSignal(third.client, to("e1"), StopCause::Requested);
    limited->sendStopSignal(third.client, to(""), StopCause::Requested);
    EXPECT_THAT(topic.take(), ElementsAre("stop (requested) by c to e1", "stop (requested) by c to "));
    send(third, "e1", kMsgWatch);
    EXPECT_EQ(topic.role, Role::Observer);
    send(third, "e1", kMsgCheckOut);
    EXPECT_THAT(third.data->take(), ElementsAre("stop accepted 0", "stop accepted 0", "refused OVERLOADED"))
        << "and not that it is an observer's session";
    EXPECT_EQ(role(enter("bob")), Role::Operator);
    for (int i = 0; i < 5; ++i) EXPECT_EQ(role(enter("")), Role::Operator);
    limited->leave(first.client, Ending::Ended, "");
    limited->leave(first.client, Ending::Lost, "");
    EXPECT_EQ(role(third), Role::Observer) << "until it is opened again";
    EXPECT_EQ(role(enter("ann")), Role::Operator);
    limited->leave(third.client, Ending::Ended, "");
    EXPECT_EQ(role(enter("ann")), Role::Observer);
}

TEST_F(LimitedUsers, SessionsWithoutEndKeepNobodyElseFromStopping) {
    for (std::size_t i = 0; i < few.clients_max - few.clients_max / 4; ++i) enter("ann");
    const auto refused = limited->setCallback("c", Role::Operator, std::make_shared<FakeOutbox>(), "ann");
    EXPECT_EQ(refused.refusal().code, RefusalCode::Overloaded);
    EXPECT_THAT(refused.refusal().message, HasSubstr("the user 'ann' has 2 sessions"));
    for (std::size_t i = 0; i < few.clients_max / 4; ++i) enter("user" + std::to_string(i));
    EXPECT_FALSE(limited->setCallback("c", Role::Operator, std::make_shared<FakeOutbox>(), "bob").ok());
}

TEST_F(LimitedUsers, WhatBelongsToACheckOutThatWasPassedOnIsNotRefused) {
    for (const auto* id : {"e1", "e2", "e3", "e4"}) {
        Registration registration;
        registration.entity = registration.name = id;
        limited->entityBasicPrflUpdate(Presence::Joined, registration, "profile");
    }
    const auto first = enter("ann"), second = enter("ann");
    // All or none: three are prepared, and two of them say so before the third is committed or given up.
    for (const auto* id : {"e1", "e2", "e3"}) send(first, id, kMsgCheckOut, "prepare");
    hold("e1", first.id());
    hold("e2", first.id());
    topic.take();
    send(first, "e3", kMsgCheckOut, "commit");
    send(first, "e3", kMsgCheckOut, "abort");
    EXPECT_THAT(topic.take(), ElementsAre("c to e3 commit", "c to e3 abort"));
    // A session of the same user resumes what another one held, also after that one was lost.
    send(second, "e1", kMsgCheckOut, "resume");
    const auto lost = [&](const std::string& holder) {
        EntityStatus now;
        now.entity = "e4";
        now.holder = {holder, holder, Role::Operator};
        now.orphaned = true;
        limited->entityUpdate(now);
    };
    lost("0b1c2d3e" + first.id().substr(8));
    send(second, "e4", kMsgCheckOut, "resume");
    EXPECT_THAT(topic.take(), ElementsAre("c to e1 resume"));
    EXPECT_THAT(second.data->take(), Contains("refused OVERLOADED")) << "of another user";
    auto anns = first.id();
    anns.back() = anns.back() == '0' ? '1' : '0';
    lost(anns);
    send(second, "e4", kMsgCheckOut, "resume");
    EXPECT_THAT(topic.take(), ElementsAre("c to e4 resume"));
    // Once it has been given back it is a check-out like any other.
    hold("e4", "");
    hold("e3", first.id());
    hold("e3", "");
    send(first, "e3", kMsgCheckOut, "again");
    EXPECT_THAT(topic.take(), IsEmpty());
}

TEST_F(LimitedUsers, AUserHoldsSoManyEntitiesInAllSessions) {
    for (const auto* id : {"e1", "e2", "e3"}) {
        Registration registration;
        registration.entity = registration.name = id;
        limited->entityBasicPrflUpdate(Presence::Joined, registration, "profile");
    }
    const auto first = enter("ann"), second = enter("ann"), bob = enter("bob");
    send(first, "e1", kMsgCheckOut);
    hold("e1", first.id());
    send(second, "e2", kMsgCheckOut);
    hold("e2", second.id());
    hold("e2", second.id());  // told again, and counted once
    topic.take();
    second.data->take();
    send(second, "e3", kMsgCheckOut);
    EXPECT_THAT(second.data->take(), ElementsAre("refused OVERLOADED"));
    EXPECT_THAT(topic.take(), IsEmpty());
    send(first, "e1", kMsgCheckOut);  // what it holds
    send(bob, "e3", kMsgCheckOut);
    EXPECT_THAT(topic.take(), SizeIs(2));
    hold("e1", "");
    send(second, "e3", kMsgCheckOut);
    EXPECT_THAT(topic.take(), SizeIs(1));
    hold("e1", first.id());
    limited->leave(second.client, Ending::Ended, "");
    topic.take();
    send(first, "e3", kMsgCheckOut);
    EXPECT_THAT(topic.take(), SizeIs(1));
}

TEST_F(LimitedUsers, AUserSendsSoMuchInASecondInAllSessions) {
    const auto first = enter("ann"), second = enter("ann"), bob = enter("bob");
    for (int i = 0; i < 5; ++i) {
        send(first, "e1");
        send(second, "e1");
    }
    EXPECT_THAT(topic.take(), SizeIs(10));
    send(second, "e1");
    EXPECT_THAT(second.data->take(), ElementsAre("refused OVERLOADED"));
    // A stop is never refused for what else is sent.
    limited->sendStopSignal(second.client, to("e1"), StopCause::Requested);
    send(bob, "e1");
    EXPECT_THAT(topic.take(), SizeIs(2));
    clock.advance(1s);
    send(second, "e1");
    EXPECT_THAT(topic.take(), SizeIs(1));
    clock.advance(1s);
    const std::string half(600, 'x');
    send(first, "e1", kMsgText, half);
    auto raw = to("e1");
    raw.msg_type = kMsgRaw;
    limited->sendToEntityDataSeq(second.client, raw, half);
    EXPECT_THAT(topic.take(), SizeIs(2));
    send(first, "e1", kMsgText, half);
    EXPECT_THAT(first.data->take(), ElementsAre("refused OVERLOADED"));
    limited->sendToEntityDataSeq(second.client, raw, half);
    EXPECT_THAT(topic.take(), IsEmpty());
}

TEST_F(FrontEndTest, TheSenderIsTheSessionsNeverThePeers) {
    const auto peer = join("client1");
    core.sendToEntity(peer.client, to("e1"), "hello");
    core.sendStopSignal(peer.client, to("e1"), StopCause::ClientLost);
    EXPECT_THAT(topic.take(), ElementsAre("client1 to e1 hello", "stop (requested) by client1 to e1"));
}

TEST_F(FrontEndTest, WhatAClientDoesAndWhatIsRefusedIsRecorded) {
    entity("e1");
    const auto peer = join("client1");
    ask(peer.client, "e1");
    EXPECT_EQ(trail.last(), "command|client1|" + peer.id() + "|e1|CHECKOUT|OK");
    core.sendStopSignal(peer.client, to("e1"), StopCause::Requested);
    EXPECT_EQ(trail.last(), "stop|client1|" + peer.id() + "|e1|stop|OK");
    auto head = to("e1");
    head.sender = FrontEndCore::me(*peer.client);
    core.entityRefusal(Lane::Data, head, {RefusalCode::NotHolder, "no", {}});
    EXPECT_THAT(trail.last(), HasSubstr("|e1|: no|NOT_HOLDER"));
    core.leave(peer.client, Ending::Lost, "it is silent");
    EXPECT_EQ(trail.last(), "session|client1|" + peer.id() + "||is lost: it is silent|");
    EXPECT_EQ(trail.notes().front(), "session|client1|" + peer.id() + "||joined as operator|OK");
}

TEST_F(FrontEndTest, ACommandThatComesAsDroppableDataIsRecordedAsWell) {
    entity("e1");
    const auto peer = join("client1");
    auto head = to("e1");
    head.msg_type = kMsgTask;
    core.sendToEntityDataSeq(peer.client, head, "a task");
    EXPECT_EQ(trail.last(), "command|client1|" + peer.id() + "|e1|TASK|OK");
    head.msg_type = kMsgCollaboration;
    core.sendToEntityDataSeq(peer.client, head, "order");
    EXPECT_THAT(trail.last(), AllOf(HasSubstr("refusal|client1|"), HasSubstr("|PERMISSION_DENIED")));
    const auto before = trail.notes().size();
    head.msg_type = kMsgRaw;
    core.sendToEntityDataSeq(peer.client, head, std::string(129 * 1024, 'x'));
    EXPECT_EQ(trail.notes().size(), before) << "raw data that is refused at 50 Hz fills the trail";
    peer.data->take();
}

TEST_F(FrontEndTest, OnlyTheServerOfTheClientRecordsTheRefusalOfAnEntity) {
    entity("e1");
    const auto peer = join("client1");
    const auto before = trail.notes().size();
    auto head = to("e1");
    head.sender = {"elsewhere", "client2", Role::Operator};
    core.entityRefusal(Lane::Data, head, {RefusalCode::NotHolder, "no", {}});
    EXPECT_EQ(trail.notes().size(), before);
}

TEST_F(FrontEndTest, AcceptsAStopForAllWithoutALease) {
    entity("e1");
    entity("e2");
    const auto peer = join();
    core.sendStopSignal(peer.client, to(""), StopCause::Requested);
    EXPECT_THAT(topic.take(), ElementsAre("stop (requested) by client1 to "));
    EXPECT_THAT(peer.signal->take(), ElementsAre("stop accepted 2"));
}

TEST_F(FrontEndTest, AStopOfSeveralIsOnePublicationAndOneReceipt) {
    entity("e1");
    entity("e2");
    entity("e3");
    const auto peer = join();
    core.sendStopSignals(peer.client, to("forged"), {"e1", "nobody", "e3"}, StopCause::ClientLost);
    EXPECT_THAT(topic.take(), ElementsAre("stop (requested) by client1 to e1 nobody e3"));
    EXPECT_THAT(peer.signal->take(), ElementsAre("stop accepted 2"));
}

TEST_F(FrontEndTest, AListOfStopsIsShortenedAndEachEntityOnItIsStoppedOnce) {
    entity("e1");
    const auto peer = join();
    core.sendStopSignals(peer.client, to(""), {"e1", "e1", "", "e1", ""}, StopCause::Requested);
    EXPECT_THAT(topic.take(), ElementsAre("stop (requested) by client1 to e1 "));
    EXPECT_THAT(peer.signal->take(), ElementsAre("stop accepted 1"));
    std::vector<std::string> many(100'000);
    for (std::size_t i = 0; i < many.size(); ++i) many[i] = std::to_string(i);
    many.front() = "e1";
    core.sendStopSignals(peer.client, to(""), many, StopCause::Requested);
    const auto stops = topic.take();
    ASSERT_EQ(stops.size(), 1U);
    EXPECT_LT(stops.front().size(), 8192 * 6U);
    EXPECT_THAT(stops.front(), HasSubstr("to e1 1 2"));
    EXPECT_THAT(peer.signal->take(), ElementsAre("stop accepted 1", "refused TOO_LARGE"));
}

TEST_F(FrontEndTest, AListThatIsTooLongCostsItsSenderTheSession) {
    const auto peer = join();
    core.sendStopSignals(peer.client, to(""), std::vector<std::string>(4'000'000), StopCause::Requested);
    EXPECT_THAT(topic.take(), Not(IsEmpty())) << "it is still a stop";
    EXPECT_TRUE(peer.data->disconnected);
}

TEST_F(FrontEndTest, AnEntityThatNamesAHolderWhoHasNotAskedForItIsNotBelieved) {
    entity("liar");
    entity("e1");
    const auto peer = join();
    status("e1", EntityState::REG, peer.id());
    tell("liar", EntityState::BUSY, peer.id());
    EXPECT_THAT(notes.back(), HasSubstr("entity liar is not believed: it names client1 as its holder"));
    pass(300ms);
    EXPECT_FALSE(peer.data->disconnected) << "its watchdog is that of a client whose robots stand";
    EXPECT_EQ(core.clients(), 1U);
    core.leave(peer.client, Ending::Lost, "over");
    EXPECT_THAT(topic.take(),
                ElementsAre("stop (client lost) by client1 to e1 liar", "lost to e1", "lost to liar"))
        << "what it says of itself is safe to believe";
}

// The client goes by the same two facts, in whichever order they come.
TEST_F(FrontEndTest, WhoAsksAfterItHasBeenNamedIsWatchedFromThenOn) {
    entity("e1");
    const auto peer = join();
    tell("e1", EntityState::BUSY, peer.id());
    pass(300ms);
    EXPECT_FALSE(peer.data->disconnected);
    core.keepAlive(peer.client);
    ask(peer.client, "e1");
    pass(300ms);
    EXPECT_TRUE(peer.data->disconnected);
}

TEST_F(FrontEndTest, WhoWasAskedAndDoesNotHoldIsToldThatTheClientHasLeft) {
    for (const auto* name : {"e1", "e2", "e3", "e4"}) entity(name);
    const auto peer = join();
    status("e1", EntityState::REG, peer.id());
    ask(peer.client, "e2");
    auto watch = to("e3");
    watch.msg_type = kMsgWatch;
    core.sendToEntityDataSeq(peer.client, watch, "watch");
    topic.take();
    core.leave(peer.client, Ending::Ended, "over");
    EXPECT_THAT(topic.take(), UnorderedElementsAre("ended to e1", "ended to e2", "ended to e3"));
}

TEST_F(FrontEndTest, AGrantToAClientThatLeftLongAgoIsEnded) {
    entity("e1");
    const auto ghost = join("ghost");
    ask(ghost.client, "e1");
    core.leave(ghost.client, Ending::Ended, "over");
    for (int i = 0; i < 1'100; ++i) core.leave(join("passer-by").client, Ending::Ended, "over");
    topic.take();
    tell("e1", EntityState::REG, ghost.id());
    EXPECT_THAT(topic.take(), Contains("lost to e1")) << "nobody remembers how it left";
}

TEST_F(FrontEndTest, OnlyTheHolderSendsAnEntityMuch) {
    entity("e1");
    const auto holder = join("client1");
    const auto stranger = join("client2");
    const std::string large(129 * 1024, 'x');
    for (const auto* name : {"e1", "nobody"}) {
        core.sendToEntity(stranger.client, to(name), large);
        core.sendToEntityDataSeq(stranger.client, to(name), large);
        EXPECT_THAT(stranger.data->take(), Contains("refused TOO_LARGE").Times(1));
        EXPECT_THAT(topic.take(), IsEmpty());
    }
    ask(holder.client, "e1");
    topic.take();
    for (int i = 0; i < 100; ++i) core.sendToEntity(holder.client, to("e1"), large);
    EXPECT_THAT(topic.take(), SizeIs(8)) << "perhaps granted, and nobody has told this server yet";
    EXPECT_THAT(holder.data->take(), Contains("refused OVERLOADED").Times(92));
    status("e1", EntityState::REG, holder.id());
    for (int i = 0; i < 100; ++i) core.sendToEntity(holder.client, to("e1"), large);
    core.sendToEntityDataSeq(holder.client, to("e1"), large);
    EXPECT_THAT(topic.take(), SizeIs(101));
    core.sendToEntity(stranger.client, to("e1"), std::string(128 * 1024, 'x'));
    EXPECT_THAT(topic.take(), SizeIs(1));
}

TEST_F(FrontEndTest, AStrangerSendsNotMuchInASecondEither) {
    entity("e1");
    const auto stranger = join();
    const std::string part(64 * 1024, 'x');
    for (int i = 0; i < 100; ++i) core.sendToEntity(stranger.client, to("e1"), part);
    EXPECT_THAT(topic.take(), SizeIs(16));
    EXPECT_THAT(stranger.data->take(), Contains("refused OVERLOADED").Times(84));
    EXPECT_FALSE(stranger.data->disconnected);
    clock.advance(1s);
    core.sendToEntity(stranger.client, to("e1"), part);
    EXPECT_THAT(topic.take(), SizeIs(1));
}

TEST_F(FrontEndTest, AClientIsNoMasterOfARun) {
    entity("e1");
    const auto peer = join();
    auto head = to("e1");
    head.msg_type = kMsgCollaboration;
    core.sendToEntity(peer.client, head, "order");
    core.sendToEntityDataSeq(peer.client, head, "order");
    EXPECT_THAT(topic.lines, IsEmpty());
    EXPECT_THAT(peer.data->take(), Contains("refused PERMISSION_DENIED").Times(1))
        << "raw data is dropped without a word";
}

TEST_F(FrontEndTest, AClientWithOneLaneGetsItsSignalsThere) {
    auto data = std::make_shared<FakeOutbox>();
    const auto client = core.setCallback("browser", Role::Operator, data).value();
    core.sendStopSignal(client, to(""), StopCause::Requested);
    EXPECT_THAT(data->take(), ElementsAre("stop accepted 0"));
}

TEST_F(FrontEndTest, StopsForASilentClientExactlyAtItsWatchdog) {
    entity("e1");
    const auto peer = join();
    status("e1", EntityState::BUSY, peer.id());
    pass(249ms);
    EXPECT_THAT(topic.lines, IsEmpty());
    EXPECT_GE(peer.signal->heartbeats, 4);
    pass(1ms);
    EXPECT_THAT(topic.take(), ElementsAre("stop (client lost) by client1 to e1", "lost to e1"));
    EXPECT_TRUE(peer.data->disconnected);
    EXPECT_TRUE(peer.signal->disconnected);
    EXPECT_EQ(core.clients(), 0U);
}

TEST_F(FrontEndTest, TheRobotsOfAllThatAreSilentStopBeforeAnythingElseIsSaid) {
    for (const auto* name : {"a", "b"}) {
        entity(name);
        status(name, EntityState::BUSY, join(std::string("client of ") + name).id());
    }
    pass(250ms);
    const auto lines = topic.take();
    ASSERT_EQ(lines.size(), 4U);
    EXPECT_THAT(std::vector(lines.begin(), lines.begin() + 2),
                UnorderedElementsAre("stop (client lost) by client of a to a",
                                     "stop (client lost) by client of b to b"));
    EXPECT_THAT(std::vector(lines.begin() + 2, lines.end()), UnorderedElementsAre("lost to a", "lost to b"));
}

TEST_F(FrontEndTest, TheRobotsOfAllBehindASilentRouterStopAtOnce) {
    const int router = 0;
    for (const auto* name : {"a", "b"}) {
        entity(name);
        status(name, EntityState::BUSY,
               join(std::string("client of ") + name, {}, Role::Operator, &router).id());
        pass(25ms);
    }
    pass(199ms);
    EXPECT_THAT(topic.lines, IsEmpty());
    pass(1ms);
    EXPECT_EQ(topic.lines.size(), 4U);
    EXPECT_EQ(core.clients(), 0U);
}

TEST_F(FrontEndTest, ShortTasksOneAfterAnotherDoNotHideASilentClient) {
    entity("e1");
    const auto peer = join();
    status("e1", EntityState::BUSY, peer.id());
    for (int task = 0; task < 2; ++task) {
        pass(100ms);
        status("e1", EntityState::REG, peer.id());
        status("e1", EntityState::BUSY, peer.id());
    }
    pass(49ms);
    EXPECT_THAT(topic.lines, IsEmpty());
    pass(1ms);
    EXPECT_THAT(topic.take(), ElementsAre("stop (client lost) by client1 to e1", "lost to e1"));
}

TEST_F(FrontEndTest, KeepAliveFeedsTheWatchdogAndAnIdleClientHasTenSeconds) {
    entity("e1");
    const auto peer = join();
    status("e1", EntityState::BUSY, peer.id());
    for (int i = 0; i < 20; ++i) {
        pass(200ms);
        core.keepAlive(peer.client);
    }
    EXPECT_EQ(core.clients(), 1U);
    status("e1", EntityState::REG, peer.id());
    pass(9999ms);
    EXPECT_EQ(core.clients(), 1U);
    pass(1ms);
    EXPECT_EQ(core.clients(), 0U);
}

TEST_F(FrontEndTest, StopsEveryEntityThatALostClientHeldAndNoOther) {
    for (const char* id : {"e1", "e2", "e3"}) entity(id);
    const auto client1 = join("client1");
    const auto client2 = join("client2");
    status("e1", EntityState::REG, client1.id());
    status("e2", EntityState::BUSY, client1.id());
    status("e3", EntityState::BUSY, client2.id());
    core.leave(client1.client, Ending::Lost, "connection lost");
    core.leave(client1.client, Ending::Ended, "again");
    EXPECT_THAT(topic.take(),
                ElementsAre("stop (client lost) by client1 to e1 e2", "lost to e1", "lost to e2"));
}

TEST_F(FrontEndTest, AnOrderlyEndStopsOnlyWhatRuns) {
    entity("e1");
    entity("e2");
    const auto peer = join();
    status("e1", EntityState::REG, peer.id());
    status("e2", EntityState::BUSY, peer.id());
    core.leave(peer.client, Ending::Ended, "over");
    EXPECT_THAT(topic.take(), ElementsAre("stop (released) by client1 to e2", "ended to e1", "ended to e2"));
}

TEST_F(FrontEndTest, WhatWasReleasedIsNotStopped) {
    entity("e1");
    const auto peer = join();
    status("e1", EntityState::BUSY, peer.id());
    status("e1", EntityState::IDLE);
    core.leave(peer.client, Ending::Lost, "connection lost");
    EXPECT_THAT(topic.lines, ElementsAre("lost to e1")) << "it might wait for it again; no stop";
}

TEST_F(FrontEndTest, StopsWhatWasGrantedToAClientThatIsGone) {
    entity("e1");
    const auto peer = join();
    core.leave(peer.client, Ending::Lost, "connection lost");
    status("e1", EntityState::REG, peer.id());
    EXPECT_THAT(topic.take(), ElementsAre("stop (client lost) by client1 to e1", "lost to e1"));
    status("e1", EntityState::REG, "a client of the server's last life");
    EXPECT_THAT(topic.take(), Contains("lost to e1"));
}

// The end of a client travels on the signal lane, its check-out on the data lane. Where the end comes first,
// the Entity Manager holds nobody yet, has nothing to end, and then grants the check-out.
TEST_F(FrontEndTest, ACheckOutThatTheEndOfItsClientOvertookIsEndedOnceItIsGranted) {
    entity("e1");
    const auto peer = join();
    ask(peer.client, "e1");
    topic.take();
    core.leave(peer.client, Ending::Lost, "connection lost");
    EXPECT_THAT(topic.take(), ElementsAre("lost to e1"));
    tell("e1", EntityState::IDLE, "");
    EXPECT_THAT(topic.take(), IsEmpty());
    tell("e1", EntityState::REG, peer.id());
    EXPECT_THAT(topic.take(), ElementsAre("stop (client lost) by client1 to e1", "lost to e1"));
}

TEST_F(FrontEndTest, RoutesToTheRecipientOrToAll) {
    const auto client1 = join("client1");
    const auto client2 = join("client2");
    Header head;
    head.sender.id = client1.id();
    core.entityMsg(Lane::Data, head, "grant");
    core.entityMsg(Lane::Signal, head, "receipt");
    head.sender.id.clear();
    core.entityMsgDataSeq(head, "sample");
    head.sender.id = "gone";
    core.entityMsg(Lane::Data, head, "late");
    EXPECT_THAT(client1.data->take(), ElementsAre("msg grant", "samples"));
    EXPECT_THAT(client1.signal->take(), ElementsAre("msg receipt"));
    EXPECT_THAT(client2.data->take(), ElementsAre("samples"));
}

TEST_F(FrontEndTest, AnswersRequests) {
    entity("e1");
    status("e1", EntityState::UNAV);
    const auto peer = join();
    peer.data->take();
    auto request = to("");
    request.msg_type = kMsgStatus;
    core.sendRequest(peer.client, request, {});
    EXPECT_THAT(peer.data->take(), ElementsAre("joined e1", "e1 UNAV"));
    request.msg_type = "WEATHER";
    core.sendRequest(peer.client, request, {});
    EXPECT_THAT(peer.data->take(), ElementsAre("refused NOT_SUPPORTED"));
    request.msg_type = kMsgGlobalServices;
    core.sendRequest(peer.client, request, {});
    EXPECT_THAT(peer.data->take(), ElementsAre("refused NOT_SUPPORTED")) << "there are none";
}

TEST_F(FrontEndTest, GlobalServicesAreAnsweredToWhoAskedAndNeverReadHere) {
    struct Echo final : GlobalServicesPort {
        Result<std::string> answer(std::string_view request) override {
            if (request == "?") return Refusal{RefusalCode::Malformed, "no request", {}};
            return "services for " + std::string(request);
        }
    } services;
    FrontEndCore its(
        settings, clock, random, topic, [](const std::string&) {}, [](auto) {}, &services);
    const auto data = std::make_shared<FakeOutbox>();
    const auto other = std::make_shared<FakeOutbox>();
    const auto client = its.setCallback("client1", Role::Observer, data).value();
    ASSERT_TRUE(its.setCallback("client2", Role::Operator, other).ok());
    auto request = to("e1");
    request.msg_type = kMsgGlobalServices;
    its.sendRequest(client, request, "request 7");
    EXPECT_THAT(data->take(), ElementsAre("msg services for request 7")) << "an observer may ask";
    EXPECT_EQ(data->last_head.entity, "") << "no entity has said it";
    EXPECT_EQ(data->last_head.sender.id, FrontEndCore::me(*client).id);
    its.sendRequest(client, request, "?");
    EXPECT_THAT(data->take(), ElementsAre("refused MALFORMED"));
    EXPECT_THAT(other->take(), IsEmpty());
    EXPECT_THAT(topic.take(), IsEmpty()) << "no entity hears of it";
}

TEST_F(FrontEndTest, SaysThatTheServerGoes) {
    const auto peer = join();
    core.shutDown();
    EXPECT_THAT(peer.data->take(), ElementsAre("update the server is shutting down"));
}

TEST_F(FrontEndTest, ItsOwnStopsHaveNumbersThatNoClientCanTake) {
    entity("e1");
    entity("e2");
    const auto peer = join();
    auto forged = to("e1");
    forged.sequence = kServerSequences + 1;
    core.sendStopSignal(peer.client, forged, StopCause::Requested);
    EXPECT_EQ(topic.numbers.back(), 0);
    status("e1", EntityState::REG, peer.id());
    status("e2", EntityState::REG, peer.id());
    core.leave(peer.client, Ending::Lost, "connection lost");
    status("e1", EntityState::IDLE);
    status("e1", EntityState::REG, peer.id());  // granted late: another stop
    ASSERT_EQ(topic.numbers.size(), 3U);
    EXPECT_GT(topic.numbers[1], kServerSequences);
    EXPECT_GT(topic.numbers[2], topic.numbers[1]);
}

TEST_F(FrontEndTest, SaysForTheAuditWhoStoppedAndRearmed) {
    entity("e1");
    const auto peer = join();
    notes.clear();
    core.sendStopSignal(peer.client, to(""), StopCause::Requested);
    auto rearm = to("e1");
    rearm.msg_type = kMsgRearm;
    core.sendToEntity(peer.client, rearm, "");
    core.sendToEntity(peer.client, to("e1"), "a text");
    EXPECT_THAT(notes, ElementsAre(HasSubstr("audit: stop by client1 (operator, " + peer.id() + ") to all 1"),
                                   HasSubstr("audit: rearm by client1 (operator, " + peer.id() + ") to e1")));
    core.sendToEntityDataSeq(peer.client, rearm, "");
    EXPECT_EQ(notes.size(), 3U) << "whatever the operation";
}

TEST_F(FrontEndTest, DrillsAreLimitedForEachClientAndStopsAreNot) {
    entity("e1");
    entity("e2");
    const auto peer = join();
    const auto other = join();
    topic.take();
    const auto drill = [&](const auto& who, int times) {
        for (int i = 0; i < times; ++i) core.sendStopSignal(who.client, to("e1"), StopCause::Drill);
        return topic.take().size();
    };
    EXPECT_EQ(drill(peer, 500), 500U);
    std::vector<std::string> many;
    for (int i = 0; i < 600; ++i) many.push_back("e" + std::to_string(i));
    core.sendStopSignals(peer.client, to(""), many, StopCause::Drill);
    EXPECT_EQ(topic.take().size(), 1U) << "what begins within is carried out";
    peer.signal->take();
    EXPECT_EQ(drill(peer, 10), 0U);
    EXPECT_THAT(peer.signal->take(), Contains("refused OVERLOADED").Times(10));
    EXPECT_EQ(drill(other, 10), 10U) << "each has its own";
    core.sendStopSignal(peer.client, to("e1"), StopCause::Requested);
    EXPECT_EQ(topic.take().size(), 1U);
    pass(1s);
    EXPECT_EQ(drill(peer, 10), 10U);
}

TEST_F(FrontEndTest, WarnsOnceAMinuteOfAClientThatIsNearlyLost) {
    entity("e1");
    const auto peer = join();
    status("e1", EntityState::BUSY, peer.id());
    notes.clear();
    const auto beat = [&](Duration period, int times) {
        for (int i = 0; i < times; ++i) {
            pass(period);
            core.keepAlive(peer.client);
        }
    };
    beat(140ms, 20);
    EXPECT_THAT(notes, IsEmpty());
    beat(160ms, 200);  // 32 s
    ASSERT_EQ(notes.size(), 1U);
    EXPECT_THAT(notes.front(), HasSubstr("client client1 is late: 1"));
    EXPECT_THAT(core.margins(), ElementsAre(HasSubstr("client client1: 160 ms of 250 ms")));
    beat(160ms, 200);
    EXPECT_EQ(notes.size(), 2U);
}

TEST_F(FrontEndTest, FourThousandJoinsAreNotQuadratic) {
    constexpr int kJoins = 4096;
    const auto before = allocations.load();
    for (int i = 0; i < kJoins; ++i) entity("e" + std::to_string(i));
    // A table that is copied whole costs 2048 allocations for each join on the average.
    EXPECT_LT(allocations - before, kJoins * 200U);
    while (core.entities() > 0)
        core.entityBasicPrflUpdate(Presence::Left, {"e" + std::to_string(core.entities() - 1)}, {});
    std::vector<std::shared_ptr<FakeOutbox>> peers;
    const auto between = allocations.load();
    for (int i = 0; i < kJoins; ++i) {
        peers.push_back(std::make_shared<FakeOutbox>());
        ASSERT_TRUE(core.setCallback("client", Role::Operator, peers.back()).ok());
    }
    EXPECT_LT(allocations - between, kJoins * 200U);
    core.entityMsgDataSeq({}, "to all");
    for (const auto& peer : peers) EXPECT_EQ(peer->lines.size(), 1U);
}

TEST(FrontEndLimits, AFloodIsImproperAndItsLastStopIsStillAStop) {
    ManualClock clock;
    SeededRandom random{1};
    FakeTopic topic;
    FrontEndCoreSettings settings;
    settings.messages_per_second = 3;
    settings.clients_max = 1;
    FrontEndCore core(
        settings, clock, random, topic, [](const std::string&) {}, [](auto) {});
    auto data = std::make_shared<FakeOutbox>();
    const auto client = core.setCallback("client1", Role::Operator, data).value();
    EXPECT_EQ(core.setCallback("client2", Role::Operator, data).refusal().code, RefusalCode::Overloaded);
    Registration registration;
    registration.entity = registration.name = "e1";
    core.entityBasicPrflUpdate(Presence::Joined, registration, "");
    EntityStatus status;
    status.entity = "e1";
    status.holder.id = FrontEndCore::me(*client).id;
    Header head;
    head.entity = "e1";
    head.msg_type = kMsgCheckOut;
    core.sendToEntity(client, head, "x");
    core.entityUpdate(status);
    for (int i = 0; i < 2; ++i) core.sendToEntity(client, head, "x");
    topic.take();
    core.sendStopSignal(client, head, StopCause::Requested);
    EXPECT_THAT(topic.take(), ElementsAre("stop (requested) by client1 to e1",
                                          "stop (improper client) by client1 to e1", "lost to e1"));
    EXPECT_TRUE(data->disconnected);
}

TEST_F(FrontEndTest, ABusyClientHearsAHeartbeatInEachFifthOfTheWatchdogBetween50And200Ms) {
    for (const auto& [watchdog, period] :
         {std::pair{100ms, 50ms}, {250ms, 50ms}, {500ms, 100ms}, {1000ms, 200ms}, {2000ms, 200ms}}) {
        SCOPED_TRACE(watchdog.count());
        settings.watchdog_busy = watchdog;
        FrontEndCore its(
            settings, clock, random, topic, [](const std::string&) {}, [](auto) {});
        const auto signal = std::make_shared<FakeOutbox>();
        const auto client =
            its.setCallback("client1", Role::Operator, std::make_shared<FakeOutbox>()).value();
        ASSERT_TRUE(its.attach(FrontEndCore::token(*client), signal).ok());
        Registration registration;
        registration.entity = registration.name = "e1";
        its.entityBasicPrflUpdate(Presence::Joined, registration, "");
        auto head = to("e1");
        head.msg_type = kMsgCheckOut;
        its.sendToEntity(client, head, "check-out");
        EntityStatus busy;
        busy.entity = "e1";
        busy.state = EntityState::BUSY;
        busy.holder = FrontEndCore::me(*client);
        its.entityUpdate(busy);
        its.onTimer();
        const int before = signal->heartbeats;
        for (int beat = 1; beat <= 10; ++beat) {
            clock.advance(period - 1ms);
            its.onTimer();
            EXPECT_EQ(signal->heartbeats, before + beat - 1);
            clock.advance(1ms);
            its.keepAlive(client);
            its.onTimer();
            EXPECT_EQ(signal->heartbeats, before + beat);
        }
    }
}

class OneOfSeveral : public FrontEndTest {
  protected:
    static FrontEndCoreSettings named() {
        FrontEndCoreSettings settings;
        settings.name = "fe1";
        settings.watchdog_busy = settings.watchdog_idle = std::chrono::hours{1};
        return settings;
    }
    void announce(Lane lane, const std::string& server, std::int64_t published,
                  const char* instance = "one") {
        several.entityServerUpdate(lane, {server, instance, "signals of " + server, published});
    }
    void entityAt(const std::string& server, const std::string& id, Presence presence = Presence::Joined) {
        Registration registration;
        registration.entity = registration.name = id;
        registration.server = server;
        several.entityBasicPrflUpdate(presence, registration, "profile");
    }
    void statusAt(const std::string& server, const std::string& id, EntityState state,
                  std::int64_t number = 0, Via via = Via::Topic) {
        EntityStatus out;
        out.entity = id;
        out.state = state;
        out.server = server;
        several.entityUpdate(out, number, via);
    }
    void passHere(Duration time) {
        const auto end = clock.now() + time;
        while (clock.now() < end) {
            const auto next = several.onTimer();
            clock.set(std::min(std::max(next, clock.now() + 1ms), end));
        }
        several.onTimer();
    }
    std::pair<std::shared_ptr<FakeOutbox>, FrontEndCore::ClientRef> joinHere() {
        auto data = std::make_shared<FakeOutbox>();
        auto client = several.setCallback("client1", Role::Operator, data).value();
        return {data, client};
    }

    FrontEndCore several{
        named(),    clock, random, topic, [this](const std::string& line) { notes.push_back(line); },
        [](auto) {}};
};

TEST_F(OneOfSeveral, TheEntitiesOfAServerThatRefusesConnectionsLeaveWithTheNextHeartbeat) {
    for (const auto* server : {"es1", "es2"}) announce(Lane::Signal, server, 1);
    entityAt("es1", "e1");
    entityAt("es2", "e2");
    passHere(1ms);
    const auto [data, client] = joinHere();
    data->take();
    several.entityServerRefused("es1", "signals of es1");
    passHere(73ms);
    EXPECT_THAT(data->take(), IsEmpty());
    passHere(1ms);
    EXPECT_THAT(data->take(), ElementsAre("left e1"));
}

TEST_F(OneOfSeveral, LeavesTheClientsOfOthersToThem) {
    entityAt("es1", "e1");
    EntityStatus out;
    out.entity = "e1";
    out.state = EntityState::REG;
    out.server = "es1";
    out.holder = {"fe2:ab:uuid", "somebody", Role::Operator};
    topic.take();
    several.entityUpdate(out);
    EXPECT_THAT(topic.take(), IsEmpty());
    out.holder.id = "fe1:an earlier start:uuid";
    several.entityUpdate(out);
    EXPECT_THAT(topic.take(), Contains("lost to e1"));
}

TEST_F(OneOfSeveral, ItsClientsIdsTellTheServerAndItsStart) {
    passHere(1ms);
    const auto id = FrontEndCore::me(*joinHere().second).id;
    EXPECT_EQ(originOf(id).server, "fe1");
    EXPECT_EQ(originOf(id).instance, topic.announced.instance);
    EXPECT_TRUE(Id128::parse(uuidOf(id)));
}

TEST_F(OneOfSeveral, TellsByTheTopicWhatUsersItHas) {
    FrontEndCore with_users{named(),     clock,   random,  topic, [](const std::string&) {},
                            [](auto) {}, nullptr, nullptr, &users};
    with_users.topicFound();
    EXPECT_EQ(topic.announced_users, users.fingerprint());
    several.topicFound();
    EXPECT_EQ(topic.announced_users, "");
}

TEST_F(OneOfSeveral, AnnouncesItselfByTheTopicEachSecondAndDirectlyEach50Ms) {
    passHere(2s);
    EXPECT_EQ(topic.announcements, 3);
    EXPECT_EQ(topic.beats, 41);
    announce(Lane::Data, "es1", 0);
    passHere(1ms);
    EXPECT_THAT(topic.reached, ElementsAre("signals of es1"));
}

TEST_F(OneOfSeveral, TheEntitiesOfASilentServerHaveLeftAndTheOthersHaveNot) {
    const auto [data, client] = joinHere();
    entityAt("es1", "e1");
    entityAt("es2", "e2");
    statusAt("es1", "e1", EntityState::BUSY);
    for (int i = 0; i < 20; ++i) {
        announce(Lane::Signal, "es1", 0);
        announce(Lane::Signal, "es2", 0);
        passHere(50ms);
    }
    data->take();
    for (int i = 0; i < 4; ++i) {
        announce(Lane::Signal, "es2", 0);
        passHere(50ms);
    }
    EXPECT_THAT(data->take(), ElementsAre("left e1")) << "250 ms after its last sign of life";
    entityAt("es1", "e1", Presence::Changed);
    EXPECT_THAT(data->take(), IsEmpty()) << "late, out of a queue";
    topic.take();
    announce(Lane::Signal, "es1", 0);
    passHere(1ms);
    EXPECT_THAT(topic.take(), testing::Contains("requestes1"));
    entityAt("es1", "e1", Presence::Changed);
    EXPECT_THAT(data->take(), ElementsAre("joined e1"));
}

TEST_F(OneOfSeveral, TheEntitiesOfAServerThatNeverAnnouncedItselfLeaveToo) {
    const auto [data, client] = joinHere();
    entityAt("es1", "e1");
    statusAt("es1", "e1", EntityState::IDLE);
    data->take();
    passHere(2900ms);
    EXPECT_THAT(data->take(), IsEmpty());
    passHere(100ms);
    EXPECT_THAT(data->take(), ElementsAre("left e1")) << "it died between its first words";
}

TEST_F(OneOfSeveral, AsksAServerOfWhichItHasHeardLessThanThatHasPublished) {
    announce(Lane::Data, "es1", 7);
    EXPECT_THAT(topic.take(), ElementsAre("requestes1")) << "it was there first";
    several.entityServerEntities("es1", {});
    entityAt("es1", "e1");
    statusAt("es1", "e1", EntityState::IDLE);
    announce(Lane::Data, "es1", 9);
    EXPECT_THAT(topic.take(), IsEmpty());
    announce(Lane::Data, "es1", 10);
    EXPECT_THAT(topic.take(), ElementsAre("requestes1"));
    announce(Lane::Data, "es1", 10);
    EXPECT_THAT(topic.take(), IsEmpty());
}

TEST_F(OneOfSeveral, AsksAgainUntilTheAnswerHasComeWhole) {
    announce(Lane::Data, "es1", 7);
    passHere(1ms);
    EXPECT_THAT(topic.take(), testing::Contains("requestes1"));
    for (int i = 0; i < 3; ++i) {
        passHere(1s);
        announce(Lane::Data, "es1", 7);
        EXPECT_THAT(topic.take(), ElementsAre("requestes1")) << "the question was lost";
    }
    several.entityServerEntities("es1", {});
    passHere(1s);
    announce(Lane::Data, "es1", 7);
    EXPECT_THAT(topic.take(), IsEmpty());
}

TEST_F(OneOfSeveral, WhatIsNotInTheListAtTheEndOfAStatusIsForgotten) {
    const auto [data, client] = joinHere();
    entityAt("es1", "e1");
    entityAt("es1", "e2");
    entityAt("es2", "e3");
    data->take();
    several.entityServerEntities("es1", {"e1"});
    EXPECT_THAT(data->take(), ElementsAre("left e2"));
    EXPECT_EQ(several.entities(), 2U);
}

TEST_F(OneOfSeveral, AnEntityThatMovedIsNotTakenAwayByTheServerItCameFrom) {
    const auto [data, client] = joinHere();
    entityAt("es1", "e1");
    entityAt("es2", "e1");
    statusAt("es2", "e1", EntityState::IDLE);
    data->take();
    statusAt("es1", "e1", EntityState::ERR);
    entityAt("es1", "e1", Presence::Changed);
    entityAt("es1", "e1", Presence::Left);
    several.entityServerEntities("es1", {});
    EXPECT_THAT(data->take(), IsEmpty());
    topic.take();
    // Another server has spoken of it, so when this one lets go, that one is asked.
    entityAt("es2", "e1", Presence::Left);
    EXPECT_THAT(data->take(), ElementsAre("left e1"));
    EXPECT_THAT(topic.take(), ElementsAre("request"));
}

TEST_F(OneOfSeveral, RefusesWhatIsForNobodyAndPassesItsStopOnAllTheSame) {
    const auto [data, client] = joinHere();
    entityAt("es1", "e1");
    data->take();
    several.sendToEntity(client, to("e2"), "hello");
    EXPECT_THAT(data->take(), ElementsAre("refused UNKNOWN_ENTITY"));
    EXPECT_THAT(topic.take(), IsEmpty());
    several.sendStopSignal(client, to("e2"), StopCause::Requested);
    EXPECT_THAT(data->take(), ElementsAre("stop accepted 0", "refused UNKNOWN_ENTITY"));
    several.sendStopSignals(client, to(""), {"e1", "e2"}, StopCause::Requested);
    EXPECT_THAT(data->take(), ElementsAre("stop accepted 1", "refused UNKNOWN_ENTITY"));
    EXPECT_THAT(topic.take(),
                ElementsAre("stop (requested) by client1 to e2", "stop (requested) by client1 to e1 e2"));
    topic.down = true;
    several.sendToEntity(client, to("e1"), "hello");
    EXPECT_THAT(data->take(), ElementsAre("refused NOT_CONNECTED"));
}

TEST_F(OneOfSeveral, OfAStatusThatComesTwoWaysTheFirstCounts) {
    const auto [data, client] = joinHere();
    entityAt("es1", "e1");
    announce(Lane::Data, "es1", 1);
    several.entityServerEntities("es1", {"e1"});
    data->take();
    statusAt("es1", "e1", EntityState::REG, 2, Via::Straight);
    statusAt("es1", "e1", EntityState::BUSY, 3, Via::Straight);
    const auto told = data->take();
    EXPECT_EQ(told.size(), 2U);
    statusAt("es1", "e1", EntityState::REG, 2);
    statusAt("es1", "e1", EntityState::BUSY, 3);
    EXPECT_THAT(data->take(), IsEmpty()) << "the topic is late, not new";
    topic.take();
    announce(Lane::Data, "es1", 3);
    EXPECT_THAT(topic.take(), IsEmpty()) << "all that went by the topic has come";
    entityAt("es2", "e1");
    data->take();
    statusAt("es2", "e1", EntityState::IDLE, 1);
    EXPECT_EQ(data->take().size(), 1U) << "another server counts for itself";
}

TEST_F(OneOfSeveral, AMessageGoesToTheServerThatHasTheEntityNow) {
    const auto [data, client] = joinHere();
    entityAt("es1", "e1");
    several.sendToEntity(client, to("e1"), "hello");
    EXPECT_EQ(topic.at, "es1");
    entityAt("es2", "e1");
    several.sendToEntity(client, to("e1"), "hello");
    EXPECT_EQ(topic.at, "es2");
}

TEST_F(OneOfSeveral, KnowsForBothLanesWhichServerHasAnEntity) {
    for (const auto lane : {Lane::Data, Lane::Signal}) EXPECT_EQ(several.serverOf("e1", lane), nullptr);
    entityAt("es1", "e1");
    for (const auto lane : {Lane::Data, Lane::Signal}) EXPECT_EQ(*several.serverOf("e1", lane), "es1");
    entityAt("es2", "e1");
    for (const auto lane : {Lane::Data, Lane::Signal}) EXPECT_EQ(*several.serverOf("e1", lane), "es2");
    entityAt("es2", "e1", Presence::Left);
    for (const auto lane : {Lane::Data, Lane::Signal}) EXPECT_EQ(several.serverOf("e1", lane), nullptr);
}

TEST_F(OneOfSeveral, AsksEverybodyWhenTheTopicIsFound) {
    several.topicFound();
    EXPECT_THAT(topic.take(), ElementsAre("request"));
    EXPECT_EQ(topic.announcements, 1);
}

}  // namespace
}  // namespace axon::front_end_server
