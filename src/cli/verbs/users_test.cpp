// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "cli/command_line.hpp"
#include "cli/fake_station.hpp"
#include "cli/view.hpp"
#include "users/users_file.hpp"

using namespace axon;
using namespace axon::cli;
using testing::HasSubstr;

namespace {

struct UsersVerb : testing::Test {
    UsersVerb() {
        std::string name = std::filesystem::temp_directory_path() / "axon-users-verb-XXXXXX";
        folder = ::mkdtemp(name.data());
        file = folder + "/users.cfg";
    }
    ~UsersVerb() override { std::filesystem::remove_all(folder); }
    /// As the user writes it, with this first line on standard input.
    int axon(std::vector<std::string> words, const std::string& typed = "secret1") {
        seen.events.clear();
        words.insert(words.begin(), "users");
        words.insert(words.end(), {"--file", file});
        std::ofstream(folder + "/typed") << typed << "\n";
        if (std::freopen((folder + "/typed").c_str(), "r", stdin) == nullptr) std::abort();
        const auto parsed = parseCommandLine(words, [](const char*) -> const char* { return nullptr; });
        said = parsed.err;
        if (!parsed.line) return parsed.exit;
        Session session{parsed.line->args, seen, nullptr, nullptr, parsed.line->settings};
        const int exit = parsed.line->verb->perform(session);
        if (const auto* error = seen.last("error")) said = error->at("message").get<std::string>();
        return exit;
    }
    std::optional<users::UserRole> role(const std::string& name, const std::string& password) const {
        return users::Users::read(file).verify(name, password);
    }
    std::string text() const {
        std::ostringstream out, err;
        const ManualClock clock;
        PersonView view(out, err, {}, clock);
        for (const auto& event : seen.events) view.emit(event);
        return out.str() + err.str();
    }

    std::string folder, file, said;
    Recorded seen;
};

TEST_F(UsersVerb, AddsListsChangesAndRemoves) {
    EXPECT_EQ(axon({"add", "boss", "admin"}), kDone) << said;
    EXPECT_EQ(axon({"add", "ann", "operator"}), kDone) << said;
    EXPECT_EQ(role("ann", "secret1"), users::UserRole::Operator);
    EXPECT_THAT(text(), HasSubstr("ann may log in as operator; servers"));
    EXPECT_EQ(axon({"role", "ann", "observer"}), kDone) << said;
    EXPECT_EQ(axon({"password", "ann"}, "secret2"), kDone) << said;
    EXPECT_EQ(role("ann", "secret2"), users::UserRole::Observer);
    EXPECT_THAT(Json(seen.events).dump(), testing::Not(HasSubstr("secret")));
    EXPECT_EQ(axon({"list"}), kDone) << said;
    const auto& list = *seen.last("users");
    EXPECT_EQ(list.at("users"), Json::parse(R"([{"name":"boss","role":"admin","hash":"argon2id"},
                                               {"name":"ann","role":"observer","hash":"argon2id"}])"));
    EXPECT_EQ(list.at("fingerprint").get<std::string>(), users::Users::read(file).fingerprint());
    EXPECT_THAT(text(), HasSubstr("ann   observer  argon2id"));
    EXPECT_EQ(axon({"remove", "ann"}), kDone) << said;
    EXPECT_FALSE(role("ann", "secret2"));
}

TEST_F(UsersVerb, ListsOfEntitiesAreShownAndKept) {
    EXPECT_EQ(axon({"add", "boss", "admin"}), kDone) << said;
    std::ofstream(file, std::ios::app) << "@checkout arm-* boss @admin\n";
    EXPECT_EQ(axon({"add", "ann", "operator"}), kDone) << said;
    EXPECT_EQ(axon({"list"}), kDone) << said;
    EXPECT_EQ(seen.last("users")->at("lists"),
              Json::parse(R"([{"right":"checkout","entity":"arm-*","who":["boss","@admin"]}])"));
    EXPECT_THAT(text(), HasSubstr("checkout  arm-*"));
}

TEST_F(UsersVerb, ItsFileCanBeReadByItsOwnerAndItsGroupAtMost) {
    EXPECT_EQ(axon({"add", "boss", "admin"}), kDone) << said;
    struct stat facts {};
    ASSERT_EQ(::stat(file.c_str(), &facts), 0);
    EXPECT_EQ(facts.st_mode & 07777U & ~0640U, 0U);
}

TEST_F(UsersVerb, SaysWhatIsWrongBeforeAPasswordIsTyped) {
    EXPECT_EQ(axon({"add", "boss", "admin"}), kDone) << said;
    EXPECT_EQ(axon({"add", "boss", "operator"}), kUsage);
    EXPECT_THAT(said, HasSubstr("already"));
    EXPECT_EQ(axon({"password", "nobody"}), kUsage);
    EXPECT_THAT(said, HasSubstr("no user 'nobody'"));
    EXPECT_EQ(axon({"add", "a b", "operator"}), kUsage);
    EXPECT_THAT(said, HasSubstr("expected a name"));
    EXPECT_EQ(axon({"add", "ann", "operator"}, ""), kUsage);
    EXPECT_THAT(said, HasSubstr("expected a password"));
    EXPECT_EQ(users::Users::read(file).size(), 1U);
}

TEST_F(UsersVerb, RefusesWhatIsNotMeant) {
    EXPECT_EQ(axon({"add", "boss", "admin"}), kDone) << said;
    EXPECT_EQ(axon({"add", "ann"}), kUsage);
    EXPECT_EQ(axon({"add", "ann", "king"}), kUsage);
    EXPECT_EQ(axon({"add"}), kUsage);
    EXPECT_EQ(axon({"role", "boss"}), kUsage);
    EXPECT_EQ(axon({"list", "boss"}), kUsage);
    EXPECT_EQ(axon({"remove", "boss", "admin"}), kUsage);
    EXPECT_EQ(axon({"promote", "boss"}), kUsage);
    EXPECT_EQ(axon({"remove", "boss"}), kUsage);
    EXPECT_THAT(said, HasSubstr("only user"));
    EXPECT_EQ(role("boss", "secret1"), users::UserRole::Admin);
}

TEST_F(UsersVerb, WarnsWhereNobodyIsAdminAnyMore) {
    EXPECT_EQ(axon({"add", "boss", "admin"}), kDone) << said;
    EXPECT_EQ(seen.last("finding"), nullptr);
    EXPECT_EQ(axon({"role", "boss", "operator"}), kDone) << said;
    ASSERT_NE(seen.last("finding"), nullptr);
    EXPECT_THAT(seen.last("finding")->at("message").get<std::string>(), HasSubstr("no user is admin"));
}

TEST_F(UsersVerb, AnEmptyFileIsListedAndAFileWithAnErrorIsNot) {
    std::ofstream(file) << "# nobody yet\n";
    ::chmod(file.c_str(), 0640);
    EXPECT_EQ(axon({"list"}), kDone) << said;
    EXPECT_THAT(text(), HasSubstr("there are no users"));
    EXPECT_EQ(axon({"add", "boss", "admin"}), kDone) << said;
    std::ofstream(file, std::ios::app) << "ann king x\n";
    EXPECT_EQ(axon({"list"}), kUsage);
    EXPECT_THAT(said, HasSubstr("users.cfg:3: expected the role"));
    file += "x";
    EXPECT_EQ(axon({"list"}), kUsage);
    EXPECT_THAT(said, HasSubstr("No such file"));
}

}  // namespace
