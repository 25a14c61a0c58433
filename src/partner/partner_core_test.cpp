// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/partner_core.hpp"

#include <gmock/gmock.h>

#include <vector>

#include "partner/translation.hpp"

namespace axon::partner {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

struct ToHome {
    Lane lane;
    Header head;
    std::string bytes;
    proto::ToClient message;
};
struct ToThere {
    SessionNumber session;
    client::Operation operation;
    Header head;
    std::string bytes;
};

struct Home final : HomePort {
    std::string uuidAtHome(std::string_view there) override { return "home-" + std::string(there); }
    std::string strangerAtHome(std::string_view id) override { return "stranger-" + std::string(id); }
    void join(const ShownEntity& entity) override { joined.push_back(entity.name); }
    void leave(const std::string& home) override { left.push_back(home); }
    void renew(const std::string& home) override { renewed.push_back(home); }
    void show(const Registration& its, const proto::BasicProfile& profile) override {
        shown.emplace_back(its, profile);
    }
    void tellStatus(const EntityStatus& status) override { statuses.push_back(status); }
    void toClient(Lane lane, const Header& head, const std::string& bytes) override {
        ToHome one{lane, head, bytes, {}};
        EXPECT_TRUE(one.message.ParseFromString(bytes));
        sent.push_back(std::move(one));
    }
    void toClientDataSeq(const Header& head, const std::string& bytes) override {
        data.push_back({Lane::Data, head, bytes, {}});
    }
    std::vector<std::string> joined, left, renewed;
    std::vector<std::pair<Registration, proto::BasicProfile>> shown;
    std::vector<EntityStatus> statuses;
    std::vector<ToHome> sent, data;
};

struct CountingLanes final : client::StopLanes {
    void sendStopSignal(Lane, const Header&, StopCause) const override { ++stops; }
    void sendStopSignals(Lane, const Header&, const std::vector<std::string>&, StopCause) const override {}
    mutable int stops = 0;
};

struct There final : TherePort {
    void open(SessionNumber session, const std::string& name, Use use) override {
        EXPECT_EQ(use != Use::Visit, !name.starts_with("a@"));
        if (use == Use::Stops)
            for_stops.push_back(session);
        else
            opened.emplace_back(session, name);
    }
    void stopsBy(SessionNumber session, bool shared) override {
        lanes[session] = std::make_shared<CountingLanes>();
        signals->stopBy(session, {"s" + std::to_string(session), "lab-a", Role::Operator}, lanes[session],
                        shared);
    }
    void visits(SessionNumber session, const Sender& client) override { visiting[session] = client.id; }
    bool send(SessionNumber session, client::Operation operation, const Header& head,
              std::string bytes) override {
        if (full) return false;
        sent.push_back({session, operation, head, std::move(bytes)});
        return true;
    }
    void keepAlive(SessionNumber session, std::int64_t) override { ++beats[session]; }
    void leave(SessionNumber session) override { left.push_back(session); }
    void drop(SessionNumber session) override { dropped.push_back(session); }
    std::vector<std::pair<SessionNumber, std::string>> opened;
    std::vector<SessionNumber> for_stops;  // opened for strangers' stops
    SignalRelay* signals = nullptr;
    std::map<SessionNumber, std::shared_ptr<CountingLanes>> lanes;  // of those that take them
    std::map<SessionNumber, std::string> visiting;
    bool full = false;
    std::vector<ToThere> sent;
    std::map<SessionNumber, int> beats;
    std::vector<SessionNumber> left, dropped;
};

constexpr const char* kRobot = "r1";
constexpr const char* kRobotHome = "home-r1";
const Sender kAnn{"ann-id", "ann@desk", Role::Operator};
const Sender kBob{"bob-id", "bob@desk", Role::Operator};
const Sender kAnnThere{"ann-there", "lab-a@ann at desk", Role::Operator};

struct PartnerCoreTest : testing::Test {
    ManualClock clock;
    Home home;
    There there;
    SignalRelay signals{clock};
    std::vector<std::string> notes;
    PartnerCore core{{"b", "a", 2}, clock,   home,
                     there,         signals, [this](const auto& line) { notes.push_back(line); }};
    SessionNumber watch = 0;

    void SetUp() override {
        there.signals = &signals;
        core.start();
        EXPECT_THAT(there.opened, IsEmpty()) << "whoever sees a robot must be able to stop it";
        core.onOpened(there.for_stops.back(), {"s", "lab-a", Role::Operator}, {});
        core.onTimer();
        watch = there.opened.back().first;
        core.onOpened(watch, {"w", "lab-a", Role::Operator}, {});
        robot(kRobot, "PeopleBot");
        core.onStatus(watch, statusOf({}, EntityState::IDLE));
        core.onHomeUp(kRobotHome);
    }
    void robot(const std::string& uuid, const std::string& name, Presence presence = Presence::Joined) {
        Registration registration;
        registration.entity = uuid;
        registration.name = name;
        proto::BasicProfile profile;
        profile.set_entity_id(uuid);
        profile.set_name(name);
        core.onProfile(watch, presence, registration, profile.SerializeAsString());
    }
    static EntityStatus statusOf(const Sender& holder, EntityState state) {
        EntityStatus status;
        status.entity = kRobot;
        status.state = state;
        status.holder = holder;
        status.held = {3, 5};
        status.server = "es1";
        return status;
    }
    void say(const Sender& client, const char* type, const proto::ToEntity& message, LeaseNumber held = {},
             std::int64_t sequence = 1) {
        Header head;
        head.sender = client;
        head.entity = kRobotHome;
        head.msg_type = type;
        head.sequence = sequence;
        head.held = held;
        core.onClientMsg(kRobotHome, false, head, message.SerializeAsString());
    }
    void checkOut(const Sender& client, std::int64_t sequence = 1) {
        proto::ToEntity message;
        message.mutable_check_out()->set_request_id("0123456789abcdef");
        message.mutable_check_out()->set_phase(proto::TAKE);
        say(client, kMsgCheckOut, message, {}, sequence);
    }
    SessionNumber visit(const Sender& client, const Sender& as) {
        checkOut(client);
        const auto session = there.opened.back().first;
        core.onOpened(session, as, {});
        return session;
    }
    void fromThere(SessionNumber session, const proto::ToClient& message, Lane lane = Lane::Data) {
        Header head;
        head.sender = kAnnThere;
        head.entity = kRobot;
        head.held = {3, 5};
        head.stop_generation = 9;
        core.onEntityMsg(session, lane, false, head, message.SerializeAsString());
    }
    /// By which session a stop of somebody without one of its own goes; 0: by none.
    SessionNumber stopGoesBy() {
        Header stop;
        stop.sender = kBob;
        std::map<SessionNumber, int> before;
        for (const auto& [session, its] : there.lanes) before[session] = its->stops;
        const auto passed = signals.stop(kRobot, stop, StopCause::Requested);
        for (const auto& [session, its] : there.lanes)
            if (its->stops > before[session]) return session;
        EXPECT_EQ(passed, SignalRelay::Passed::NoSession);
        return 0;
    }
    void pass(Duration time) {
        for (const auto until = clock.now() + time; clock.now() < until; clock.advance(25ms)) core.onTimer();
    }
};

TEST_F(PartnerCoreTest, AnEntityIsShownUnderTheNameOfItsLaboratoryWithAUuidOfItsOwn) {
    EXPECT_THAT(home.joined, ElementsAre("b/PeopleBot"));
    ASSERT_EQ(home.shown.size(), 1U);
    EXPECT_EQ(home.shown[0].first.entity, kRobotHome);
    EXPECT_EQ(home.shown[0].second.name(), "b/PeopleBot");
    EXPECT_EQ(home.shown[0].second.entity_id(), kRobotHome);
    ASSERT_EQ(home.statuses.size(), 1U);
    EXPECT_EQ(home.statuses[0].entity, kRobotHome);
    EXPECT_EQ(home.statuses[0].server, "") << "of a server there nobody knows anything here";
}

TEST_F(PartnerCoreTest, WhatThePartnerShowsForOthersIsNotShownAndSaidOnce) {
    robot("r2", "a/PeopleBot");
    robot("r2", "a/PeopleBot", Presence::Changed);
    EXPECT_EQ(core.entities(), 1U);
    EXPECT_EQ(std::count_if(notes.begin(), notes.end(),
                            [](const auto& line) { return line.find("a/PeopleBot") != std::string::npos; }),
              1);
    robot(kRobot, "c/PeopleBot", Presence::Changed);
    EXPECT_THAT(home.left, ElementsAre(kRobotHome)) << "one that takes such a name leaves";
}

TEST_F(PartnerCoreTest, OnlySoManyEntitiesAreShown) {
    robot("other", "a/Other");
    for (std::size_t i = 0; i <= PartnerCore::kEntities; ++i)
        robot("r-" + std::to_string(i), "Bot" + std::to_string(i));
    EXPECT_EQ(core.entities(), PartnerCore::kEntities);
    EXPECT_EQ(
        std::count_if(notes.begin(), notes.end(),
                      [](const auto& line) { return line.find("has more than 1000") != std::string::npos; }),
        1)
        << "also when something else is not shown";
    robot(kRobot, "PeopleBot", Presence::Changed);
    EXPECT_EQ(home.shown.size(), 2U) << "those that are shown go on";
}

TEST_F(PartnerCoreTest, WhenOneOfTheManyEntitiesLeavesTheOthersAreAskedFor) {
    const auto last = "r-" + std::to_string(PartnerCore::kEntities);
    const auto lists = [&] {
        return std::count_if(there.sent.begin(), there.sent.end(), [&](const auto& one) {
            return one.session == watch && one.operation == client::Operation::Request &&
                   one.head.msg_type == kMsgStatus && one.bytes.empty();
        });
    };
    const auto hears = [&](Duration time) {  // the sessions do not expire meanwhile
        core.onHeartbeat(watch);
        core.onHeartbeat(there.for_stops.back());
        core.onHomeHeartbeat(kRobotHome);
        pass(time);
    };
    for (std::size_t i = 1; i < PartnerCore::kEntities; ++i)
        robot("r-" + std::to_string(i), "Bot" + std::to_string(i));
    robot("r-1", "Bot1", Presence::Left);
    robot("r-1", "Bot1");
    hears(3s);
    EXPECT_EQ(lists(), 0) << "all of them are shown";
    robot(last, "Last");
    there.full = true;
    robot("r-1", "Bot1", Presence::Left);
    robot("r-2", "Bot2", Presence::Left);
    hears(3s);
    EXPECT_EQ(lists(), 0);
    there.full = false;
    hears(3s);
    EXPECT_EQ(lists(), 1) << "once for both, and again if the server did not read";
    robot(last, "Last");
    EXPECT_EQ(home.joined.back(), "b/Last");
    robot("r-3", "Bot3", Presence::Left);
    hears(3s);
    EXPECT_EQ(lists(), 1) << "there are no more";
}

TEST_F(PartnerCoreTest, AProfileThatIsNoneIsIgnored) {
    Registration registration;
    registration.entity = "r9";
    registration.name = "X";
    core.onProfile(watch, Presence::Joined, registration, "\xff\xff\xff");
    EXPECT_EQ(core.entities(), 1U);
}

TEST_F(PartnerCoreTest, AClientThatAsksHasASessionOfItsOwnAndNothingIsSentBeforeIt) {
    checkOut(kAnn);
    ASSERT_EQ(there.opened.size(), 2U);
    EXPECT_EQ(there.opened[1].second, "a@ann at desk");
    EXPECT_THAT(there.sent, IsEmpty());
    const auto session = there.opened[1].first;
    core.onOpened(session, kAnnThere, {});
    EXPECT_EQ(there.visiting.at(session), "ann-id");
    ASSERT_EQ(there.sent.size(), 1U);
    EXPECT_EQ(there.sent[0].session, session);
    EXPECT_EQ(there.sent[0].head.entity, kRobot);
    EXPECT_EQ(there.sent[0].head.msg_type, kMsgCheckOut);
    EXPECT_EQ(there.sent[0].head.sender.id, "") << "the server there says who it is";
}

TEST_F(PartnerCoreTest, MessagesPassUnchangedEachByTheSessionOfItsSender) {
    const auto ann = visit(kAnn, kAnnThere);
    const auto bob = visit(kBob, {"bob-there", "lab-a@bob", Role::Operator});
    there.sent.clear();
    proto::ToEntity task;
    task.mutable_task()->set_task_id("0123456789abcdef");
    say(kAnn, kMsgTask, task, {3, 5}, 2);
    say(kBob, kMsgTask, task, {3, 5}, 2);  // under the lease of another
    ASSERT_EQ(there.sent.size(), 2U);
    EXPECT_EQ(there.sent[0].session, ann);
    EXPECT_EQ(there.sent[0].bytes, task.SerializeAsString());
    EXPECT_EQ(there.sent[0].head.held, (LeaseNumber{3, 5}));
    EXPECT_EQ(there.sent[1].session, bob) << "whose the lease is, its Entity Manager knows";
}

TEST_F(PartnerCoreTest, AnAnswerGoesToItsClientWithoutOffersThatLeadPastTheGateway) {
    const auto session = visit(kAnn, kAnnThere);
    proto::ToClient message;
    auto& reply = *message.mutable_check_out();
    reply.mutable_lease()->set_epoch(3);
    reply.mutable_lease()->set_number(5);
    reply.mutable_lease()->set_key("key");
    reply.set_datagram_endpoint("10.0.0.1:1");
    reply.set_direct_endpoint("10.0.0.1:2");
    reply.set_direct_signal_endpoint("10.0.0.1:3");
    reply.mutable_services()->add_services()->set_entity_id(kRobot);
    fromThere(session, message);
    ASSERT_EQ(home.sent.size(), 1U);
    const auto& told = home.sent[0];
    EXPECT_EQ(told.head.sender.id, "ann-id");
    EXPECT_EQ(told.head.entity, kRobotHome);
    EXPECT_EQ(told.head.stop_generation, 9);
    EXPECT_EQ(told.message.check_out().lease().key(), "key");
    EXPECT_EQ(told.message.check_out().services().services(0).entity_id(), kRobotHome);
    EXPECT_EQ(told.message.check_out().datagram_endpoint(), "");
    EXPECT_EQ(told.message.check_out().direct_endpoint(), "");
    EXPECT_EQ(told.message.check_out().direct_signal_endpoint(), "");
}

TEST_F(PartnerCoreTest, OtherMessagesOfAnEntityPassByteForByte) {
    const auto session = visit(kAnn, kAnnThere);
    proto::ToClient message;
    message.mutable_task()->set_progress(0.5);
    fromThere(session, message);
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].bytes, message.SerializeAsString());
    Header head;
    head.entity = kRobot;
    core.onEntityMsg(session, Lane::Data, true, head, "whatever");
    ASSERT_EQ(home.data.size(), 1U);
    EXPECT_EQ(home.data[0].bytes, "whatever");
    EXPECT_EQ(home.data[0].head.sender.id, "ann-id");
}

TEST_F(PartnerCoreTest, MessagesOfUnknownEntitiesSessionsAndContentsGoNowhere) {
    const auto session = visit(kAnn, kAnnThere);
    proto::ToClient message;
    message.mutable_text()->set_text("x");
    Header head;
    head.entity = "unknown";
    core.onEntityMsg(session, Lane::Data, false, head, message.SerializeAsString());
    head.entity = kRobot;
    core.onEntityMsg(99, Lane::Data, false, head, message.SerializeAsString());
    core.onEntityMsg(watch, Lane::Data, false, head, message.SerializeAsString());
    core.onEntityMsg(session, Lane::Data, false, head, "\xff\xff");
    core.onClientMsg("unknown", false, head, "x");
    core.onStatus(99, statusOf({}, EntityState::BUSY));
    EXPECT_THAT(home.sent, IsEmpty());
    EXPECT_EQ(home.statuses.size(), 1U);
}

TEST_F(PartnerCoreTest, AMessageThatIsNoneIsRefusedHere) {
    Header head;
    head.sender = kAnn;
    core.onClientMsg(kRobotHome, false, head, "\xff\xff");
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].message.reply().refusal().code(), proto::MALFORMED);
    EXPECT_EQ(there.opened.size(), 1U) << "no session is opened for it";
}

TEST_F(PartnerCoreTest, TheHolderIsCalledAsAtHomeOrByAnIdOfNobody) {
    visit(kAnn, kAnnThere);
    core.onStatus(watch, statusOf(kAnnThere, EntityState::REG));
    EXPECT_EQ(home.statuses.back().holder.id, "ann-id");
    EXPECT_EQ(home.statuses.back().holder.name, "ann@desk");
    EXPECT_EQ(home.statuses.back().held, (LeaseNumber{3, 5}));
    core.onStatus(watch, statusOf({"fe1:x:y", "carol@b", Role::Operator}, EntityState::REG));
    EXPECT_EQ(home.statuses.back().holder.id, "stranger-fe1:x:y");
    EXPECT_EQ(home.statuses.back().holder.name, "carol@b");
}

TEST_F(PartnerCoreTest, WhatOnlyAHolderMaySayOpensNoSession) {
    proto::ToEntity task;
    task.mutable_task()->set_task_id("0123456789abcdef");
    say(kBob, kMsgTask, task, {3, 5});
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].head.sender.id, "bob-id");
    EXPECT_EQ(home.sent[0].message.reply().request_id(), "0123456789abcdef");
    EXPECT_EQ(home.sent[0].message.reply().refusal().code(), proto::NOT_HOLDER);
    EXPECT_EQ(there.opened.size(), 1U);
}

TEST_F(PartnerCoreTest, ARefusalOfTheServerThereAnswersTheRequest) {
    const auto session = visit(kAnn, kAnnThere);
    Header head;
    head.entity = kRobot;
    head.msg_type = kMsgCheckOut;
    head.sequence = 1;
    core.onRefusal(session, head, {RefusalCode::PermissionDenied, "not on the list", {}});
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].head.msg_type, kMsgCheckOut);
    EXPECT_EQ(home.sent[0].message.check_out().request_id(), "0123456789abcdef");
    EXPECT_EQ(home.sent[0].message.check_out().refusal().code(), proto::PERMISSION_DENIED);
    EXPECT_EQ(home.sent[0].message.check_out().refusal().message(), "not on the list");
    head.sequence = 77;
    core.onRefusal(session, head, {RefusalCode::PermissionDenied, "of nothing", {}});
    EXPECT_EQ(home.sent.size(), 1U);
}

TEST_F(PartnerCoreTest, AClientThatIsNotLetInIsToldWhy) {
    checkOut(kAnn);
    core.onRefused(there.opened.back().first, {RefusalCode::Overloaded, "256 sessions", {}});
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].message.check_out().refusal().code(), proto::OVERLOADED);
    EXPECT_THAT(home.sent[0].message.check_out().refusal().message(),
                HasSubstr("b does not let this client in"));
    EXPECT_EQ(core.visitors(), 0U);
}

TEST_F(PartnerCoreTest, OnlySoManyVisitAndSoMuchWaits) {
    checkOut(kAnn);
    checkOut(kBob);
    checkOut({"carol-id", "carol", Role::Operator});
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].head.sender.id, "carol-id");
    EXPECT_EQ(home.sent[0].message.check_out().refusal().code(), proto::OVERLOADED);
    for (std::size_t i = 0; i < PartnerCore::kWaitingMessages; ++i) checkOut(kAnn, static_cast<int>(i) + 2);
    ASSERT_EQ(home.sent.size(), 2U);
    EXPECT_EQ(home.sent[1].head.sender.id, "ann-id");
    EXPECT_EQ(home.sent[1].message.check_out().refusal().code(), proto::OVERLOADED);
}

TEST_F(PartnerCoreTest, AServerThatDoesNotReadRefusesMore) {
    visit(kAnn, kAnnThere);
    there.full = true;
    checkOut(kAnn, 2);
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].message.check_out().refusal().code(), proto::OVERLOADED);
}

TEST_F(PartnerCoreTest, AClientLeavesThereAsItLeavesHome) {
    const auto ann = visit(kAnn, kAnnThere);
    const auto bob = visit(kBob, {"bob-there", "b", Role::Operator});
    core.onClientUpdate("unknown", "ann-id", ClientChange::Lost);
    EXPECT_THAT(there.dropped, IsEmpty());
    core.onClientUpdate(kRobotHome, "ann-id", ClientChange::Lost);
    core.onClientUpdate(kRobotHome, "bob-id", ClientChange::Ended);
    core.onClientUpdate(kRobotHome, "bob-id", ClientChange::Ended);
    EXPECT_THAT(there.dropped, ElementsAre(ann));
    EXPECT_THAT(there.left, ElementsAre(bob));
    EXPECT_EQ(core.visitors(), 0U);
}

TEST_F(PartnerCoreTest, ALostSessionAnswersWhatWasUnderWay) {
    const auto ann = visit(kAnn, kAnnThere);
    core.onClosed(ann, "cut");
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].message.check_out().refusal().code(), proto::OUTCOME_UNKNOWN);
    core.onStatus(watch, statusOf(kAnnThere, EntityState::REG));
    EXPECT_EQ(home.statuses.back().holder.id, "ann-id") << "whose grace runs is said by the right name";
    checkOut(kAnn, 2);
    EXPECT_EQ(there.opened.size(), 3U) << "with which it takes up its lease again";
}

TEST_F(PartnerCoreTest, ALostLaboratoryLeavesHomeAndIsLookedForAgain) {
    const auto ann = visit(kAnn, kAnnThere);
    core.onClosed(watch, "cut");
    EXPECT_THAT(home.left, ElementsAre(kRobotHome));
    EXPECT_THAT(there.dropped, ElementsAre(watch, ann));
    EXPECT_EQ(there.opened.size(), 2U);
    pass(200ms);
    ASSERT_EQ(there.opened.size(), 3U);
    const auto second = there.opened.back().first;
    core.onRefused(second, {RefusalCode::Unavailable, "nobody there", {}});
    core.onProfile(watch, Presence::Joined, {}, {});  // late, of the first session
    EXPECT_EQ(core.entities(), 0U);
    pass(300ms);
    EXPECT_EQ(there.opened.size(), 4U);
}

TEST_F(PartnerCoreTest, ASilentServerThereIsLost) {
    pass(9s);
    EXPECT_THAT(home.left, IsEmpty());
    EXPECT_GT(there.beats[watch], 4);
    core.onHomeHeartbeat(kRobotHome);
    pass(1100ms);
    EXPECT_THAT(home.left, ElementsAre(kRobotHome));
}

TEST_F(PartnerCoreTest, WhileARobotOfAVisitorMovesItsServerMayBeSilentForItsShortWatchdog) {
    const auto ann = visit(kAnn, kAnnThere);
    core.onStatus(watch, statusOf(kAnnThere, EntityState::BUSY));
    core.onHomeHeartbeat(kRobotHome);
    pass(200ms);
    EXPECT_THAT(there.dropped, IsEmpty());
    EXPECT_GE(there.beats[ann], 4) << "and it beats in a fifth of that";
    core.onHomeHeartbeat(kRobotHome);
    pass(100ms);
    EXPECT_THAT(there.dropped, testing::Contains(ann));
}

TEST_F(PartnerCoreTest, WhenTheServerAtHomeIsLostOrSilentItsClientsAreLostThere) {
    const auto ann = visit(kAnn, kAnnThere);
    core.onHomeDown(kRobotHome, "cut");
    EXPECT_THAT(there.dropped, ElementsAre(ann));
    EXPECT_THAT(home.left, IsEmpty()) << "the entity session connects again by itself";
    core.onHomeUp(kRobotHome);
    EXPECT_EQ(home.shown.size(), 2U);
    const auto again = visit(kAnn, kAnnThere);
    core.onStatus(watch, statusOf(kAnnThere, EntityState::BUSY));
    for (int i = 0; i < 12; ++i) {
        core.onHeartbeat(again);
        core.onHeartbeat(watch);
        pass(25ms);
    }
    EXPECT_THAT(there.dropped, ElementsAre(ann, again));
    EXPECT_THAT(home.renewed, ElementsAre(kRobotHome));
}

TEST_F(PartnerCoreTest, WhoOnlyAskedSomethingOnceLeavesAgain) {
    proto::ToEntity message;
    message.mutable_status_request()->set_request_id("1");
    say(kBob, kMsgStatus, message);
    const auto bob = there.opened.back().first;
    core.onOpened(bob, {"bob-there", "b", Role::Operator}, {});
    const auto ann = visit(kAnn, kAnnThere);
    for (int i = 0; i < 32; ++i) {
        for (const auto session : {watch, ann, bob}) core.onHeartbeat(session);
        core.onHomeHeartbeat(kRobotHome);
        pass(1s);
    }
    EXPECT_THAT(there.left, ElementsAre(bob));
}

TEST_F(PartnerCoreTest, WhoIsRefusedHasReleasedOrWatchesNoLongerLeavesAgain) {
    const auto leaves = [&](SessionNumber session) {
        for (int i = 0; i < 32; ++i) {
            core.onHeartbeat(watch);
            core.onHeartbeat(session);
            core.onHomeHeartbeat(kRobotHome);
            pass(1s);
        }
        const bool left = !there.left.empty();
        there.left.clear();
        return left;
    };
    auto session = visit(kAnn, kAnnThere);
    EXPECT_FALSE(leaves(session)) << "she waits for an answer";
    proto::ToClient answer;
    answer.mutable_check_out()->set_request_id("0123456789abcdef");
    answer.mutable_check_out()->set_place(1);
    fromThere(session, answer);
    EXPECT_FALSE(leaves(session)) << "she waits for the robot";
    answer.mutable_check_out()->mutable_refusal()->set_code(proto::ALREADY_HELD);
    fromThere(session, answer);
    EXPECT_TRUE(leaves(session)) << "refused";

    session = visit(kAnn, kAnnThere);
    answer.Clear();
    answer.mutable_check_out()->set_request_id("0123456789abcdef");
    answer.mutable_check_out()->mutable_lease()->set_number(5);
    fromThere(session, answer);
    EXPECT_FALSE(leaves(session)) << "she holds it";
    answer.mutable_lease_ended();
    fromThere(session, answer);
    EXPECT_TRUE(leaves(session)) << "it has ended";

    proto::ToEntity watching;
    watching.mutable_watch()->set_on(true);
    say(kAnn, kMsgWatch, watching);
    session = there.opened.back().first;
    core.onOpened(session, kAnnThere, {});
    EXPECT_FALSE(leaves(session)) << "she watches";
    watching.mutable_watch()->set_on(false);
    say(kAnn, kMsgWatch, watching);
    EXPECT_TRUE(leaves(session)) << "no longer";
}

TEST_F(PartnerCoreTest, WhoSendsMoreThanItsShareIsRefused) {
    proto::ToClient answer;
    answer.mutable_reply()->set_request_id("1");
    core.onClientFlood(kRobotHome, kBob, answer);
    core.onClientFlood("unknown", kBob, answer);
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].head.sender.id, "bob-id");
    EXPECT_EQ(home.sent[0].message.reply().request_id(), "1");
    EXPECT_EQ(home.sent[0].message.reply().refusal().code(), proto::OVERLOADED);
}

TEST_F(PartnerCoreTest, AResetOfWhoHoldsNothingIsRefusedBySignal) {
    Header head;
    head.sender = kBob;
    head.sequence = 12;
    core.onCommandOfStranger(kRobotHome, head);
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].lane, Lane::Signal);
    EXPECT_EQ(home.sent[0].message.reply().request_id(), "bob-id:12");
    EXPECT_EQ(home.sent[0].message.reply().refusal().code(), proto::NOT_HOLDER);
}

TEST_F(PartnerCoreTest, TheAccountOfAnAdministratorRearmsOnlyForTheHolder) {
    const Sender admin{"ann-there", "lab-a@ann", Role::Admin};
    const auto session = visit(kAnn, admin);
    proto::ToEntity rearm;
    rearm.mutable_rearm()->set_request_id("1");
    say(kAnn, kMsgRearm, rearm, {3, 5}, 2);
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].message.reply().refusal().code(), proto::NOT_HOLDER);
    proto::ToClient granted;
    granted.mutable_check_out()->mutable_lease()->set_epoch(3);
    granted.mutable_check_out()->mutable_lease()->set_number(5);
    fromThere(session, granted);
    there.sent.clear();
    say(kAnn, kMsgRearm, rearm, {3, 5}, 3);
    EXPECT_EQ(there.sent.size(), 1U);
    proto::ToClient ended;
    ended.mutable_lease_ended();
    fromThere(session, ended);
    there.sent.clear();
    say(kAnn, kMsgRearm, rearm, {3, 5}, 4);
    EXPECT_THAT(there.sent, IsEmpty());
}

TEST_F(PartnerCoreTest, OnlyRawDataMayBeDroppable) {
    const Sender eve{"eve-id", "eve@desk", Role::Observer};
    proto::ToEntity asked;
    asked.mutable_status_request()->set_request_id("1");
    say(eve, kMsgStatus, asked);
    core.onOpened(there.opened.back().first, {"eve-there", "lab-a@eve", Role::Operator}, {});
    there.sent.clear();
    proto::ToEntity take;
    take.mutable_check_out()->set_phase(proto::TAKE);
    Header head;
    head.sender = eve;
    for (const auto* type : {kMsgCheckOut, kMsgTask, kMsgRearm, ""}) {
        head.msg_type = type;
        core.onClientMsg(kRobotHome, true, head, take.SerializeAsString());
    }
    EXPECT_THAT(there.sent, IsEmpty()) << "it would go past what her role permits";
    head.msg_type = kMsgRaw;
    core.onClientMsg(kRobotHome, true, head, "anything");
    ASSERT_EQ(there.sent.size(), 1U);
    EXPECT_EQ(there.sent[0].operation, client::Operation::ToEntityDataSeq);
}

TEST_F(PartnerCoreTest, AHolderIsKnownHoweverManyVisitAfterIt) {
    visit(kAnn, kAnnThere);
    for (std::size_t i = 0; i <= PartnerCore::kHolders; ++i) {
        const auto number = std::to_string(i);
        const Sender bob{"bob-" + number, "bob", Role::Operator};
        visit(bob, {"bob-there-" + number, "b", Role::Operator});
        core.onClientUpdate(kRobotHome, bob.id, ClientChange::Ended);
    }
    core.onStatus(watch, statusOf(kAnnThere, EntityState::BUSY));
    EXPECT_EQ(home.statuses.back().holder.id, "ann-id");
    core.onStatus(watch, statusOf({"bob-there-0", "b", Role::Operator}, EntityState::REG));
    EXPECT_EQ(home.statuses.back().holder.id, "stranger-bob-there-0") << "of the gone only so many are";
}

TEST_F(PartnerCoreTest, TheSilenceOfOneSessionEndsThatOneOnly) {
    const auto ann = visit(kAnn, kAnnThere);
    const auto bob = visit(kBob, {"bob-there", "b", Role::Operator});
    core.onStatus(watch, statusOf(kAnnThere, EntityState::BUSY));
    for (int i = 0; i < 16; ++i) {
        core.onHeartbeat(bob);
        core.onHomeHeartbeat(kRobotHome);
        pass(25ms);
    }
    EXPECT_THAT(there.dropped, ElementsAre(ann));
    EXPECT_THAT(home.left, IsEmpty());
    EXPECT_EQ(core.visitors(), 1U);
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].head.sender.id, "ann-id");
    EXPECT_EQ(home.sent[0].message.check_out().refusal().code(), proto::OUTCOME_UNKNOWN);
}

TEST_F(PartnerCoreTest, AnEntityThatAClientHasToGiveUpIsGivenUpAloneAndTheOthersStay) {
    robot("r2", "Arm");
    const auto ann = visit(kAnn, kAnnThere);  // waits for r1
    Header head;
    head.sender = kAnn;
    head.msg_type = kMsgCheckOut;
    head.sequence = 2;
    proto::ToEntity take;
    take.mutable_check_out()->set_request_id("fedcba9876543210");
    take.mutable_check_out()->set_phase(proto::TAKE);
    core.onClientMsg("home-r2", false, head, take.SerializeAsString());
    proto::ToEntity watching;
    watching.mutable_watch()->set_on(true);
    say(kAnn, kMsgWatch, watching, {}, 3);
    there.sent.clear();
    core.onClientUpdate(kRobotHome, "ann-id", ClientChange::Ended);
    EXPECT_THAT(there.left, IsEmpty()) << "she drives r2";
    proto::ToEntity told;
    ASSERT_EQ(there.sent.size(), 2U);
    EXPECT_EQ(there.sent[0].session, ann);
    EXPECT_EQ(there.sent[0].head.entity, kRobot);
    EXPECT_EQ(there.sent[0].head.msg_type, kMsgCheckOut);
    ASSERT_TRUE(told.ParseFromString(there.sent[0].bytes));
    EXPECT_EQ(told.check_out().phase(), proto::ABORT);
    EXPECT_EQ(told.check_out().request_id(), "0123456789abcdef");
    EXPECT_EQ(there.sent[1].head.msg_type, kMsgWatch);
    ASSERT_TRUE(told.ParseFromString(there.sent[1].bytes));
    EXPECT_TRUE(told.has_watch() && !told.watch().on());
    core.onClientUpdate("home-r2", "ann-id", ClientChange::Ended);
    EXPECT_THAT(there.left, ElementsAre(ann)) << "nothing is left that she wants";
    EXPECT_THAT(home.sent, testing::Contains(testing::Truly([](const ToHome& one) {
                    return one.message.check_out().request_id() == "fedcba9876543210" &&
                           one.message.check_out().refusal().code() == proto::OUTCOME_UNKNOWN;
                })))
        << "and no request stays without an answer";
}

TEST_F(PartnerCoreTest, AnEntityThatIsHeldAlreadyWhenItHasToBeGivenUpIsReleased) {
    robot("r2", "Arm");
    const auto ann = visit(kAnn, kAnnThere);
    Header head;
    head.sender = kAnn;
    head.sequence = 2;
    proto::ToEntity watching;
    watching.mutable_watch()->set_on(true);
    core.onClientMsg("home-r2", false, head, watching.SerializeAsString());
    proto::ToClient granted;
    granted.mutable_check_out()->mutable_lease()->set_epoch(3);
    granted.mutable_check_out()->mutable_lease()->set_number(5);
    fromThere(ann, granted);
    there.sent.clear();
    core.onClientUpdate(kRobotHome, "ann-id", ClientChange::Ended);
    EXPECT_THAT(there.left, IsEmpty());
    ASSERT_EQ(there.sent.size(), 1U);
    EXPECT_EQ(there.sent[0].head.msg_type, kMsgRelease);
    EXPECT_EQ(there.sent[0].head.held, (LeaseNumber{3, 5}));
    proto::ToEntity told;
    ASSERT_TRUE(told.ParseFromString(there.sent[0].bytes));
    EXPECT_TRUE(told.has_release());
}

TEST_F(PartnerCoreTest, TheSessionForStrangersStopsEndsAloneAndIsOpenedAgain) {
    const auto ann = visit(kAnn, kAnnThere);
    EXPECT_EQ(stopGoesBy(), there.for_stops[0]);
    core.onClosed(there.for_stops[0], "flooded");
    EXPECT_THAT(there.dropped, ElementsAre(there.for_stops[0]));
    EXPECT_EQ(stopGoesBy(), watch) << "until there is another one";
    EXPECT_THAT(home.left, IsEmpty());
    EXPECT_EQ(core.visitors(), 1U);
    pass(200ms);
    ASSERT_EQ(there.for_stops.size(), 2U);
    core.onRefused(there.for_stops[1], {RefusalCode::Overloaded, "full", {}});
    EXPECT_THAT(notes, testing::Contains(HasSubstr("no session for stops of clients without one (full)")));
    EXPECT_EQ(stopGoesBy(), watch);
    pass(400ms);
    ASSERT_EQ(there.for_stops.size(), 3U);
    core.onOpened(there.for_stops[2], {"s2", "lab-a", Role::Operator}, {});
    EXPECT_EQ(stopGoesBy(), there.for_stops[2]);
    // It beats, and its own silence ends only itself.
    for (int i = 0; i < 11; ++i) {
        for (const auto session : {watch, ann}) core.onHeartbeat(session);
        core.onHomeHeartbeat(kRobotHome);
        pass(1s);
    }
    EXPECT_GT(there.beats[there.for_stops[2]], 4);
    EXPECT_THAT(there.dropped, ElementsAre(there.for_stops[0], there.for_stops[2]));
    EXPECT_EQ(core.visitors(), 1U);
}

TEST_F(PartnerCoreTest, WithoutASessionForStrangersStopsTheOneThatWatchesTakesThemFromTheBeginning) {
    core.onClosed(there.for_stops[0], "flooded");
    core.onClosed(watch, "lost");
    pass(200ms);
    core.onRefused(there.for_stops.back(), {RefusalCode::Overloaded, "full", {}});
    pass(25ms);
    const auto again = there.opened.back().first;
    ASSERT_NE(again, watch);
    core.onOpened(again, {"w2", "lab-a", Role::Operator}, {});
    EXPECT_EQ(stopGoesBy(), again);
    core.onClosed(again, "lost");
    EXPECT_EQ(stopGoesBy(), 0U);
}

TEST_F(PartnerCoreTest, WhatASessionThatFailedWasToldOfIsNotAskedForInTheNext) {
    core.onClosed(watch, "lost");
    pass(200ms);
    ASSERT_NE(there.opened.back().first, watch);
    watch = there.opened.back().first;
    for (std::size_t i = 0; i <= PartnerCore::kEntities; ++i)
        robot("many-" + std::to_string(i), "Many" + std::to_string(i));
    core.onRefused(watch, {RefusalCode::Overloaded, "full", {}});
    EXPECT_EQ(core.entities(), 0U);
    pass(500ms);
    ASSERT_NE(there.opened.back().first, watch);
    watch = there.opened.back().first;
    core.onOpened(watch, {"w3", "lab-a", Role::Operator}, {});
    pass(PartnerCore::kListAgain + 100ms);
    EXPECT_THAT(there.sent, IsEmpty());
}

TEST_F(PartnerCoreTest, AReceiptThatComesByTheSessionThatWatchesIsForWhoStopped) {
    core.onClosed(there.for_stops[0], "flooded");
    Header stop;
    stop.sender = kBob;
    stop.sequence = 7;
    EXPECT_EQ(signals.stop(kRobot, stop, StopCause::Requested), SignalRelay::Passed::Sent);
    proto::ToClient message;
    message.mutable_receipt()->set_stop_id(SignalId{"s" + std::to_string(watch), 1}.text());
    fromThere(watch, message, Lane::Signal);
    ASSERT_EQ(home.sent.size(), 1U);
    EXPECT_EQ(home.sent[0].head.sender.id, kBob.id);
    EXPECT_EQ(home.sent[0].message.receipt().stop_id(), (SignalId{kBob.id, 7}.text()));
    message.mutable_receipt()->set_stop_id(SignalId{"somebody", 1}.text());
    fromThere(watch, message, Lane::Signal);
    message.Clear();
    message.mutable_lease_ended();
    fromThere(watch, message);
    EXPECT_EQ(home.sent.size(), 1U) << "what is not a receipt of its own is for nobody";
}

TEST_F(PartnerCoreTest, TheOrderlyEndReleasesWhatIsHeld) {
    const auto ann = visit(kAnn, kAnnThere);
    core.stop();
    EXPECT_THAT(there.left, ElementsAre(ann, watch, there.for_stops[0]));
    EXPECT_THAT(home.left, ElementsAre(kRobotHome));
    core.onClosed(watch, "left");
    pass(5s);
    EXPECT_EQ(there.opened.size(), 2U);
}

}  // namespace
}  // namespace axon::partner
