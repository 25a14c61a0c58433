// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Glacier2/Router.h>

#include <exception>
#include <functional>
#include <memory>
#include <string>

namespace axon::transport {

/// For tests: what a router says besides the answer to createSession(), which a test decides: no time-outs,
/// nothing to add, and no way back unless the test has one. Threads: Ice's.
class FakeRouter : public Glacier2::Router {
  public:
    void createSessionFromSecureConnectionAsync(
        std::function<void(const std::shared_ptr<Glacier2::SessionPrx>&)>,
        std::function<void(std::exception_ptr)>, const Ice::Current&) override {}
    void refreshSessionAsync(std::function<void()>, std::function<void(std::exception_ptr)>,
                             const Ice::Current&) override {}
    void destroySession(const Ice::Current&) override {}
    std::string getCategoryForClient(const Ice::Current&) const override { return "its"; }
    long long int getSessionTimeout(const Ice::Current&) const override { return 0; }
    int getACMTimeout(const Ice::Current&) const override { return 0; }
    std::shared_ptr<Ice::ObjectPrx> getClientProxy(Ice::optional<bool>&, const Ice::Current&) const override {
        return nullptr;
    }
    std::shared_ptr<Ice::ObjectPrx> getServerProxy(const Ice::Current&) const override { return nullptr; }
    Ice::ObjectProxySeq addProxies(Ice::ObjectProxySeq, const Ice::Current&) override { return {}; }
};

}  // namespace axon::transport
