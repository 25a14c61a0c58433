// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/users_watch.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <vector>

#include "users/users_file.hpp"

namespace axon::users {
namespace {

using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

// openssl passwd -6 -salt saltsalt secret1
const std::string kHash =
    "$6$saltsalt$jCP90RmSIIja2o9FRs25ASQaR1lMN6uKHmNcHaoNCpAXgV3n5NfAlQdZQcvMVQO1BTCOFF0LzoHFZBt9E45NW0";

class UsersWatchTest : public testing::Test {
  protected:
    UsersWatchTest() {
        std::string name = std::filesystem::temp_directory_path() / "axon-watch-XXXXXX";
        folder = ::mkdtemp(name.data());
        file = folder + "/users.cfg";
        write("boss admin " + kHash + "\nclient1 operator " + kHash + "\n");
        watch.emplace(
            file, std::make_shared<const Users>(Users::read(file)), clock,
            [this](const std::string& line) { notes.push_back(line); },
            [this](std::shared_ptr<const Users> users) { taken.push_back(std::move(users)); });
        look();
        look();
    }
    ~UsersWatchTest() override { std::filesystem::remove_all(folder); }
    void write(const std::string& text) const {
        std::ofstream(file) << text;
        ::chmod(file.c_str(), 0640);
    }
    void look() {
        clock.advance(UsersWatch::kPeriod);
        watch->onTimer();
    }

    ManualClock clock;
    std::string folder, file;
    std::vector<std::string> notes;
    std::vector<std::shared_ptr<const Users>> taken;
    std::optional<UsersWatch> watch;
};

TEST_F(UsersWatchTest, WhatIsTheSameIsNotTaken) {
    look();
    write("# a comment\nboss admin " + kHash + "\nclient1 operator " + kHash + "\n");
    for (int i = 0; i < 3; ++i) look();
    EXPECT_THAT(taken, IsEmpty());
    EXPECT_THAT(notes, IsEmpty());
}

TEST_F(UsersWatchTest, ANewFileIsTakenOnceItHasStayedTheSame) {
    removeUser(file, "client1");
    look();
    EXPECT_THAT(taken, IsEmpty());  // half a file might look like that
    look();
    ASSERT_EQ(taken.size(), 1U);
    EXPECT_FALSE(taken[0]->roleOf("client1"));
    EXPECT_THAT(notes, ElementsAre(HasSubstr("1 user of " + file)));
    look();
    EXPECT_EQ(taken.size(), 1U);
}

TEST_F(UsersWatchTest, AFileThatIsBeingWrittenIsNotRead) {
    for (int i = 0; i < 5; ++i) {
        std::ofstream(file, std::ios::app) << "user" << i << " observer " << kHash << "\n";
        look();
    }
    EXPECT_THAT(taken, IsEmpty());
    look();
    ASSERT_EQ(taken.size(), 1U);
    EXPECT_EQ(taken[0]->size(), 7U);
}

TEST_F(UsersWatchTest, AFileThatIsWrittenWhileItIsReadIsReadAgain) {
    int readings = 0;
    UsersWatch other(
        file, std::make_shared<const Users>(Users::read(file)), clock,
        [this](const std::string& line) { notes.push_back(line); },
        [this](std::shared_ptr<const Users> users) { taken.push_back(std::move(users)); },
        [&](const std::string& its) {
            auto users = Users::read(its);
            // Its writer goes on, after a pause as long as the one between two looks.
            if (++readings == 1) write("boss admin " + kHash + "\nclient1 operator " + kHash + "\n# whole\n");
            return users;
        });
    const auto lookThere = [&] {
        clock.advance(UsersWatch::kPeriod);
        other.onTimer();
    };
    write("boss admin " + kHash + "\n");
    for (int i = 0; i < 5; ++i) lookThere();
    EXPECT_EQ(readings, 2);
    EXPECT_THAT(taken, IsEmpty()) << "client1 was missing only in the half";
}

TEST_F(UsersWatchTest, AFileWithAnErrorChangesNothingAndIsSaidOnce) {
    write("boss admin " + kHash + "\nclient1 king " + kHash + "\n");
    for (int i = 0; i < 4; ++i) look();
    EXPECT_THAT(taken, IsEmpty());
    EXPECT_THAT(notes, ElementsAre(testing::AllOf(HasSubstr("users.cfg:2: expected the role"),
                                                  HasSubstr("could log in before still can"))));
    write("boss operator " + kHash + "\n");
    for (int i = 0; i < 3; ++i) look();
    ASSERT_EQ(taken.size(), 1U);
    EXPECT_EQ(taken[0]->roleOf("boss"), UserRole::Operator);
}

TEST_F(UsersWatchTest, AFileThatIsGoneEmptyOrOpenToOthersChangesNothing) {
    std::filesystem::remove(file);
    for (int i = 0; i < 3; ++i) look();
    write("# nobody\n");
    for (int i = 0; i < 3; ++i) look();
    write("boss admin " + kHash + "\n");
    ::chmod(file.c_str(), 0644);
    for (int i = 0; i < 3; ++i) look();
    EXPECT_THAT(taken, IsEmpty());
    EXPECT_THAT(notes, ElementsAre(HasSubstr("No such file"), HasSubstr("at least one user"),
                                   HasSubstr("chmod 640")));
    ::chmod(file.c_str(), 0640);
    for (int i = 0; i < 3; ++i) look();
    EXPECT_EQ(taken.size(), 1U);
}

TEST_F(UsersWatchTest, LooksOnceAPeriodOnly) {
    removeUser(file, "client1");
    for (int i = 0; i < 100; ++i) watch->onTimer();
    EXPECT_THAT(taken, IsEmpty());
    EXPECT_EQ(watch->onTimer(), clock.now() + UsersWatch::kPeriod);
}

TEST_F(UsersWatchTest, WhoseHashIsOfAnOlderKindIsSaid) {
    setPassword(file, "boss", "secret2");
    look();
    look();
    EXPECT_THAT(notes, ElementsAre(HasSubstr("1 has a hash of crypt(5) (client1)")));
}

}  // namespace
}  // namespace axon::users
