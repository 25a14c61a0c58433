// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/lms2xx/client_session.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <optional>

namespace axon::lms2xx {
namespace {

using std::chrono::milliseconds;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

/// Plays the laser by hand: notes what the session sends, and answers when told to.
class ClientSessionTest : public ::testing::Test, public ClientSession::Port {
  protected:
    void send(const Bytes& bytes) override {
        for (auto& item : wire_.feed(bytes, clock_.now())) sent_.push_back(std::move(item.telegram));
    }
    void onOnline(const Setting& setting) override { setting_ = setting; }
    void onScan(const Scan& scan) override { scans_.push_back(scan); }
    void onLost(const std::string& reason) override { lost_.push_back(reason); }
    bool setSpeed(int baud) override {
        if (!line_can_change_) return false;
        line_speed_ = baud;
        return true;
    }

    void begin(const robots::LineSpeed& line = {}) {
        line_speed_ = line.baud;
        session_.begin(clock_.now(), line);
    }
    void answer(const Telegram& telegram) { session_.receive(encode(telegram), clock_.now()); }
    /// As a laser answers what was sent last.
    void answerLast(bool done = true) {
        const auto asked = sent_.back();
        session_.receive(Bytes{kAck}, clock_.now());
        switch (static_cast<Command>(asked.command)) {
            case Command::Mode:
                answer(modeAnswer(done));
                break;
            case Command::ReadConfiguration:
                answer(toAnswer(measuring_));
                break;
            case Command::Variant:
                answer(toAnswer(VariantAnswer{done, done ? Variant() : Variant{100, 50}}));
                break;
            default:
                FAIL() << "nobody answers this";
        }
    }
    void scan(std::uint8_t status = kGood, std::size_t values = 181) {
        MeasuredValues measured{.millimetres = measuring_.millimetres, .values = {}, .status = status};
        for (std::size_t i = 0; i < values; ++i)
            measured.values.push_back(static_cast<std::uint16_t>(1000 + i));
        answer(toAnswer(measured));
    }
    void setUp(const robots::LineSpeed& line = {}) {
        begin(line);
        while (session_.state() != ClientSession::State::Scanning && lost_.empty()) answerLast();
    }
    void pass(milliseconds time) {
        for (; time.count() > 0; time -= milliseconds{50}) {
            clock_.advance(milliseconds{50});
            session_.tick(clock_.now());
        }
    }
    /// What was sent since the last call.
    std::vector<Telegram> takeSent() { return std::exchange(sent_, {}); }

    ManualClock clock_;
    TelegramReader wire_{TelegramReader::From::Host};
    std::vector<Telegram> sent_;
    std::optional<Setting> setting_;
    std::vector<Scan> scans_;
    std::vector<std::string> lost_;
    Measuring measuring_{.millimetres = true, .mode = 6};
    bool line_can_change_ = true;
    int line_speed_ = 0;
    ClientSession session_{*this};
};

TEST_F(ClientSessionTest, EndsOldOutputRaisesTheSpeedReadsTheConfigurationAndStarts) {
    setUp({.baud = 9600});
    EXPECT_THAT(takeSent(), ElementsAre(request(Mode::OutputOnRequest), request(Mode::Baud38400),
                                        request(Command::ReadConfiguration), request(Variant()),
                                        request(Mode::ContinuousOutput)));
    EXPECT_EQ(line_speed_, 38400);
    EXPECT_EQ(setting_, (Setting{38400, Variant(), measuring_}));
    EXPECT_THAT(lost_, IsEmpty());
}

TEST_F(ClientSessionTest, ScansAreDistancesFromRightToLeftAndAsOldAsTheirWayWasLong) {
    setUp({.baud = 9600});
    clock_.advance(milliseconds{500});
    scan();
    ASSERT_EQ(scans_.size(), 1U);
    EXPECT_DOUBLE_EQ(scans_[0].start_deg, -90);
    EXPECT_DOUBLE_EQ(scans_[0].step_deg, 1);
    ASSERT_EQ(scans_[0].ranges_mm.size(), 181U);
    EXPECT_EQ(scans_[0].ranges_mm[180], 1180);
    EXPECT_FALSE(scans_[0].polluted);
    // 372 bytes of ten bits at 38400 baud: 96.9 ms.
    EXPECT_NEAR(static_cast<double>((clock_.now() - scans_[0].taken).count()), 96.9e6 + 7e6, 0.1e6);
    scan(0x90, 201);
    ASSERT_EQ(scans_.size(), 2U);
    EXPECT_DOUBLE_EQ(scans_[1].start_deg, -50) << "what a scan is, its number of values says";
    EXPECT_DOUBLE_EQ(scans_[1].step_deg, 0.5);
    EXPECT_TRUE(scans_[1].polluted);
}

TEST_F(ClientSessionTest, ScansThatWaitedTogetherAreAsOldAsWhatCameAfterThem) {
    setUp({.baud = 9600});
    clock_.advance(milliseconds{500});
    MeasuredValues measured{.millimetres = true, .values = {}, .status = kGood};
    measured.values.assign(181, 1000);
    const auto one = encode(toAnswer(measured));
    Bytes three;
    for (int i = 0; i < 3; ++i) three.insert(three.end(), one.begin(), one.end());
    session_.receive(three, clock_.now());
    ASSERT_EQ(scans_.size(), 3U);
    for (std::size_t i = 0; i < 3; ++i) {
        const auto age = static_cast<double>((clock_.now() - scans_[i].taken).count());
        EXPECT_NEAR(age, static_cast<double>(3 - i) * 96.9e6 + 7e6, 0.3e6) << i;
    }
}

TEST_F(ClientSessionTest, ALaserInCentimetresIsUnderstoodAndLeftAsItIs) {
    measuring_ = {.millimetres = false, .mode = 0};
    setUp();
    scan();
    ASSERT_EQ(scans_.size(), 1U);
    EXPECT_EQ(scans_[0].ranges_mm[0], 10000);
    for (const auto& telegram : sent_) EXPECT_NE(telegram.command, 0x77) << "writes the laser's memory";
}

TEST_F(ClientSessionTest, ALaserThatAKilledProgramLeftTalkingFastIsFoundThere) {
    begin({.baud = 9600});
    session_.receive(Bytes(300, 0x5A), clock_.now());  // what 38400 baud look like at 9600
    pass(milliseconds{1500});
    EXPECT_EQ(line_speed_, 38400);
    scan();  // one that was under way
    EXPECT_THAT(scans_, IsEmpty());
    sent_.erase(sent_.begin());
    while (session_.state() != ClientSession::State::Scanning) answerLast();
    EXPECT_THAT(takeSent(), ElementsAre(request(Mode::OutputOnRequest), request(Command::ReadConfiguration),
                                        request(Variant()), request(Mode::ContinuousOutput)));
}

TEST_F(ClientSessionTest, ALaserThatAnswersNowhereIsSaidAfterAllSpeeds) {
    begin({.baud = 9600});
    std::vector<int> speeds{line_speed_};
    for (int i = 0; i < 200 && lost_.empty(); ++i) {
        pass(milliseconds{50});
        if (line_speed_ != speeds.back()) speeds.push_back(line_speed_);
    }
    EXPECT_THAT(speeds, ElementsAre(9600, 38400, 19200, 9600, 38400, 19200));
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_THAT(lost_[0], HasSubstr("is it switched on"));
    EXPECT_EQ(session_.state(), ClientSession::State::Closed);
}

TEST_F(ClientSessionTest, ALaserThatKeepsItsSpeedIsListenedToThere) {
    begin({.baud = 9600});
    answerLast();
    answerLast(false);
    while (session_.state() != ClientSession::State::Scanning) answerLast();
    EXPECT_EQ(line_speed_, 9600);
    EXPECT_EQ(setting_->baud, 9600);
}

TEST_F(ClientSessionTest, ALineThatDoesNotCarryTheFasterSpeedIsNotTriedTwice) {
    begin({.baud = 9600});
    answerLast();
    answerLast();
    EXPECT_EQ(line_speed_, 38400);
    pass(2 * ClientSession::kTries * milliseconds{3000});
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_THAT(lost_[0], HasSubstr("does not answer at 38400 baud"));
    lost_.clear();
    takeSent();
    setUp({.baud = 9600});
    EXPECT_EQ(line_speed_, 9600);
    EXPECT_EQ(session_.state(), ClientSession::State::Scanning);
}

TEST_F(ClientSessionTest, TheSpeedThatTheAddressAsksForIsUsed) {
    setUp({.baud = 19200, .asked = 19200});
    EXPECT_EQ(line_speed_, 19200);
    EXPECT_EQ(setting_->baud, 19200);
}

TEST_F(ClientSessionTest, ALaserThatKeepsItsVariantIsListenedToAsItIs) {
    begin();
    answerLast();
    answerLast();
    answerLast(false);
    EXPECT_EQ(sent_.back(), request(Mode::ContinuousOutput));
    answerLast();
    EXPECT_EQ(setting_->variant, (Variant{100, 50}));
    // Or it refuses, or says nothing at all.
    begin();
    answerLast();
    answerLast();
    answer({0x80, kRefused, {kGood}});
    EXPECT_EQ(sent_.back(), request(Mode::ContinuousOutput));
    begin();
    answerLast();
    answerLast();
    pass(2 * milliseconds{3000});
    EXPECT_EQ(sent_.back(), request(Mode::ContinuousOutput));
}

TEST_F(ClientSessionTest, WhatIsNoScanIsDroppedAndCounted) {
    setUp();
    scan(kGood, 180);
    answer({0x80, kMeasuredValues, {0x01, 0x40}});
    EXPECT_THAT(scans_, IsEmpty());
    EXPECT_EQ(session_.droppedScans(), 2U);
    EXPECT_THAT(lost_, IsEmpty());
    auto damaged = encode(toAnswer(MeasuredValues{
        .millimetres = true, .values = std::vector<std::uint16_t>(181, 500), .status = kGood}));
    damaged[100] ^= 1U;
    session_.receive(damaged, clock_.now());
    EXPECT_THAT(scans_, IsEmpty());
    EXPECT_EQ(session_.reader().badCrcs(), 1U);
}

TEST_F(ClientSessionTest, ASilentLaserIsLostAndToldToBeQuiet) {
    setUp();
    pass(milliseconds{1950});
    scan();
    pass(milliseconds{1950});
    EXPECT_THAT(lost_, IsEmpty());
    takeSent();
    pass(milliseconds{50});
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_THAT(lost_[0], HasSubstr("no scan of the laser for 2000 ms"));
    EXPECT_THAT(takeSent(), ElementsAre(request(Mode::OutputOnRequest)));
}

TEST_F(ClientSessionTest, AFaultAndAFreshStartEndTheSession) {
    setUp();
    scan(0x13);
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_THAT(lost_[0], HasSubstr("fault"));
    EXPECT_THAT(scans_, IsEmpty());
    setUp();
    lost_.clear();
    session_.begin(clock_.now(), {});
    while (session_.state() != ClientSession::State::Scanning) answerLast();
    answer({0x80, kPowerOn, {'L', 'M', 'S', kGood}});
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_THAT(lost_[0], HasSubstr("switched on again"));
}

TEST_F(ClientSessionTest, ALaserThatHasJustStartedIsAskedAtOnce) {
    begin();
    takeSent();
    answer({0x80, kPowerOn, {'L', 'M', 'S', kGood}});
    EXPECT_THAT(takeSent(), ElementsAre(request(Mode::OutputOnRequest)));
}

TEST_F(ClientSessionTest, ALaserThatMeasuresNoDistancesIsSaid) {
    measuring_.mode = 0x3F;
    setUp();
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_THAT(lost_[0], HasSubstr("fix: "));
}

TEST_F(ClientSessionTest, ARefusalAndSilenceWhileItIsSetUpEndTheSession) {
    begin();
    answerLast();
    answer({0x80, kRefused, {kGood}});
    ASSERT_EQ(lost_.size(), 1U);
    EXPECT_THAT(lost_[0], HasSubstr("refuses to be set up"));
    begin();
    answerLast();
    pass(2 * milliseconds{3000});
    ASSERT_EQ(lost_.size(), 2U);
    EXPECT_THAT(lost_[1], HasSubstr("stopped answering"));
    begin();
    answerLast();
    answerLast();
    answerLast();
    answerLast(false);
    ASSERT_EQ(lost_.size(), 3U);
    EXPECT_THAT(lost_[2], HasSubstr("refuses to send scans"));
}

}  // namespace
}  // namespace axon::lms2xx
