// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>

#include "cli/fake_station.hpp"
#include "cli/verbs/console_address.hpp"

using namespace axon;
using namespace axon::cli;

namespace {

int console(Recorded& seen, const std::string& server) {
    Settings settings;
    settings.server = server;
    settings.timeout_s = 1;
    Session session{{{"print", true}}, seen, std::make_shared<Mailbox>(), nullptr, settings};
    return findVerb("console")->perform(session);
}

}  // namespace

TEST(ConsoleAddress, FollowsThePortForClients) {
    EXPECT_EQ(consoleAddress("127.0.0.1:10410"), "http://127.0.0.1:10417/");
    EXPECT_EQ(consoleAddress("lab:20000"), "http://lab:20007/");
}

TEST(ConsoleAddress, IsOverTlsWhereClientsComeOverTlsFromAnotherMachine) {
    EXPECT_EQ(consoleAddress("ssl://lab.example:10410"), "https://lab.example:10417/");
    EXPECT_EQ(consoleAddress("ssl://localhost:10410"), "http://localhost:10417/");
}

TEST(ConsoleAddress, OfARouterIsUnknown) {
    EXPECT_EQ(consoleAddress("Axon/router:tcp -h lab -p 4063"), std::nullopt);
    EXPECT_EQ(consoleAddress("lab:65530"), std::nullopt);
}

TEST(ConsoleVerb, SaysWhatToDoWhereNobodyAnswers) {
    Recorded seen;
    EXPECT_EQ(console(seen, "127.0.0.1:1"), kNoServer);
    ASSERT_NE(seen.last("error"), nullptr);
    EXPECT_THAT(seen.last("error")->at("fix").get<std::string>(), testing::HasSubstr("console="));
    EXPECT_EQ(console(seen, "Axon/router:tcp -h lab -p 4063"), kUsage);
}
