// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/core/sites.hpp"

#include <gtest/gtest.h>

#include <stdexcept>

namespace axon::console {
namespace {

const Sites kPlain{{false, 10417, 10418, 10419, {"lab", "Lab.Example"}, {}}};

TEST(Sites, AreTheAddressOfTheConnectionAndLocalhost) {
    const auto site = kPlain.ofHost("127.0.0.1:10417", "127.0.0.1");
    ASSERT_TRUE(site);
    EXPECT_EQ(site->origin, "http://127.0.0.1:10417");
    EXPECT_EQ(site->socket, "ws://127.0.0.1:10418");
    EXPECT_EQ(site->endpoint, "ws -h 127.0.0.1 -p 10418 -r /axon");
    EXPECT_EQ(site->signal_socket, "ws://127.0.0.1:10419");
    EXPECT_EQ(site->signal_endpoint, "ws -h 127.0.0.1 -p 10419 -r /axon-signal");
    EXPECT_FALSE(site->secure);
    EXPECT_TRUE(kPlain.ofHost("localhost:10417", "127.0.0.1"));
    EXPECT_TRUE(kPlain.ofHost("192.168.0.5:10417", "192.168.0.5"));
}

TEST(Sites, AreTheNamesInTheSettingsInAnyCase) {
    const auto site = kPlain.ofHost("LAB.example:10417", "192.168.0.5");
    ASSERT_TRUE(site);
    EXPECT_EQ(site->origin, "http://lab.example:10417");
}

TEST(Sites, ANameThatLeadsToOurAddressIsNotOurs) {
    EXPECT_FALSE(kPlain.ofHost("rebound.example:10417", "127.0.0.1"));
    EXPECT_FALSE(kPlain.ofHost("127.0.0.1.example:10417", "127.0.0.1"));
    EXPECT_FALSE(kPlain.ofHost("localhost:10417", "192.168.0.5")) << "no loopback";
    EXPECT_FALSE(kPlain.ofHost("192.168.0.5:10417", "127.0.0.1")) << "another address";
    EXPECT_FALSE(kPlain.ofHost("127.0.0.1:8080", "127.0.0.1")) << "another port";
    EXPECT_FALSE(kPlain.ofHost("127.0.0.1", "127.0.0.1")) << "port 80";
}

TEST(Sites, WhatIsNoHostIsNotOurs) {
    for (const char* host :
         {"", ":", ":10417", "127.0.0.1:", "127.0.0.1:0", "127.0.0.1:10417 ", "127.0.0.1:+10417",
          "127.0.0.1:10417:10417", "user@127.0.0.1:10417", "[::1]:10417", "127.0.0.1:99999",
          "127.0.0.1:10417/", "-h:10417", "127.0.0.1\r\n:10417"})
        EXPECT_FALSE(kPlain.ofHost(host, "127.0.0.1")) << host;
}

TEST(Sites, AnOriginIsOursOnlyAsAWhole) {
    EXPECT_TRUE(kPlain.isOurs("http://127.0.0.1:10417", "127.0.0.1"));
    EXPECT_TRUE(kPlain.isOurs("http://localhost:10417", "127.0.0.1"));
    for (const char* origin :
         {"", "null", "https://127.0.0.1:10417", "http://127.0.0.1:10418", "http://localhost",
          "http://127.0.0.1:10417/", "http://127.0.0.1:10417.example", "http://other.example", "file://",
          "ws://127.0.0.1:10417", "http://127.0.0.1:010417"})
        EXPECT_FALSE(kPlain.isOurs(origin, "127.0.0.1")) << origin;
}

TEST(Sites, BehindAProxyBothPortsAreThatOfTheProxy) {
    const Sites sites{{false, 10417, 10418, 10419, {}, {"https://Lab.Example", "https://lab.example:8443"}}};
    const auto site = sites.ofHost("lab.example", "127.0.0.1");
    ASSERT_TRUE(site);
    EXPECT_EQ(site->origin, "https://lab.example");
    EXPECT_EQ(site->socket, "wss://lab.example");
    EXPECT_EQ(site->endpoint, "wss -h lab.example -p 443 -r /axon");
    EXPECT_EQ(site->signal_socket, site->socket);
    EXPECT_EQ(site->signal_endpoint, "wss -h lab.example -p 443 -r /axon-signal");
    EXPECT_EQ(sites.ofOrigin("https://LAB.example:8443", "127.0.0.1")->signal_endpoint,
              "wss -h lab.example -p 8443 -r /axon-signal");
    EXPECT_TRUE(site->secure);
    EXPECT_EQ(sites.ofHost("lab.example:8443", "127.0.0.1")->endpoint, "wss -h lab.example -p 8443 -r /axon");
    EXPECT_TRUE(sites.isOurs("https://lab.example", "127.0.0.1"));
    EXPECT_FALSE(sites.isOurs("http://lab.example", "127.0.0.1")) << "not by HTTPS";
    EXPECT_TRUE(sites.ofHost("127.0.0.1:10417", "127.0.0.1")) << "past the proxy";
}

TEST(Sites, OverTlsEverythingIsSecure) {
    const Sites sites{{true, 443, 10418, 10419, {"lab"}, {}}};
    const auto site = sites.ofHost("lab", "10.0.0.1");
    ASSERT_TRUE(site);
    EXPECT_EQ(site->origin, "https://lab");
    EXPECT_EQ(site->endpoint, "wss -h lab -p 10418 -r /axon");
}

TEST(Sites, WhoNamesNoOriginIsToldTheAddressThatItConnectedTo) {
    EXPECT_EQ(kPlain.ofAddress("192.168.0.5").signal_endpoint, "ws -h 192.168.0.5 -p 10419 -r /axon-signal");
}

TEST(Sites, RefuseSettingsThatAreNoNamesAndNoOrigins) {
    const auto with = [](std::vector<std::string> names, std::vector<std::string> proxies) {
        return Sites({false, 1, 2, 3, std::move(names), std::move(proxies)});
    };
    EXPECT_THROW(with({"http://lab"}, {}), std::invalid_argument);
    EXPECT_THROW(with({""}, {}), std::invalid_argument);
    EXPECT_THROW(with({}, {"lab.example"}), std::invalid_argument);
    EXPECT_THROW(with({}, {"https://lab.example/path"}), std::invalid_argument);
    EXPECT_THROW(with({}, {"https://"}), std::invalid_argument);
}

}  // namespace
}  // namespace axon::console
