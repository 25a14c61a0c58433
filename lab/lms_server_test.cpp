// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/lms_server.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "lab/laboratory.hpp"
#include "robots/arcos/laser.hpp"
#include "robots/lms2xx/client_session.hpp"

namespace axon::lab {
namespace {

using lms2xx::Bytes;
using lms2xx::Mode;
using lms2xx::Telegram;
using std::chrono::milliseconds;
using ::testing::ElementsAre;
using ::testing::IsEmpty;

constexpr milliseconds kPeriod{4};

/// The virtual laser between a client and a body that sees the same each time.
class LmsServerTest : public ::testing::Test {
  protected:
    std::vector<Telegram> telegramsIn(const Bytes& bytes) {
        std::vector<Telegram> telegrams;
        for (auto& item : wire_.feed(bytes, TimePoint{}))
            if (item.kind == lms2xx::TelegramReader::Item::Kind::Telegram)
                telegrams.push_back(std::move(item.telegram));
        return telegrams;
    }
    std::vector<Telegram> ask(LmsServer& laser, const Telegram& request) {
        return telegramsIn(laser.receive(lms2xx::encode(request), TimePoint{}));
    }
    /// A scan every 100 ms, as the physics gives them; how many arrived at the client.
    int pass(LmsServer& laser, milliseconds time) {
        int arrived = 0;
        for (; time.count() > 0; time -= kPeriod) {
            age_ += kPeriod;
            body_.laser_scanned = age_.count() % 100 == 0;
            for (const auto& telegram : telegramsIn(laser.step(kPeriod, body_))) {
                last_ = lms2xx::parseMeasuredValues(telegram);
                arrived += last_ ? 1 : 0;
            }
        }
        return arrived;
    }

    lms2xx::TelegramReader wire_{lms2xx::TelegramReader::From::Laser};
    milliseconds age_{};
    BodyReadings body_ = [] {
        BodyReadings body;
        body.laser_mm.assign(181, 1234);
        body.laser_mm[3] = arcos::LaserPacket::kNothing_mm;
        return body;
    }();
    std::optional<lms2xx::MeasuredValues> last_;
};

TEST_F(LmsServerTest, SendsScansWhenToldAndAsManyAsTheLineCarries) {
    LmsServer laser(true);
    EXPECT_EQ(pass(laser, milliseconds{2000}), 0);
    EXPECT_FALSE(laser.scanning().on);
    EXPECT_THAT(ask(laser, request(Mode::ContinuousOutput)), ElementsAre(lms2xx::modeAnswer(true)));
    EXPECT_TRUE(laser.scanning().on);
    const int slow = pass(laser, milliseconds{10000});
    EXPECT_NEAR(slow, 25, 1) << "388 ms each at 9600 baud";
    ask(laser, request(Mode::Baud38400));
    EXPECT_EQ(laser.baud(), 38400);
    EXPECT_NEAR(pass(laser, milliseconds{10000}), 100, 2);
    ASSERT_TRUE(last_);
    EXPECT_TRUE(last_->millimetres);
    EXPECT_EQ(lms2xx::distance_mm(last_->values[0], true, 15), 1234);
    EXPECT_EQ(lms2xx::distance_mm(last_->values[3], true, 15), lms2xx::kNothing_mm);
    ask(laser, request(Mode::OutputOnRequest));
    EXPECT_EQ(pass(laser, milliseconds{1000}), 0);
}

TEST_F(LmsServerTest, CentimetresAndEightMetresAreRoundedAndCut) {
    LmsServer laser(false, {.millimetres = false, .mode = 0});
    body_.laser_mm[1] = 1239;
    body_.laser_mm[2] = 32000;
    ask(laser, request(Mode::ContinuousOutput));
    EXPECT_GT(pass(laser, milliseconds{200}), 0);
    EXPECT_EQ(last_->values[1], 124);
    EXPECT_EQ(last_->values[2], 3200);
    LmsServer near(false, {.millimetres = true, .mode = 2});
    ask(near, request(Mode::ContinuousOutput));
    EXPECT_GT(pass(near, milliseconds{200}), 0);
    EXPECT_EQ(lms2xx::distance_mm(last_->values[1], true, 13), 1239);
    EXPECT_EQ(lms2xx::distance_mm(last_->values[2], true, 13), lms2xx::kNothing_mm) << "beyond eight metres";
}

TEST_F(LmsServerTest, OneScanIsSentWhereOneIsAskedFor) {
    LmsServer laser(false);
    EXPECT_THAT(ask(laser, {Telegram::kAnyLaser, static_cast<std::uint8_t>(lms2xx::Command::Measure), {1}}),
                IsEmpty());
    EXPECT_EQ(pass(laser, milliseconds{1000}), 1);
}

TEST_F(LmsServerTest, ItScansAsTheVariantSays) {
    LmsServer laser(false);
    const auto answers = ask(laser, request(lms2xx::Variant{100, 25}));
    ASSERT_EQ(answers.size(), 1U);
    EXPECT_EQ(lms2xx::parseVariantAnswer(answers[0]), (lms2xx::VariantAnswer{true, {100, 25}}));
    EXPECT_DOUBLE_EQ(laser.scanning().start_deg, -50);
    EXPECT_EQ(laser.scanning().readings(), 401);
    ask(laser, request(Mode::ContinuousOutput));
    EXPECT_EQ(pass(laser, milliseconds{500}), 0) << "what was scanned before it heard that";
    body_.laser_mm.assign(401, 500);
    EXPECT_EQ(pass(laser, milliseconds{500}), 5);
    const auto refused = ask(laser, request(lms2xx::Variant{90, 100}));
    ASSERT_EQ(refused.size(), 1U);
    EXPECT_EQ(lms2xx::parseVariantAnswer(refused[0]), (lms2xx::VariantAnswer{false, {100, 25}}));
}

TEST_F(LmsServerTest, WhatItDoesNotKnowIsRefusedAndWhatIsDamagedIsNotAcknowledged) {
    LmsServer laser(true);
    for (const Telegram& odd :
         {Telegram{0, 0x55, {}}, Telegram{0, 0x20, {}}, Telegram{0, 0x74, {1}}, Telegram{0, 0x30, {9}}}) {
        const auto answers = ask(laser, odd);
        ASSERT_EQ(answers.size(), 1U);
        EXPECT_EQ(answers[0].command, lms2xx::kRefused);
    }
    EXPECT_EQ(laser.counters().refused, 4U);
    EXPECT_THAT(ask(laser, request(Mode::Baud500000)), ElementsAre(lms2xx::modeAnswer(false)));
    EXPECT_EQ(laser.baud(), 9600);
    auto damaged = lms2xx::encode(request(Mode::ContinuousOutput));
    damaged[5] ^= 1U;
    EXPECT_THAT(laser.receive(damaged, TimePoint{}), ElementsAre(lms2xx::kNak));
    EXPECT_FALSE(laser.scanning().on);
}

/// The client's session and the virtual laser in the virtual laboratory: what is measured is what stands
/// there.
class LmsInTheLaboratoryTest : public ::testing::Test, public lms2xx::ClientSession::Port {
  protected:
    void send(const Bytes& bytes) override { newBytes(lab_.laser(0).receive(bytes)); }
    void onOnline(const lms2xx::Setting& setting) override { setting_ = setting; }
    void onScan(const lms2xx::Scan& scan) override {
        scans_.push_back(scan);
        age_ = lab_.now() - scan.taken;
    }
    void onLost(const std::string& reason) override { ADD_FAILURE() << reason; }
    bool setSpeed(int baud) override {
        line_speed_ = baud;
        return true;
    }
    void newBytes(const Bytes& bytes) { inbox_.insert(inbox_.end(), bytes.begin(), bytes.end()); }
    static WorldDescription world() {
        WorldDescription world;
        world.robots = {{.name = "PeopleBot", .x = 2, .y = 3, .theta = 0, .port = {}}};
        return world;
    }
    void run(milliseconds time) {
        const auto end = lab_.age() + time;
        while (lab_.age() < end) {
            session_.receive(std::exchange(inbox_, {}), lab_.now());
            session_.tick(lab_.now());
            lab_.step();
        }
    }

    Bytes inbox_;
    std::optional<lms2xx::Setting> setting_;
    std::vector<lms2xx::Scan> scans_;
    Duration age_{};  // of the last scan, when it arrived
    int line_speed_ = 9600;
    Laboratory lab_{world(),
                    [](std::size_t, const arcos::Bytes&) {},
                    {},
                    {.send = [this](std::size_t, const Bytes& bytes) { newBytes(bytes); }, .serial = true}};
    lms2xx::ClientSession session_{*this};
};

TEST_F(LmsInTheLaboratoryTest, ScansAreTheWallsOfTheRoom) {
    session_.begin(lab_.now(), {.baud = 9600});
    run(milliseconds{3000});
    ASSERT_TRUE(setting_);
    EXPECT_EQ(setting_->baud, 38400);
    EXPECT_EQ(line_speed_, 38400);
    ASSERT_GT(scans_.size(), 20U);
    const auto& scan = scans_.back();
    ASSERT_EQ(scan.ranges_mm.size(), 181U);
    // The room is 8 x 6 m; the laser sits 21 mm before the robot's middle.
    EXPECT_NEAR(scan.ranges_mm[0], 3000, 5);
    EXPECT_NEAR(scan.ranges_mm[90], 5979, 5);
    EXPECT_NEAR(scan.ranges_mm[180], 3000, 5);
    EXPECT_NEAR(std::chrono::duration<double>(age_).count(), 0.104, 0.001)
        << "97 ms on the line, and half a sweep";
}

TEST_F(LmsInTheLaboratoryTest, ALaserThatIsStillTalkingIsFoundAgain) {
    session_.begin(lab_.now(), {.baud = 9600});
    run(milliseconds{1000});
    const auto before = scans_.size();
    ASSERT_GT(before, 0U);
    line_speed_ = 38400;
    session_.begin(lab_.now(), {.baud = 38400});  // the program was killed, and is there again
    run(milliseconds{1000});
    EXPECT_GT(scans_.size(), before + 5);
}

}  // namespace
}  // namespace axon::lab
