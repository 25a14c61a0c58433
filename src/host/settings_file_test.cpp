// SPDX-License-Identifier: MIT
#include "host/settings_file.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>

#include "common/descriptor.hpp"

namespace axon {
namespace {

using testing::AllOf;
using testing::ElementsAre;
using testing::Field;
using testing::HasSubstr;
using testing::StartsWith;

auto is(const std::string& key, const std::string& value, const std::string& where) {
    return AllOf(Field(&Setting::key, key), Field(&Setting::value, value), Field(&Setting::where, where));
}

std::vector<Setting> parsed(std::string_view text) {
    const auto settings = parseSettings(text, "f");
    EXPECT_TRUE(settings.ok()) << settings.refusal().message;
    return settings.ok() ? settings.value() : std::vector<Setting>();
}

std::string valueOf(const std::string& value) {
    const auto settings = parsed("a=" + value);
    return settings.size() == 1 ? settings[0].value : "not one setting";
}

TEST(SettingsFile, SaysOfEachSettingWhereItIs) {
    EXPECT_THAT(parsed("\xEF\xBB\xBF# ours\r\n\n  Axon.Ports =  5600 - 5610  # ten\r\n a b\t=\nAxon.Ports=1"),
                ElementsAre(is("Axon.Ports", "5600 - 5610", "f:3"), is("a b", "", "f:4"),
                            is("Axon.Ports", "1", "f:5")));
    EXPECT_THAT(parsed(""), ElementsAre());
    EXPECT_THAT(parsed("\n # a = b"), ElementsAre());
}

TEST(SettingsFile, ABackslashTakesTheMeaningFromTheNextCharacter) {
    EXPECT_EQ(valueOf("one\\#two\\=three\\\\ # comment"), "one#two=three\\");
    EXPECT_EQ(valueOf("a=b=c"), "a=b=c");
    EXPECT_EQ(valueOf(" \\ \\ a b\\  "), "  a b ");
    EXPECT_EQ(valueOf("C:\\new\\"), "C:\\new\\");
    EXPECT_THAT(parsed("a\\=b\\#c\\ d = 1"), ElementsAre(is("a=b#c d", "1", "f:1")));
}

TEST(SettingsFile, ALineThatIsNoSettingIsRefusedWithItsNumberAndTheFix) {
    for (const char* line : {"Axon.Ports 5500", "  Axon.Ports", "= 5500", "a # = b", "a\\=b"}) {
        const auto refused = parseSettings("a = b\n" + std::string(line), "config/ports.cfg");
        ASSERT_FALSE(refused.ok()) << line;
        EXPECT_EQ(refused.refusal().code, RefusalCode::Malformed);
        EXPECT_THAT(refused.refusal().message, AllOf(StartsWith("config/ports.cfg:2: '"),
                                                     HasSubstr("expected a line KEY = VALUE; fix: ")));
    }
}

TEST(SettingsFile, DoesNotRepeatWhatMayBeAPassword) {
    EXPECT_THAT(parseSettings("Axon.Password secret1", "f").refusal().message,
                AllOf(HasSubstr("'Axon.Password'"), testing::Not(HasSubstr("secret1"))));
    for (const char* line : {"Axon.Password:secret1", "=secret1", "\x1b[2Jsecret1"})
        EXPECT_THAT(parseSettings(line, "f").refusal().message, testing::Not(HasSubstr("secret1"))) << line;
    EXPECT_THAT(parseSettings(std::string(5000, 'x'), "f").refusal().message,
                AllOf(HasSubstr("'xxx"), testing::SizeIs(testing::Lt(300))));
}

TEST(SettingsFile, AFileThatCannotBeReadIsRefusedWithItsName) {
    for (const char* file : {"/nonexistent/ports.cfg", "/tmp", "/dev/zero"}) {
        const auto refused = readSettings(file);
        ASSERT_FALSE(refused.ok()) << file;
        EXPECT_EQ(refused.refusal().code, RefusalCode::BadName);
        EXPECT_THAT(
            refused.refusal().message,
            AllOf(StartsWith(file), HasSubstr(": cannot be read; expected a file"), HasSubstr("fix: ")));
    }
    std::string name = std::filesystem::temp_directory_path() / "axon-settings-XXXXXX";
    Descriptor(::mkstemp(name.data())).reset();
    std::ofstream(name) << "a = b\n";
    EXPECT_THAT(readSettings(name).value(), ElementsAre(is("a", "b", name + ":1")));
    std::filesystem::remove(name);
}

}  // namespace
}  // namespace axon
