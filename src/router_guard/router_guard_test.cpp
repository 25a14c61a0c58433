// SPDX-License-Identifier: GPL-2.0-or-later
#include "router_guard/router_guard.hpp"

#include <gtest/gtest.h>

#include <atomic>

#include "support/loopback.hpp"

namespace axon::router_guard {
namespace {

using namespace std::chrono_literals;
using axon::test::waitUntil;

/// A server behind the router that counts its calls.
class Server {
  public:
    Server() : communicator_(Ice::initialize()) {
        adapter_ = communicator_->createObjectAdapterWithEndpoints(
            "Router", "tcp -h " + axon::test::loopbackAddress() + " -p 0");
        adapter_->addDefaultServant(new Counter(calls), "");
        adapter_->activate();
    }
    ~Server() {
        goOn();  // an adapter that is held is not destroyed
        communicator_->destroy();
    }
    std::string endpoint() const { return adapter_->getPublishedEndpoints().front()->toString() + " -t 300"; }
    void standStill() { adapter_->hold(); }
    void goOn() { adapter_->activate(); }
    std::atomic<int> calls{0};

  private:
    class Counter final : public Ice::Blobject {
      public:
        explicit Counter(std::atomic<int>& calls) : calls_(calls) {}
        bool ice_invoke(const std::vector<Ice::Byte>&, std::vector<Ice::Byte>&,
                        const Ice::Current&) override {
            ++calls_;
            return true;
        }

      private:
        std::atomic<int>& calls_;
    };

    Ice::CommunicatorPtr communicator_;
    Ice::ObjectAdapterPtr adapter_;
};

/// The communicator of a router with these servers, and its guard.
class Router {
  public:
    explicit Router(const std::string& endpoints) {
        Ice::InitializationData data;
        data.properties = Ice::createProperties();
        data.properties->setProperty("Glacier2.PermissionsVerifier", "verifier:" + endpoints);
        data.properties->setProperty("Glacier2.SessionManager", "manager:" + endpoints);
        // As the routers of axon-cluster: a connection with sessions is not closed because it is quiet.
        data.properties->setProperty("Ice.ACM.Client.Close", "0");
        data.properties->setProperty("Ice.LogFile", "/dev/null");
        communicator_ = Ice::initialize(data);
        guard_ = std::make_unique<RouterGuard>(communicator_);
        guard_->initialize();
    }
    ~Router() {
        guard_->destroy();
        communicator_->destroy();
    }
    Ice::ObjectPrx manager() const { return communicator_->propertyToProxy("Glacier2.SessionManager"); }

  private:
    Ice::CommunicatorPtr communicator_;
    std::unique_ptr<RouterGuard> guard_;
};

bool isOpen(const Ice::ConnectionPtr& connection) {
    try {
        connection->throwException();
        return true;
    } catch (const Ice::Exception&) {
        return false;
    }
}

TEST(RouterGuard, ClosesTheConnectionToAServerThatStandsStillAlthoughLogInsAreSentOverIt) {
    Server still, alive;
    const Router router(still.endpoint() + ":" + alive.endpoint());
    const auto over = [&](const Server& server) {
        const auto all = router.manager()->ice_getEndpoints();
        return router.manager()->ice_endpoints({all[&server == &still ? 0 : 1]});
    };
    const auto with_sessions = over(still)->ice_getConnection(), others = over(alive)->ice_getConnection();
    ASSERT_TRUE(waitUntil([&] { return still.calls >= 3 && alive.calls >= 3; })) << "the guard asks both";
    EXPECT_TRUE(isOpen(with_sessions) && isOpen(others));

    still.standStill();
    EXPECT_TRUE(waitUntil([&] {
        over(still)->ice_oneway()->begin_ice_ping();  // as many as come: one in a millisecond
        return !isOpen(with_sessions);
    }));
    EXPECT_TRUE(isOpen(others));

    still.goOn();
    EXPECT_TRUE(waitUntil([&, before = still.calls.load()] { return still.calls > before; }))
        << "and is asked again";
}

TEST(RouterGuard, AServerThatIsNotThereIsAskedUntilItIsThere) {
    std::string address;
    {
        const Server gone;
        address = gone.endpoint();
    }
    Server alive;
    const Router router(address + ":" + alive.endpoint());
    EXPECT_TRUE(waitUntil([&] { return alive.calls >= 3; })) << "beside one that is not there";
}

TEST(RouterGuard, ARouterWithoutServersEndsAtOnce) {
    const auto communicator = Ice::initialize();
    RouterGuard guard(communicator);
    guard.initialize();
    guard.destroy();
    communicator->destroy();
}

}  // namespace
}  // namespace axon::router_guard
