// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/lab_options.hpp"

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <fstream>
#include <set>
#include <sstream>

namespace axon::lab {
namespace {

using ::testing::HasSubstr;

class LabOptionsTest : public ::testing::Test {
  protected:
    LabOptionsTest() { addOptions(app_, options_); }
    static LabOptions parsed(std::vector<std::string> words) {
        CLI::App app;
        LabOptions options;
        addOptions(app, options);
        std::reverse(words.begin(), words.end());  // as CLI11 takes them
        app.parse(words);
        return options;
    }

    CLI::App app_;
    LabOptions options_;
};

TEST_F(LabOptionsTest, ToGiveWhatTheHelpShowsAsTheDefaultChangesNothing) {
    std::vector<std::string> shown;
    for (const auto* option : app_.get_options()) {
        const auto value = option->get_default_str();
        if (value.empty()) continue;
        shown.push_back(option->get_name());
        EXPECT_THAT(app_.help(), HasSubstr("=" + value)) << option->get_name();
        EXPECT_EQ(parsed({option->get_name(), value}), LabOptions()) << option->get_name() << " " << value;
    }
    EXPECT_THAT(shown,
                ::testing::IsSupersetOf({"--world", "--listen", "--port", "--speed", "--seed", "--noise"}));
}

TEST_F(LabOptionsTest, DevicesOfAllKindsAreKeptInTheirOrder) {
    const auto options = parsed({"--arm", "x=1", "--robot", "x=2", "--arm", "x=3"});
    EXPECT_THAT(options.devices,
                ::testing::ElementsAre(::testing::Pair("cyton", "x=1"), ::testing::Pair("cyton", "x=3")));
    EXPECT_THAT(options.robots, ::testing::ElementsAre("x=2"));
}

TEST_F(LabOptionsTest, NoNounOfADeviceCanBeAnOptionThatThereIsAlready) {
    std::set<std::string> others;
    for (const auto* option : app_.get_options()) {
        for (const auto& name : option->get_lnames()) others.insert(name);
    }
    for (const auto& kind : deviceKinds()) others.erase(kind.noun);
    EXPECT_THAT(others, ::testing::ElementsAreArray(kOtherOptions));
}

TEST_F(LabOptionsTest, TheHelpNamesEveryKeyOfAThing) {
    std::vector<std::pair<std::string, std::function<void()>>> things{
        {"--robot", [] { parseRobot("?=1", 0); }},
        {"--box", [] { parseBox("?=1"); }},
        {"--table", [] { parseTable("?=1"); }},
        {"--object", [] { parseObject("?=1"); }}};
    for (const auto& kind : deviceKinds())
        things.emplace_back("--" + kind.noun, [&kind] { parseDevice(kind, "?=1"); });
    for (const auto& [option, refused] : things) {
        std::string known;
        try {
            refused();
        } catch (const BadDescription& error) {
            known = error.what();
        }
        const std::string_view before = "expected one of ";
        ASSERT_THAT(known, HasSubstr(before));
        std::istringstream keys(known.substr(known.find(before) + before.size()));
        for (std::string key; std::getline(keys >> std::ws, key, ',');)
            EXPECT_THAT(app_.get_option(option)->get_description(),
                        ::testing::ContainsRegex("[ ,]" + key + "="))
                << option;
    }
}

TEST_F(LabOptionsTest, HelpAndReadmeTellThePortsAndTheWorldThatThereAre) {
    const auto help = app_.help();
    std::ostringstream text;
    text << std::ifstream("lab/README.md").rdbuf();
    const auto readme = text.str();
    using Server = LabServer;
    std::vector ports{Server::kFirstPort, Server::kFirstCameraPort, Server::kFirstActsPort,
                      Server::kFirstLaserPort};
    for (const auto& kind : deviceKinds()) ports.push_back(kind.first_port);
    EXPECT_EQ(std::set(ports.begin(), ports.end()).size(), ports.size()) << "two begin at the same port";
    for (const int port : ports) {
        EXPECT_THAT(help, HasSubstr(std::to_string(port)));
        EXPECT_THAT(readme, HasSubstr(fmt::format("| {} and up", port)));
    }
    for (const int port : {Server::kControlPort, Server::kOverviewPort}) {
        EXPECT_THAT(help, HasSubstr(std::to_string(port)));
        EXPECT_THAT(readme, HasSubstr(fmt::format("| {} ", port)));
    }
    EXPECT_THAT(help, HasSubstr("--world " + LabOptions().world + "\n"));
    EXPECT_THAT(readme, HasSubstr("`--world " + LabOptions().world + "` (the default)"));
}

}  // namespace
}  // namespace axon::lab
