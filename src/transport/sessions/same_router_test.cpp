// SPDX-License-Identifier: GPL-2.0-or-later
// Of several routers, the second lane goes through the one of the first: with ports on loopback.
#include <gtest/gtest.h>

#include "support/loopback.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/communicator.hpp"
#include "transport/sessions/routed_session.hpp"

namespace axon::transport {
namespace {

TEST(SameRouter, OfTheOtherLaneIsThatOfTheFirst) {
    const Ice::CommunicatorHolder server(Ice::initialize()), data(Ice::initialize()),
        signal(Ice::initialize());
    std::string routers = "Axon.Clients/router";
    for (const char* name : {"A", "B"}) {
        const auto adapter =
            listen(*server.communicator(), name, tcpEndpoint(test::loopbackAddress() + ":0"));
        adapter->activate();
        const auto at = publishedEndpoints(*adapter).front();
        routers += ":" + at.text();
    }
    const auto connection = data.communicator()->stringToProxy(routers)->ice_getConnection();
    const auto other = sameRouter(signal.communicator()->stringToProxy(routers), *connection);
    ASSERT_EQ(other->ice_getEndpoints().size(), 1U);
    EXPECT_EQ(other->ice_getEndpoints().front()->toString(), connection->getEndpoint()->toString());
    EXPECT_EQ(other->ice_getIdentity(), (Ice::Identity{"router", "Axon.Clients"}));
    EXPECT_EQ(other->ice_getCommunicator(), signal.communicator());
    const auto alone = signal.communicator()->stringToProxy("Axon.Clients/router:tcp -h 127.0.0.1 -p 1");
    EXPECT_EQ(sameRouter(alone, *connection), alone);
}

}  // namespace
}  // namespace axon::transport
