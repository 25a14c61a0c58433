// SPDX-License-Identifier: GPL-2.0-or-later
// Of several routers, the second lane goes through the one of the first: with ports on loopback.
#include <gtest/gtest.h>

#include <set>
#include <string>

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

TEST(LostRouter, IsTriedLastAndTheOthersInAnyOrder) {
    const Ice::CommunicatorHolder ice(Ice::initialize());
    const auto routers = ice.communicator()->stringToProxy(
        "Axon.Clients/router:tcp -h a -p 1 -t 3000:tcp -h b -p 2:tcp -h c -p 3:tcp -h c -p 4");
    const auto lost =
        ice.communicator()->stringToProxy("router:tcp -h b -p 2 -t 1000")->ice_getEndpoints().front();
    std::set<std::string> first;
    for (int i = 0; i < 200; ++i) {
        const auto order = lostLast(routers, lost);
        ASSERT_EQ(order->ice_getEndpoints().size(), 4U);
        EXPECT_EQ(order->ice_getEndpoints().back()->toString(), "tcp -h b -p 2 -t 60000");
        EXPECT_EQ(order->ice_getEndpointSelection(), Ice::EndpointSelectionType::Ordered);
        EXPECT_EQ(order->ice_getIdentity(), routers->ice_getIdentity());
        first.insert(order->ice_getEndpoints().front()->toString());
    }
    EXPECT_EQ(first.size(), 3U);
    const auto ordered = lostLast(routers->ice_endpointSelection(Ice::EndpointSelectionType::Ordered), lost);
    EXPECT_EQ(ordered->ice_getEndpoints().front()->toString(), "tcp -h a -p 1 -t 3000");
    EXPECT_EQ(lostLast(routers, nullptr), routers) << "nothing was lost";
    const auto other = ice.communicator()->stringToProxy("router:tcp -h x -p 2")->ice_getEndpoints().front();
    EXPECT_EQ(lostLast(routers, other)->ice_getEndpoints().size(), 4U) << "it is none of them any more";
    const auto alone = ice.communicator()->stringToProxy("Axon.Clients/router:tcp -h b -p 2");
    EXPECT_EQ(lostLast(alone, lost), alone);
}

}  // namespace
}  // namespace axon::transport
