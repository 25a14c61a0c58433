// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/clients/silence.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <map>

#include "front_end_server/clients/deaf_outbox.hpp"

namespace axon::front_end_server {
namespace {

using namespace std::chrono_literals;
using testing::ElementsAre;
using testing::IsEmpty;
using testing::Pair;

/// Time-outs of 250 ms while busy, and of 10 s otherwise; each was heard last at a moment of its own.
class Silence : public testing::Test {
  protected:
    void add(const std::string& id, const int& behind, Duration heard, bool busy = true) {
        auto client = std::make_shared<Client>(Sender{id, id, Role::Operator}, "token of " + id,
                                               std::make_shared<DeafOutbox>(&behind), FrontEndCoreSettings{},
                                               TimePoint{});
        client->liveness.setBusy(busy, TimePoint{});
        client->liveness.heard(TimePoint{heard});
        clients.emplace(id, std::move(client));
    }
    /// {id: why}
    std::map<std::string, std::string> at(Duration now) const {
        std::map<std::string, std::string> found;
        for (const auto& [client, why] : silentAt(clients, TimePoint{now})) found.emplace(client->me.id, why);
        return found;
    }

    const int router = 1, other_router = 2;
    Clients::ById clients;
};

TEST_F(Silence, NobodyIsLostBeforeItsTimeOut) {
    add("a", router, 0ms);
    add("idle", router, 0ms, false);
    EXPECT_THAT(at(249ms), IsEmpty());
    EXPECT_THAT(at(250ms), ElementsAre(Pair("a", "nothing was heard of it for 250 ms")));
}

TEST_F(Silence, ASilentRouterTakesAllItsBusyClientsAtOnce) {
    add("a", router, 0ms);
    add("b", router, 25ms);
    add("c", router, 50ms);
    add("elsewhere", other_router, 40ms);
    add("idle", router, 0ms, false);
    EXPECT_THAT(at(249ms), IsEmpty());
    EXPECT_THAT(
        at(250ms),
        ElementsAre(Pair("a", "nothing was heard of it for 250 ms"),
                    Pair("b", "nothing was heard of it for 225 ms, nor of the others behind its router"),
                    Pair("c", "nothing was heard of it for 200 ms, nor of the others behind its router")));
}

TEST_F(Silence, BehindARouterThatWorksEachHasItsWholeTimeOut) {
    add("a", router, 0ms);
    add("b", router, 25ms);
    add("works", router, 51ms);
    EXPECT_THAT(at(250ms), ElementsAre(Pair("a", "nothing was heard of it for 250 ms")));
}

TEST_F(Silence, OneWithoutATaskSaysNothingOfItsRouter) {
    add("a", router, 9770ms);
    add("b", router, 9795ms);
    add("idle", router, 0ms, false);
    EXPECT_THAT(at(10s), ElementsAre(Pair("idle", "nothing was heard of it for 10000 ms")));
}

}  // namespace
}  // namespace axon::front_end_server
