// SPDX-License-Identifier: GPL-2.0-or-later
#include <axon/messages.pb.h>
#include <gtest/gtest.h>

#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "client/direct/direct_links.hpp"
#include "client/direct/direct_sending.hpp"
#include "client/testing/test_path.hpp"
#include "common/clock.hpp"
#include "common/ids.hpp"

namespace axon::client {
namespace {

using namespace std::chrono_literals;
using direct::Keeping;
using test::NotedPath;

/// The servers, which note the numbers of what they are given; 0 for a mark.
struct NotedServers final : DataLane {
    explicit NotedServers(std::vector<std::int64_t>& numbers) : sent(numbers) {}
    void send(Operation, const Header& head, std::string) const override {
        sent.push_back(head.msg_type == kMsgWay ? 0 : head.sequence);
    }
    void add(Operation kind, const Header& head, std::string bytes) const override {
        send(kind, head, std::move(bytes));
    }
    void write() const override {}
    std::size_t waiting() const override { return 0; }
    std::size_t waitingBytes() const override { return 0; }
    void awaitRoom(Duration) const override {}
    std::vector<std::int64_t>& sent;
};

struct DirectLinksTest : testing::Test {
    DirectLinksTest() { links.offer(offer); }
    /// One turn, and the path that it wants opened.
    std::shared_ptr<NotedPath> turn() {
        last = links.turn();
        for (const auto& [link, path] : last.begun) {
            Header head;
            head.entity = path->entity();
            head.msg_type = kMsgWay;
            Outgoing mark{Operation::ToEntity, head, "", link, servers, path};
            EXPECT_TRUE(sending.takes(mark));
        }
        for (const auto& [path, why] : last.close) path->close(why);
        return last.open.empty() ? nullptr : std::static_pointer_cast<NotedPath>(last.open.front());
    }
    std::shared_ptr<NotedPath> standing() {
        auto path = turn();
        path->stand();
        turn();
        return path;
    }
    bool give(const char* type, std::int64_t sequence, Operation kind = Operation::ToEntity) {
        Header head;
        head.entity = "robot";
        head.msg_type = type;
        head.sequence = sequence;
        Outgoing message{kind, head, "x", links.linkOf("robot"), servers};
        if (sending.takes(message)) return true;
        by_servers.push_back(sequence);
        return false;
    }
    DirectLinks::Arrival comes(const DirectPath& path, std::int64_t sequence, const char* type = kMsgText) {
        Header head;
        head.msg_type = type;
        head.sequence = sequence;
        head.entity = "robot";
        return links.arrived(path, Keeping::Kept, head, "x");
    }
    /// By the servers; what was held back is in `heard`.
    bool relayed(std::int64_t sequence, const char* type = kMsgText, const std::string& message = "x") {
        Header head;
        head.entity = "robot";
        head.msg_type = type;
        head.sequence = sequence;
        return links.relayed(Keeping::Kept, head, message,
                             [this](const Header& its, std::string_view) { heard.push_back(its.sequence); });
    }
    bool markOf(const DirectPath& path) {
        proto::ToClient mark;
        mark.mutable_way()->set_path(path.number().bytes());
        return relayed(0, kMsgWay, mark.SerializeAsString());
    }

    ManualClock clock;
    SeededRandom random{1};
    const DirectOffer offer{"robot",   {1, 1},   std::string(16, 'k'), "11111111-1111-4111-8111-111111111111",
                            "there:1", "there:2"};
    DirectLinks links{clock, 4, [this](const DirectOffer& its) {
                          return std::make_shared<NotedPath>(its, Id128::random(random), clock);
                      }};
    std::vector<std::int64_t> by_servers, heard;
    const std::shared_ptr<const DataLane> servers = std::make_shared<NotedServers>(by_servers);
    int lively = 0;
    DirectSending sending{[this] { ++lively; }};
    DirectLinks::Turn last;
};

TEST_F(DirectLinksTest, FromTheMarkOnMessagesGoByThePath) {
    EXPECT_FALSE(give(kMsgText, 1)) << "while it is being opened";
    const auto path = standing();
    EXPECT_TRUE(give(kMsgText, 2));
    EXPECT_FALSE(give(kMsgCheckOut, 3)) << "the servers see who holds what";
    EXPECT_FALSE(give(kMsgRearm, 4));
    EXPECT_EQ(by_servers, (std::vector<std::int64_t>{1, 0, 3, 4})) << "0 is the mark";
    EXPECT_EQ(path->sent, (std::vector<std::int64_t>{2}));
    EXPECT_EQ(lively, 1) << "an idle path beats at once";
}

TEST_F(DirectLinksTest, WhatAnEarlierLeaseHasNotAcknowledgedIsLostWithTheSession) {
    for (const bool withdrawn : {false, true}) {
        links.offer(offer);
        const auto path = standing();
        EXPECT_TRUE(give(kMsgText, 1));
        by_servers.clear();
        if (withdrawn) {
            links.withdraw({"robot", offer.lease});
            path->close("the lease has ended");
            turn();
        } else {
            auto next = offer;
            next.lease.number = 2;
            links.offer(next);
        }
        for (const auto& left : links.clear()) left->close("the session is lost");
        path->close("the session is lost");
        sending.fallBackFromEnded();
        EXPECT_EQ(by_servers, (std::vector<std::int64_t>{})) << "withdrawn: " << withdrawn;
    }
}

TEST_F(DirectLinksTest, WhatIsNotAcknowledgedGoesByTheServersBeforeAllThatComesAfterTheBreak) {
    const auto path = standing();
    by_servers.clear();
    for (std::int64_t number = 1; number <= 4; ++number) EXPECT_TRUE(give(kMsgText, number));
    path->acknowledged = 2;
    path->close("cut");
    EXPECT_FALSE(give(kMsgText, 5));
    EXPECT_EQ(by_servers, (std::vector<std::int64_t>{3, 4, 5}));
    turn();
    sending.fallBackFromEnded();
    EXPECT_EQ(by_servers.size(), 3U) << "once";
}

TEST_F(DirectLinksTest, AnAcknowledgementOfWhatWasNeverSentCostsNoMoreThanWhatWasSentByThen) {
    const auto path = standing();
    by_servers.clear();
    EXPECT_TRUE(give(kMsgText, 1));
    path->acknowledged = std::int64_t{1} << 52U;
    EXPECT_TRUE(give(kMsgText, 2));
    path->acknowledged = 0;
    EXPECT_TRUE(give(kMsgText, 3));
    path->close("cut");
    EXPECT_FALSE(give(kMsgText, 4));
    EXPECT_EQ(by_servers, (std::vector<std::int64_t>{2, 3, 4}));
}

TEST_F(DirectLinksTest, AReleaseEndsThePathAndGoesByTheServersBehindWhatWasNotAcknowledged) {
    const auto path = standing();
    by_servers.clear();
    EXPECT_TRUE(give(kMsgText, 1));
    EXPECT_FALSE(give(kMsgRelease, 2));
    EXPECT_TRUE(path->ended());
    EXPECT_EQ(by_servers, (std::vector<std::int64_t>{1, 2}));
}

TEST_F(DirectLinksTest, WithTheSessionWhatIsNotAcknowledgedIsLost) {
    standing();
    by_servers.clear();
    EXPECT_TRUE(give(kMsgText, 1));
    for (const auto& path : links.clear()) path->close("the session is lost");
    sending.fallBackFromEnded();
    EXPECT_TRUE(by_servers.empty());
}

TEST_F(DirectLinksTest, WhatComesBeforeItsMarkIsHeldBackAndThenHeardOnceAndInOrder) {
    const auto path = standing();
    EXPECT_TRUE(relayed(1));
    EXPECT_FALSE(comes(*path, 2).pass);
    EXPECT_FALSE(comes(*path, 3).pass);
    EXPECT_FALSE(markOf(*path));
    EXPECT_EQ(heard, (std::vector<std::int64_t>{2, 3}));
    EXPECT_TRUE(comes(*path, 4).pass);
    EXPECT_FALSE(relayed(4)) << "sent again";
    EXPECT_TRUE(relayed(5));
    EXPECT_FALSE(comes(*path, 5).pass);
}

TEST_F(DirectLinksTest, AMarkOfAnotherPathOpensNothing) {
    const auto path = standing();
    comes(*path, 2);
    proto::ToClient mark;
    mark.mutable_way()->set_path(Id128::random(random).bytes());
    EXPECT_FALSE(relayed(0, kMsgWay, mark.SerializeAsString()));
    EXPECT_FALSE(relayed(0, kMsgWay, "not a message"));
    EXPECT_TRUE(heard.empty());
}

TEST_F(DirectLinksTest, WhatGoesByTheServersEndsThePathThatBringsIt) {
    const auto path = standing();
    markOf(*path);
    EXPECT_TRUE(comes(*path, 1).pass);
    for (const auto* type : {kMsgCheckOut, kMsgRearm}) {
        const auto arrival = comes(*path, 2, type);
        EXPECT_FALSE(arrival.pass) << type;
        EXPECT_EQ(arrival.close, path) << type;
    }
}

TEST_F(DirectLinksTest, APathWhoseMarkDoesNotComeInTimeIsGivenUpAndTriedAgain) {
    const auto path = standing();
    comes(*path, 1);
    turn();
    EXPECT_FALSE(path->ended());
    clock.advance(direct::kMarkWithin);
    turn();
    EXPECT_TRUE(path->ended());
    EXPECT_EQ(turn(), nullptr);
    EXPECT_TRUE(last.ended);
    clock.advance(direct::Retry::kFirst);
    EXPECT_NE(turn(), nullptr);
}

TEST_F(DirectLinksTest, AStopGoesToWhomItNamesAndOneOfNobodyToAll) {
    const auto path = standing();
    Header head;
    head.sequence = 7;
    DirectLinks::stop(*links.paths(), head, {"another"}, StopCause::Requested);
    EXPECT_TRUE(path->stops.empty());
    DirectLinks::stop(*links.paths(), head, {"another", "robot"}, StopCause::Requested);
    DirectLinks::stop(*links.paths(), head, {}, StopCause::Requested);
    head.entity = "robot";
    DirectLinks::stop(*links.paths(), head, {}, StopCause::Requested);
    EXPECT_EQ(path->stops.size(), 3U);
}

}  // namespace
}  // namespace axon::client
