// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/peoplebot/settings.hpp"

#include <gtest/gtest.h>

namespace axon::peoplebot {
namespace {

TEST(PeopleBotSettings, APoseIsReadAndMistakesAreNamed) {
    EXPECT_EQ(parsePose("1500,-2,90.5").heading_deg, 90.5);
    for (const char* text : {"", "1", "1,2", "1,2,3,4", "1,2,x", "nan,0,0"})
        EXPECT_THROW(parsePose(text), BadSetting) << text;
}

TEST(PeopleBotSettings, RulesOfTheProfilesFolderComeBeforeTheInstalledOnes) {
    Settings settings;
    settings.profiles = "robots/peoplebot";
    EXPECT_EQ(rulesFile(settings, "wander.rules"), "robots/peoplebot/wander.rules");
    EXPECT_THROW(rulesFile(settings, "nobody.rules"), BadSetting);
}

}  // namespace
}  // namespace axon::peoplebot
