// SPDX-License-Identifier: GPL-2.0-or-later
#include "messages/profile_reader.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <thread>

#include "messages/profile_command.hpp"
#include "messages/xml_document.hpp"

namespace axon {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

const std::string kArm =
    R"(<BasicProfile name="Arm" category="ROBOT" type="STATIONARY" xpos="0" ypos="0" zpos="0"/>)";

std::string listed(const std::vector<Finding>& findings) {
    std::string out;
    for (const auto& finding : findings) out += finding.toString() + "\n";
    return out;
}

std::string withParam(const std::string& attributes) {
    return "<ServiceProfile><Service name=\"S\" type=\"SMPL\"><Parameters><Param name=\"P\" " + attributes +
           "/></Parameters></Service></ServiceProfile>";
}

TEST(ProfileReader, AFindingReadsFileLineSeverityElementExpectationMend) {
    const auto reading = readBasicProfile(
        "<BasicProfile name=\"Arm\"\n category=\"DRONE\" type=\"STATIONARY\"\n"
        " xpos=\"0\" ypos=\"0\" zpos=\"0\"/>",
        "arm.xml");
    EXPECT_EQ(listed(reading.findings),
              "arm.xml:2: error: BasicProfile \"Arm\" category: one of ROBOT, MACHINE, found \"DRONE\": "
              "write one of them\n");
}

TEST(ProfileReader, AllFindingsComeAtOnceInTheOrderOfLines) {
    const auto reading = readServicesProfile(R"(<ServiceProfile count="9">
  <Service name="" type="SIMPLE">
    <Parameters>
      <Param name="P" type="IN" data_type="FLOAT"
             required="yes"
             colour="red"/>
    </Parameters>
  </Service>
</ServiceProfile>)",
                                             "s.xml");
    std::vector<int> lines;
    for (const auto& finding : reading.findings) lines.push_back(finding.line);
    EXPECT_EQ(lines, (std::vector<int>{1, 2, 2, 4, 4, 5, 6})) << listed(reading.findings);
    EXPECT_FALSE(reading.ok());
}

TEST(ProfileReader, UnknownAttributesAndElementsAreWarningsThatSuggestTheRightName) {
    const auto reading = readBasicProfile(
        "<BasicProfile name='Arm' category='ROBOT' type='STATIONARY' xpos='0' ypos='0' "
        "zpoz='0'><extra/></BasicProfile>",
        "b.xml");
    EXPECT_TRUE(reading.ok()) << listed(reading.findings);
    EXPECT_THAT(listed(reading.findings),
                AllOf(HasSubstr("warning: BasicProfile \"Arm\" zpoz"), HasSubstr("\"zpos\""),
                      HasSubstr("warning: extra in BasicProfile \"Arm\"")));
}

TEST(ProfileReader, AnEntityIsNotCalledByWhatMeansAnotherOne) {
    const auto found = [](const std::string& name) {
        const auto read =
            readBasicProfile("<BasicProfile name=\"" + name +
                                 "\" category=\"ROBOT\" type=\"MOBILE\" xpos=\"0\" ypos=\"0\" zpos=\"0\"/>",
                             "b.xml");
        return read.findings.empty() ? std::string() : read.findings.front().toString();
    };
    EXPECT_EQ(found("Q"), "");
    EXPECT_EQ(found("Q #"), "");
    EXPECT_THAT(found("Q#2"), HasSubstr("b.xml:1"));
    EXPECT_THAT(found("Q#2"), HasSubstr("no '#' with a number at its end"));
    EXPECT_THAT(found("00000001-1111-4111-8111-111111111111"), HasSubstr("no UUID"));
}

TEST(ProfileReader, HintsForEditorsAreNoFindings) {
    const auto reading = readBasicProfile(
        "<BasicProfile xmlns:xsi='http://www.w3.org/2001/XMLSchema-instance' "
        "xsi:noNamespaceSchemaLocation='b.xsd' "
        "name='Arm' category='ROBOT' type='STATIONARY' xpos='0' ypos='0' zpos='0'/>",
        "b.xml");
    EXPECT_THAT(reading.findings, IsEmpty()) << listed(reading.findings);
}

TEST(ProfileReader, MissingOptionalAttributesHaveTheDefaultsOfTheThesis) {
    const auto reading = readServicesProfile(withParam("type='INPUT' data_type='INT'"), "s.xml");
    EXPECT_THAT(reading.findings, IsEmpty()) << listed(reading.findings);
    const auto& service = reading.message.services(0);
    EXPECT_TRUE(service.is_active());
    EXPECT_TRUE(service.is_blocking());
    EXPECT_FALSE(service.is_pausable());
    EXPECT_EQ(service.on_client_loss(), proto::STOP_TASK);
    const auto& param = service.params(0);
    EXPECT_FALSE(param.ready());
    EXPECT_FALSE(param.required());
    EXPECT_FALSE(param.savable());
    EXPECT_FALSE(param.multiple());
}

TEST(ProfileReader, HoldingATaskThatCannotPauseIsAWarning) {
    const auto read = [](const std::string& attributes) {
        return readServicesProfile("<ServiceProfile count='1'>\n<Service name='Drive' type='SMPL' " +
                                       attributes + "/>\n</ServiceProfile>",
                                   "s.xml");
    };
    EXPECT_THAT(read("on_client_loss='hold' pausable='true'").findings, IsEmpty());
    const auto reading = read("on_client_loss='hold'");
    ASSERT_EQ(reading.findings.size(), 1U);
    EXPECT_TRUE(reading.ok());
    EXPECT_EQ(reading.findings[0].line, 2);
    EXPECT_NE(reading.findings[0].toString().find("pausable"), std::string::npos);
}

TEST(ProfileReader, AParameterWithAValueIsReady) {
    const auto reading = readServicesProfile(withParam("type='CONFIG' data_type='DBL' value='2'"), "s.xml");
    const auto& param = reading.message.services(0).params(0);
    EXPECT_TRUE(param.ready());
    EXPECT_EQ(param.initial(0).dbl(), 2.0);
}

TEST(ProfileReader, AConfigParameterIsSavableWhateverIsSaid) {
    for (const auto* said : {"", " savable='true'"}) {
        const auto reading =
            readServicesProfile(withParam(std::string("type='CONFIG' data_type='DBL'") + said), "s.xml");
        EXPECT_THAT(reading.findings, IsEmpty());
        EXPECT_TRUE(reading.message.services(0).params(0).savable());
    }
    for (const auto* said : {" savable='false'", " modifiable='0'"}) {
        const auto reading =
            readServicesProfile(withParam(std::string("type='CONFIG' data_type='DBL'") + said), "s.xml");
        EXPECT_TRUE(reading.ok());
        ASSERT_FALSE(reading.findings.empty());
        EXPECT_THAT(reading.findings.back().toString(), HasSubstr("whose value is always kept"));
        EXPECT_TRUE(reading.message.services(0).params(0).savable());
    }
    EXPECT_FALSE(readServicesProfile(withParam("type='INPUT' data_type='DBL'"), "s.xml")
                     .message.services(0)
                     .params(0)
                     .savable());
}

TEST(ProfileReader, ReadyWithoutAValueIsAWarningAndCountsAsNotSet) {
    const auto reading =
        readServicesProfile(withParam("type='CONFIG' data_type='DBL' ready='true'"), "s.xml");
    EXPECT_TRUE(reading.ok());
    EXPECT_EQ(reading.findings.size(), 1U) << listed(reading.findings);
    EXPECT_FALSE(reading.message.services(0).params(0).ready());
}

TEST(ProfileReader, ARequiredOutputIsAWarningAndNotRequired) {
    const auto reading =
        readServicesProfile(withParam("type='OUTPUT' data_type='INT' required='true'"), "s.xml");
    EXPECT_TRUE(reading.ok());
    EXPECT_EQ(reading.findings.size(), 1U) << listed(reading.findings);
    EXPECT_FALSE(reading.message.services(0).params(0).required());
}

TEST(ProfileReader, AnEmptyTextIsAValueAndAnEmptyNumberIsNone) {
    const auto text = readServicesProfile(withParam("type='INPUT' data_type='STR' value=''"), "s.xml");
    EXPECT_TRUE(text.message.services(0).params(0).ready());
    const auto number = readServicesProfile(withParam("type='INPUT' data_type='INT' value=''"), "s.xml");
    EXPECT_TRUE(number.ok());
    EXPECT_EQ(number.findings.size(), 1U);
    EXPECT_FALSE(number.message.services(0).params(0).ready());
}

TEST(ProfileReader, TheOtherKindOfProfileIsNamed) {
    const auto reading = readServicesProfile(kArm, "arm.xml");
    EXPECT_THAT(listed(reading.findings), HasSubstr("this is a basic profile"));
    EXPECT_FALSE(reading.ok());
}

TEST(ProfileReader, KindsAreDetectedPastCommentsAndDeclarations) {
    EXPECT_EQ(detectKind("<?xml version='1.0'?><!-- <GlobalProfile> --><BasicProfile/>"), ProfileKind::Basic);
    EXPECT_EQ(detectKind("<ServicesProfile>"), ProfileKind::Services);
    EXPECT_EQ(detectKind("<!DOCTYPE x><GlobalProfile\n>"), ProfileKind::Global);
    EXPECT_EQ(detectKind("<!-- <BasicProfile/>"), ProfileKind::Unknown);
    EXPECT_EQ(detectKind("<"), ProfileKind::Unknown);
    EXPECT_EQ(detectKind(""), ProfileKind::Unknown);
}

TEST(ProfileReader, WhatIsNoUtf8TextOrNoXmlIsOneFinding) {
    using namespace std::string_literals;
    for (const auto& xml :
         {""s, "   \n"s, "PeopleBot"s, "\xFF\xFE<\0B\0"s, "<B\0asicProfile/>"s, "\x4C\x6F\xA7\x94"s,
          "<BasicProfile name='Zo\xEB'/>"s, "<"s, "<!"s, "<BasicProfile"s, "<?xml"s}) {
        const auto reading = readBasicProfile(xml, "x.xml");
        EXPECT_FALSE(reading.ok()) << xml;
        EXPECT_GE(reading.findings.size(), 1U);
    }
}

TEST(ProfileReader, ABadByteIsFoundInItsLine) {
    const auto reading = readBasicProfile("<BasicProfile\n name='A'\n descr='Zo\xEB'/>", "x.xml");
    EXPECT_THAT(listed(reading.findings), HasSubstr("x.xml:3: error: document: UTF-8 text"));
}

TEST(ProfileReader, AByteOrderMarkIsNoFinding) {
    EXPECT_THAT(readBasicProfile("\xEF\xBB\xBF" + kArm, "arm.xml").findings, IsEmpty());
}

TEST(ProfileReader, AttributeLinesSurviveGreaterSignsQuotesAndNewLines) {
    const auto reading = readBasicProfile(
        "<!-- <BasicProfile -->\r\n<BasicProfile name='a > b'\r\n\r\n descr=\"it's = 'so'\"\r\n"
        " category='X' type = 'MOBILE' xpos='0' ypos='0' zpos='0'/>",
        "x.xml");
    ASSERT_EQ(reading.findings.size(), 1U) << listed(reading.findings);
    EXPECT_EQ(reading.findings[0].line, 5);
    EXPECT_EQ(reading.message.descr(), "it's = 'so'");
}

TEST(ProfileReader, PredefinedEntitiesAndReferencesAreDecoded) {
    const auto reading = readBasicProfile(
        "<BasicProfile name='A&amp;B &lt;1&gt; &#x41;' category='ROBOT' type='MOBILE' xpos='0' ypos='0' "
        "zpos='0'/>",
        "x.xml");
    EXPECT_THAT(reading.findings, IsEmpty()) << listed(reading.findings);
    EXPECT_EQ(reading.message.name(), "A&B <1> A");
}

TEST(ProfileReader, LimitsOfSizeElementsAndAttributesAreFindings) {
    EXPECT_THAT(listed(readBasicProfile(std::string(kMaxXmlBytes + 1, ' '), "x.xml").findings),
                HasSubstr("at most 1 MiB, found more"));
    std::string many = "<ServiceProfile>";
    for (int i = 0; i <= kMaxXmlElements; ++i) many += "<x/>";
    EXPECT_THAT(listed(readServicesProfile(many + "</ServiceProfile>", "x.xml").findings),
                HasSubstr("elements"));
    std::string wide = "<BasicProfile";
    for (int i = 0; i <= kMaxXmlAttributes; ++i) wide += " a" + std::to_string(i) + " = '1'";
    EXPECT_THAT(listed(readBasicProfile(wide + "/>", "x.xml").findings), HasSubstr("attributes in one tag"));
}

TEST(ProfileReader, ChoicesAreBounded) {
    std::string choices = "0";
    for (int i = 1; i < 256; ++i) choices += "|" + std::to_string(i);
    const std::string attributes = "type='INPUT' data_type='INT' choices='";
    EXPECT_TRUE(readServicesProfile(withParam(attributes + choices + "'"), "x.xml").ok());
    const auto reading = readServicesProfile(withParam(attributes + choices + "|256'"), "x.xml");
    EXPECT_THAT(listed(reading.findings), HasSubstr("at most 256 choices, found 257"));
}

/// A megabyte that makes every reference look for near names among thousands of long ones.
TEST(ProfileReader, AHostileProfileIsReadInBoundedWork) {
    std::string xml = "<ServiceProfile><Service name='c' type='CMPLX'><Services>";
    const std::string tail(110, 'x');
    for (int i = 0; i < 600; ++i) xml += "<ServiceRef name='r" + std::to_string(i) + tail + "'/>";
    xml += "</Services></Service>";
    for (int i = 0; xml.size() < kMaxXmlBytes - 200; ++i)
        xml += "<Service name='s" + std::to_string(i) + tail + "' type='SMPL'/>";
    const auto reading = readServicesProfile(xml + "</ServiceProfile>", "x.xml");
    EXPECT_EQ(reading.findings.size(), kMaxFindings + 1);
}

TEST(ProfileReader, FindingsAreBoundedAndSayWhatIsLeftOut) {
    std::string many = "<ServiceProfile>";
    for (int i = 0; i < 1000; ++i) many += "<x/>";
    const auto reading = readServicesProfile(many + "</ServiceProfile>", "x.xml");
    EXPECT_EQ(reading.findings.size(), kMaxFindings + 1);
    EXPECT_THAT(reading.findings.back().toString(), HasSubstr("501 more"));
    EXPECT_TRUE(reading.ok()) << "warnings only, however many";
}

TEST(ProfileReader, AnErrorThatIsLeftOutStillIsAnError) {
    std::string many = "<ServiceProfile>";
    for (int i = 0; i < 1000; ++i) many += "<x/>";
    EXPECT_FALSE(readServicesProfile(many + "<Service/></ServiceProfile>", "x.xml").ok());
}

TEST(ProfileReader, ALongChainOfCompositesIsNoRecursion) {
    std::string xml = "<ServiceProfile>";
    for (int i = 0; i < 4000; ++i)
        xml += "<Service name='s" + std::to_string(i) + "' type='CMPLX'><Services><ServiceRef name='s" +
               std::to_string(i + 1) + "'/></Services></Service>";
    xml += "<Service name='s4000' type='SMPL'/></ServiceProfile>";
    const auto reading = readServicesProfile(xml, "x.xml");
    ASSERT_EQ(reading.findings.size(), 1U) << listed(reading.findings);
    EXPECT_THAT(reading.findings[0].toString(),
                AllOf(HasSubstr("\"s3991\""), HasSubstr("one within the other")));
    EXPECT_EQ(reading.message.services(7).service_list(0), "s8");
}

std::string globalStep(int role, int preced, const std::string& more = "/>") {
    return "<entity category='ROBOT' type='MOBILE' id='" + std::to_string(role) +
           "' service_global_id='walk' preced='" + std::to_string(preced) + "' " + more;
}

std::string globalService(const std::string& inside, const std::string& attributes = "") {
    return "<GlobalProfile><Service name='S' " + attributes + ">" + inside + "</Service></GlobalProfile>";
}

TEST(GlobalProfileReader, StepsNameWhereTheirValuesComeFrom) {
    const auto reading = readGlobalProfile(
        globalService(
            globalStep(3, 2,
                       "><key_value param_name='Target' param_from=' locate.Position.x '/>"
                       "<key_value param_name='Speed' param_value='2'/></entity>") +
                "<entity name='locate' category='MACHINE' type='STATIONARY' id='7' service_global_id='find' "
                "preced='1'/>"
                "<compensate id='7' service_global_id='off'><key_value param_name='Now' "
                "param_value='true'/></compensate>",
            "on_failure='compensate'"),
        "g.xml");
    EXPECT_THAT(reading.findings, IsEmpty()) << "a step may take from one that the file names later:\n"
                                             << listed(reading.findings);
    ASSERT_EQ(reading.message.services_size(), 1);
    const auto& service = reading.message.services(0);
    EXPECT_EQ(service.on_failure(), proto::COMPENSATE);
    ASSERT_EQ(service.steps_size(), 2);
    ASSERT_EQ(service.steps(0).sources_size(), 1);
    EXPECT_EQ(service.steps(0).sources(0).param(), "Target");
    EXPECT_EQ(service.steps(0).sources(0).step(), "locate");
    EXPECT_EQ(service.steps(0).sources(0).output(), "Position.x") << "all after the first '.'";
    ASSERT_EQ(service.steps(0).params_size(), 1);
    EXPECT_EQ(service.steps(0).params(0).name(), "Speed");
    EXPECT_EQ(service.steps(1).name(), "locate");
    ASSERT_EQ(service.compensation_size(), 1);
    EXPECT_EQ(service.compensation(0).role(), 7);
    EXPECT_EQ(service.compensation(0).category(), proto::MACHINE) << "those of the participant";
    EXPECT_EQ(service.compensation(0).type(), proto::STATIONARY);
    EXPECT_EQ(service.compensation(0).service_global_id(), "off");
    ASSERT_EQ(service.compensation(0).params_size(), 1);
    EXPECT_EQ(service.compensation(0).params(0).values(0).str(), "true");
}

TEST(GlobalProfileReader, WithoutAWordAFailureStopsAll) {
    const auto reading = readGlobalProfile(globalService(globalStep(0, 1)), "g.xml");
    EXPECT_THAT(reading.findings, IsEmpty()) << listed(reading.findings);
    EXPECT_EQ(reading.message.services(0).on_failure(), proto::STOP_ALL);
    const auto held = readGlobalProfile(globalService(globalStep(0, 1), "on_failure='hold-others'"), "g.xml");
    EXPECT_EQ(held.message.services(0).on_failure(), proto::HOLD_OTHERS);
}

TEST(GlobalProfileReader, ACompensationThatNeverRunsIsAWarning) {
    const auto reading = readGlobalProfile(
        globalService(globalStep(0, 1) + "<compensate id='0' service_global_id='park'/>"), "g.xml");
    EXPECT_TRUE(reading.ok());
    ASSERT_EQ(reading.findings.size(), 1U) << listed(reading.findings);
    EXPECT_THAT(reading.findings[0].toString(),
                AllOf(HasSubstr("warning"), HasSubstr("without it no compensation runs")));
}

TEST(GlobalProfileReader, NumbersOfTheOrderMayBeLeftOut) {
    const auto reading =
        readGlobalProfile(globalService(globalStep(0, 0) + globalStep(0, 7) + globalStep(1, 3)), "g.xml");
    EXPECT_THAT(reading.findings, IsEmpty()) << listed(reading.findings);
}

TEST(GlobalProfileReader, AServiceHasAtMostAThousandStepsAnd256Participants) {
    const auto finding = [](int steps, int roles) {
        std::string inside;
        for (int i = 0; i < steps; ++i) inside += globalStep(i % roles, 1);
        const auto reading = readGlobalProfile(globalService(inside), "g.xml");
        EXPECT_LE(reading.findings.size(), 1U) << listed(reading.findings);
        return listed(reading.findings);
    };
    EXPECT_EQ(finding(1000, 256), "");
    EXPECT_THAT(finding(1001, 1), AllOf(HasSubstr("error"), HasSubstr("at most 1000 steps, found 1001")));
    EXPECT_THAT(finding(257, 257),
                AllOf(HasSubstr("error"), HasSubstr("at most 256 participants"), HasSubstr("found 257")));
}

TEST(ProfileReader, AGlobalIdThatIsAnotherServicesNameIsAWarning) {
    const auto reading = readServicesProfile(
        "<ServiceProfile><Service name='Go' type='SMPL'/><Service name='Walk' global_id='Go' "
        "type='SMPL'/></ServiceProfile>",
        "s");
    EXPECT_TRUE(reading.ok());
    EXPECT_EQ(reading.findings.size(), 1U) << listed(reading.findings);
}

TEST(ProfileReader, ThreadsReadAtTheSameTime) {
    std::vector<std::thread> threads;
    std::vector<std::size_t> findings(4, 99);
    for (std::size_t i = 0; i < findings.size(); ++i) {
        threads.emplace_back([&findings, i] {
            std::size_t total = 0;
            for (int round = 0; round < 50; ++round) {
                total += readBasicProfile(kArm, "a.xml").findings.size();
                total += readBasicProfile("<BasicProfile", "b.xml").findings.empty() ? 1 : 0;
            }
            findings[i] = total;
        });
    }
    for (auto& thread : threads) thread.join();
    EXPECT_EQ(findings, std::vector<std::size_t>(4, 0));
}

class ProfileCheckCommand : public ::testing::Test {
  protected:
    void SetUp() override {
        std::string name = (std::filesystem::temp_directory_path() / "axon-profile-XXXXXX").string();
        ASSERT_NE(::mkdtemp(name.data()), nullptr);
        folder_ = name;
    }
    void TearDown() override { std::filesystem::remove_all(folder_); }

    std::string file(const std::string& name, const std::string& text) {
        std::ofstream(folder_ / name) << text;
        return (folder_ / name).string();
    }

    std::filesystem::path folder_;
    std::ostringstream out_;
};

TEST_F(ProfileCheckCommand, WarningsAloneAreSuccess) {
    EXPECT_EQ(checkProfiles({file("a.xml", kArm), "api/schema/samples/valid/figure_a_1.xml"}, false, out_),
              0);
    EXPECT_THAT(out_.str(), HasSubstr("2 files: 0 errors, 1 warning\n"));
}

TEST_F(ProfileCheckCommand, ErrorsAreStatusOneAndAllFilesAreChecked) {
    const auto bad = file("bad.xml", "<BasicProfile/>");
    EXPECT_EQ(checkProfiles({bad, file("worse.xml", "nothing")}, false, out_), 1);
    EXPECT_THAT(out_.str(), AllOf(HasSubstr("bad.xml:1: error: BasicProfile name:"),
                                  HasSubstr("worse.xml:1: error: document:")));
}

TEST_F(ProfileCheckCommand, UnreadableFilesAreStatusTwo) {
    EXPECT_EQ(checkProfiles({(folder_ / "none.xml").string()}, false, out_), 2);
    EXPECT_EQ(checkProfiles({folder_.string()}, false, out_), 2);
    EXPECT_EQ(checkProfiles({"/dev/zero"}, false, out_), 2);
    EXPECT_EQ(checkProfiles({}, false, out_), 2);
}

TEST_F(ProfileCheckCommand, JsonHasOneObjectForEachFindingAndOneThatCounts) {
    const auto bad = file("b\"a\td.xml",
                          "<BasicProfile name='A' category='ROBOT' type='FAST' xpos='0' ypos='0' zpos='0'/>");
    EXPECT_EQ(checkProfiles({bad}, true, out_), 1);
    EXPECT_THAT(out_.str(), AllOf(HasSubstr("b\\\"a\\u0009d.xml\",\"line\":1,\"severity\":\"error\","
                                            "\"element\":\"BasicProfile \\\"A\\\" type\""),
                                  HasSubstr("{\"ok\":false,\"files\":1,\"errors\":1,\"warnings\":0}\n")));
}

}  // namespace
}  // namespace axon
