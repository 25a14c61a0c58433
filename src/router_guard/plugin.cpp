// SPDX-License-Identifier: GPL-2.0-or-later
// What glacier2router calls: Ice.Plugin.AxonRouterGuard=FOLDER/axonrouterguard:createAxonRouterGuard
#include "router_guard/priority.hpp"
#include "router_guard/router_guard.hpp"

namespace {

/// Both parts of the guard, as Ice begins and ends them.
class Plugin final : public Ice::Plugin {
  public:
    explicit Plugin(const Ice::CommunicatorPtr& communicator)
        : priority_(
              [communicator](const std::string& sentence) { communicator->getLogger()->print(sentence); }),
          guard_(communicator) {
        priority_.begin();
    }
    void initialize() override { guard_.initialize(); }
    void destroy() override {
        guard_.destroy();
        priority_.end();
    }

  private:
    axon::router_guard::Priority priority_;
    axon::router_guard::RouterGuard guard_;
};

}  // namespace

extern "C" ICE_DECLSPEC_EXPORT Ice::Plugin* createAxonRouterGuard(const Ice::CommunicatorPtr& communicator,
                                                                  const std::string& /*name*/,
                                                                  const Ice::StringSeq& /*arguments*/) {
    return new Plugin(communicator);  // which Ice deletes
}
