// SPDX-License-Identifier: GPL-2.0-or-later
// Against the bytes that the vendor prints: "Telegrams for Configuring and Operating the LMS2xx"
// (8007954/Q501, 2006; TL below) and "Quick Manual for LMS communication setup" (June 2001; QM).
#include "robots/lms2xx/telegram.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "robots/lms2xx/scan.hpp"

namespace axon::lms2xx {
namespace {

using std::chrono::milliseconds;
using ::testing::ElementsAre;
using ::testing::IsEmpty;
using ::testing::SizeIs;
using Item = TelegramReader::Item;
using Kind = TelegramReader::Item::Kind;

constexpr TimePoint kNow{};

Item whole(Telegram telegram) {
    return {Kind::Telegram, std::move(telegram)};
}
const Item kAcknowledged{Kind::Ack, {}};

std::vector<Item> read(TelegramReader& reader, const Bytes& bytes) {
    return reader.feed(bytes, kNow);
}

struct Printed {
    Telegram telegram;
    Bytes bytes;
    const char* source;
};
const std::vector<Printed>& requests() {
    static const std::vector<Printed> all{
        {request(Command::Status), {0x02, 0x00, 0x01, 0x00, 0x31, 0x15, 0x12}, "QM p. 9, status"},
        {request(Command::ReadConfiguration),
         {0x02, 0x00, 0x01, 0x00, 0x74, 0x50, 0x12},
         "TL 7.43, configuration"},
        {request(Mode::Baud38400), {0x02, 0x00, 0x02, 0x00, 0x20, 0x40, 0x50, 0x08}, "QM p. 10, 38400 baud"},
        {request(Mode::Baud19200), {0x02, 0x00, 0x02, 0x00, 0x20, 0x41, 0x51, 0x08}, "QM p. 10, 19200 baud"},
        {request(Mode::Baud9600), {0x02, 0x00, 0x02, 0x00, 0x20, 0x42, 0x52, 0x08}, "QM p. 10, 9600 baud"},
        {request(Mode::Baud500000),
         {0x02, 0x00, 0x02, 0x00, 0x20, 0x48, 0x58, 0x08},
         "TL table 7-18, 500000 baud"},
        {request(Mode::ContinuousOutput),
         {0x02, 0x00, 0x02, 0x00, 0x20, 0x24, 0x34, 0x08},
         "QM p. 12, start"},
        {request(Mode::OutputOnRequest), {0x02, 0x00, 0x02, 0x00, 0x20, 0x25, 0x35, 0x08}, "QM p. 14, stop"},
        {request(Variant{180, 100}),
         {0x02, 0x00, 0x05, 0x00, 0x3B, 0xB4, 0x00, 0x64, 0x00, 0x97, 0x49},
         "QM p. 11, 180 degrees, 1 degree"},
        {request(Variant{180, 50}),
         {0x02, 0x00, 0x05, 0x00, 0x3B, 0xB4, 0x00, 0x32, 0x00, 0x3B, 0x1F},
         "QM p. 11, 180 degrees, half a degree"},
        {request(Variant{100, 100}),
         {0x02, 0x00, 0x05, 0x00, 0x3B, 0x64, 0x00, 0x64, 0x00, 0x1D, 0x0F},
         "QM p. 11, 100 degrees, 1 degree"},
        {request(Variant{100, 25}),
         {0x02, 0x00, 0x05, 0x00, 0x3B, 0x64, 0x00, 0x19, 0x00, 0xE7, 0x72},
         "QM p. 11, 100 degrees, a quarter"},
    };
    return all;
}

// The laser's name and version after it was switched on, QM p. 9.
const Bytes kSwitchedOn{0x02, 0x81, 0x17, 0x00, 0x90, 0x4C, 0x4D, 0x53, 0x32, 0x30,
                        0x30, 0x3B, 0x33, 0x30, 0x31, 0x30, 0x36, 0x33, 0x3B, 0x56,
                        0x30, 0x32, 0x2E, 0x30, 0x36, 0x20, 0x13, 0x64, 0x5A};

MeasuredValues scanOf(std::size_t values) {
    MeasuredValues scan{.millimetres = true, .values = {}, .status = kGood};
    // With all the bytes that begin something else: STX, ACK, NAK.
    for (std::size_t i = 0; i < values; ++i)
        scan.values.push_back(static_cast<std::uint16_t>(0x0602 + 0x1502 * i));
    return scan;
}

TEST(TelegramTest, RequestsAreTheBytesThatTheVendorPrints) {
    for (const auto& [telegram, bytes, source] : requests()) EXPECT_EQ(encode(telegram), bytes) << source;
}

TEST(TelegramTest, AnswersThatTheVendorPrintsAreRead) {
    TelegramReader laser(TelegramReader::From::Laser);
    // QM p. 10: ACK, then done; from a laser at the address 1, and from one at 0 (TL table 7-20).
    const auto found = read(laser, {0x06, 0x02, 0x81, 0x03, 0x00, 0xA0, 0x00, 0x10, 0x36, 0x1A,  //
                                    0x06, 0x02, 0x80, 0x03, 0x00, 0xA0, 0x00, 0x10, 0x16, 0x0A});
    EXPECT_THAT(found, ElementsAre(kAcknowledged, whole({0x81, 0xA0, {0x00, 0x10}}), kAcknowledged,
                                   whole(modeAnswer(true))));
    EXPECT_EQ(parseModeAnswer(found[1].telegram), true);
    const auto name = read(laser, kSwitchedOn);
    ASSERT_THAT(name, SizeIs(1));
    EXPECT_EQ(name[0].telegram.command, kPowerOn);
    EXPECT_EQ(std::string(name[0].telegram.data.begin(), name[0].telegram.data.end() - 2),
              "LMS200;301063;V02.06");
    // A reset is answered and followed by the name: TL table 7-7.
    EXPECT_THAT(read(laser, {0x06, 0x02, 0x80, 0x02, 0x00, 0x91, 0x10, 0x79, 0x30}), SizeIs(2));
    EXPECT_EQ(laser.badCrcs(), 0U);
    EXPECT_EQ(laser.noiseBytes(), 0U);
}

TEST(TelegramTest, HoweverTheBytesArriveTheSameIsRead) {
    Bytes stream{kAck};
    for (const auto& telegram :
         {modeAnswer(true), toAnswer(scanOf(181)), toAnswer(Measuring{.millimetres = true, .mode = 6})}) {
        const auto bytes = encode(telegram);
        stream.insert(stream.end(), bytes.begin(), bytes.end());
    }
    for (std::size_t piece = 1; piece < stream.size(); piece += piece < 16 ? 1 : 97) {
        TelegramReader laser(TelegramReader::From::Laser);
        std::vector<Item> found;
        for (std::size_t at = 0; at < stream.size(); at += piece) {
            const auto part = std::span(stream).subspan(at, std::min(piece, stream.size() - at));
            for (auto& item : laser.feed(part, kNow)) found.push_back(std::move(item));
        }
        ASSERT_THAT(found, SizeIs(4)) << piece;
        EXPECT_EQ(found[2].telegram, toAnswer(scanOf(181)));
    }
}

TEST(TelegramTest, ADamagedByteCostsItsTelegramAndNotTheNext) {
    const auto first = encode(toAnswer(scanOf(181)));
    const auto second = encode(modeAnswer(true));
    for (std::size_t at = 0; at < first.size(); ++at) {
        auto stream = first;
        stream[at] ^= 0x40U;
        stream.insert(stream.end(), second.begin(), second.end());
        TelegramReader laser(TelegramReader::From::Laser);
        auto found = read(laser, stream);
        // A damaged length may claim more than there is: the time-out ends that.
        for (auto& item : laser.feed(second, kNow + TelegramReader::kPartialTimeout))
            found.push_back(std::move(item));
        std::erase_if(found, [](const Item& item) { return item.kind != Kind::Telegram; });
        EXPECT_THAT(found, ElementsAre(whole(modeAnswer(true)), whole(modeAnswer(true)))) << "byte " << at;
    }
}

TEST(TelegramTest, ATelegramThatIsCutOffIsForgotten) {
    const auto bytes = encode(toAnswer(scanOf(181)));
    for (const std::size_t length : {std::size_t{1}, std::size_t{3}, std::size_t{4}, bytes.size() - 1}) {
        TelegramReader laser(TelegramReader::From::Laser);
        EXPECT_THAT(laser.feed(std::span(bytes).first(length), kNow), IsEmpty());
        EXPECT_TRUE(laser.partial());
        const auto found = laser.feed(encode(modeAnswer(true)), kNow + TelegramReader::kPartialTimeout);
        ASSERT_FALSE(found.empty()) << length;
        EXPECT_EQ(found.back(), whole(modeAnswer(true))) << length;
    }
}

TEST(TelegramTest, LengthsThatNoTelegramHasAreNotWaitedFor) {
    TelegramReader laser(TelegramReader::From::Laser);
    Bytes stream{0x02, 0x80, 0x00, 0x00, 0x02, 0x80, 0xFF, 0xFF, 0x02, 0x80, 0x29, 0x03};  // 0, 65535, 809
    const auto good = encode(modeAnswer(true));
    stream.insert(stream.end(), good.begin(), good.end());
    const auto found = read(laser, stream);
    ASSERT_FALSE(found.empty());
    EXPECT_EQ(found.back(), whole(modeAnswer(true)));
    EXPECT_FALSE(laser.partial());
    EXPECT_GE(laser.noiseBytes(), 11U);
}

TEST(TelegramTest, NoiseBetweenTelegramsIsSkippedAndCounted) {
    std::mt19937 random(7);
    const auto good = encode(toAnswer(scanOf(101)));
    TelegramReader laser(TelegramReader::From::Laser);
    int seen = 0;
    constexpr int kTelegrams = 200;
    TimePoint now{};
    for (int i = 0; i < kTelegrams; ++i) {
        Bytes noise(random() % 40);
        for (auto& byte : noise) byte = static_cast<std::uint8_t>(random());
        now += TelegramReader::kPartialTimeout;
        laser.feed(noise, now);
        now += TelegramReader::kPartialTimeout;  // what looked like a beginning is over
        for (const auto& item : laser.feed(good, now)) seen += item == whole(toAnswer(scanOf(101))) ? 1 : 0;
    }
    EXPECT_EQ(seen, kTelegrams);
    EXPECT_GT(laser.noiseBytes(), 0U);
}

TEST(TelegramTest, EachSideReadsOnlyTheOthersTelegrams) {
    TelegramReader laser(TelegramReader::From::Laser);
    TelegramReader host(TelegramReader::From::Host);
    const auto question = encode(request(Mode::ContinuousOutput));
    EXPECT_THAT(read(laser, question), IsEmpty()) << "an echo of what was said";
    EXPECT_THAT(read(host, question), ElementsAre(whole(request(Mode::ContinuousOutput))));
    EXPECT_THAT(read(host, encode(modeAnswer(true))), IsEmpty());
    EXPECT_THAT(read(host, {kAck, kNak}), IsEmpty());
}

TEST(ScanTest, MeasuredValuesAreWhatTheListingSays) {
    // TL 7.5.2: the word before the values has their number, and 01 in its two highest bits for millimetres.
    const Telegram answer{0x80, kMeasuredValues, {0x02, 0x40, 0xE8, 0x03, 0xFF, 0x7F, 0x10}};
    const auto scan = parseMeasuredValues(answer);
    ASSERT_TRUE(scan);
    EXPECT_TRUE(scan->millimetres);
    EXPECT_THAT(scan->values, ElementsAre(1000, 0x7FFF));
    EXPECT_EQ(scan->status, 0x10);
    // With the indices of scan and telegram, where the laser is configured so.
    auto indexed = answer;
    indexed.data.insert(indexed.data.end() - 1, {0x11, 0x22});
    EXPECT_EQ(parseMeasuredValues(indexed), scan);
}

TEST(ScanTest, MeasuredValuesThatAreNoneAreRefused) {
    const Bytes good{0x01, 0x40, 0xE8, 0x03, 0x10};
    EXPECT_TRUE(parseMeasuredValues({0x80, kMeasuredValues, good}));
    EXPECT_FALSE(parseMeasuredValues({0x80, kModeAnswer, good}));
    for (const auto& bad : std::vector<Bytes>{
             {},
             {0x01},
             {0x01, 0x40},
             {0x00, 0x40, 0x10},                    // none
             {0x02, 0x40, 0xE8, 0x03, 0x10},        // fewer than it says
             {0x01, 0x40, 0xE8, 0x03, 0x00, 0x10},  // more
             {0x01, 0x60, 0xE8, 0x03, 0x10},        // a part of a scan
             {0x01, 0x48, 0xE8, 0x03, 0x10},        // every second value
             {0x01, 0x80, 0xE8, 0x03, 0x10},        // a unit that is not used
             {0xFF, 0x43, 0xE8, 0x03, 0x10},
         })
        EXPECT_FALSE(parseMeasuredValues({0x80, kMeasuredValues, bad}));
}

TEST(ScanTest, AValueIsADistanceBesideItsFlags) {
    // TL 7.46: field A, B and C in the three highest bits of measuring mode 2.
    EXPECT_EQ(distance_mm(0xE000 | 1234, true, 13), 1234);
    EXPECT_EQ(distance_mm(0x8000 | 8191, true, 15), 8191);
    EXPECT_EQ(distance_mm(500, false, 13), 5000) << "centimetres";
    EXPECT_EQ(distance_mm(8000, false, 13), kNothing_mm) << "80 m";
    // TL 10.8: from 1FF7 on no distances, but why there is none; so in the other ranges.
    for (const int bits : {13, 14, 15}) {
        const auto limit = 1U << static_cast<unsigned>(bits);
        for (unsigned value = limit - 9; value < limit; ++value)
            EXPECT_EQ(distance_mm(static_cast<std::uint16_t>(value), true, bits), kNothing_mm);
        EXPECT_EQ(distance_mm(static_cast<std::uint16_t>(limit - 10), true, bits), limit - 10);
    }
}

TEST(ScanTest, TheConfigurationTellsUnitAndRange) {
    for (const auto& [mode, bits] : std::vector<std::pair<int, int>>{
             {0, 13}, {1, 13}, {2, 13}, {3, 14}, {4, 14}, {5, 15}, {6, 15}, {15, 15}}) {
        const auto measuring =
            parseMeasuring(toAnswer(Measuring{.millimetres = mode % 2 == 0, .mode = mode}));
        ASSERT_TRUE(measuring);
        EXPECT_EQ(measuring->millimetres, mode % 2 == 0);
        EXPECT_EQ(measuring->distanceBits(), bits) << mode;
    }
    EXPECT_FALSE((Measuring{.mode = 0x3F}.distanceBits())) << "how much light came back";
    // QM p. 11: older lasers have 32 bytes; what is neither is not understood.
    Telegram answer{0x80, kConfigurationAnswer, Bytes(33, 0)};
    answer.data[6] = 1;
    EXPECT_EQ(parseMeasuring(answer), (Measuring{.millimetres = true, .mode = 0}));
    answer.data.push_back(0);
    EXPECT_FALSE(parseMeasuring(answer));
    EXPECT_FALSE(parseMeasuring({0x80, kModeAnswer, Bytes(33, 0)}));
}

TEST(ScanTest, VariantsAreKnownByTheirNumberOfValues) {
    for (const auto& variant :
         {Variant{180, 100}, Variant{180, 50}, Variant{100, 100}, Variant{100, 50}, Variant{100, 25}})
        EXPECT_EQ(variantOf(static_cast<std::size_t>(variant.values())), variant);
    for (const std::size_t values : {0, 1, 180, 182, 400, 721}) EXPECT_FALSE(variantOf(values));
    const VariantAnswer answer{.done = true, .variant = {100, 50}};
    EXPECT_EQ(parseVariantAnswer(toAnswer(answer)), answer);
    EXPECT_FALSE(parseVariantAnswer({0x80, kVariantAnswer, {1, 0xB4, 0, 0x65, 0, 0x10}}));
    EXPECT_FALSE(parseVariantAnswer({0x80, kVariantAnswer, {1, 0xB4, 0}}));
}

TEST(ScanTest, AStatusTellsFaultsAndDirt) {
    EXPECT_FALSE(Status(0x10).faulty());
    EXPECT_FALSE(Status(0x12).faulty()) << "a warning";
    EXPECT_TRUE(Status(0x13).faulty());
    EXPECT_TRUE(Status(0x14).faulty());
    EXPECT_TRUE(Status(0x90).polluted);
    EXPECT_FALSE(Status(0x10).polluted);
}

}  // namespace
}  // namespace axon::lms2xx
