// SPDX-License-Identifier: GPL-2.0-or-later
#include <gtest/gtest.h>

#include <algorithm>
#include <fstream>
#include <map>
#include <set>
#include <sstream>

#include "messages/profile_reader.hpp"
#include "messages/values.hpp"
#include "robots/peoplebot/motion.hpp"
#include "robots/peoplebot/navigation.hpp"
#include "robots/peoplebot/settings.hpp"
#include "robots/peoplebot/wander.hpp"

namespace axon::peoplebot {
namespace {

std::string textOf(const std::string& path) {
    std::ostringstream content;
    content << std::ifstream(path).rdbuf();
    return content.str();
}
std::string contentOf(const std::string& name) {
    return textOf("robots/peoplebot/" + name);
}

TEST(PeopleBotProfiles, AreReadWithoutAnyFinding) {
    for (const char* name : {"basic_profile.xml", "services_profile.xml"}) {
        const auto check = checkProfileFile(std::string("robots/peoplebot/") + name);
        EXPECT_TRUE(check.readable);
        for (const auto& finding : check.findings) ADD_FAILURE() << finding.toString();
    }
}

TEST(PeopleBotProfiles, ARenamedProfileIsTheSameProfileWithAnotherName) {
    const auto before = readBasicProfile(contentOf("basic_profile.xml"), "before");
    const auto after =
        readBasicProfile(robots::withEntityName(contentOf("basic_profile.xml"), "left & <Client2>"), "after");
    ASSERT_TRUE(after.ok());
    EXPECT_EQ(after.message.name(), "left & <Client2>");
    EXPECT_EQ(after.message.descr(), before.message.descr());
}

/// The names of a service's parameters of this type.
std::set<std::string> namesOf(const proto::Service& service, proto::ParamType type) {
    std::set<std::string> names;
    for (const auto& param : service.params())
        if (param.type() == type) names.insert(param.name());
    return names;
}

/// Thesis 4.1.2: what it names as inputs is INPUT, and what else may be chosen is CONFIG.
TEST(PeopleBotProfiles, InputsAreThoseOfTheThesisAndTheRestIsConfiguration) {
    const auto profile = readServicesProfile(contentOf("services_profile.xml"), "services");
    using Names = std::set<std::string>;
    const std::map<std::string, std::pair<Names, Names>> expected{
        {"Driving", {{"Distance", "Velocity", "Range Threshold"}, {"Speed Limit"}}},
        {"Turning", {{"Angle", "Velocity"}, {"Speed Limit"}}},
        {"Patrol", {{"Angle"}, {}}},
        {"Wander", {{"Duration"}, {"Velocity"}}},
        {"Navigation", {{"Destination", "Start"}, {"Velocity", "Tolerance"}}},
        {"Navigation to a Zone", {{"Destination"}, {}}},
        {"Operate Gripper", {{"Direction", "Open/Close"}, {}}},
        {"Gripper", {{"Direction", "Open/Close"}, {}}},
        {"Table Object Tracking and Grabbing",
         {{"Color"}, {"Table Height", "Back Off", "Velocity", "Range Threshold"}}},
        {"Approach Table", {{"Distance", "Reach"}, {"Velocity", "Range Threshold"}}}};
    ASSERT_EQ(static_cast<std::size_t>(profile.message.services_size()), expected.size());
    for (const auto& service : profile.message.services()) {
        const auto& [inputs, configuration] = expected.at(service.name());
        EXPECT_EQ(namesOf(service, proto::INPUT), inputs) << service.name();
        EXPECT_EQ(namesOf(service, proto::CONFIG), configuration) << service.name();
        for (const auto& param : service.params()) {
            EXPECT_TRUE(param.ready() || param.type() != proto::CONFIG) << param.name();
            EXPECT_TRUE(!param.units().empty() || param.type() != proto::FEEDBACK) << param.name();
        }
    }
    EXPECT_EQ(namesOf(profile.message.services(0), proto::FEEDBACK), (Names{"Speed", "Remaining"}));
}

TEST(PeopleBotProfiles, WhatTheServicesProfileAllowsTheMotionsDo) {
    const auto profile = readServicesProfile(contentOf("services_profile.xml"), "services");
    ASSERT_GE(profile.message.services_size(), 5);
    const auto& driving = profile.message.services(0);
    EXPECT_EQ(driving.global_id(), "Drive");
    EXPECT_TRUE(driving.is_pausable());
    EXPECT_TRUE(driving.is_blocking());
    Driving::Request request;
    for (const auto& param : driving.params()) {
        if (param.name() == "Velocity") {
            EXPECT_EQ(param.maximum(), Driving::kFastest_mm_s);
            EXPECT_EQ(param.minimum(), -Driving::kFastest_mm_s);
            EXPECT_EQ(param.initial(0).dbl(), request.velocity_mm_s);
        }
        if (param.name() == "Speed Limit") {
            EXPECT_EQ(param.minimum(), Driving::kSlowest_mm_s);
            EXPECT_EQ(param.maximum(), Driving::kFastest_mm_s);
            EXPECT_EQ(param.initial(0).dbl(), request.speed_limit_mm_s);
        }
        if (param.name() == "Range Threshold") {
            EXPECT_EQ(param.initial(0).dbl(), request.range_threshold_mm);
            EXPECT_LT(param.maximum(), arcos::kNoEcho_mm);
        }
        EXPECT_EQ(param.required(), param.name() == "Distance");
    }
    const auto& turning = profile.message.services(1);
    EXPECT_EQ(turning.global_id(), "Turn");
    for (const auto& param : turning.params()) {
        if (param.name() != "Velocity" && param.name() != "Speed Limit") continue;
        EXPECT_EQ(param.maximum(), Turning::kFastest_deg_s);
        EXPECT_EQ(param.minimum(), Turning::kSlowest_deg_s);
        EXPECT_EQ(param.initial(0).dbl(), param.name() == "Velocity" ? Turning::Request{}.velocity_deg_s
                                                                     : Turning::Request{}.speed_limit_deg_s);
    }
    for (const auto& service : profile.message.services()) {
        if (service.name() != "Wander" && service.name() != "Navigation") continue;
        const bool wander = service.name() == "Wander";
        EXPECT_EQ(service.global_id(), wander ? "peoplebot_wander" : "cruiser_dest");
        for (const auto& param : service.params()) {
            if (param.name() == "Velocity") {
                EXPECT_EQ(param.minimum(), wander ? Wander::kSlowest_mm_s : Navigation::kSlowest_mm_s);
                EXPECT_EQ(param.maximum(), wander ? Wander::kFastest_mm_s : Navigation::kFastest_mm_s);
                EXPECT_EQ(param.initial(0).dbl(),
                          wander ? Wander::Request{}.velocity_mm_s : Navigation::Request{}.velocity_mm_s);
            }
            if (param.name() == "Tolerance") {
                EXPECT_EQ(param.initial(0).dbl(), Navigation::Request{}.tolerance_mm);
            }
            EXPECT_EQ(param.required(), param.name() == "Destination") << param.name();
        }
        EXPECT_EQ(service.resources_size(), wander ? 0 : 1);
    }
}

TEST(PeopleBotProfiles, FigureA1OfTheThesisFindsItsServicesHereAndAtTheArm) {
    const auto figure = readGlobalProfile(textOf("api/schema/samples/valid/figure_a_1.xml"), "figure");
    const auto mobile = readServicesProfile(contentOf("services_profile.xml"), "mobile");
    const auto arm = readServicesProfile(textOf("robots/cyton/services_profile.xml"), "arm");
    ASSERT_EQ(figure.message.services_size(), 2);
    for (const auto& service : figure.message.services()) {
        for (const auto& step : service.steps()) {
            const auto& offered = (step.type() == proto::MOBILE ? mobile : arm).message.services();
            const auto found = std::find_if(offered.begin(), offered.end(), [&](const auto& one) {
                return one.global_id() == step.service_global_id();
            });
            ASSERT_NE(found, offered.end()) << step.service_global_id();
            for (const auto& given : step.params()) {
                const auto meta = std::find_if(found->params().begin(), found->params().end(),
                                               [&](const auto& one) { return one.name() == given.name(); });
                ASSERT_NE(meta, found->params().end()) << step.service_global_id() << ": " << given.name();
                EXPECT_TRUE(parseParam(*meta, given.values(0).str()))
                    << step.service_global_id() << ": " << given.name();
            }
        }
    }
}

}  // namespace
}  // namespace axon::peoplebot
