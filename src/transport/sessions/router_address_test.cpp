// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/sessions/router_address.hpp"

#include <gtest/gtest.h>

namespace axon::transport {
namespace {

TEST(RouterAddress, IsTheOtherEndOfTheRoutersConnection) {
    EXPECT_EQ(routerAddress({{"_con.remoteAddress", "10.0.0.7"}, {"_con.remotePort", "50122"}}),
              "10.0.0.7:50122");
    EXPECT_EQ(routerAddress("fd00::7", "1"), "fd00::7:1");
    EXPECT_EQ(routerAddress("::ffff:10.0.0.7", "1"), "10.0.0.7:1");
}

TEST(RouterAddress, IsNothingWhereTheRouterSaysNothingUsable) {
    EXPECT_EQ(routerAddress({}), "");
    EXPECT_EQ(routerAddress({{"_con.remoteAddress", "10.0.0.7"}}), "");
    EXPECT_EQ(routerAddress({{"_con.remotePort", "1"}}), "");
    for (const auto& [address, port] : {std::pair<std::string, std::string>{"", "1"},
                                        {"10.0.0.7", ""},
                                        {"10.0.0.7", "123456"},
                                        {"10.0.0.7", "1 "},
                                        {"::ffff:", ""},
                                        {"somewhere", "1"},
                                        {"10.0.0.7\nlog", "1"},
                                        {std::string(46, '1'), "1"}})
        EXPECT_EQ(routerAddress(address, port), "") << address << " " << port;
}

}  // namespace
}  // namespace axon::transport
