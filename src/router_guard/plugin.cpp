// SPDX-License-Identifier: GPL-2.0-or-later
// What glacier2router calls: Ice.Plugin.AxonRouterGuard=FOLDER/axonrouterguard:createAxonRouterGuard
#include "router_guard/router_guard.hpp"

#include <fcntl.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstring>
#include <string>
#include <thread>

namespace {

/// Signals pass a router between threads with real-time priority, so it goes before ordinary programs, where
/// permitted. It gets no real-time priority, which data of a peer that floods would have, too.
constexpr int kNice = -10;

/// With kernel.sched_autogroup_enabled, Linux compares sessions first, and only within one its programs. 0,
/// or the error; ENOENT where there are no such groups.
int raiseSession() {
    constexpr int kTries = 20;
    const int file = ::open("/proc/self/autogroup", O_WRONLY | O_CLOEXEC);
    if (file < 0) return errno;
    const auto text = std::to_string(kNice);
    int error = EAGAIN;
    // Of all who are not root, one in 100 ms may.
    for (int tries = 0; tries < kTries && error == EAGAIN; ++tries) {
        if (tries > 0) std::this_thread::sleep_for(std::chrono::milliseconds{110});
        error = ::write(file, text.data(), text.size()) < 0 ? errno : 0;
    }
    ::close(file);
    return error;
}

/// For this thread and all that it starts, those of Ice among them.
void goBeforeOthers(const Ice::CommunicatorPtr& communicator) {
    if (::setpriority(PRIO_PROCESS, 0, kNice) != 0) {
        communicator->getLogger()->print(
            "router guard: a priority above that of other programs is not permitted, so stops are slower "
            "under full load; fix: LimitNICE=-10 in the systemd unit, or start it as root");
        return;
    }
    if (::getsid(0) != ::getpid()) return;  // a session that others share stays as it is
    if (const auto error = raiseSession(); error != 0 && error != ENOENT)
        communicator->getLogger()->print(
            std::string("router guard: the priority of its session could not be set (") + ::strerror(error) +
            "), so stops are slower under full load if kernel.sched_autogroup_enabled is 1; fix: start the "
            "router as root");
}

}  // namespace

extern "C" ICE_DECLSPEC_EXPORT Ice::Plugin* createAxonRouterGuard(const Ice::CommunicatorPtr& communicator,
                                                                  const std::string& /*name*/,
                                                                  const Ice::StringSeq& /*arguments*/) {
    goBeforeOthers(communicator);
    return new axon::router_guard::RouterGuard(communicator);  // which Ice deletes
}
