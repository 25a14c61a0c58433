// SPDX-License-Identifier: MIT
#include "host/port_range.hpp"

#include <gtest/gtest.h>

namespace axon {
namespace {

TEST(PortRange, ReadsARangeWithCommentsAndSpaces) {
    const auto ports =
        parsePorts("# ours\r\n\n  Axon.Ports =  5600 - 5610  # ten\r\nAxon.Address=127.1.2.3", "ports.cfg");
    ASSERT_TRUE(ports.ok()) << ports.refusal().message;
    EXPECT_EQ(ports->ports, (PortRange{5600, 5610}));
    EXPECT_EQ(ports->address, "127.1.2.3");
}

TEST(PortRange, ASinglePortIsARangeOfOne) {
    EXPECT_EQ(parsePorts("Axon.Ports = 8000", "f")->ports, (PortRange{8000, 8000}));
}

TEST(PortRange, AnEmptyFileKeepsTheDefaults) {
    const auto ports = parsePorts("", "f");
    ASSERT_TRUE(ports.ok());
    EXPECT_EQ(ports->ports, (PortRange{5500, 8000}));
    EXPECT_EQ(ports->address, "127.0.0.1");
}

TEST(PortRange, OutOfRangeNamesFileLineAndExpectation) {
    for (const char* range :
         {"5499-8000", "5500-8001", "7000-6000", "0", "99999999999-5", "5500-", "-5600", "x", ""}) {
        const auto ports = parsePorts("\nAxon.Ports = " + std::string(range), "config/ports.cfg");
        ASSERT_FALSE(ports.ok()) << range;
        EXPECT_NE(ports.refusal().message.find("config/ports.cfg:2:"), std::string::npos)
            << ports.refusal().message;
        EXPECT_NE(ports.refusal().message.find("expected"), std::string::npos) << ports.refusal().message;
        EXPECT_NE(ports.refusal().message.find("5500"), std::string::npos) << ports.refusal().message;
    }
}

TEST(PortRange, UnknownSettingsAndBadAddressesAreRefused) {
    EXPECT_EQ(parsePorts("Axon.Port = 5500", "f").refusal().code, RefusalCode::Malformed);
    EXPECT_EQ(parsePorts("Axon.Ports 5500", "f").refusal().code, RefusalCode::Malformed);
    EXPECT_EQ(parsePorts("Axon.Address = localhost", "f").refusal().code, RefusalCode::Malformed);
    EXPECT_EQ(readPorts("/nonexistent/ports.cfg").refusal().code, RefusalCode::BadName);
    EXPECT_EQ(readPorts("/tmp").refusal().code, RefusalCode::BadName);
}

TEST(PortRange, KnowsTheLoopbackNetwork) {
    EXPECT_TRUE(isLoopback("127.0.0.1"));
    EXPECT_TRUE(isLoopback("127.200.3.4"));
    EXPECT_FALSE(isLoopback("128.0.0.1"));
    EXPECT_FALSE(isLoopback("0.0.0.0"));
    EXPECT_FALSE(isLoopback("127.1"));
}

}  // namespace
}  // namespace axon
