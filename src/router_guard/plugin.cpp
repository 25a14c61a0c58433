// SPDX-License-Identifier: GPL-2.0-or-later
// What glacier2router calls: Ice.Plugin.AxonRouterGuard=FOLDER/axonrouterguard:createAxonRouterGuard
#include "router_guard/router_guard.hpp"

extern "C" ICE_DECLSPEC_EXPORT Ice::Plugin* createAxonRouterGuard(const Ice::CommunicatorPtr& communicator,
                                                                  const std::string& /*name*/,
                                                                  const Ice::StringSeq& /*arguments*/) {
    return new axon::router_guard::RouterGuard(communicator);  // which Ice deletes
}
