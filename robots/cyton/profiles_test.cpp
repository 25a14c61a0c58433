// SPDX-License-Identifier: GPL-2.0-or-later
#include <gtest/gtest.h>

#include <fstream>
#include <sstream>

#include "messages/profile_reader.hpp"
#include "robots/cyton/pick_and_place.hpp"
#include "robots/cyton/settings.hpp"

namespace axon::cyton {
namespace {

std::string contentOf(const std::string& name) {
    std::ostringstream content;
    content << std::ifstream("robots/cyton/" + name).rdbuf();
    return content.str();
}

TEST(CytonProfiles, AreReadWithoutAnyFinding) {
    for (const char* name : {"basic_profile.xml", "services_profile.xml"}) {
        const auto check = checkProfileFile(std::string("robots/cyton/") + name);
        EXPECT_TRUE(check.readable);
        for (const auto& finding : check.findings) ADD_FAILURE() << finding.toString();
    }
}

TEST(CytonProfiles, ARenamedProfileIsTheSameProfileWithAnotherName) {
    const auto before = readBasicProfile(contentOf("basic_profile.xml"), "before");
    const auto after =
        readBasicProfile(robots::withEntityName(contentOf("basic_profile.xml"), "left & <Cyton2>"), "after");
    ASSERT_TRUE(after.ok());
    EXPECT_EQ(after.message.name(), "left & <Cyton2>");
    EXPECT_EQ(after.message.descr(), before.message.descr());
}

TEST(CytonProfiles, WhatTheServicesProfileAllowsTheArmDoes) {
    const auto profile = readServicesProfile(contentOf("services_profile.xml"), "services");
    ASSERT_EQ(profile.message.services_size(), 3);
    EXPECT_EQ(profile.message.services(0).global_id(), "cyton_reach");
    EXPECT_EQ(profile.message.services(1).global_id(), "cyton_control");
    EXPECT_EQ(profile.message.services(2).global_id(), "cyton_pick");
    for (const auto& service : profile.message.services()) {
        EXPECT_TRUE(service.is_pausable()) << service.name();
        EXPECT_TRUE(service.is_blocking()) << service.name();
    }
    std::size_t joints = 0;
    for (const auto& param : profile.message.services(1).params()) {
        for (const auto& joint : kChain) {
            if (param.name() != joint.name) continue;
            ++joints;
            EXPECT_NEAR(param.minimum(), degrees(joint.minimum), 0.01) << joint.name;
            EXPECT_NEAR(param.maximum(), degrees(joint.maximum), 0.01) << joint.name;
            EXPECT_EQ(param.initial_size(), 0) << "a joint that is not given stays";
        }
        if (param.name() == "Gripper") {
            EXPECT_GE(param.minimum(), gripper::kClosed_mm);
            EXPECT_LE(param.maximum(), gripper::kOpen_mm);
        }
    }
    EXPECT_EQ(joints, kJoints);
}

/// Thesis 4.2.2: the inputs of Control are angles, and Reach Demo has none.
TEST(CytonProfiles, TheSpeedIsConfigurationAndTheAnglesAreFeedback) {
    const auto profile = readServicesProfile(contentOf("services_profile.xml"), "services");
    for (const auto& service : profile.message.services()) {
        std::map<proto::ParamType, std::vector<std::string>> names;
        for (const auto& param : service.params()) names[param.type()].push_back(param.name());
        EXPECT_EQ(names[proto::CONFIG], std::vector<std::string>{"Speed"}) << service.name();
        EXPECT_EQ(names[proto::FEEDBACK].back(), "Angles") << service.name();
        EXPECT_EQ(service.params(service.params_size() - 1).units(), "deg");
        EXPECT_EQ(names[proto::INPUT].empty(), service.name() == "Reach Demo");
    }
}

TEST(CytonProfiles, TheDefaultsOfGrabAndPlaceAreThePlannersOwn) {
    const auto profile = readServicesProfile(contentOf("services_profile.xml"), "services");
    const PickAndPlaceRequest request;
    const std::map<std::string, double> expected{
        {"Pick X", request.pick[0] * 1000},     {"Pick Y", request.pick[1] * 1000},
        {"Pick Z", request.pick[2] * 1000},     {"Place X", request.place[0] * 1000},
        {"Place Y", request.place[1] * 1000},   {"Place Z", request.place[2] * 1000},
        {"Object Width", request.width * 1000}, {"Object Height", request.height * 1000},
        {"Speed", request.speed * 100}};
    std::size_t seen = 0;
    for (const auto& param : profile.message.services(2).params()) {
        if (param.name() == "Object Width") {
            EXPECT_EQ(param.maximum(), PickAndPlaceRequest::kWidest * 1000);
        }
        const auto found = expected.find(param.name());
        if (found == expected.end()) continue;
        ++seen;
        EXPECT_NEAR(param.initial(0).dbl(), found->second, 1e-9) << param.name();
    }
    EXPECT_EQ(seen, expected.size());
}

TEST(CytonSettings, APlaceIsReadOrRefusedAndALineGetsASpeed) {
    EXPECT_EQ(parsePlace("600,-20.5,700"), (std::array<double, 3>{600, -20.5, 700}));
    for (const char* wrong : {"", "1,2", "1,2,3,4", "a,b,c", "1,2,nan"})
        EXPECT_THROW(parsePlace(wrong), BadSetting) << wrong;
    EXPECT_EQ(withSpeed("/dev/ttyUSB0"), "/dev/ttyUSB0:115200");
    EXPECT_EQ(withSpeed("/dev/ttyUSB0:38400"), "/dev/ttyUSB0:38400");
    EXPECT_EQ(withSpeed("127.0.0.1:8201"), "127.0.0.1:8201");
}

}  // namespace
}  // namespace axon::cyton
