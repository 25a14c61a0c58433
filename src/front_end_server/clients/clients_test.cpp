// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/clients/clients.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <vector>

#include "front_end_server/clients/deaf_outbox.hpp"

namespace axon::front_end_server {
namespace {

using testing::ElementsAre;
using testing::IsEmpty;
using testing::UnorderedElementsAre;

class ClientsTest : public testing::Test {
  protected:
    ClientRef add(const std::string& id) {
        auto client =
            std::make_shared<Client>(Sender{id, id, Role::Operator}, "token of " + id,
                                     std::make_shared<DeafOutbox>(), FrontEndCoreSettings{}, TimePoint{});
        clients.add(client);
        return client;
    }
    std::vector<std::string> reached(Lane lane, const std::string& recipient) const {
        std::vector<std::string> ids;
        clients.to(lane, recipient,
                   [&](const Client& client, ClientOutbox&) { ids.push_back(client.me.id); });
        return ids;
    }

    Clients clients;
};

TEST_F(ClientsTest, OneIsReachedByItsIdAndAllWithoutOne) {
    add("c1");
    add("c2");
    for (const auto lane : {Lane::Signal, Lane::Data}) {
        EXPECT_THAT(reached(lane, "c2"), ElementsAre("c2"));
        EXPECT_THAT(reached(lane, ""), UnorderedElementsAre("c1", "c2"));
        EXPECT_THAT(reached(lane, "nobody"), IsEmpty());
    }
}

TEST_F(ClientsTest, ASignalTakesTheDataLaneUntilTheSignalLaneIsAttached) {
    const auto client = add("c1");
    const auto outbox = [&](Lane lane) {
        const ClientOutbox* its = nullptr;
        clients.to(lane, "c1", [&](const Client&, ClientOutbox& one) { its = &one; });
        return its;
    };
    EXPECT_EQ(outbox(Lane::Signal), client->data.get());
    const auto signal = std::make_shared<DeafOutbox>();
    client->signal.store(std::make_shared<const std::shared_ptr<ClientOutbox>>(signal));
    EXPECT_EQ(outbox(Lane::Signal), signal.get());
    EXPECT_EQ(outbox(Lane::Data), client->data.get());
}

TEST_F(ClientsTest, ATokenIsForOneUseAndForAClientThatIsHere) {
    const auto client = add("c1");
    EXPECT_EQ(clients.takeToken("guessed"), nullptr);
    EXPECT_EQ(clients.takeToken("token of c1"), client);
    EXPECT_EQ(clients.takeToken("token of c1"), nullptr);
    clients.remove(add("c2"));
    EXPECT_EQ(clients.takeToken("token of c2"), nullptr);
}

TEST_F(ClientsTest, OneThatIsRemovedIsNowhereAnyMore) {
    const auto client = add("c1");
    EXPECT_EQ(clients.find("c1"), client);
    EXPECT_TRUE(clients.remove(client));
    EXPECT_FALSE(clients.remove(client));
    EXPECT_EQ(clients.find("c1"), nullptr);
    EXPECT_THAT(reached(Lane::Data, ""), IsEmpty());
    EXPECT_EQ(clients.size(), 0U);
}

}  // namespace
}  // namespace axon::front_end_server
