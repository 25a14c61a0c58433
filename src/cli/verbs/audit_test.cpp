// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>
#include <unistd.h>

#include <filesystem>
#include <sstream>

#include "audit/files.hpp"
#include "audit/testing.hpp"
#include "cli/command_line.hpp"
#include "cli/fake_station.hpp"
#include "cli/view.hpp"
#include "common/queue_share.hpp"

using namespace axon;
using namespace axon::cli;
using testing::ElementsAre;
using testing::HasSubstr;

namespace {

struct Audit : testing::Test {
    Audit() {
        audit::Files files(folder.path, "axon-server", {});
        add(files, {0, "", "started", "", "", "", "", "", "axon-server 0.1", "", ""});
        add(files, {0, "", "session", "ann", "tablet", "c1", "", "", "joined as operator", "OK", ""});
        add(files, {0, "", "stop", "", "tablet", "c1", "", "e1", "stop", "OK", ""});
        add(files, {0, "", "stop", "", "bob", "c2", "", "e2", "stop \x1b[31m", "OK", ""});
        add(files, {0, "", "refusal", "eve", "", "", "10.0.0.9:4444", "", "log-in", "PERMISSION_DENIED", ""});
    }
    void add(audit::Files& files, audit::Record record) {
        record.at = audit::utcTime(1'790'000'000'000'000 + 1'000'000 * at++);
        EXPECT_TRUE(files.append(record));
    }
    /// As the user writes it.
    int axon(std::vector<std::string> words) {
        words.insert(words.begin(), "audit");
        const auto parsed = parseCommandLine(words, [](const char*) -> const char* { return nullptr; });
        EXPECT_TRUE(parsed.line) << parsed.err;
        if (!parsed.line) return parsed.exit;
        Session session{parsed.line->args, seen, nullptr, nullptr, parsed.line->settings};
        return parsed.line->verb->perform(session);
    }
    /// The numbers of the records that are shown.
    std::vector<int> shown(std::vector<std::string> words) {
        seen.events.clear();
        words.insert(words.begin(), {"show", "--folder", folder.path.string()});
        EXPECT_EQ(axon(words), kDone);
        std::vector<int> numbers;
        for (const auto& event : seen.events)
            if (event.at("event") == "audit_record") numbers.push_back(event.at("n"));
        return numbers;
    }
    audit::TrailFolder folder;
    int at = 0;
    Recorded seen;
};

}  // namespace

TEST_F(Audit, ShowsTheRecordsThatAreAskedFor) {
    EXPECT_THAT(shown({}), ElementsAre(1, 2, 3, 4, 5));
    EXPECT_THAT(shown({"--last", "2"}), ElementsAre(4, 5));
    EXPECT_THAT(shown({"--kind", "stop"}), ElementsAre(3, 4));
    EXPECT_THAT(shown({"--entity", "e1"}), ElementsAre(3));
    EXPECT_THAT(shown({"--user", "eve"}), ElementsAre(5));
    const auto second = audit::utcTime(1'790'000'000'000'000 + 1'000'000).substr(0, 19);
    EXPECT_THAT(shown({"--until", second}), ElementsAre(1, 2));
    EXPECT_THAT(shown({"--since", second, "--kind", "session"}), ElementsAre(2));
    EXPECT_EQ(seen.last("audit_record")->at("user"), "ann");
    EXPECT_FALSE(seen.last("audit_record")->contains("entity"));
}

TEST_F(Audit, WithoutAFolderItSaysThatAuditingIsOffAndWhatTurnsItOn) {
    if (std::filesystem::exists("/var/lib/axon-server/audit"))
        GTEST_SKIP() << "axon-server of the Debian package records on this machine, so its folder is there";
    EXPECT_EQ(axon({"show"}), kUsage);
    const auto error = *seen.last("error");
    EXPECT_THAT(error.at("message").get<std::string>(), HasSubstr("auditing is off"));
    EXPECT_THAT(error.at("fix").get<std::string>(), HasSubstr("set Axon.Audit.Folder=DIR"));
}

TEST_F(Audit, AUserIsFoundByWhatTheClientDidUnderAnotherName) {
    EXPECT_THAT(shown({"--user", "ann"}), ElementsAre(2, 3));
}

TEST_F(Audit, AUserIsFoundByTheIdOfTheClientWhereNoSessionIsInTheTrail) {
    audit::TrailFolder of_manager;
    audit::Files files(of_manager.path, "axon-entity-manager-Greeter", {});
    const auto id = [](const char* user, char version) {
        return userPart(user) + version + "123-9abc-123456789012";
    };
    add(files, {0, "", "stop", "", "tablet", id("ann", '8'), "", "e1", "stopped", "", ""});
    add(files, {0, "", "stop", "", "tablet", "fe1:one:" + id("ann", '8'), "", "e1", "stopped", "", ""});
    add(files, {0, "", "stop", "", "tablet", id("bob", '8'), "", "e1", "stopped", "", ""});
    add(files, {0, "", "stop", "", "tablet", id("ann", '4'), "", "e1", "stopped", "", ""});  // no client's
    add(files, {0, "", "stop", "", "tablet", userPart("ann"), "", "e1", "stopped", "", ""});
    EXPECT_EQ(axon({"show", "--folder", of_manager.path.string(), "--user", "ann"}), kDone);
    std::vector<int> numbers;
    for (const auto& event : seen.events) numbers.push_back(event.at("n"));
    EXPECT_THAT(numbers, ElementsAre(1, 2));
}

TEST_F(Audit, TheUserOfASessionIsToldWithWhatItsClientDid) {
    shown({"--kind", "stop"});
    EXPECT_EQ(seen.events.at(0).at("session_user"), "ann");
    EXPECT_FALSE(seen.events.at(0).contains("user")) << "it is not in that record";
    EXPECT_FALSE(seen.events.at(1).contains("session_user"));
}

TEST_F(Audit, AUserIsFoundInTheTrailsOfOtherServersToo) {
    audit::Files other(folder.path, "axon-a", {});
    add(other, {0, "", "ownership", "", "tablet", "c1", "", "e1", "checked out", "", ""});
    shown({"--user", "ann"});
    EXPECT_EQ(seen.events.size(), 3U);
    EXPECT_EQ(seen.last("audit_record")->at("trail"), "axon-a");
}

TEST_F(Audit, AnEntityIsFoundByItsNameAndStopsOfAllAreItsToo) {
    {
        audit::Files files(folder.path, "axon-server", {});
        add(files, {0, "", "session", "", "Cart", "", "", "e2", "entity joined", "OK", ""});
        add(files, {0, "", "stop", "", "bob", "c2", "", "", "stop to all 2 entities", "OK", ""});
        add(files, {0, "", "stop", "", "bob", "c2", "", "", "stop of 2 entities: e1, e3", "OK", ""});
        add(files, {0, "", "stop", "", "bob", "c2", "", "", "stop of 2 entities: e2, e3", "OK", ""});
        add(files, {0, "", "command", "", "Cart", "c3", "", "e1", "TASK", "OK", ""});
    }
    EXPECT_THAT(shown({"--entity", "Cart"}), ElementsAre(4, 6, 7, 9));
    EXPECT_THAT(shown({"--entity", "e2"}), ElementsAre(4, 6, 7, 9));
    EXPECT_THAT(shown({"--entity", "e1"}), ElementsAre(3, 7, 8, 10));
}

TEST_F(Audit, VerifyTellsTheLastHashAndFindsItAgain) {
    EXPECT_EQ(axon({"verify", folder.path.string()}), kDone);
    const std::string hash = seen.last("audit_trail")->at("hash");
    EXPECT_EQ(seen.last("audit_trail")->at("last"), 5);
    EXPECT_EQ(axon({"verify", folder.path.string(), "--kept", hash}), kDone);
    EXPECT_EQ(axon({"verify", folder.path.string(), "--kept", audit::kNoHash}), kRefused);
    EXPECT_THAT(seen.last("finding")->at("message").get<std::string>(), HasSubstr("cut or written anew"));
}

TEST_F(Audit, VerifyNamesThePlaceOfAChangeAndFails) {
    auto text = folder.text("axon-server.1.jsonl");
    text.replace(text.find("tablet"), 6, "laptop");
    folder.write("axon-server.1.jsonl", text);
    EXPECT_EQ(axon({"verify", folder.path.string()}), kRefused);
    EXPECT_THAT(seen.last("finding")->at("name").get<std::string>(), HasSubstr("axon-server.1.jsonl:2"));
    EXPECT_EQ(seen.last("audit_trail")->at("whole"), false);
    shown({});
    EXPECT_THAT(seen.last("finding")->at("fix").get<std::string>(), HasSubstr("axon audit verify"));
}

TEST_F(Audit, WhatPeopleSeeHasNoControlCharacters) {
    shown({"--entity", "e2"});
    std::ostringstream out, err;
    PersonView(out, err, {}, ManualClock()).emit(*seen.last("audit_record"));
    EXPECT_THAT(out.str(), HasSubstr("stop"));
    EXPECT_EQ(out.str().find('\x1b'), std::string::npos);
    EXPECT_EQ(axon({"verify", folder.path.string()}), kDone);
    PersonView(out, err, {}, ManualClock()).emit(*seen.last("audit_trail"));
    EXPECT_THAT(out.str(), HasSubstr("axon-server: 5 records"));
}

TEST_F(Audit, SaysWhatIsWrongWithTheCommand) {
    EXPECT_EQ(axon({"verify", (folder.path / "none").string()}), kUsage);
    EXPECT_EQ(axon({"show", "--since", "yesterday"}), kUsage);
    EXPECT_EQ(axon({"show", "a", "--folder", "b"}), kUsage);
    EXPECT_EQ(axon({"verify", folder.path.string(), "--last", "3"}), kUsage);
    EXPECT_EQ(axon({"show", "--kept", audit::kNoHash}), kUsage);
    for (const auto& kept :
         {std::string("abc"), std::string(63, '0'), std::string(65, '0'), std::string(64, 'g')})
        EXPECT_EQ(axon({"verify", folder.path.string(), "--kept", kept}), kUsage) << kept;
    const auto said = [this] { return seen.last("error")->at("message").get<std::string>(); };
    const audit::TrailFolder empty;
    for (const auto* action : {"show", "verify"}) {
        EXPECT_EQ(axon({action, empty.path.string()}), kUsage);
        EXPECT_THAT(said(), HasSubstr("there is no audit trail"));
        EXPECT_EQ(axon({action, (empty.path / "none").string()}), kUsage);
        EXPECT_THAT(said(), HasSubstr("there is no folder"));
    }
    std::filesystem::create_directory_symlink(empty.path / "loop", empty.path / "loop");
    EXPECT_EQ(axon({"show", (empty.path / "loop").string()}), kUsage);
    EXPECT_EQ(said().find('\n'), std::string::npos);
    EXPECT_THAT(said(), HasSubstr("cannot be read"));
    if (::geteuid() == 0) return;  // who may read everything
    const audit::TrailFolder closed;
    std::filesystem::permissions(closed.path, std::filesystem::perms::none);
    EXPECT_EQ(axon({"show", closed.path.string()}), kUsage);
    EXPECT_THAT(said(), HasSubstr("fix: run it as the user who runs the program, or as root"));
}
