// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/common/robot_settings.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "robots/common/robot_entity.hpp"

namespace axon::robots {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::ThrowsMessage;

TEST(RobotSettings, ARangeOfPortsIsReadAndMistakesAreNamed) {
    EXPECT_EQ(parsePortRange("5500-5600"), (std::pair<std::uint16_t, std::uint16_t>(5500, 5600)));
    for (const char* text : {"", "5500", "5600-5500", "a-b", "5500-99999", "nothing.cfg"})
        EXPECT_THROW(parsePortRange(text), BadSetting) << text;
}

TEST(RobotSettings, ThreeNumbersAreReadOrRefusedWithWhatWasExpected) {
    EXPECT_THAT(parseThreeNumbers("600,-20.5,700", "--at", "X,Y,Z"), ElementsAre(600, -20.5, 700));
    for (const char* wrong : {"", "1", "1,2", "1,2,3,4", "a,b,c", "1,2,nan", "1,,3"})
        EXPECT_THROW(parseThreeNumbers(wrong, "--at", "X,Y,Z"), BadSetting) << wrong;
    EXPECT_THAT([] { parseThreeNumbers("1,2", "--at", "X,Y,Z in mm"); },
                ThrowsMessage<BadSetting>("--at 1,2: expected X,Y,Z in mm"));
}

TEST(RobotSettings, ANameReplacesOnlyTheNameOfTheRoot) {
    EXPECT_EQ(
        withEntityName("<!-- name=\"x\" --><BasicProfile  descr='d' name = \"PeopleBot\"\n type=\"MOBILE\"/>",
                       "A & \"B\""),
        "<!-- name=\"x\" --><BasicProfile  descr='d' name = \"A &amp; &quot;B&quot;\"\n type=\"MOBILE\"/>");
    for (const char* bad :
         {"", "<BasicProfile/>", "<BasicProfile", "<BasicProfile name",
          "<BasicProfile name=", "<BasicProfile name=x>", "<BasicProfile name=\"x",
          "<BasicProfile type=\"name\"/>", "<!-- <BasicProfile name='x'/>", "<Other name='x'/>"}) {
        EXPECT_THROW(withEntityName(bad, "A"), BadSetting) << bad;
    }
    EXPECT_EQ(withEntityName("<!-- <BasicProfile name='x'/> --><BasicProfile name='y'>", "z"),
              "<!-- <BasicProfile name='x'/> --><BasicProfile name=\"z\">");
    EXPECT_EQ(withEntityName("<BasicProfile name='$1'/>", "$2"), "<BasicProfile name=\"$2\"/>");
}

TEST(RobotSettings, AFolderWithoutProfilesIsRefused) {
    RobotSettings settings("blimp");
    settings.profiles = "/nonexistent";
    EXPECT_THAT([&] { profileFolder(settings); },
                ThrowsMessage<BadSetting>(HasSubstr("say with --profiles where the two profiles lie")));
    settings.profiles.clear();
    EXPECT_THAT([&] { profileFolder(settings); },
                ThrowsMessage<BadSetting>(HasSubstr("share/axon/robots/blimp")));
}

TEST(RobotSettings, TheTemporaryFileGoesWithItsObject) {
    std::filesystem::path path;
    {
        const TemporaryFile file("<x/>");
        path = file.path();
        EXPECT_EQ(contentOf(path), "<x/>");
    }
    EXPECT_FALSE(std::filesystem::exists(path));
    EXPECT_EQ(contentOf(path), "");
}

TEST(RobotSettings, PortsAreAFileWhereThereIsOneElseARange) {
    RobotSettings settings("blimp");
    settings.ports = "5500-5600";
    const auto range = interfacerOptions(settings, nullptr);
    EXPECT_EQ(range.application, "blimp");
    EXPECT_EQ(range.first_port, 5500);
    EXPECT_EQ(range.last_port, 5600);
    const TemporaryFile file("5500\n");
    settings.ports = file.path();
    EXPECT_EQ(interfacerOptions(settings, nullptr).ports_file, file.path());
    settings.ports = "nothing.cfg";
    EXPECT_THROW(interfacerOptions(settings, nullptr), BadSetting);
}

}  // namespace
}  // namespace axon::robots
