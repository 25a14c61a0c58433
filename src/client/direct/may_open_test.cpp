// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/direct/may_open.hpp"

#include <gtest/gtest.h>

namespace axon::client {
namespace {

const char* const kPlain = "192.0.2.7:4100";
const char* const kPlainSignals = "192.0.2.7:4101";
const char* const kTls = "ssl://192.0.2.7:4100";
const char* const kTlsSignals = "ssl://192.0.2.7:4101";

DirectSurroundings ofPlainServer() {
    return {.server = "192.0.2.1:4061"};
}

DirectSurroundings ofTlsServer() {
    return {.server_tls = true, .has_trust = true, .server = "192.0.2.1:4061"};
}

TEST(MayOpen, WhatTheServerOffersAlike) {
    EXPECT_TRUE(mayOpen(kPlain, kPlainSignals, ofPlainServer()));
    EXPECT_TRUE(mayOpen(kTls, kTlsSignals, ofTlsServer()));
}

TEST(MayOpen, NothingThatIsNotOfferedOrNotWanted) {
    EXPECT_FALSE(mayOpen("", kPlainSignals, ofPlainServer()));
    EXPECT_FALSE(mayOpen(kPlain, "", ofPlainServer()));
    auto unwanted = ofPlainServer();
    unwanted.wanted = false;
    EXPECT_FALSE(mayOpen(kPlain, kPlainSignals, unwanted));
}

TEST(MayOpen, NothingBehindARouter) {
    for (auto routed : {ofPlainServer(), ofTlsServer()}) {
        routed.routed = true;
        EXPECT_FALSE(mayOpen(kPlain, kPlainSignals, routed));
        EXPECT_FALSE(mayOpen(kTls, kTlsSignals, routed));
    }
}

TEST(MayOpen, NothingPlainBesideAServerOverTls) {
    EXPECT_FALSE(mayOpen(kPlain, kPlainSignals, ofTlsServer()));
    EXPECT_FALSE(mayOpen(kTls, kPlainSignals, ofTlsServer()));
    EXPECT_FALSE(mayOpen(kPlain, kTlsSignals, ofTlsServer()));
}

TEST(MayOpen, NoPathWhoseLanesDiffer) {
    auto trusting = ofPlainServer();
    trusting.has_trust = true;
    EXPECT_FALSE(mayOpen(kTls, kPlainSignals, trusting));
    EXPECT_FALSE(mayOpen(kPlain, kTlsSignals, trusting));
}

TEST(MayOpen, OverTlsOnlyWhereTheCertificateCanBeChecked) {
    auto without = ofTlsServer();
    without.has_trust = false;
    EXPECT_FALSE(mayOpen(kTls, kTlsSignals, without));
    auto unknown = ofTlsServer();
    unknown.known = false;
    EXPECT_FALSE(mayOpen(kTls, kTlsSignals, unknown));
    auto plain = ofPlainServer();
    plain.known = false;
    EXPECT_TRUE(mayOpen(kPlain, kPlainSignals, plain)) << "no certificate has to have its name";
}

TEST(MayOpen, ThisMachinesOwnAddressOnlyWhereTheServerIsHere) {
    auto here = ofPlainServer();
    here.server = "127.0.0.1:4061";
    EXPECT_TRUE(mayOpen("127.0.0.1:4100", "127.0.0.1:4101", here));
    EXPECT_FALSE(mayOpen("127.0.0.1:4100", "127.0.0.1:4101", ofPlainServer()));
    EXPECT_FALSE(mayOpen("ssl://127.0.0.1:4100", "ssl://127.0.0.1:4101", ofTlsServer()));
    auto unknown = ofPlainServer();
    unknown.server.clear();
    EXPECT_TRUE(mayOpen("127.0.0.1:4100", "127.0.0.1:4101", unknown));
}

}  // namespace
}  // namespace axon::client
