// SPDX-License-Identifier: GPL-2.0-or-later
#include "messages/composites.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "messages/profile_reader.hpp"

namespace axon {
namespace {

using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::string simple(const std::string& name, const std::string& params = {}) {
    return "<Service name='" + name + "' type='SMPL'><Parameters>" + params + "</Parameters></Service>";
}

std::string composite(const std::string& name, const std::vector<std::string>& parts,
                      const std::string& params = {}) {
    std::string xml =
        "<Service name='" + name + "' type='CMPLX'><Parameters>" + params + "</Parameters><Services>";
    for (const auto& part : parts) xml += "<ServiceRef name='" + part + "'/>";
    return xml + "</Services></Service>";
}

Reading<proto::ServicesProfile> read(const std::string& services) {
    return readServicesProfile("<ServiceProfile>" + services + "</ServiceProfile>", "s");
}

/// "name severity: expected", of each finding.
std::vector<std::string> said(const Reading<proto::ServicesProfile>& reading) {
    std::vector<std::string> all;
    for (const auto& finding : reading.findings)
        all.push_back(finding.element +
                      (finding.severity == Finding::Severity::Error ? " error: " : " warning: ") +
                      finding.expected);
    return all;
}

std::vector<std::string> shown(const proto::ServicesProfile& profile, int service) {
    const auto composites = readComposites(profile);
    std::vector<std::string> names;
    for (const auto& view : composites.params[static_cast<std::size_t>(service)])
        names.push_back(
            viewName(profile, view.service, profile.services(view.service).params(view.item).name()));
    return names;
}

const std::string kDistance =
    "<Param name='Distance' type='INPUT' data_type='INT' units='mm' maximum='500'/>";

TEST(Composites, ComeDownToSimpleServicesInTheirOrder) {
    const auto reading =
        read(composite("Patrol", {"Leg", "Look", "Leg"}) + composite("Leg", {"Drive", "Turn"}) +
             simple("Drive") + simple("Turn") + simple("Look"));
    EXPECT_THAT(said(reading), IsEmpty());
    const auto composites = readComposites(reading.message);
    EXPECT_THAT(composites.parts[0],
                ElementsAre(ElementsAre(0, 1, 2), ElementsAre(0, 1, 3), ElementsAre(0, 4),
                            ElementsAre(0, 1, 2), ElementsAre(0, 1, 3)));
    EXPECT_THAT(composites.parts[1], ElementsAre(ElementsAre(1, 2), ElementsAre(1, 3)));
    EXPECT_THAT(composites.parts[4], ElementsAre(ElementsAre(4)));
}

TEST(Composites, ShowWhatTheirPartsNeedAndGiveOnce) {
    const auto reading =
        read(composite("Patrol", {"Drive", "Turn", "Drive"}) +
             simple("Drive", kDistance + "<Param name='Travelled' type='OUTPUT' data_type='INT'/>") +
             simple("Turn", "<Param name='Angle' type='INPUT' data_type='INT'/>"));
    EXPECT_THAT(said(reading), IsEmpty());
    EXPECT_THAT(shown(reading.message, 0), ElementsAre("Drive.Distance", "Drive.Travelled", "Turn.Angle"));
}

TEST(Composites, HideWhatACompositeAroundThePartDeclaresItself) {
    const auto reading = read(composite("Patrol", {"Leg", "Drive"}) + composite("Leg", {"Drive"}, kDistance) +
                              composite("Round", {"Leg", "Drive"}, kDistance) + simple("Drive", kDistance));
    EXPECT_THAT(said(reading), IsEmpty());
    EXPECT_THAT(shown(reading.message, 0), ElementsAre("Leg.Distance", "Drive.Distance"));
    EXPECT_THAT(shown(reading.message, 1), IsEmpty());
    EXPECT_THAT(shown(reading.message, 2), IsEmpty());
}

TEST(Composites, AreBoundedInTheirPartsAndLevels) {
    const std::vector<std::string> most(256, "Drive");
    EXPECT_THAT(said(read(simple("Drive") + composite("Long", most))), IsEmpty());
    EXPECT_THAT(said(read(simple("Drive") + composite("Long", most) + composite("Longer", {"Long", "Drive"}) +
                          composite("Round", {"Longer"}))),
                ElementsAre("Service \"Longer\" error: at most 256 parts, found 257"));
    std::string many = simple("Drive");
    for (int i = 0; i < 17; ++i) many += composite("Long" + std::to_string(i), most);
    EXPECT_THAT(said(read(many)),
                ElementsAre("Service \"Long16\" error: at most 4096 parts in all composites together"));
    std::string nested = simple("c0");
    for (int i = 1; i <= 10; ++i) nested += composite("c" + std::to_string(i), {"c" + std::to_string(i - 1)});
    EXPECT_THAT(said(read(nested)),
                ElementsAre("Service \"c9\" error: at most 8 composites one within the other"));
    std::string large = simple(
        "Drive", "<Param name='P' type='INPUT' data_type='STR' descr='" + std::string(60'000, 'x') + "'/>");
    for (int i = 0; i < 18; ++i) large += composite("Copy" + std::to_string(i), {"Drive"});
    EXPECT_THAT(said(read(large)),
                ElementsAre(HasSubstr("\"Copy17\" error: parameters of parts that come to at most 1 MiB")));
}

TEST(Composites, MustDeclareAParameterAsTheirPartsDo) {
    const auto parts = simple("Drive", kDistance);
    const auto of = [&](const std::string& attributes) {
        return said(read(parts + composite("Patrol", {"Drive"},
                                           "<Param name='Distance' type='INPUT' " + attributes + "/>")));
    };
    EXPECT_THAT(of("data_type='INT' units='mm' value='500'"), IsEmpty());
    EXPECT_THAT(of("data_type='DBL' units='mm'"),
                ElementsAre(HasSubstr("error: parameter \"Distance\" as its part \"Drive\"")));
    EXPECT_THAT(of("data_type='INT' units='m'"),
                ElementsAre(HasSubstr("the same data_type, units and multiple")));
    EXPECT_THAT(of("data_type='INT' units='mm' value='501'"), ElementsAre(HasSubstr("found 501")));
}

TEST(Composites, SayWhatHasNoEffectOrTwoMeanings) {
    EXPECT_THAT(said(read(simple("Drive") + composite("Patrol", {"Drive"}, kDistance))),
                ElementsAre(HasSubstr("warning: a part with an INPUT or CONFIG parameter \"Distance\"")));
    EXPECT_THAT(
        said(read(simple("A.B", "<Param name='C' type='INPUT' data_type='INT'/>") +
                  simple("A", "<Param name='B.C' type='INPUT' data_type='INT'/>") +
                  composite("Patrol", {"A", "A.B"}))),
        ElementsAre(HasSubstr("error: names that differ from those of its parts' parameters and resources; "
                              "\"A.B.C\" would mean two things")));
}

}  // namespace
}  // namespace axon
