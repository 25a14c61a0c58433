// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/sessions/routed_session.hpp"

#include <gtest/gtest.h>

namespace axon::transport {
namespace {

TEST(WayToARouter, IsTlsWithACertificateAndPlainWithoutWhateverTheOrder) {
    const std::string name = "Axon.Clients/router", plain = "tcp -h 127.0.0.1 -p 10414",
                      tls = "ssl -h 127.0.0.1 -p 10418";
    for (const auto& both : {name + ":" + plain + ":" + tls, name + ":" + tls + ":" + plain}) {
        EXPECT_EQ(wayToRouter(both, true), name + ":" + tls);
        EXPECT_EQ(wayToRouter(both, false), name + ":" + plain);
    }
    const auto many = name + " -t:" + plain + ":wss -h a -p 1:" + tls + ":ws -h a -p 2";
    EXPECT_EQ(wayToRouter(many, true), name + " -t:wss -h a -p 1:" + tls);
    EXPECT_EQ(wayToRouter(many, false), name + " -t:" + plain + ":ws -h a -p 2");
}

TEST(WayToARouter, ThatHasNoChoiceIsAsItIs) {
    for (const std::string one : {"Axon.Clients/router:tcp -h 127.0.0.1 -p 10414",
                                  "Axon.Clients/router: ssl -h lab -p 10418", "Axon.Clients/router", ""}) {
        EXPECT_EQ(wayToRouter(one, true), one);
        EXPECT_EQ(wayToRouter(one, false), one);
    }
    EXPECT_EQ(wayToRouter("Axon.Clients/router:tcp -h \"::1\" -p 10414", true),
              "Axon.Clients/router:tcp -h \"::1\" -p 10414");
}

TEST(WayToARouter, OneOfSeveralIsGivenUpSoon) {
    const auto soon = routerTriedFor("Axon.Clients/router:tcp -h a -p 1:tcp -h b -p 2");
    ASSERT_TRUE(soon);
    EXPECT_LE(*soon, 500) << "two lanes try up to twice, and everything is to be usable within 5 s";
    const auto handshake = routerTriedFor("Axon.Clients/router:ssl -h a -p 1:ssl -h b -p 2");
    ASSERT_TRUE(handshake);
    EXPECT_GT(*handshake, *soon) << "all peers of a lost router shake hands with another one at once";
    EXPECT_LE(*handshake, 1000) << "the lost one is tried last, so one more of them may be away";
    EXPECT_FALSE(routerTriedFor("Axon.Clients/router:tcp -h a -p 1"));
    EXPECT_FALSE(routerTriedFor("Axon.Clients/router:tcp -h \"::1\" -p 1"));
    EXPECT_FALSE(routerTriedFor("127.0.0.1:10410"));
    EXPECT_FALSE(routerTriedFor("ssl://lab:10410"));
}

TEST(WayToARouter, IsTlsOrNot) {
    EXPECT_TRUE(isTlsRouter("Axon.Clients/router: ssl -h lab -p 10418"));
    EXPECT_TRUE(isTlsRouter("Axon.Clients/router:ssl -h \"::1\" -p 10418"));
    EXPECT_FALSE(isTlsRouter("Axon.Clients/router:tcp -h sslhost -p 10418"));
    EXPECT_FALSE(isTlsRouter("Axon.Clients/router"));
    EXPECT_FALSE(isTlsRouter(""));
}

}  // namespace
}  // namespace axon::transport
