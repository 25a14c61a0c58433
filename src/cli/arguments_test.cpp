// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/arguments.hpp"

#include <gmock/gmock.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <iterator>
#include <sstream>

#include "cli/command_line.hpp"
#include "cli/fake_station.hpp"
#include "cli/words.hpp"

using namespace axon;
using namespace axon::cli;
using testing::AllOf;
using testing::HasSubstr;
using testing::Not;

namespace {

const Service& driving() {
    static const Service service = FakeStation().services_.front();
    return service;
}

std::string textAt(const Argument& argument, std::size_t i) {
    return std::get<std::string>(argument.values.at(i));
}

Parsed parse(std::vector<std::string> words) {
    return parseCommandLine(std::move(words), [](const char*) { return static_cast<const char*>(nullptr); });
}

}  // namespace

TEST(ReadArguments, ResolvesNamesAsPeopleTypeThem) {
    for (const auto* word :
         {"Range Threshold=500", "range_threshold=500", "RANGE-THRESHOLD=500", " range threshold =500"}) {
        const auto arguments = readArguments(driving(), {word});
        ASSERT_TRUE(arguments) << word;
        EXPECT_EQ(arguments->at(0).name, "Range Threshold");
        EXPECT_EQ(textAt(arguments->at(0), 0), "500");
        EXPECT_TRUE(arguments->at(0).from_text);
    }
}

TEST(ReadArguments, TakesUnitsOffNumbersOnly) {
    const auto arguments =
        readArguments(driving(), {"Distance=1500 mm", "Range Threshold=1e3", "Colours=5mm"});
    ASSERT_TRUE(arguments);
    EXPECT_EQ(textAt(arguments->at(0), 0), "1500");
    EXPECT_EQ(arguments->at(0).units, "mm");
    EXPECT_EQ(textAt(arguments->at(1), 0), "1e3");
    EXPECT_EQ(arguments->at(1).units, "");
    EXPECT_EQ(textAt(arguments->at(2), 0), "5mm");
}

TEST(ReadArguments, CollectsRepeatedKeysOfMultipleParameters) {
    const auto arguments = readArguments(driving(), {"Colours=red", "colours=green"});
    ASSERT_TRUE(arguments);
    ASSERT_EQ(arguments->size(), 1U);
    EXPECT_EQ(arguments->at(0).values.size(), 2U);
}

TEST(ReadArguments, RefusesARepeatedKeyOfASingleParameter) {
    const auto arguments = readArguments(driving(), {"Distance=1", "distance=2"});
    ASSERT_FALSE(arguments);
    EXPECT_EQ(arguments.refusal().code, RefusalCode::WrongType);
}

TEST(ReadArguments, TakesAChoiceAsPeopleTypeIt) {
    auto service = driving();
    service.parameters[2].choices = {Value(std::string("Light Red")), Value(std::string("green")),
                                     Value(std::string("Up")), Value(std::string("UP"))};
    const auto arguments = readArguments(
        service, {"Colours=light_red", "Colours=GREEN", "Colours=up", "Colours=UP", "Colours=blue"});
    ASSERT_TRUE(arguments);
    EXPECT_EQ(textAt(arguments->at(0), 0), "Light Red");
    EXPECT_EQ(textAt(arguments->at(0), 1), "green");
    EXPECT_EQ(textAt(arguments->at(0), 2), "up") << "it may mean two choices";
    EXPECT_EQ(textAt(arguments->at(0), 3), "UP");
    EXPECT_EQ(textAt(arguments->at(0), 4), "blue") << "the refusal shows it";
}

TEST(ReadArguments, KeepsEmptyValuesAndFurtherEqualsSigns) {
    const auto arguments = readArguments(driving(), {"Colours=", "Colours=a=b"});
    ASSERT_TRUE(arguments);
    EXPECT_EQ(textAt(arguments->at(0), 0), "");
    EXPECT_EQ(textAt(arguments->at(0), 1), "a=b");
}

TEST(ReadArguments, AValueThatIsNoNumberStaysWhatTheUserWrote) {
    const auto arguments = readArguments(FakeStation().services_.front(), {"Distance=0x10"});
    ASSERT_TRUE(arguments);
    EXPECT_EQ(std::get<std::string>(arguments->front().values.front()), "0x10") << "the refusal shows it";
    EXPECT_EQ(arguments->front().units, "");
}

TEST(ReadArguments, NamesNoParameterThatOnlyTheRobotSets) {
    auto service = FakeStation().services_.front();
    Parameter room;
    room.name = "Room";
    room.kind = client::ParameterKind::Output;
    service.parameters.push_back(room);
    const auto refused = readArguments(service, {"Roon=3"});
    ASSERT_FALSE(refused);
    EXPECT_EQ(refused.refusal().message.find("Room"), std::string::npos) << refused.refusal().message;
    EXPECT_TRUE(readArguments(service, {"Room=3"})) << "the robot's side says why not";
}

TEST(ReadArguments, NamesTheNearOnesOfAnUnknownParameter) {
    const auto arguments = readArguments(driving(), {"Distanz=1"});
    ASSERT_FALSE(arguments);
    EXPECT_EQ(arguments.refusal().code, RefusalCode::UnknownParameter);
    EXPECT_THAT(arguments.refusal().message, HasSubstr("did you mean \"Distance\"?"));
}

TEST(ReadArguments, RefusesAWordThatIsNoPair) {
    for (const auto* word : {"1000", "=1000", ""}) {
        const auto arguments = readArguments(driving(), {word});
        ASSERT_FALSE(arguments) << word;
        EXPECT_EQ(arguments.refusal().code, RefusalCode::Malformed);
    }
}

TEST(ReadArguments, RefusesTwoUnitsForOneParameter) {
    auto service = driving();
    service.parameters[0].multiple = true;
    const auto arguments = readArguments(service, {"Distance=1mm", "Distance=1m"});
    ASSERT_FALSE(arguments);
    EXPECT_EQ(arguments.refusal().code, RefusalCode::WrongUnits);
}

TEST(FindService, PrefersTheExactNameAndTakesTheOnlySimilarOne) {
    auto other = driving();
    other.name = "DRIVING";
    const std::vector<Service> both{driving(), other};
    EXPECT_EQ(findService(both, "DRIVING").value(), &both[1]);
    EXPECT_FALSE(findService(both, "driving"));
    const std::vector<Service> one{driving()};
    EXPECT_TRUE(findService(one, "driving"));
    EXPECT_TRUE(findService(one, "peoplebot_drive"));
    const auto unknown = findService(one, "Drivign");
    ASSERT_FALSE(unknown);
    EXPECT_THAT(unknown.refusal().message, HasSubstr("\"Driving\""));
}

TEST(SplitMeasure, TellsNumbersFromMeasures) {
    EXPECT_FALSE(splitMeasure("1500"));
    EXPECT_FALSE(splitMeasure("1e3"));
    EXPECT_FALSE(splitMeasure("-1.5"));
    EXPECT_FALSE(splitMeasure("fast"));
    EXPECT_FALSE(splitMeasure("1,2"));
    EXPECT_FALSE(splitMeasure(""));
    EXPECT_FALSE(splitMeasure("."));
    EXPECT_EQ(splitMeasure("-1.5e-3m/s")->number, "-1.5e-3");
    EXPECT_EQ(splitMeasure("-1.5e-3m/s")->units, "m/s");
    EXPECT_EQ(splitMeasure("5e")->units, "e");
    EXPECT_EQ(splitMeasure("90°")->units, "°");
    EXPECT_EQ(splitMeasure(".5 %")->units, "%");
}

TEST(CommandLine, ReadsAVerbWithGlobalOptionsAfterIt) {
    const auto parsed = parse({"run", "PeopleBot", "Driving", "Distance=-1000", "Range Threshold=[1,2]",
                               "--json", "--server", "lab:4000", "--wait", "2.5"});
    ASSERT_TRUE(parsed.line) << parsed.err;
    EXPECT_STREQ(parsed.line->verb->name, "run");
    EXPECT_EQ(parsed.line->args["parameters"], Json({"Distance=-1000", "Range Threshold=[1,2]"}));
    EXPECT_EQ(parsed.line->args["wait"], 2.5);
    EXPECT_TRUE(parsed.line->settings.json);
    EXPECT_EQ(parsed.line->settings.server, "lab:4000");
}

TEST(CommandLine, TakesTheDirectPathUnlessItIsToldNotTo) {
    EXPECT_TRUE(parse({"checkout", "A"}).line->settings.direct);
    EXPECT_FALSE(parse({"checkout", "A", "--no-direct"}).line->settings.direct);
}

TEST(CommandLine, TakesAnOperandThatIsCalledLikeAVerb) {
    const auto parsed = parse({"run", "reset", "stop"});
    ASSERT_TRUE(parsed.line) << parsed.err;
    EXPECT_STREQ(parsed.line->verb->name, "run");
    EXPECT_EQ(parsed.line->args["entity"], "reset");
    EXPECT_EQ(parsed.line->args["service"], "stop");
}

TEST(CommandLine, LeavesTheCommandUnderCheckoutAlone) {
    const auto parsed =
        parse({"--timeout", "3", "checkout", "A", "B", "--json", "--", "ls", "--help", "--", "-x"});
    ASSERT_TRUE(parsed.line) << parsed.err;
    EXPECT_EQ(parsed.line->args["entity"], Json({"A", "B"}));
    EXPECT_EQ(parsed.line->command, (std::vector<std::string>{"ls", "--help", "--", "-x"}));
    EXPECT_TRUE(parsed.line->settings.json);
}

TEST(CommandLine, SendsTextsThatLookLikeOptionsOrLists) {
    auto parsed = parse({"send", "A", "--", "--raw"});
    ASSERT_TRUE(parsed.line) << parsed.err;
    EXPECT_EQ(parsed.line->args["text"], "--raw");
    parsed = parse({"send", "A", "[1, 2]"});
    ASSERT_TRUE(parsed.line) << parsed.err;
    EXPECT_EQ(parsed.line->args["text"], "[1, 2]");
    parsed = parse({"send", "A", "--raw", "hi"});
    ASSERT_TRUE(parsed.line) << parsed.err;
    EXPECT_EQ(parsed.line->args["hex"], "6869");
}

TEST(CommandLine, SaysWhatIsWrongAndHowToFixIt) {
    for (const auto& [words, expected] : std::vector<std::pair<std::vector<std::string>, std::string>>{
             {{"rnu"}, "did you mean \"run\"?"},
             {{"run", "A"}, "fix: axon run ENTITY SERVICE [PARAMETER=VALUE…]"},
             {{"ls", "--colour"}, "fix: axon ls"},
             {{"send", "A"}, "either TEXT or --file FILE"},
             {{"upload", "A", "S", "R", "/no/such/file"}, "found none at \"/no/such/file\""},
             {{"watch", "A", "--for", "long"}, "fix: axon watch"},
             {{"ls", "--server", "here"}, "HOST:PORT"},
             {{"ls", "--timeout", "0"}, "fix: axon ls"},
             {{"completion", "tcsh"}, "bash"},
             {{"profile", "fix", "a.xml"}, "expected \"check\", found \"fix\"\nfix: axon profile"},
             {{"profile", "chek", "a.xml"},
              "expected \"check\", found \"chek\"\nfix: did you mean \"check\"?"},
             {{"agent", "stp"}, "fix: did you mean \"stop\"?"},
             {{"checkout", "A", "--hand-over", "yeld"}, "fix: did you mean \"yield\"?"}}) {
        const auto parsed = parse(words);
        EXPECT_FALSE(parsed.line) << words.front();
        EXPECT_EQ(parsed.exit, kUsage);
        EXPECT_THAT(parsed.err, HasSubstr(expected));
        EXPECT_THAT(parsed.err, HasSubstr("fix: "));
    }
}

TEST(CommandLine, WhatFollowsBenchIsAnotherProgramsBusiness) {
    const auto parsed = parse({"bench", "peers", "--json", "peers.json", "--help", "--", "--server"});
    ASSERT_TRUE(parsed.line);
    EXPECT_STREQ(parsed.line->verb->name, "bench");
    EXPECT_EQ(parsed.line->args["words"],
              (Json{"peers", "--json", "peers.json", "--help", "--", "--server"}));
    EXPECT_FALSE(parsed.line->settings.json);
    EXPECT_EQ(parse({"bench"}).line->args["words"], Json::array());
}

TEST(CommandLine, HelpTeachesByExamples) {
    const auto root = parse({"--help"});
    EXPECT_EQ(root.exit, kDone);
    EXPECT_THAT(root.out, HasSubstr("axon run PeopleBot Driving Distance=1000"));
    EXPECT_THAT(root.out, testing::Not(HasSubstr("__complete")));
    for (const auto* verb : verbs()) {
        if (verb->hidden) continue;
        std::istringstream words(verb->name);
        std::vector<std::string> line{std::istream_iterator<std::string>(words), {}};
        line.emplace_back("--help");
        const auto help = parse(line);
        EXPECT_EQ(help.exit, kDone) << verb->name;
        EXPECT_THAT(help.out, HasSubstr("Examples:")) << verb->name;
        EXPECT_THAT(help.out, HasSubstr(std::string("Usage: axon ") + verb->name)) << verb->name;
    }
}

TEST(CommandLine, TakesTheServerFromTheEnvironmentUnlessTold) {
    const auto environment = [](const char* name) {
        return std::string_view(name) == "AXON_SERVER" ? "lab:1" : nullptr;
    };
    EXPECT_EQ(parseCommandLine({"ls"}, environment).line->settings.server, "lab:1");
    EXPECT_EQ(parseCommandLine({"ls", "--server", "lab:2"}, environment).line->settings.server, "lab:2");
}

TEST(CommandLine, TakesRouterUserAndPasswordFromAConfigurationUnlessTold) {
    const auto file = testing::TempDir() + "client-" + std::to_string(::getpid()) + ".cfg";
    const std::string router = "Axon.Clients/router:tcp -h 127.0.0.1 -p 10414";
    std::ofstream(file) << "Ice.Default.Router=" << router
                        << "\nAxon.User=client1\nAxon.Password=secret1\nIceSSL.DefaultDir=/x\n";
    std::filesystem::permissions(file,
                                 std::filesystem::perms::owner_read | std::filesystem::perms::owner_write);
    const auto nothing = [](const char*) -> const char* { return nullptr; };
    const auto settings = parseCommandLine({"--config", file, "ls"}, nothing).line->settings;
    EXPECT_EQ(settings.server, router);
    EXPECT_EQ(settings.user, "client1");
    EXPECT_EQ(settings.password, "secret1");
    EXPECT_EQ(settings.properties.at("IceSSL.DefaultDir"), "/x");
    const auto other =
        parseCommandLine({"--config", file, "--user", "client2", "--server", "lab:1", "ls"}, nothing);
    EXPECT_EQ(other.line->settings.server, "lab:1");
    EXPECT_EQ(other.line->settings.password, "") << "it is another user's";
    const auto both = [&](const char* name) -> const char* {
        return std::string_view(name) == "AXON_SERVER"   ? "lab:1"
               : std::string_view(name) == "AXON_CONFIG" ? file.c_str()
                                                         : nullptr;
    };
    EXPECT_EQ(parseCommandLine({"ls"}, both).line->settings.server, "lab:1");
    EXPECT_EQ(parseCommandLine({"--config", file, "ls"}, both).line->settings.server, router);
    EXPECT_EQ(parseCommandLine({"agent", "stop"},
                               [&](const char* name) {
                                   return std::string_view(name) == "AXON_CONFIG" ? file.c_str() : nullptr;
                               })
                  .line->settings.server,
              router)
        << "an agent is found by it";

    std::filesystem::permissions(file, std::filesystem::perms::others_read,
                                 std::filesystem::perm_options::add);
    EXPECT_THAT(parseCommandLine({"--config", file, "ls"}, nothing).err, HasSubstr("chmod 600"));
    std::ofstream(file) << "Axon.Sever=lab:1\n";
    EXPECT_THAT(parseCommandLine({"--config", file, "ls"}, nothing).err, HasSubstr("Axon.Server"));
    EXPECT_EQ(parseCommandLine({"--config", file + ".not", "ls"}, nothing).exit, kUsage);
    std::filesystem::remove(file);
}

TEST(Words, NumbersEntitiesOfOneName) {
    const FakeStation station;
    const auto all = station.entities();
    EXPECT_EQ(callName(all[0], all), "PeopleBot#1");
    EXPECT_EQ(callName(all[1], all), "PeopleBot#2");
    EXPECT_EQ(callName(all[2], all), "Cyton");
}

TEST(Words, QuotesForTheShellWhatNeedsIt) {
    EXPECT_EQ(shellWord("PeopleBot#2"), "PeopleBot#2");
    EXPECT_EQ(shellWord("Cyton Arm"), "'Cyton Arm'");
    EXPECT_EQ(shellWord("it's"), "'it'\\''s'");
    EXPECT_EQ(shellWord(""), "''");
}

TEST(Words, NamesTheHolderAndTheFixOfARefusal) {
    const auto event = errorEvent({RefusalCode::AlreadyHeld, "PeopleBot is held", "cl2@lab"}, "PeopleBot");
    EXPECT_EQ(event["code"], "ALREADY_HELD");
    EXPECT_EQ(event["holder"], "cl2@lab");
    EXPECT_THAT(event["fix"].get<std::string>(), HasSubstr("cl2@lab"));
    EXPECT_EQ(errorEvent({RefusalCode::Latched, "stopped", {}}, "Cyton Arm")["fix"],
              "rearm it when it is safe to move again: axon rearm 'Cyton Arm'");
}

TEST(Words, SaysOneFixTheOneOfTheMessageIfItHasOne) {
    const auto own = errorEvent({RefusalCode::Latched, "It has been stopped; fix: look at it", {}}, "Cyton");
    EXPECT_EQ(own["message"], "It has been stopped");
    EXPECT_EQ(own["fix"], "look at it");
    client::TaskReport report;
    report.state = client::TaskState::Refused;
    report.reason = {RefusalCode::Latched, "It has been stopped; fix: look at it", {}};
    const auto task = taskEvent(report, "Cyton", client::Seconds(1));
    EXPECT_EQ(task["reason"]["message"], "It has been stopped");
    EXPECT_EQ(task["fix"], "look at it");
    const auto misuse = usageEvent("cannot read a file; fix: check its permissions", "axon run ENTITY");
    EXPECT_EQ(misuse["message"], "cannot read a file");
    EXPECT_EQ(misuse["fix"], "check its permissions");
    const auto nobody = noServerEvent(
        {RefusalCode::Unavailable, "nothing listens there; fix: start axon-server", {}}, "lab:1");
    EXPECT_EQ(nobody["message"], "nothing listens there");
    EXPECT_THAT(nobody["fix"].get<std::string>(), AllOf(HasSubstr("--server"), Not(HasSubstr("fix:"))));
    const auto plain = noServerEvent(
        {RefusalCode::Unavailable, "no TLS on that port; fix: leave ssl:// out", {}}, "ssl://lab:1");
    EXPECT_EQ(plain["fix"], "leave ssl:// out");
    EXPECT_FALSE(
        noServerEvent({RefusalCode::PermissionDenied, "the password is wrong", {}}, "lab:1").contains("fix"));
}

TEST(Words, SurvivesTextThatIsNoUtf8) {
    EXPECT_EQ(line({{"text", "a\xff"}}), "{\"text\":\"a\xEF\xBF\xBD\"}");
}
