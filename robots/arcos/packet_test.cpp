// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/arcos/packet.hpp"

#include <gtest/gtest.h>

#include "common/ids.hpp"
#include "robots/arcos/server_information.hpp"

namespace axon::arcos {
namespace {

using std::chrono::milliseconds;

const TimePoint kStart{std::chrono::seconds{1000}};

Bytes concatenate(std::initializer_list<Bytes> parts) {
    Bytes all;
    for (const auto& part : parts) all.insert(all.end(), part.begin(), part.end());
    return all;
}

TEST(ArcosPacket, HandshakeBytesAreThoseOfTheManual) {
    EXPECT_EQ(encodeCommand(Command::Pulse), (Bytes{0xFA, 0xFB, 3, 0, 0, 0}));
    EXPECT_EQ(encodeCommand(Command::Open), (Bytes{0xFA, 0xFB, 3, 1, 0, 1}));
    EXPECT_EQ(encodeCommand(Command::Close), (Bytes{0xFA, 0xFB, 3, 2, 0, 2}));
    // ENABLE 1: 0x043B + 0x0100 = 0x053B.
    EXPECT_EQ(encodeCommand(Command::Enable, 1), (Bytes{0xFA, 0xFB, 6, 4, 0x3B, 1, 0, 0x05, 0x3B}));
}

TEST(ArcosPacket, ChecksumAddsPairsAndXorsTheOddByte) {
    EXPECT_EQ(checksum(Bytes{0xFF, 0xFF, 0x00, 0x02}), 0x0001);
    EXPECT_EQ(checksum(Bytes{0x01, 0x02, 0xF0}), 0x0102 ^ 0xF0);
    EXPECT_EQ(checksum(Bytes{}), 0);
}

TEST(ArcosPacket, NegativeArgumentsTravelAsMagnitudeAndComeBack) {
    PacketReader reader;
    for (const int value : {0, 1, -1, 300, -300, 32767, -32767}) {
        const auto packets = reader.feed(encodeCommand(Command::Vel, value), kStart);
        ASSERT_EQ(packets.size(), 1U);
        const auto argument = parseArgument(packets[0]);
        EXPECT_EQ(argument.kind, Argument::Kind::Integer);
        EXPECT_EQ(argument.value, value);
    }
    const auto text = reader.feed(encodeCommand(Command::DigOut, "on"), kStart);
    EXPECT_EQ(parseArgument(text.at(0)).text, "on");
}

TEST(ArcosPacket, TheTwoBytesOfAnArgumentComeBackFromSignAndMagnitude) {
    // Two bytes in one argument are sent as what they are as an integer: from 0x8000 on a negative one.
    const auto arrived = [](std::uint8_t type, int magnitude) {
        return parseArgument({30, FieldWriter().u8(type).u16(magnitude).take()});
    };
    EXPECT_EQ(arrived(0x3B, 0x0A05).raw, 0x0A05);
    EXPECT_EQ(arrived(0x1B, 0x7FFF).raw, 0x8001);
    EXPECT_EQ(arrived(0x1B, 0x0100).raw, 0xFF00);
    EXPECT_EQ(arrived(0x1B, 1).raw, 0xFFFF);
    EXPECT_EQ(arrived(0x1B, 0x8000).raw, 0x8000);
    EXPECT_EQ(arrived(0x1B, 0x8000).value, -0x8000);
    // Of a client that does not know the sign.
    EXPECT_EQ(arrived(0x3B, 0xF605).raw, 0xF605);
    PacketReader reader;
    const auto lowest = reader.feed(encodeCommand(Command::Vel2, -0x8000), kStart);
    EXPECT_EQ(parseArgument(lowest.at(0)).raw, 0x8000);
}

TEST(ArcosPacket, ShortOrForeignArgumentsAreMalformed) {
    EXPECT_EQ(parseArgument({11, {}}).kind, Argument::Kind::None);
    EXPECT_EQ(parseArgument({11, {0x3B}}).kind, Argument::Kind::Malformed);
    EXPECT_EQ(parseArgument({11, {0x3B, 1}}).kind, Argument::Kind::Malformed);
    EXPECT_EQ(parseArgument({11, {0x55, 1, 0}}).kind, Argument::Kind::Malformed);
    EXPECT_EQ(parseArgument({11, {0x2B, 9, 'a'}}).kind, Argument::Kind::Malformed);
}

TEST(ArcosPacketReader, FindsPacketsHoweverTheBytesAreCut) {
    const auto wire = concatenate({encodeCommand(Command::Vel, 200), encodeCommand(Command::Pulse)});
    for (std::size_t cut = 0; cut <= wire.size(); ++cut) {
        PacketReader reader;
        auto packets = reader.feed(std::span(wire).first(cut), kStart);
        for (auto& packet : reader.feed(std::span(wire).subspan(cut), kStart)) packets.push_back(packet);
        ASSERT_EQ(packets.size(), 2U) << "cut at " << cut;
        EXPECT_EQ(packets[0].id, 11);
        EXPECT_EQ(packets[1].id, 0);
    }
}

TEST(ArcosPacketReader, IgnoresAndCountsBadChecksums) {
    PacketReader reader;
    auto damaged = encodeCommand(Command::Vel, 200);
    damaged[5] ^= 0x40U;
    const auto packets = reader.feed(concatenate({damaged, encodeCommand(Command::Stop)}), kStart);
    ASSERT_EQ(packets.size(), 1U);
    EXPECT_EQ(packets[0].id, static_cast<std::uint8_t>(Command::Stop));
    EXPECT_EQ(reader.badChecksums(), 1U);
}

TEST(ArcosPacketReader, SkipsGarbageAndFalseStarts) {
    PacketReader reader;
    const auto packets = reader.feed(
        concatenate({{0, 0xFB, 0xFA, 0xFA, 0xFB, 2, 7}, encodeCommand(Command::Open), {0xFA}}), kStart);
    ASSERT_EQ(packets.size(), 1U);
    EXPECT_EQ(packets[0].id, 1);
    const auto close = encodeCommand(Command::Close);
    EXPECT_EQ(reader.feed(std::span(close).subspan(1), kStart).size(), 1U);
}

TEST(ArcosPacketReader, ADamagedLengthHidesNothingForLongerThanItsBytes) {
    PacketReader reader;
    auto long_packet = encodeCommand(Command::Vel, 1);
    long_packet[2] = 20;  // claims bytes of the packets that follow
    const auto stop = encodeCommand(Command::Stop);
    auto packets = reader.feed(concatenate({long_packet, stop}), kStart);
    EXPECT_TRUE(packets.empty());
    packets = reader.feed(concatenate({stop, stop}), kStart);
    EXPECT_EQ(packets.size(), 3U);
}

TEST(ArcosPacketReader, ACountThatNoPacketHasIsAFalseStartAndHidesNothing) {
    PacketReader reader;
    EXPECT_TRUE(reader.feed(Bytes{0xFA, 0xFB, 0xFF}, kStart).empty());
    const auto packets = reader.feed(encodeCommand(Command::EStop), kStart);
    ASSERT_EQ(packets.size(), 1U);
    EXPECT_EQ(packets[0].id, static_cast<std::uint8_t>(Command::EStop));
    EXPECT_EQ(
        reader.feed(concatenate({{0xFA, 0xFB, kMaximumCount + 1}, encodeCommand(Command::Stop)}), kStart)
            .size(),
        1U);
}

TEST(ArcosPacketReader, TheLongestPacketIsRead) {
    PacketReader reader;
    const Packet longest{kConfigPacket, Bytes(kMaximumData, 7)};
    const auto wire = encode(longest);
    EXPECT_EQ(wire[2], kMaximumCount);
    EXPECT_EQ(reader.feed(wire, kStart), std::vector{longest});
}

TEST(ArcosPacketReader, WhatFollowsAFalseStartIsReadWhenItsTimeIsUp) {
    PacketReader reader;
    Bytes wire{0xFA, 0xFB, 0xC8};  // claims 200 bytes
    const auto e_stop = encodeCommand(Command::EStop);
    wire.insert(wire.end(), e_stop.begin(), e_stop.end());
    EXPECT_TRUE(reader.feed(wire, kStart).empty());
    // Others keep coming: the time counts from the false start, not from the newest byte.
    auto now = kStart;
    std::size_t pulses = 0;
    std::vector<Packet> packets;
    while (packets.empty() && now < kStart + 2 * PacketReader::kPartialTimeout) {
        packets = reader.feed(encodeCommand(Command::Pulse), now += milliseconds{60});
        ++pulses;
    }
    EXPECT_LE(now, kStart + PacketReader::kPartialTimeout + milliseconds{60});
    ASSERT_EQ(packets.size(), 1 + pulses);
    EXPECT_EQ(packets[0].id, static_cast<std::uint8_t>(Command::EStop));
}

TEST(ArcosPacketReader, WhatFollowsAFalseStartIsReadWithoutFurtherBytes) {
    PacketReader reader;
    Bytes wire{0xFA, 0xFB, 0xC8};
    const auto e_stop = encodeCommand(Command::EStop);
    wire.insert(wire.end(), e_stop.begin(), e_stop.end());
    EXPECT_TRUE(reader.feed(wire, kStart).empty());
    EXPECT_TRUE(reader.feed({}, kStart + PacketReader::kPartialTimeout).empty());
    EXPECT_EQ(reader.feed({}, kStart + PacketReader::kPartialTimeout + milliseconds{1}).size(), 1U);
}

TEST(ArcosPacketReader, GivesUpAPacketWhoseRestDoesNotCome) {
    PacketReader reader;
    EXPECT_TRUE(reader.feed(Bytes{0xFA, 0xFB, 0xC8, 1, 2}, kStart).empty());
    const auto later = kStart + PacketReader::kPartialTimeout + milliseconds{1};
    EXPECT_EQ(reader.feed(encodeCommand(Command::Stop), later).size(), 1U);
}

TEST(ArcosPacketReader, SurvivesRandomBytesAndStaysSmall) {
    SeededRandom random(42);
    PacketReader reader;
    for (int i = 0; i < 2000; ++i) {
        Bytes noise(random.next() % 64);
        random.fill(noise.data(), noise.size());
        if (i % 3 == 0) noise.insert(noise.begin(), {0xFA, 0xFB});
        for (const auto& packet : reader.feed(noise, kStart)) {
            parseServerInformation(packet);
            parseRobotConfig(packet);
            parseInputsOutputs(packet);
            parseArgument(packet);
        }
    }
    Bytes quiet(300, 0);
    reader.feed(quiet, kStart);
    EXPECT_EQ(reader.feed(encodeCommand(Command::Stop), kStart).size(), 1U);
}

ServerInformation sampleInformation() {
    ServerInformation sip;
    sip.moving = true;
    sip.x = 0x1234;
    sip.y = 0x7FFF;
    sip.theta = -700;
    sip.left_mm_s = -200;
    sip.right_mm_s = 210;
    sip.battery_dv = 127;
    sip.right_stall = true;
    sip.front_bumpers = 0b10001;
    sip.rear_bumpers = 0b00100;
    sip.flags = ServerInformation::kMotorsOn | ServerInformation::kFirstSonarArrayOn;
    sip.sonars = {{0, 5000}, {17, 412}};
    sip.digital_in = 0x0E;
    sip.battery_x10 = 127;
    sip.rotation_tenth_deg_s = -123;
    sip.temperature_c = -5;
    sip.state_of_charge = 80;
    return sip;
}

TEST(ServerInformationPacket, HasTheLayoutOfTheManual) {
    const auto packet = toPacket(sampleInformation());
    EXPECT_EQ(packet.id, kMovingPacket);
    const Bytes head(packet.data.begin(), packet.data.begin() + 24);
    EXPECT_EQ(head, (Bytes{0x34,       0x12,       0xFF, 0x7F, 0x44, 0xFD, 0x38, 0xFF, 210,  0,  127,
                           0b00001000, 0b00100011,  // rear bumpers low, front bumpers high, stalls in bit 0
                           0,          0,          3,    0,    0,    2,    0,    0x88, 0x13, 17, 0x9C}));
    EXPECT_EQ(packet.data.size(), 19U + 2 * 3 + 16);
}

TEST(ServerInformationPacket, ComesBackAsItWasSent) {
    EXPECT_EQ(parseServerInformation(toPacket(sampleInformation())), sampleInformation());
}

TEST(ServerInformationPacket, EveryTruncationIsRefusedOrEndsAtAFieldOfOldFirmware) {
    const auto whole = toPacket(sampleInformation());
    for (std::size_t length = 0; length < whole.data.size(); ++length) {
        const Packet cut{whole.id, Bytes(whole.data.begin(), whole.data.begin() + static_cast<long>(length))};
        EXPECT_EQ(parseServerInformation(cut).has_value(), length >= 25) << length;
    }
}

TEST(RobotConfigPacket, ComesBackAsItWasSentAndRefusesTruncation) {
    RobotConfig config{.type = "Pioneer",
                       .subtype = "peoplebot-sh",
                       .serial_number = "A1",
                       .top_rotation_deg_s = 500,
                       .top_speed_mm_s = 2200,
                       .top_rotation_acceleration = 1000,
                       .top_acceleration = 4000,
                       .name = "Ann",
                       .sip_cycle_ms = 100,
                       .front_sonar = true,
                       .rear_sonar = true,
                       .low_battery_dv = 115,
                       .watchdog_ms = 2000,
                       .stall_pause_ms = 500,
                       .rotation_limit_deg_s = 100,
                       .speed_limit_mm_s = 750,
                       .rotation_acceleration = 100,
                       .rotation_deceleration = 101,
                       .acceleration = 300,
                       .deceleration = 600,
                       .front_bumpers = 5,
                       .rear_bumpers = 5,
                       .sonar_cycle_ms = 40,
                       .firmware = "1.0"};
    const auto packet = toPacket(config);
    EXPECT_EQ(parseRobotConfig(packet), config);
    EXPECT_FALSE(parseRobotConfig({kConfigPacket, Bytes(packet.data.begin(), packet.data.begin() + 60)}));
}

TEST(InputsOutputsPacket, ComesBackAsItWasSentAndRefusesTruncation) {
    const InputsOutputs io{{1, 2, 3, 4}, {0xFF}, {512, 1023}};
    EXPECT_EQ(parseInputsOutputs(toPacket(io)), io);
    EXPECT_FALSE(parseInputsOutputs({kIoPacket, {200, 1, 2}}));
}

}  // namespace
}  // namespace axon::arcos
