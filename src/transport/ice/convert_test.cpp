// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/convert.hpp"

#include <gtest/gtest.h>

#include <limits>

#include "transport/ice/communicator.hpp"

namespace axon::transport {
namespace {

TEST(Convert, EnumeratorsOfTheContractsAndOfTheCoresAgree) {
    const auto same = [](auto ice, auto plain) { EXPECT_EQ(static_cast<int>(ice), static_cast<int>(plain)); };
    same(ice::Role::Observer, Role::Observer);
    same(ice::Role::Operator, Role::Operator);
    same(ice::Role::Admin, Role::Admin);
    same(ice::Lane::Signal, Lane::Signal);
    same(ice::Lane::Data, Lane::Data);
    same(ice::Presence::Joined, Presence::Joined);
    same(ice::Presence::Changed, Presence::Changed);
    same(ice::Presence::Left, Presence::Left);
    same(ice::ClientChange::Lost, ClientChange::Lost);
    same(ice::ClientChange::Ended, ClientChange::Ended);
#define AXON_STATE(name, availability) same(ice::EntityState::name, EntityState::name);
#include "common/axon/states.def"
#undef AXON_STATE
    same(ice::StopCause::Unspecified, StopCause::Unspecified);
    same(ice::StopCause::Requested, StopCause::Requested);
    same(ice::StopCause::ClientLost, StopCause::ClientLost);
    same(ice::StopCause::Released, StopCause::Released);
    same(ice::StopCause::Improper, StopCause::Improper);
    same(ice::StopCause::ServerLost, StopCause::ServerLost);
    same(ice::StopCause::LinkLost, StopCause::LinkLost);
    same(ice::StopCause::Reset, StopCause::Reset);
    same(ice::StopCause::Clear, StopCause::Clear);
    same(ice::StopCause::Cancel, StopCause::Cancel);
    same(ice::StopCause::Shutdown, StopCause::Shutdown);
    same(ice::StopCause::Fault, StopCause::Fault);
    same(ice::StopCause::Drill, StopCause::Drill);
}

TEST(Convert, EverythingOfAHeaderGoesThereAndBack) {
    Header head;
    head.sender = {"id", "client1@lab", Role::Admin};
    head.entity = "uuid";
    head.msg_type = kMsgTask;
    head.held = {3, 7};
    head.stop_generation = 11;
    head.sequence = 1LL << 52;
    head.sent_at_us = 123456789;
    const auto back = fromIce(toIce(head));
    EXPECT_EQ(back.sender, head.sender);
    EXPECT_EQ(back.entity, head.entity);
    EXPECT_EQ(back.msg_type, head.msg_type);
    EXPECT_EQ(back.held, head.held);
    EXPECT_EQ(back.stop_generation, head.stop_generation);
    EXPECT_EQ(back.sequence, head.sequence);
    EXPECT_EQ(back.sent_at_us, head.sent_at_us);

    const EntityStatus status{
        "uuid", EntityState::BUSY, true, 5, {"c", "n", Role::Operator}, {1, 2}, "why", true, 3, 450, "es1"};
    EXPECT_EQ(fromIce(toIce(status)), status);
    const Registration registration{"uuid", "name", "ROBOT", "MOBILE", 20, 900, "es1"};
    EXPECT_EQ(fromIce(toIce(registration)), registration);
    const ServerAnnouncement server{"fe1", "1234abcd", "signals:tcp", 1LL << 40, "messages:tcp"};
    EXPECT_EQ(fromIce(toIce(server)), server);
}

TEST(Convert, ANumberThatIsNoneBecomesZero) {
    for (const double bad :
         {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity(), -1.0, 1e300}) {
        ice::Header head;
        head.seq = bad;
        EXPECT_EQ(fromIce(std::move(head)).sequence, 0);
    }
}

TEST(Endpoint, TakesHostAndPortAndNothingElse) {
    EXPECT_EQ(tcpEndpoint("127.0.0.1:10410"), "tcp -h 127.0.0.1 -p 10410");
    EXPECT_EQ(tcpEndpoint("localhost:0"), "tcp -h localhost -p 0");
    for (const char* bad :
         {"", "host", ":1", "host:", "host:65536", "host:-1", "host:1x", "a b:1", "h -t 5:1", "-h:1"}) {
        EXPECT_THROW(tcpEndpoint(bad), std::invalid_argument) << bad;
    }
}

TEST(Translate, GivesEachFailureItsCode) {
    const auto code = [](auto error) { return translate(std::make_exception_ptr(error)).code; };
    EXPECT_EQ(code(Axon::CommUtil::RequestRefused(static_cast<int>(RefusalCode::Duplicate), "x")),
              RefusalCode::Duplicate);
    EXPECT_EQ(code(Ice::InvocationTimeoutException(__FILE__, __LINE__)), RefusalCode::TimedOut);
    EXPECT_EQ(code(Ice::ConnectionRefusedException(__FILE__, __LINE__)), RefusalCode::NotConnected);
    EXPECT_EQ(code(Ice::ConnectionLostException(__FILE__, __LINE__)), RefusalCode::NotConnected);
    EXPECT_EQ(code(Ice::MemoryLimitException(__FILE__, __LINE__)), RefusalCode::TooLarge);
    EXPECT_EQ(code(Ice::BadMagicException(__FILE__, __LINE__)), RefusalCode::Malformed);
    EXPECT_EQ(code(std::runtime_error("x")), RefusalCode::Internal);
}

TEST(Convert, AHeadWithALongStringIsNotProper) {
    Header head;
    head.sender.id = "12345";
    head.entity = std::string(kHeadStringMax, 'e');
    EXPECT_EQ(stringBytes(head), kHeadStringMax + 5);
    EXPECT_TRUE(isProper(head));
    head.msg_type = std::string(kHeadStringMax + 1, 't');
    EXPECT_FALSE(isProper(head));
    cutStrings(head);
    EXPECT_TRUE(isProper(head));
    EXPECT_EQ(head.sender.id, "12345");
}

}  // namespace
}  // namespace axon::transport
