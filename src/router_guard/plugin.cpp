// SPDX-License-Identifier: GPL-2.0-or-later
// What programs of Ice's call: glacier2router with
// Ice.Plugin.AxonRouterGuard=FOLDER/axonrouterguard:createAxonRouterGuard, and those that are no routers with
// Ice.Plugin.AxonRefusals=FOLDER/axonrouterguard:createAxonRefusals.
#include <Ice/LoggerUtil.h>

#include <utility>

#include "router_guard/priority.hpp"
#include "router_guard/refusals_log.hpp"
#include "router_guard/router_guard.hpp"

namespace {

using axon::router_guard::WatchedProgram;

/// Who is refused is recorded.
class RefusalsPlugin : public Ice::LoggerPlugin {
  public:
    RefusalsPlugin(const Ice::CommunicatorPtr& communicator, WatchedProgram its)
        : LoggerPlugin(communicator, its.logger), its_(std::move(its)) {}
    void destroy() override {
        if (its_.refusals) its_.refusals->end();
    }

  private:
    const WatchedProgram its_;
};

/// The same, and both parts of the guard, as Ice begins and ends them.
class RouterPlugin final : public RefusalsPlugin {
  public:
    RouterPlugin(const Ice::CommunicatorPtr& communicator, WatchedProgram its)
        : RefusalsPlugin(communicator, std::move(its)),
          priority_(
              [communicator](const std::string& sentence) { communicator->getLogger()->print(sentence); }),
          guard_(communicator) {
        priority_.begin();
    }
    void initialize() override { guard_.initialize(); }
    void destroy() override {
        guard_.destroy();
        priority_.end();
        RefusalsPlugin::destroy();
    }

  private:
    axon::router_guard::Priority priority_;
    axon::router_guard::RouterGuard guard_;
};

}  // namespace

extern "C" ICE_DECLSPEC_EXPORT Ice::Plugin* createAxonRouterGuard(const Ice::CommunicatorPtr& communicator,
                                                                  const std::string& name,
                                                                  const Ice::StringSeq& /*arguments*/) {
    return new RouterPlugin(  // Ice deletes it
        communicator, axon::router_guard::watchRefusals(communicator, "Ice.Plugin." + name, false));
}

extern "C" ICE_DECLSPEC_EXPORT Ice::Plugin* createAxonRefusals(const Ice::CommunicatorPtr& communicator,
                                                               const std::string& name,
                                                               const Ice::StringSeq& /*arguments*/) {
    return new RefusalsPlugin(communicator,
                              axon::router_guard::watchRefusals(communicator, "Ice.Plugin." + name, true));
}
