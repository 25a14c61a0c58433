// SPDX-License-Identifier: GPL-2.0-or-later
#include <gmock/gmock.h>
#include <sys/timex.h>

#include "cli/fake_station.hpp"
#include "cli/verbs/doctor_report.hpp"

using namespace axon;
using namespace axon::cli;
using testing::HasSubstr;
using testing::Not;

namespace {

/// One finding of `axon doctor`.
struct Finding : testing::Test {
    Recorded seen;
    Report report{seen};
    std::string operator[](const char* member) const { return seen.last("finding")->value(member, ""); }
};

constexpr std::time_t kNow = 1790000000;  // 2026

}  // namespace

TEST_F(Finding, AnUnknownNameIsToldFromANameServiceThatIsDown) {
    Network network;
    network.addresses = [](const std::string&, std::uint16_t) { return Addresses{{}, Reach::UnknownHost}; };
    explainNoServer(report, "lab.example.org:10410", network);
    EXPECT_THAT((*this)["message"], HasSubstr("no machine is called \"lab.example.org\""));
    network.addresses = [](const std::string&, std::uint16_t) { return Addresses{{}, Reach::NoResolver}; };
    explainNoServer(report, "lab.example.org:10410", network);
    EXPECT_THAT((*this)["message"], HasSubstr("name service (DNS) does not answer"));
    EXPECT_THAT((*this)["message"], Not(HasSubstr("no machine")));
    EXPECT_EQ((*this)["level"], "bad");
}

TEST_F(Finding, RealTimeIsForOneUserAndNotForAGroupThatMayReadMore) {
    reportRealTime(report, false, "ana");
    EXPECT_EQ((*this)["level"], "warn");
    EXPECT_THAT((*this)["fix"], HasSubstr("'ana - rtprio 20'"));
    EXPECT_THAT((*this)["fix"], Not(HasSubstr("group")));
    reportRealTime(report, true, "ana");
    EXPECT_EQ((*this)["level"], "ok");
}

TEST_F(Finding, OfTimeServersNothingIsSaidWhereNothingIsKnown) {
    reportClock(report, kNow, -1, 0);
    EXPECT_EQ((*this)["level"], "ok");
    EXPECT_THAT((*this)["message"], HasSubstr(" UTC"));
    EXPECT_THAT((*this)["message"], Not(HasSubstr("time server")));
    reportClock(report, kNow, TIME_OK, 0);
    EXPECT_THAT((*this)["message"], HasSubstr("a time server corrects"));
    reportClock(report, kNow, TIME_ERROR, STA_UNSYNC);
    EXPECT_THAT((*this)["message"], HasSubstr("no time server corrects"));
    reportClock(report, 0, -1, 0);
    EXPECT_EQ((*this)["level"], "bad") << "1970";
}
