// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/links/back_end/application_search.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace axon::entity_manager {
namespace {

using namespace std::chrono_literals;
using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr TimePoint kStart{1h};

ApplicationSearch searchFor(const std::string& application, const std::string& instance = {}) {
    return ApplicationSearch({application, instance, {{5500, 5600}, "127.0.0.1"}, "/etc/axon/ports.cfg"});
}

TEST(ApplicationSearch, SaysNothingForThreeSecondsAndNothingAfterItHasEnded) {
    auto search = searchFor("peoplebot");
    EXPECT_FALSE(search.report(kStart)) << "nobody looks yet";
    search.begin(kStart);
    EXPECT_FALSE(search.report(kStart + 2999ms));
    EXPECT_TRUE(search.report(kStart + 3s));
    search.end();
    EXPECT_FALSE(search.report(kStart + 1h));
}

TEST(ApplicationSearch, NamesWhatIsLookedForAndWhere) {
    auto search = searchFor("peoplebot", "left");
    search.begin(kStart);
    const auto report = search.report(kStart + 3s);
    ASSERT_TRUE(report);
    EXPECT_EQ(
        report->finding,
        "no robot application \"peoplebot\", instance \"left\" is found at 127.0.0.1, ports 5500 to 5600 "
        "(/etc/axon/ports.cfg); none listens there");
    EXPECT_THAT(report->fix, HasSubstr("start the application"));
}

TEST(ApplicationSearch, NamesTheApplicationsThatAreThereAndTheNearestName) {
    auto search = searchFor("peoplebott");
    search.begin(kStart);
    search.met(5500, "peoplebot", "", "", kStart + 1s);
    search.met(5501, "cyton", "right", "", kStart + 1s);
    const auto report = search.report(kStart + 3s);
    ASSERT_TRUE(report);
    EXPECT_THAT(
        report->finding,
        HasSubstr("found there: \"peoplebot\" (port 5500), \"cyton\", instance \"right\" (port 5501)"));
    EXPECT_THAT(report->fix, AllOf(HasSubstr("--application"), HasSubstr("did you mean \"peoplebot\"?")));
}

TEST(ApplicationSearch, AnotherInstanceOfTheSameApplicationIsSaid) {
    auto search = searchFor("cyton", "left");
    search.begin(kStart);
    search.met(5500, "cyton", "right", "", kStart + 1s);
    const auto report = search.report(kStart + 3s);
    ASSERT_TRUE(report);
    EXPECT_THAT(report->finding, HasSubstr("found there: \"cyton\", instance \"right\""));
    EXPECT_THAT(report->fix, HasSubstr("--instance"));
}

TEST(ApplicationSearch, AnApplicationThatDeclinesIsTheReason) {
    auto search = searchFor("cyton");
    search.begin(kStart);
    search.met(5500, "other", "", "", kStart + 1s);
    search.met(5501, "cyton", "", "it is linked with another Entity Manager", kStart + 1s);
    const auto report = search.report(kStart + 3s);
    ASSERT_TRUE(report);
    EXPECT_THAT(report->finding, AllOf(HasSubstr("port 5501 and declines: it is linked"),
                                       Not(HasSubstr("no robot application"))));
}

TEST(ApplicationSearch, RepeatsItselfLessAndLessOftenAndForgetsWhatHasGone) {
    auto search = searchFor("cyton");
    search.begin(kStart);
    search.met(5500, "peoplebot", "", "", kStart + 1s);
    ASSERT_TRUE(search.report(kStart + 3s));
    EXPECT_FALSE(search.report(kStart + 8999ms));
    const auto second = search.report(kStart + 9s);
    ASSERT_TRUE(second);
    EXPECT_THAT(second->finding, HasSubstr("none listens there"));
    int reports = 0;
    for (auto now = kStart + 10s; now < kStart + 24h; now += 1s) reports += search.report(now) ? 1 : 0;
    EXPECT_GE(reports, 24 * 6);  // every ten minutes in the end
    EXPECT_LE(reports, 24 * 6 + 10);

    search.begin(kStart + 25h);  // the link was there in between
    EXPECT_TRUE(search.report(kStart + 25h + 3s));
}

TEST(ApplicationSearch, ManyApplicationsMakeNoEndlessLine) {
    auto search = searchFor("cyton");
    search.begin(kStart);
    for (std::uint16_t port = 5500; port < 5600; ++port)
        search.met(port, std::string(300, 'x'), "", "", kStart + 1s);
    const auto report = search.report(kStart + 3s);
    ASSERT_TRUE(report);
    EXPECT_THAT(report->finding, HasSubstr("and 56 more"));
    EXPECT_LT(report->finding.size(), 1000U);
}

}  // namespace
}  // namespace axon::entity_manager
