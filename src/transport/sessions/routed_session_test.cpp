// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/sessions/routed_session.hpp"

#include <gtest/gtest.h>

#include <future>
#include <set>
#include <string>
#include <vector>

#include "support/loopback.hpp"
#include "transport/sessions/fake_router.hpp"
#include "transport/sessions/router_servants.hpp"

namespace axon::transport {
namespace {

/// A router that opens no session, and says of each request the next of these reasons.
class UnwillingRouter final : public FakeRouter {
  public:
    explicit UnwillingRouter(std::vector<std::string> reasons) : reasons_(std::move(reasons)) {}
    void createSessionAsync(std::string user, std::string password,
                            std::function<void(const std::shared_ptr<Glacier2::SessionPrx>&)>,
                            std::function<void(std::exception_ptr)> refuse,
                            const Ice::Current& current) override {
        asked.push_back(user + "/" + password + "/" + current.ctx.at(kContextName));
        connections.insert(current.con);
        const auto& reason = reasons_.at(asked.size() - 1);
        refuse(verifies ? std::make_exception_ptr(Glacier2::PermissionDeniedException(reason))
                        : std::make_exception_ptr(Glacier2::CannotCreateSessionException(reason)));
    }

    bool verifies = false;  ///< it fails at the password, before it asks for a session
    std::vector<std::string> asked;
    std::set<std::shared_ptr<Ice::Connection>> connections;

  private:
    const std::vector<std::string> reasons_;
};

/// Why no session was opened through it.
std::string reasonOf(const std::shared_ptr<UnwillingRouter>& router) {
    const Ice::CommunicatorHolder ice(Ice::initialize());
    const auto adapter =
        ice->createObjectAdapterWithEndpoints("Router", "tcp -h " + axon::test::loopbackAddress() + " -p 0");
    const auto proxy = adapter->addWithUUID(router);
    adapter->activate();
    std::promise<std::string> reason;
    openRoutedSession(
        proxy, {"ann", "secret", "ann@lab", {}, 10'000}, [&](const RoutedSession&) { reason.set_value(""); },
        [&](const std::exception_ptr& error) {
            try {
                std::rethrow_exception(error);
            } catch (const Glacier2::CannotCreateSessionException& cannot) {
                reason.set_value(cannot.reason);
            } catch (const Glacier2::PermissionDeniedException& denied) {
                reason.set_value(denied.reason);
            } catch (const std::exception& other) {
                reason.set_value(other.what());
            }
        });
    return reason.get_future().get();
}

TEST(ASessionThroughARouter, IsAskedForOnceMoreOverTheSameConnectionIfTheServerDidNotAnswer) {
    for (const bool verifies : {false, true}) {
        const auto router =
            std::make_shared<UnwillingRouter>(std::vector<std::string>(2, "internal server error"));
        router->verifies = verifies;
        EXPECT_EQ(reasonOf(router), "internal server error");
        EXPECT_EQ(router->asked, std::vector<std::string>(2, "ann/secret/ann@lab"));
        EXPECT_EQ(router->connections.size(), 1U);
    }
}

TEST(ASessionThroughARouter, ThatAServerRefusedIsNotAskedForAgain) {
    const auto router = std::make_shared<UnwillingRouter>(std::vector<std::string>{"it is full"});
    EXPECT_EQ(reasonOf(router), "it is full");
    EXPECT_EQ(router->asked.size(), 1U);
}

TEST(WayToARouter, IsTlsWithACertificateAndPlainWithoutWhateverTheOrder) {
    const std::string name = "Axon.Clients/router", plain = "tcp -h 127.0.0.1 -p 10414",
                      tls = "ssl -h 127.0.0.1 -p 10418";
    for (const auto& both : {name + ":" + plain + ":" + tls, name + ":" + tls + ":" + plain}) {
        EXPECT_EQ(wayToRouter(both, true), name + ":" + tls);
        EXPECT_EQ(wayToRouter(both, false), name + ":" + plain);
    }
    const auto many = name + " -t:" + plain + ":wss -h a -p 1:" + tls + ":ws -h a -p 2";
    EXPECT_EQ(wayToRouter(many, true), name + " -t:wss -h a -p 1:" + tls);
    EXPECT_EQ(wayToRouter(many, false), name + " -t:" + plain + ":ws -h a -p 2");
}

TEST(WayToARouter, ThatHasNoChoiceIsAsItIs) {
    for (const std::string one : {"Axon.Clients/router:tcp -h 127.0.0.1 -p 10414",
                                  "Axon.Clients/router: ssl -h lab -p 10418", "Axon.Clients/router", ""}) {
        EXPECT_EQ(wayToRouter(one, true), one);
        EXPECT_EQ(wayToRouter(one, false), one);
    }
    EXPECT_EQ(wayToRouter("Axon.Clients/router:tcp -h \"::1\" -p 10414", true),
              "Axon.Clients/router:tcp -h \"::1\" -p 10414");
}

TEST(WayToARouter, OneOfSeveralIsGivenUpSoon) {
    const auto soon = routerTriedFor("Axon.Clients/router:tcp -h a -p 1:tcp -h b -p 2");
    ASSERT_TRUE(soon);
    EXPECT_LE(*soon, 500) << "two lanes try up to twice, and everything is to be usable within 5 s";
    const auto handshake = routerTriedFor("Axon.Clients/router:ssl -h a -p 1:ssl -h b -p 2");
    ASSERT_TRUE(handshake);
    EXPECT_GT(*handshake, *soon) << "all peers of a lost router shake hands with another one at once";
    EXPECT_LE(*handshake, 1500) << "a log-in has 3 s, and one of two routers may be away";
    EXPECT_FALSE(routerTriedFor("Axon.Clients/router:tcp -h a -p 1"));
    EXPECT_FALSE(routerTriedFor("Axon.Clients/router:tcp -h \"::1\" -p 1"));
    EXPECT_FALSE(routerTriedFor("127.0.0.1:10410"));
    EXPECT_FALSE(routerTriedFor("ssl://lab:10410"));
}

TEST(WayToARouter, IsTlsOrNot) {
    EXPECT_TRUE(isTlsRouter("Axon.Clients/router: ssl -h lab -p 10418"));
    EXPECT_TRUE(isTlsRouter("Axon.Clients/router:ssl -h \"::1\" -p 10418"));
    EXPECT_FALSE(isTlsRouter("Axon.Clients/router:tcp -h sslhost -p 10418"));
    EXPECT_FALSE(isTlsRouter("Axon.Clients/router"));
    EXPECT_FALSE(isTlsRouter(""));
}

}  // namespace
}  // namespace axon::transport
