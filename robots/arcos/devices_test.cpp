// SPDX-License-Identifier: GPL-2.0-or-later
// Gripper, laser and camera: what both sides of the wire agree on.
#include <gtest/gtest.h>

#include "robots/arcos/gripper.hpp"
#include "robots/arcos/laser.hpp"
#include "robots/arcos/vcc4.hpp"

namespace axon::arcos {
namespace {

TEST(GripperSwitches, LimitsAndPaddlesAreActiveLowBeamsAndMotionActiveHigh) {
    EXPECT_EQ(toByte(GripperSwitches{}), 0b00110011);
    EXPECT_EQ(toByte(GripperSwitches{.paddles_open = true, .inner_beam_broken = true}), 0b00111010);
    for (int byte = 0; byte < 256; ++byte) {
        EXPECT_EQ(toByte(parseGripperSwitches(static_cast<std::uint8_t>(byte))), byte);
        EXPECT_EQ(toByte(parseGripState(static_cast<std::uint8_t>(byte))), byte);
    }
}

TEST(GripperPacket, IsThreeBytes) {
    const GripperPacket gripper{GripperPacket::kGeneralIo, {.left_paddle_pressed = true}, 10};
    const auto packet = toPacket(gripper);
    EXPECT_EQ(packet, (Packet{0xE0, {2, 0b00100011, 10}}));
    EXPECT_EQ(parseGripperPacket(packet), gripper);
    EXPECT_FALSE(parseGripperPacket({0xE0, {2, 0}}));
    EXPECT_FALSE(parseGripperPacket({0xE1, {2, 0, 0}}));
}

TEST(LaserPacket, BothKindsComeBackAsTheyWent) {
    LaserPacket laser{
        .x = 10, .y = 20, .theta = -90, .total = 181, .first = 32, .readings = {{1000, 0}, {32767, 0}}};
    EXPECT_EQ(toPacket(laser).data.size(), 3 * 2 + 2 * 2 + 1 + 2 * 2U);
    EXPECT_EQ(parseLaserPacket(toPacket(laser)), laser);
    const LaserPacket extended{.extended = true, .total = 2, .first = 0, .readings = {{1, 7}, {2, 0}}};
    EXPECT_EQ(toPacket(extended).data, (Bytes{2, 0, 0, 0, 2, 1, 0, 7, 0, 0, 2, 0, 0, 0, 0, 0, 0}));
    EXPECT_EQ(parseLaserPacket(toPacket(extended)), extended);
}

TEST(LaserPacket, WhatDoesNotFitIsRefused) {
    EXPECT_FALSE(parseLaserPacket({0x60, {1, 0, 1, 0, 0, 0, 181, 0, 0, 0, 2, 1, 1}}));
    EXPECT_FALSE(parseLaserPacket({0x61, {1, 0, 1, 0, 1, 1, 0, 7, 0, 0}}));
    EXPECT_FALSE(parseLaserPacket({0x62, {}}));
}

TEST(LaserScanAssembler, GivesWholeScansOnly) {
    LaserScanAssembler scan;
    const auto packet = [](std::uint16_t first, std::size_t count) {
        return LaserPacket{.total = 40, .first = first, .readings = std::vector<LaserPacket::Reading>(count)};
    };
    EXPECT_FALSE(scan.add(packet(0, 32)));
    const auto whole = scan.add(packet(32, 8));
    ASSERT_TRUE(whole);
    EXPECT_EQ(whole->size(), 40U);
    EXPECT_FALSE(scan.add(packet(32, 8)));
    EXPECT_FALSE(scan.add(packet(0, 32)));
    EXPECT_FALSE(scan.add(packet(0, 32)));
    EXPECT_TRUE(scan.add(packet(32, 8)));
    EXPECT_EQ(scan.dropped(), 1U);
}

TEST(Vcc4, PanTiltIsEightHexadecimalDigitsWithTheCamerasSign) {
    // 10 degrees to the left and 5 down: the camera's pan is -89 units, its tilt -44.
    const auto text = vcc4::panTilt({10, -5});
    EXPECT_EQ(text, std::string("\xFF"
                                "00\0\x62"
                                "7FA77FD4\xEF",
                                14));
    vcc4::RequestReader reader;
    EXPECT_TRUE(reader.feed("noise").empty());
    EXPECT_TRUE(reader.feed(text.substr(0, 5)).empty());
    const auto requests = reader.feed(text.substr(5) + vcc4::stop());
    ASSERT_EQ(requests.size(), 2U);
    EXPECT_EQ(requests[0].code, vcc4::Code::PanTilt);
    const auto to = vcc4::parsePanTilt(requests[0].parameters);
    ASSERT_TRUE(to);
    EXPECT_NEAR(to->pan_left_deg, 10, 0.06);
    EXPECT_NEAR(to->tilt_up_deg, -5, 0.06);
    EXPECT_EQ(requests[1].code, vcc4::Code::Stop);
}

TEST(Vcc4, LimitsAreClampedByTheClientAndRefusedByTheCamera) {
    vcc4::RequestReader reader;
    const auto requests = reader.feed(vcc4::panTilt({-200, 100}));
    ASSERT_EQ(requests.size(), 1U);
    const auto to = vcc4::parsePanTilt(requests[0].parameters);
    ASSERT_TRUE(to);
    EXPECT_NEAR(to->pan_left_deg, -98, 0.06);
    EXPECT_NEAR(to->tilt_up_deg, 88, 0.06);
    EXPECT_FALSE(vcc4::parsePanTilt("90007FD4"));
    EXPECT_FALSE(vcc4::parsePanTilt("80008"));
    EXPECT_FALSE(vcc4::parsePanTilt("8000-001"));
}

TEST(Vcc4, AnAnswerTellsWhereTheCameraLooks) {
    const auto at = vcc4::parsePanTiltAnswer(vcc4::answerPanTilt({-45, 30}));
    ASSERT_TRUE(at);
    EXPECT_NEAR(at->pan_left_deg, -45, 0.06);
    EXPECT_FALSE(vcc4::parsePanTiltAnswer(vcc4::answer(vcc4::Error::Busy)));
    EXPECT_EQ(vcc4::answer(vcc4::Error::None),
              "\xFE"
              "0000\xEF");
    EXPECT_NEAR(vcc4::viewAt(0), 45, 1e-9);
    EXPECT_NEAR(vcc4::viewAt(1960), 1.97, 1e-9);
}

TEST(Vcc4, ACommandWithoutAnEndDoesNotSwallowTheNext) {
    vcc4::RequestReader reader;
    EXPECT_TRUE(reader
                    .feed(std::string("\xFF"
                                      "00\0\x62",
                                      5))
                    .empty());
    EXPECT_EQ(reader.feed(vcc4::power(true)).size(), 1U);
    EXPECT_TRUE(reader.feed("\xFF" + std::string(100, '0') + "\xEF").empty());
}

}  // namespace
}  // namespace axon::arcos
