// SPDX-License-Identifier: GPL-2.0-or-later
// What glacier2router calls: Ice.Plugin.AxonRouterGuard=FOLDER/axonrouterguard:createAxonRouterGuard
#include "router_guard/router_guard.hpp"

#include <sys/resource.h>
#include <unistd.h>

#include <fstream>

namespace {

/// Signals pass a router between threads with real-time priority, so it goes before ordinary programs, where
/// permitted. It gets no real-time priority, which data of a peer that floods would have, too.
constexpr int kNice = -10;

/// For this thread and all that it starts, those of Ice among them.
void goBeforeOthers(const Ice::CommunicatorPtr& communicator) {
    if (::setpriority(PRIO_PROCESS, 0, kNice) != 0) {
        communicator->getLogger()->print(
            "router guard: a priority above that of other programs is not permitted, so stops are slower "
            "under full load; fix: LimitNICE=-10 in the systemd unit, or start it as root");
        return;
    }
    // With kernel.sched_autogroup_enabled, Linux compares sessions first, and programs within one only. A
    // session that others share stays as it is. Without autogroups there is no such file.
    if (::getsid(0) == ::getpid()) std::ofstream("/proc/self/autogroup") << kNice;
}

}  // namespace

extern "C" ICE_DECLSPEC_EXPORT Ice::Plugin* createAxonRouterGuard(const Ice::CommunicatorPtr& communicator,
                                                                  const std::string& /*name*/,
                                                                  const Ice::StringSeq& /*arguments*/) {
    goBeforeOthers(communicator);
    return new axon::router_guard::RouterGuard(communicator);  // which Ice deletes
}
