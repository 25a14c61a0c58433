// SPDX-License-Identifier: GPL-2.0-or-later
#include "console/core/form.hpp"

#include <gtest/gtest.h>

namespace axon::console {
namespace {

TEST(Form, IsWhatABrowserWrites) {
    const auto form = parseForm("user=anna&password=a%26b%3D+%C3%A4");
    ASSERT_TRUE(form);
    EXPECT_EQ(*form, (Form{{"user", "anna"}, {"password", "a&b= \xc3\xa4"}}));
    EXPECT_EQ(*parseForm(""), Form{});
    EXPECT_EQ(*parseForm("user="), (Form{{"user", ""}}));
    EXPECT_EQ(*parseForm("user"), (Form{{"user", ""}}));
}

TEST(Form, WhatIsNoneIsRefused) {
    for (const char* body : {"user=%", "user=%2", "user=%zz", "a=1&a=2", "=1", "&", "a=1&", "a b=1", "a=\n",
                             "a=\xff", "{\"user\": 1}", "a=1&b=1&c=1&d=1&e=1&f=1&g=1&h=1&i=1"})
        EXPECT_FALSE(parseForm(body)) << body;
}

TEST(Cookie, IsFoundByItsWholeName) {
    EXPECT_EQ(cookie("a=1; axon-10417=xyz;b=2", "axon-10417"), "xyz");
    EXPECT_EQ(cookie("axon-10417=", "axon-10417"), "");
    EXPECT_FALSE(cookie("xaxon-10417=xyz", "axon-10417"));
    EXPECT_FALSE(cookie("axon-104170=xyz", "axon-10417"));
    EXPECT_FALSE(cookie("axon-10417", "axon-10417"));
    EXPECT_FALSE(cookie("", "axon-10417"));
    EXPECT_FALSE(cookie(";;;=;", "axon-10417"));
}

TEST(Cookie, ThatIsThereTwiceIsNobodys) {
    EXPECT_FALSE(cookie("axon=1; axon=2", "axon"));
}

TEST(Accepts, WhatTheHeaderNamesUnlessItIsForbidden) {
    EXPECT_TRUE(accepts("gzip, deflate, br", "br"));
    EXPECT_TRUE(accepts("GZIP;q=0.5", "gzip"));
    EXPECT_FALSE(accepts("gzip;q=0, br", "gzip"));
    EXPECT_FALSE(accepts("gzip; q=0.000", "gzip"));
    EXPECT_FALSE(accepts("xgzip", "gzip"));
    EXPECT_FALSE(accepts("", "gzip"));
    EXPECT_FALSE(accepts("*", "gzip")) << "plain is always right";
}

TEST(MatchesTag, AnyOfSeveral) {
    EXPECT_TRUE(matchesTag("\"a\", W/\"b\"", "\"b\""));
    EXPECT_TRUE(matchesTag("*", "\"b\""));
    EXPECT_FALSE(matchesTag("\"a\"", "\"b\""));
    EXPECT_FALSE(matchesTag("b", "\"b\""));
    EXPECT_FALSE(matchesTag("", "\"b\""));
}

TEST(ForwardedFor, IsTheAddressThatTheNearestProxyHasSeen) {
    EXPECT_EQ(forwardedFor("192.0.2.7"), "192.0.2.7");
    EXPECT_EQ(forwardedFor("forged, 198.51.100.1,  2001:db8::7 "), "2001:db8::7");
    for (const auto* none : {"", ",", "192.0.2.7,", "unknown", "192.0.2.7:80", "192.0.2.7 x", "[2001:db8::7]",
                             "192.0.2", "192.0.2.256", "1.2.3.4.5", "a\nb", ":", "::x"})
        EXPECT_FALSE(forwardedFor(none)) << none;
}

}  // namespace
}  // namespace axon::console
