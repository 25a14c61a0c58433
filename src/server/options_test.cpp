// SPDX-License-Identifier: GPL-2.0-or-later
#include "server/options.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "transport/ice/endpoint.hpp"

namespace axon::server {
namespace {

using testing::HasSubstr;

Parsed parse(std::vector<std::string> words) {
    words.insert(words.begin(), "axon-server");
    std::vector<char*> arguments;
    for (auto& word : words) arguments.push_back(word.data());
    return parseOptions(static_cast<int>(arguments.size()), arguments.data());
}

std::string complaint(const std::vector<std::string>& words) {
    try {
        parse(words);
    } catch (const std::runtime_error& error) {
        return error.what();
    }
    return "accepted";
}

TEST(ServerOptions, ListensElsewhereOnlyWithUsers) {
    EXPECT_THAT(complaint({"--listen", "0.0.0.0"}), HasSubstr("--add-user"));
    EXPECT_THAT(complaint({"--listen", "0.0.0.0", "--users", "users.cfg"}), HasSubstr("axon certs issue"));
    EXPECT_EQ(
        parse({"--listen", "0.0.0.0", "--users", "users.cfg", "--plain-tcp"}).options->settings.users_file,
        "users.cfg");
}

TEST(ServerOptions, TheFourPortsFollowTheBasePort) {
    using Addresses = std::vector<std::string>;
    const auto addresses = [](const std::vector<std::string>& words) {
        const auto settings = parse(words).options->settings;
        Addresses all;
        for (const auto& text : {settings.client_endpoint, settings.client_signal_endpoint,
                                 settings.entity_endpoint, settings.entity_signal_endpoint})
            all.push_back(transport::parseEndpoint(text).address());
        return all;
    };
    EXPECT_EQ(addresses({"--base-port", "20000"}),
              (Addresses{"127.0.0.1:20000", "127.0.0.1:20001", "127.0.0.1:20002", "127.0.0.1:20003"}));
    EXPECT_EQ(addresses({"--base-port", "20000", "--entity-endpoint", "127.0.0.1:7"}),
              (Addresses{"127.0.0.1:20000", "127.0.0.1:20001", "127.0.0.1:7", "127.0.0.1:20003"}));
    EXPECT_EQ(addresses({"--base-port", "0", "--listen", "127.0.0.2"}), Addresses(4, "127.0.0.2:0"));
    EXPECT_EQ(parse({"--base-port", "65533"}).exit_code, 2) << "there is no fourth port";
}

TEST(ServerOptions, TheBasePortIsForLanesOfOneEndpoint) {
    const auto file = std::filesystem::path(testing::TempDir()) / "axon-several-endpoints.cfg";
    std::ofstream(file) << "EntityServer.Endpoints = tcp -h 127.0.0.1 -p 7001:tcp -h 127.0.0.2 -p 7002\n";
    EXPECT_THAT(complaint({"--config", file.string(), "--base-port", "20000"}),
                testing::AllOf(HasSubstr("EntityServer.Endpoints has several endpoints in the configuration"),
                               HasSubstr("fix: change their ports there")));
    EXPECT_EQ(complaint({"--config", file.string()}), "accepted");
    EXPECT_EQ(complaint({"--config", file.string(), "--base-port", "0"}), "accepted") << "free ports differ";
    EXPECT_EQ(
        complaint({"--config", file.string(), "--base-port", "20000", "--entity-endpoint", "127.0.0.1:7"}),
        "accepted")
        << "which replaces them";
    std::filesystem::remove(file);
}

TEST(ServerOptions, AMisspeltOptionIsNamedWithTheOneThatMayBeMeant) {
    testing::internal::CaptureStderr();
    EXPECT_EQ(parse({"--liten", "0.0.0.0"}).exit_code, 2);
    EXPECT_THAT(testing::internal::GetCapturedStderr(), HasSubstr("did you mean \"--listen\"?"));
}

TEST(ServerOptions, TheConsoleIsBesideTheOtherPorts) {
    const auto console = [](const std::vector<std::string>& words) {
        const auto its = parse(words).options->settings.console;
        return its.endpoint.empty() ? std::string("none")
                                    : transport::parseEndpoint(its.endpoint).address() + " " +
                                          transport::parseEndpoint(its.session_endpoint).address() + " " +
                                          transport::parseEndpoint(its.signal_endpoint).address() +
                                          (its.required ? " required" : "");
    };
    EXPECT_EQ(console({}), "127.0.0.1:10417 127.0.0.1:10418 127.0.0.1:10419");
    EXPECT_EQ(console({"--base-port", "20000"}), "127.0.0.1:20007 127.0.0.1:20008 127.0.0.1:20009");
    EXPECT_EQ(console({"--base-port", "0"}), "127.0.0.1:0 127.0.0.1:0 127.0.0.1:0");
    EXPECT_EQ(console({"--client-endpoint", "127.0.0.3:0"}), "127.0.0.3:0 127.0.0.3:0 127.0.0.3:0");
    EXPECT_EQ(console({"--client-endpoint", "127.0.0.3:65530"}), "none") << "there are no such ports";
    EXPECT_EQ(console({"--listen", "0.0.0.0", "--users", "users.cfg", "--plain-tcp"}),
              "127.0.0.1:10417 127.0.0.1:10418 127.0.0.1:10419")
        << "not to other machines unless asked";
    EXPECT_EQ(console({"--client-endpoint", "ssl://0.0.0.0:20000", "--users", "users.cfg"}),
              "127.0.0.1:20007 127.0.0.1:20008 127.0.0.1:20009");
    EXPECT_EQ(console({"--console-endpoint", "127.0.0.2:8000"}),
              "127.0.0.2:8000 127.0.0.2:8001 127.0.0.2:8002 required");
    EXPECT_EQ(console({"--console-endpoint", "ssl://127.0.0.2:443", "--console-session-endpoint",
                       "ssl://127.0.0.2:444"}),
              "ssl://127.0.0.2:443 ssl://127.0.0.2:444 ssl://127.0.0.2:445 required");
    EXPECT_EQ(console({"--no-console"}), "none");
    EXPECT_THAT(complaint({"--console-endpoint", "0.0.0.0:80"}), HasSubstr("no users"));
    EXPECT_THAT(complaint({"--console-files", "/no/such/folder"}), HasSubstr("fix: "));
}

TEST(ServerOptions, AConsoleThatIsConfiguredMovesWithTheOtherPorts) {
    const auto file = std::filesystem::path(testing::TempDir()) / "axon-console-endpoints.cfg";
    std::ofstream(file) << "Console.Endpoints = 127.0.0.1:8000\nConsoleSession.Endpoints = 127.0.0.1:8001\n"
                        << "ConsoleSignal.Endpoints = 127.0.0.1:8002\n";
    const auto console = [&](std::vector<std::string> words) {
        words.insert(words.begin(), {"--config", file.string()});
        auto its = parse(words).options->settings.console;
        std::string all;
        for (const auto& text : {its.endpoint, its.session_endpoint, its.signal_endpoint})
            all += (all.empty() ? "" : " ") + transport::parseEndpoint(text).address();
        return all;
    };
    EXPECT_EQ(console({}), "127.0.0.1:8000 127.0.0.1:8001 127.0.0.1:8002");
    EXPECT_EQ(console({"--base-port", "20000"}), "127.0.0.1:20007 127.0.0.1:20008 127.0.0.1:20009");
    EXPECT_EQ(console({"--base-port", "0"}), "127.0.0.1:0 127.0.0.1:0 127.0.0.1:0");
    EXPECT_EQ(console({"--listen", "127.0.0.2"}), "127.0.0.2:8000 127.0.0.2:8001 127.0.0.2:8002");
    EXPECT_EQ(console({"--base-port", "20000", "--console-session-endpoint", "127.0.0.1:7"}),
              "127.0.0.1:20007 127.0.0.1:7 127.0.0.1:20009");
    EXPECT_EQ(console({"--listen", "0.0.0.0", "--users", "users.cfg", "--plain-tcp"}),
              "127.0.0.1:8000 127.0.0.1:8001 127.0.0.1:8002")
        << "not to other machines unless asked";
    std::ofstream(file) << "Console.Endpoints = ssl://192.0.2.1:8000\n";
    EXPECT_EQ(console({"--listen", "192.0.2.2", "--users", "users.cfg", "--plain-tcp"}),
              "ssl://192.0.2.2:8000 ssl://192.0.2.2:8001 ssl://192.0.2.2:8002");
    EXPECT_THAT(complaint({"--config", file.string(), "--base-port", "65530"}),
                testing::AllOf(HasSubstr("there is none; fix: "), HasSubstr("65526")));
    std::filesystem::remove(file);
}

TEST(ServerOptions, AConsoleForWhichThereAreNoPortsIsLeftOutWithAWord) {
    const auto last = parse({"--base-port", "65526"}).options->settings.console;
    EXPECT_EQ(transport::parseEndpoint(last.signal_endpoint).port, 65535);
    EXPECT_EQ(last.left_out, "");
    const auto none = parse({"--base-port", "65527"}).options->settings.console;
    EXPECT_EQ(none.endpoint, "");
    EXPECT_THAT(none.left_out, HasSubstr("fix: choose a port for clients (--base-port) of at most 65526"));
    EXPECT_THAT(complaint({"--base-port", "65527", "--console-session-endpoint", "127.0.0.1:7"}),
                HasSubstr("fix: "));
    EXPECT_THAT(complaint({"--console-endpoint", "127.0.0.1:65535"}), HasSubstr("there is no port after"));
    EXPECT_EQ(parse({"--base-port", "65527", "--no-console"}).options->settings.console.left_out, "");
}

TEST(ServerOptions, SaysWhatAddUserNeeds) {
    EXPECT_THAT(complaint({"--add-user", "client1", "--user-role", "admin"}), HasSubstr("add --users FILE"));
    EXPECT_THAT(complaint({"--add-user", "client1", "--users", "u"}),
                HasSubstr("expected observer, operator"));
    EXPECT_THAT(complaint({"--user-role", "admin"}), HasSubstr("for --add-user"));
}

TEST(ServerOptions, TheLogTakesBothSpellingsOfWarning) {
    EXPECT_EQ(parse({"--log-level", "warning"}).options->log_level, "warning");
    EXPECT_EQ(parse({"--log-level", "warn"}).options->log_level, "warn");
    EXPECT_EQ(parse({"--log-level", "loud"}).exit_code, 2);
}

TEST(ServerOptions, OneOfSeveralServersNeedsANameAndTheTopicManager) {
    EXPECT_EQ(complaint({"--role", "both"}), "accepted");
    EXPECT_EQ(parse({"--role", "admin"}).exit_code, 2);
    EXPECT_THAT(complaint({"--role", "front-end"}), HasSubstr("Server.Name=fe1"));
    std::string name = std::filesystem::temp_directory_path() / "axon-options-XXXXXX";
    const std::string folder = ::mkdtemp(name.data());
    const auto file = folder + "/frontendserver.cfg";
    std::ofstream(file) << "Server.Name=fe1\n";
    EXPECT_THAT(complaint({"--role", "front-end", "--config", file}), HasSubstr("Server.TopicManager="));
    std::ofstream(file)
        << "Server.Name=fe1\nServer.TopicManager=IceStorm/TopicManager:tcp -h 127.0.0.1 -p 1\n"
        << "FrontEndServerTopic.Endpoints=tcp -h 127.0.0.1 -p 10501\n";
    EXPECT_THAT(complaint({"--config", file}), HasSubstr("--role front-end"));
    const auto settings = parse({"--role", "front-end", "--config", file}).options->settings;
    EXPECT_EQ(settings.role, ServerRole::FrontEnd);
    EXPECT_EQ(settings.name, "fe1");
    EXPECT_EQ(settings.topic_manager, "IceStorm/TopicManager:tcp -h 127.0.0.1 -p 1");
    EXPECT_EQ(settings.topic_endpoint, "tcp -h 127.0.0.1 -p 10501");
    std::ofstream(file) << "Server.Name=fe:1\n";
    EXPECT_THAT(complaint({"--role", "front-end", "--config", file}), HasSubstr("letters, digits"));
    std::filesystem::remove_all(folder);
}

TEST(ServerOptions, ReadsUsersAndDrillPeriodFromTheFile) {
    std::string name = std::filesystem::temp_directory_path() / "axon-options-XXXXXX";
    const std::string folder = ::mkdtemp(name.data());
    const auto file = folder + "/server.cfg";
    std::ofstream(file) << "Axon.DrillPeriod=30\nServer.Users=/etc/axon/users.cfg\n";
    const auto settings = parse({"--config", file}).options->settings;
    EXPECT_EQ(settings.entity.drill_period, std::chrono::seconds{30});
    EXPECT_EQ(settings.users_file, "/etc/axon/users.cfg");
    std::ofstream(file) << "Axon.DrillPeriod=soon\n";
    EXPECT_THAT(complaint({"--config", file}), HasSubstr("expected a number from 0 to 86400"));
    std::filesystem::remove_all(folder);
}

TEST(ServerOptions, TheAuditIsOffUntilAFolderIsNamed) {
    std::string name = std::filesystem::temp_directory_path() / "axon-options-XXXXXX";
    const std::string folder = ::mkdtemp(name.data());
    const auto file = folder + "/server.cfg";
    EXPECT_TRUE(parse({}).options->settings.audit.folder.empty());
    std::ofstream(file) << "Axon.Audit.Folder=/var/lib/a\nAxon.Audit.Size=4096\nAxon.Audit.Files=3\n";
    const auto audit = parse({"--config", file}).options->settings.audit;
    EXPECT_EQ(audit.folder, "/var/lib/a");
    EXPECT_EQ(audit.files.bytes, 4096U);
    EXPECT_EQ(audit.files.files, 3);
    std::ofstream(file) << "Axon.Audit.Size=4095\n";
    EXPECT_THAT(complaint({"--config", file}), HasSubstr("Axon.Audit.Size"));
    std::ofstream(file) << "Axon.Audit.Files=0\n";
    EXPECT_THAT(complaint({"--config", file}), HasSubstr("expected a number from 1 to 10000"));
    std::filesystem::remove_all(folder);
}

TEST(ServerOptions, WatchdogsAreWhatAClientCanKeepUpWith) {
    std::string name = std::filesystem::temp_directory_path() / "axon-options-XXXXXX";
    const std::string folder = ::mkdtemp(name.data());
    const auto file = folder + "/server.cfg";
    const auto with = [&](const std::string& busy, const std::string& idle) {
        std::ofstream(file) << "FrontEndServer.WatchdogBusyMs=" << busy
                            << "\nFrontEndServer.WatchdogIdleMs=" << idle << "\n";
        return complaint({"--config", file});
    };
    for (const auto& [busy, idle] : {std::pair{"50", "1000"}, std::pair{"2000", "2000"},
                                     std::pair{"2000", "600000"}, std::pair{"50", "600000"}})
        EXPECT_EQ(with(busy, idle), "accepted");
    EXPECT_THAT(with("49", "10000"),
                HasSubstr("FrontEndServer.WatchdogBusyMs: '49': expected a number from 50 to 2000"));
    EXPECT_THAT(with("2001", "10000"), HasSubstr("from 50 to 2000"));
    EXPECT_THAT(with("250", "999"),
                HasSubstr("FrontEndServer.WatchdogIdleMs: '999': expected a number from 1000 to 600000"));
    EXPECT_THAT(with("250", "600001"), HasSubstr("from 1000 to 600000"));
    EXPECT_THAT(with("2000", "1999"), HasSubstr("fix: lower the first or raise the second"));
    std::filesystem::remove_all(folder);
}

TEST(ServerOptions, LimitsOfAUserAreNumbersInTheirRange) {
    std::string name = std::filesystem::temp_directory_path() / "axon-options-XXXXXX";
    const std::string folder = ::mkdtemp(name.data());
    const auto file = folder + "/server.cfg";
    const auto with = [&](const std::string& line) {
        std::ofstream(file) << "FrontEndServer.User" << line << "\n";
        return complaint({"--config", file});
    };
    std::ofstream(file) << "FrontEndServer.UserSessions=3\nFrontEndServer.UserCheckOuts=0\n"
                           "FrontEndServer.UserMessages=10\nFrontEndServer.UserBytes=2000000000\n";
    const auto its = parse({"--config", file}).options->settings.front_end;
    EXPECT_EQ(its.user_sessions, 3U);
    EXPECT_EQ(its.user_check_outs, 0U);
    EXPECT_EQ(its.user_messages_per_second, 10U);
    EXPECT_EQ(its.user_bytes_per_second, 2'000'000'000U);
    EXPECT_THAT(with("Sessions=0"), HasSubstr("expected a number from 1 to 1000000"));
    EXPECT_THAT(with("CheckOuts=-1"), HasSubstr("expected a number from 0 to 1000000"));
    EXPECT_THAT(with("Messages=9"), HasSubstr("expected a number from 10 to 10000000"));
    EXPECT_THAT(with("Bytes=2000000001"), HasSubstr("expected a number from 1024 to 2000000000"));
    EXPECT_THAT(with("Bytes=much"), HasSubstr("expected a number"));
    std::filesystem::remove_all(folder);
}

TEST(ServerOptions, TheThreadsMayStandStillForEverUnlessASettingSaysHowLong) {
    EXPECT_EQ(parse({}).options->settings.stuck_for, Duration::zero());
    std::string name = std::filesystem::temp_directory_path() / "axon-options-XXXXXX";
    const std::string folder = ::mkdtemp(name.data());
    const auto file = folder + "/server.cfg";
    std::ofstream(file) << "Server.WatchdogS=30\n";
    EXPECT_EQ(parse({"--config", file}).options->settings.stuck_for, std::chrono::seconds{30});
    std::ofstream(file) << "Server.WatchdogS=3601\n";
    EXPECT_THAT(complaint({"--config", file}), HasSubstr("expected a number from 0 to 3600"));
    std::filesystem::remove_all(folder);
}

TEST(ServerOptions, GlobalServicesLieBesideTheConfigurationUnlessAFolderIsNamed) {
    EXPECT_EQ(parse({}).options->settings.global_services, "globalservices");
    std::string name = std::filesystem::temp_directory_path() / "axon-options-XXXXXX";
    const std::string folder = ::mkdtemp(name.data());
    const auto file = folder + "/server.cfg";
    std::ofstream(file) << "Axon.DrillPeriod=30\n";
    EXPECT_EQ(parse({"--config", file}).options->settings.global_services, folder + "/globalservices")
        << "it need not be there";
    std::ofstream(file) << "Server.GlobalServices=" << folder << "\n";
    EXPECT_EQ(parse({"--config", file}).options->settings.global_services, folder);
    EXPECT_EQ(parse({"--config", file, "--global-services", "/tmp"}).options->settings.global_services,
              "/tmp");
    EXPECT_THAT(complaint({"--global-services", folder + "/none"}), HasSubstr("is not a folder"));
    std::filesystem::remove_all(folder);
}

}  // namespace
}  // namespace axon::server
