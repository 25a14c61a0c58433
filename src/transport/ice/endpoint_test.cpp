// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/endpoint.hpp"

#include <gtest/gtest.h>

#include <stdexcept>

namespace axon::transport {
namespace {

TEST(Endpoints, AreReadInOurFormAndInIces) {
    EXPECT_EQ(parseEndpoint("127.0.0.1:10410").text(), "tcp -h 127.0.0.1 -p 10410");
    EXPECT_EQ(parseEndpoint("ssl://lab.example:0").text(), "ssl -h lab.example -p 0");
    EXPECT_EQ(parseEndpoint(" ssl -h  0.0.0.0 -p 4063 ").address(), "ssl://0.0.0.0:4063");
    EXPECT_EQ(parseEndpoint("tcp -h lab -p 1").address(), "lab:1");
    const auto both = parseEndpoints("ssl -h 0.0.0.0 -p 4063:tcp -h 127.0.0.1 -p 10410");
    ASSERT_EQ(both.size(), 2U);
    EXPECT_TRUE(both[0].tls);
    EXPECT_FALSE(both[1].tls);
    EXPECT_EQ(textOf(both), "ssl -h 0.0.0.0 -p 4063:tcp -h 127.0.0.1 -p 10410");
    EXPECT_EQ(parseEndpoints("lab:1").size(), 1U);
}

TEST(Endpoints, AreRefusedWhereIceWouldReadSomethingElse) {
    for (const auto* bad : {"",
                            ":",
                            "ssl://",
                            "ssl://:1",
                            "ssl://lab",
                            "lab",
                            "lab:",
                            "lab:x",
                            "lab:65536",
                            "lab:-1",
                            "-h:1",
                            "a b:1",
                            "http://lab:1",
                            "tcp -p 1",
                            "tcp -h lab",
                            "ssl -h lab -p 1 -t 5",
                            "udp -h lab -p 1",
                            "ssl -h lab -p 65536",
                            "ssl -h lab -p 1:",
                            "ssl -h lab -p 1:tcp",
                            "ssl -h lab -p 1::tcp -h lab -p 2",
                            "ssl -h -p -p 1",
                            "ssl -h lab -p 1\n:",
                            "lab:1:2"})
        EXPECT_THROW(parseEndpoints(bad), std::invalid_argument) << bad;
}

TEST(Endpoints, TheSignalLaneIsCalledByTheNameThatTheCertificateIsFor) {
    const auto called = parseEndpoint("ssl://lab.example:10410");
    EXPECT_EQ(asCalled("ssl -h 10.0.0.5 -p 10411", called, "10.0.0.5"), "ssl -h lab.example -p 10411");
    EXPECT_EQ(asCalled("ssl -h 10.0.0.6 -p 10411", called, "10.0.0.5"), "ssl -h 10.0.0.6 -p 10411");
    EXPECT_EQ(asCalled("tcp -h 10.0.0.5 -p 10411", called, "10.0.0.5"), "tcp -h 10.0.0.5 -p 10411");
}

}  // namespace
}  // namespace axon::transport
