// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/endings/gone_clients.hpp"

#include <gtest/gtest.h>

namespace axon::front_end_server {
namespace {

Sender client(const std::string& id, const std::string& name = "ann") {
    return {id, name, Role::Operator};
}

TEST(GoneClients, TheFirstEndingOfAClientCounts) {
    GoneClients gone(2);
    gone.remember(client("c1"), Ending::Improper);
    gone.remember(client("c1"), Ending::Ended);
    EXPECT_EQ(gone.find(client("c1")).ending, Ending::Improper);
    gone.remember(client("c2"), Ending::Ended);
    EXPECT_EQ(gone.find(client("c1")).ending, Ending::Improper) << "it takes one place only";
}

TEST(GoneClients, WhatTheClientSaidOfItselfCountsAndNotWhatAnEntitySaysOfIt) {
    GoneClients gone(2);
    gone.remember(client("c1", "ann"), Ending::Ended);
    EXPECT_EQ(gone.find(client("c1", "bob")).sender.name, "ann");
}

TEST(GoneClients, OneThatIsNotRememberedCountsAsLost) {
    GoneClients gone(2);
    for (const auto* id : {"c1", "c2", "c3"}) gone.remember(client(id), Ending::Ended);
    EXPECT_EQ(gone.find(client("c1")).ending, Ending::Lost) << "the oldest";
    EXPECT_EQ(gone.find(client("c2")).ending, Ending::Ended);
    EXPECT_EQ(gone.find(client("never here")).ending, Ending::Lost);
    EXPECT_EQ(gone.find(client("never here", "bob")).sender.name, "bob");
    GoneClients forgetful(0);
    forgetful.remember(client("c1"), Ending::Ended);
    EXPECT_EQ(forgetful.find(client("c1")).ending, Ending::Lost);
}

}  // namespace
}  // namespace axon::front_end_server
