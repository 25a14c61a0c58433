// SPDX-License-Identifier: GPL-2.0-or-later
#include "messages/values.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "messages/text.hpp"

namespace axon {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::Not;

proto::CtrlParam meta(proto::DataType type, const std::string& units = "") {
    proto::CtrlParam out;
    out.set_name("Distance");
    out.set_data_type(type);
    out.set_units(units);
    return out;
}

proto::Value intValue(std::int64_t number) {
    proto::Value value;
    value.set_int_(number);
    return value;
}

proto::Value dblValue(double number) {
    proto::Value value;
    value.set_dbl(number);
    return value;
}

proto::Value strValue(const std::string& text) {
    proto::Value value;
    value.set_str(text);
    return value;
}

proto::Param param(const std::vector<proto::Value>& values, const std::string& units = "") {
    proto::Param out;
    out.set_name("Distance");
    out.set_units(units);
    for (const auto& value : values) *out.add_values() = value;
    return out;
}

RefusalCode codeOf(proto::DataType type, const std::string& text) {
    const auto value = parseValue(meta(type), text);
    return value ? RefusalCode::Ok : value.refusal().code;
}

TEST(ParseValue, WholeNumbersAreIntsHoweverTheyAreWritten) {
    for (const auto* text : {"1000", "+1000", " 1000 ", "1e3", "1000.0"}) {
        const auto value = parseValue(meta(proto::INT), text);
        ASSERT_TRUE(value.ok()) << text;
        EXPECT_EQ(value.value().int_(), 1000) << text;
    }
    EXPECT_EQ(parseValue(meta(proto::INT), "-9223372036854775808").value().int_(),
              std::numeric_limits<std::int64_t>::min());
}

TEST(ParseValue, OtherTextIsNoNumber) {
    for (const auto* text :
         {"", " ", "ten", "1.5", "0x10", "1 000", "+-1", "--1", "1e400", "nan", "inf", "9223372036854775808"})
        EXPECT_EQ(codeOf(proto::INT, text), RefusalCode::WrongType) << text;
    for (const auto* text : {"", "nan", "-inf", "infinity", "1e400", "1,5", "0x1p3", "+-1", "1mm"})
        EXPECT_EQ(codeOf(proto::DBL, text), RefusalCode::WrongType) << text;
}

TEST(ParseValue, BooleansAreTheUsualWordsInAnyCase) {
    for (const auto* text : {"true", "TRUE", "1", "yes", "On"})
        EXPECT_TRUE(parseValue(meta(proto::BOOL), text).value().bool_());
    for (const auto* text : {"false", "False", "0", "no", "off"})
        EXPECT_FALSE(parseValue(meta(proto::BOOL), text).value().bool_());
    for (const auto* text : {"", "2", "open", "truee"})
        EXPECT_EQ(codeOf(proto::BOOL, text), RefusalCode::WrongType);
}

TEST(ParseValue, TextStaysAsItIsAndMustBeUtf8) {
    EXPECT_EQ(parseValue(meta(proto::STR), "  a b ").value().str(), "  a b ");
    EXPECT_EQ(parseValue(meta(proto::STR), "").value().str(), "");
    for (const auto* text : {"\xFF", "a\xC3", "\xC0\x80", "\xED\xA0\x80", "\xF4\x90\x80\x80"})
        EXPECT_EQ(codeOf(proto::STR, text), RefusalCode::WrongType);
}

TEST(ParseValue, TheRefusalSaysWhatWasExpectedAndWhatWasFound) {
    auto distance = meta(proto::INT, "mm");
    distance.set_minimum(0);
    distance.set_maximum(5000);
    EXPECT_EQ(parseValue(distance, "te\nn").refusal().message,
              "parameter \"Distance\" takes INT from 0 to 5000 in mm; found \"te?n\"");
}

TEST(ParseValue, BoundsAreWrittenAsPeopleWriteThem) {
    auto count = meta(proto::DBL);
    count.set_minimum(-2500000);
    count.set_maximum(100000);
    EXPECT_EQ(describeValues(count), "DBL from -2500000 to 100000");
    count.set_minimum(0.25);
    count.set_maximum(1e300);
    EXPECT_EQ(describeValues(count), "DBL from 0.25 to 1e+300");
}

TEST(ParseParam, AUnitMayStandBehindTheNumber) {
    for (const auto* text : {"1000", "1000mm", " 1000 mm "}) {
        const auto parsed = parseParam(meta(proto::INT, "mm"), text);
        ASSERT_TRUE(parsed.ok()) << text;
        EXPECT_EQ(parsed.value().values(0).int_(), 1000);
    }
    EXPECT_EQ(parseParam(meta(proto::INT, "mm"), "1000 cm").refusal().code, RefusalCode::WrongUnits);
    EXPECT_EQ(parseParam(meta(proto::INT), "1000 cm").refusal().code, RefusalCode::WrongUnits);
    EXPECT_TRUE(parseParam(meta(proto::DBL, "m/s2"), "1.5 m/s2").ok()) << "a unit may have digits";
    EXPECT_EQ(parseParam(meta(proto::STR, "mm"), "1000 mm").value().values(0).str(), "1000 mm");
}

TEST(ParseParam, CommasSeparateTheValuesOfAListOnly) {
    auto list = meta(proto::INT, "mm");
    list.set_multiple(true);
    const auto parsed = parseParam(list, "1, 2mm,3");
    ASSERT_TRUE(parsed.ok());
    EXPECT_EQ(parsed.value().values_size(), 3);
    EXPECT_EQ(parseParam(list, "1,,3").refusal().code, RefusalCode::WrongType);
    EXPECT_EQ(parseParam(meta(proto::INT), "1,2").refusal().code, RefusalCode::WrongType);
    EXPECT_EQ(parseParam(meta(proto::STR), "a,b").value().values_size(), 1);
}

TEST(CheckParam, IntsServeAsDoublesAndWholeDoublesAsInts) {
    EXPECT_EQ(acceptParam(meta(proto::DBL), param({intValue(3)})).value().values(0).dbl(), 3.0);
    EXPECT_EQ(acceptParam(meta(proto::INT), param({dblValue(-3.0)})).value().values(0).int_(), -3);
    EXPECT_EQ(checkParam(meta(proto::INT), param({dblValue(0.5)})).code, RefusalCode::WrongType);
    EXPECT_EQ(checkParam(meta(proto::INT), param({dblValue(1e19)})).code, RefusalCode::WrongType);
    EXPECT_EQ(checkParam(meta(proto::INT), param({dblValue(std::nan(""))})).code, RefusalCode::WrongType);
}

TEST(CheckParam, OtherTypesAreRefused) {
    EXPECT_EQ(checkParam(meta(proto::INT), param({strValue("3")})).code, RefusalCode::WrongType);
    EXPECT_EQ(checkParam(meta(proto::STR), param({intValue(3)})).code, RefusalCode::WrongType);
    EXPECT_EQ(checkParam(meta(proto::BOOL), param({intValue(1)})).code, RefusalCode::WrongType);
    EXPECT_EQ(checkParam(meta(proto::INT), param({proto::Value()})).code, RefusalCode::WrongType);
    EXPECT_EQ(checkParam(meta(proto::DATA_TYPE_UNSPECIFIED), param({intValue(1)})).code,
              RefusalCode::WrongType);
}

TEST(CheckParam, ATextLargerThan64KiBIsRefused) {
    proto::Value text;
    text.set_str(std::string(64 * 1024, 'x'));
    EXPECT_TRUE(acceptParam(meta(proto::STR), param({text})));
    text.mutable_str()->push_back('x');
    EXPECT_EQ(acceptParam(meta(proto::STR), param({text})).refusal().code, RefusalCode::TooLarge);
}

TEST(CheckParam, NotANumberNeverReachesARobot) {
    for (const double bad :
         {std::nan(""), std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity()})
        EXPECT_EQ(checkParam(meta(proto::DBL), param({dblValue(bad)})).code, RefusalCode::OutOfRange);
}

TEST(CheckParam, LimitsAreInclusive) {
    auto ranged = meta(proto::DBL);
    ranged.set_minimum(-0.5);
    ranged.set_maximum(0.5);
    EXPECT_TRUE(checkParam(ranged, param({dblValue(-0.5)})).ok());
    EXPECT_TRUE(checkParam(ranged, param({dblValue(0.5)})).ok());
    EXPECT_EQ(checkParam(ranged, param({dblValue(std::nextafter(0.5, 1))})).code, RefusalCode::OutOfRange);
    EXPECT_EQ(checkParam(ranged, param({intValue(-1)})).code, RefusalCode::OutOfRange);
}

TEST(CheckParam, LargeIntsAreComparedExactly) {
    auto ranged = meta(proto::INT);
    ranged.set_maximum(9007199254740992.0);
    EXPECT_TRUE(checkParam(ranged, param({intValue(9007199254740992)})).ok());
    EXPECT_EQ(checkParam(ranged, param({intValue(9007199254740993)})).code, RefusalCode::OutOfRange);
}

TEST(CheckParam, OnlyTheChoicesAreAllowed) {
    auto colour = meta(proto::STR);
    *colour.add_choices() = strValue("red");
    *colour.add_choices() = strValue("green");
    EXPECT_TRUE(checkParam(colour, param({strValue("green")})).ok());
    const auto refusal = checkParam(colour, param({strValue("Green")}));
    EXPECT_EQ(refusal.code, RefusalCode::OutOfRange);
    EXPECT_THAT(refusal.message, HasSubstr("one of \"red\", \"green\""));
}

TEST(CheckParam, OneValueUnlessMultipleAndNeverNone) {
    EXPECT_EQ(checkParam(meta(proto::INT), param({})).code, RefusalCode::WrongType);
    EXPECT_EQ(checkParam(meta(proto::INT), param({intValue(1), intValue(2)})).code, RefusalCode::WrongType);
    auto list = meta(proto::INT);
    list.set_multiple(true);
    EXPECT_TRUE(checkParam(list, param({intValue(1), intValue(2)})).ok());
    list.set_maximum(1);
    EXPECT_EQ(checkParam(list, param({intValue(1), intValue(2)})).code, RefusalCode::OutOfRange);
}

TEST(CheckParam, UnitsAreThoseOfTheProfileOrLeftOut) {
    EXPECT_TRUE(checkParam(meta(proto::INT, "mm"), param({intValue(1)})).ok());
    EXPECT_TRUE(checkParam(meta(proto::INT, "mm"), param({intValue(1)}, "mm")).ok());
    EXPECT_EQ(checkParam(meta(proto::INT, "mm"), param({intValue(1)}, "meters")).code,
              RefusalCode::WrongUnits);
    EXPECT_EQ(checkParam(meta(proto::INT), param({intValue(1)}, "mm")).code, RefusalCode::WrongUnits);
}

TEST(ToText, IsWhatParseValueReadsBack) {
    for (const double number : {0.0, 0.1, -1e-300, 123456789.125, 1e300}) {
        const auto back = parseValue(meta(proto::DBL), toText(dblValue(number)));
        ASSERT_TRUE(back.ok());
        EXPECT_EQ(back.value().dbl(), number);
    }
    EXPECT_EQ(toText(dblValue(0.1)), "0.1");
    EXPECT_EQ(toText(intValue(-7)), "-7");
    EXPECT_EQ(toText(proto::Value()), "");
}

TEST(ResourceUrl, LeavesItsFolderByNoWay) {
    for (const auto* path :
         {"lab.map", "maps/lab.map", "a..b", "...", ".hidden", "ma ps/\xC3\xA9", "/srv/maps/lab.map"})
        EXPECT_TRUE(checkResourceUrl(path).ok()) << path;
    for (const auto* path : {"", "/", "//srv/x", "/srv/../etc/passwd", "/..", "..", "../x", "a/../b", "a/..",
                             "./a", "a//b", "a/", "C:x", "a\\b", "file:///x", "a\nb", "a\x7F", "\xFF"})
        EXPECT_EQ(checkResourceUrl(path).code, RefusalCode::BadName) << path;
    EXPECT_EQ(checkResourceUrl(std::string(513, 'a')).code, RefusalCode::BadName);
    EXPECT_EQ(checkResourceUrl(std::string_view("a\0b", 3)).code, RefusalCode::BadName);
}

TEST(RefusalConversion, KeepsCodeMessageAndHolder) {
    const Refusal refusal{RefusalCode::AlreadyHeld, "held", "Ada"};
    const auto back = toRefusal(toProto(refusal));
    EXPECT_EQ(back.code, refusal.code);
    EXPECT_EQ(back.message, refusal.message);
    EXPECT_EQ(back.holder, refusal.holder);
    EXPECT_TRUE(toRefusal(proto::Refusal()).ok());
}

proto::ServicesProfile offered(const std::vector<std::pair<std::string, std::string>>& names) {
    proto::ServicesProfile profile;
    for (const auto& [name, global_id] : names) {
        auto& service = *profile.add_services();
        service.set_name(name);
        service.set_global_id(global_id);
    }
    return profile;
}

TEST(FindService, NamesComeBeforeGlobalIdsAndExactCaseBeforeOther) {
    const auto profile = offered({{"Walk", "go"}, {"go", "walk"}, {"Turning", ""}});
    EXPECT_EQ(findServiceIndex(profile, "go").value(), 1);
    EXPECT_EQ(findServiceIndex(profile, "Walk").value(), 0);
    EXPECT_EQ(findServiceIndex(profile, "walk").value(), 1);
    EXPECT_EQ(findServiceIndex(profile, "TURNING").value(), 2);
    EXPECT_EQ(findService(profile, "turning"), &profile.services(2));
}

TEST(FindService, AnAmbiguousCaseIsRefusedWithTheCandidates) {
    const auto refusal = findServiceIndex(offered({{"Walk", ""}, {"walk", ""}}), "WALK").refusal();
    EXPECT_EQ(refusal.code, RefusalCode::UnknownService);
    EXPECT_THAT(refusal.message, HasSubstr("did you mean \"Walk\" or \"walk\"?"));
}

TEST(FindService, ARefusalNamesNearNamesOrElseWhatThereIs) {
    const auto profile = offered({{"Driving", ""}, {"Turning", ""}});
    EXPECT_THAT(findServiceIndex(profile, "Drving").refusal().message,
                AllOf(HasSubstr("did you mean \"Driving\"?"), Not(HasSubstr("Turning"))));
    EXPECT_THAT(findServiceIndex(profile, "Grab and Place").refusal().message,
                HasSubstr("it has \"Driving\", \"Turning\""));
    EXPECT_THAT(findServiceIndex({}, "x").refusal().message, HasSubstr("it has none"));
    EXPECT_EQ(findService(profile, ""), nullptr);
}

TEST(FindService, AHugeNameCostsNothing) {
    const auto refusal = findServiceIndex(offered({{"Driving", ""}}), std::string(1000000, 'D')).refusal();
    EXPECT_LT(refusal.message.size(), 400U);
}

TEST(FindParam, WorksAsForServices) {
    proto::Service service;
    service.set_name("Walk");
    service.add_params()->set_name("Distance");
    service.add_resources()->set_name("map");
    EXPECT_EQ(findParamIndex(service, "distance").value(), 0);
    EXPECT_EQ(findParamIndex(service, "Distanz").refusal().code, RefusalCode::UnknownParameter);
    EXPECT_EQ(findResourceIndex(service, "Map").value(), 0);
    EXPECT_EQ(findResourceIndex(service, "image").refusal().code, RefusalCode::UnknownResource);
}

TEST(FindParam, OffersNoneThatOnlyTheRobotSets) {
    proto::Service service;
    service.set_name("Walk");
    auto& room = *service.add_params();
    room.set_name("Room");
    room.set_type(proto::OUTPUT);
    EXPECT_EQ(findParamIndex(service, "Room").value(), 0);
    EXPECT_THAT(findParamIndex(service, "Roon").refusal().message, HasSubstr("it has none that can be set"));
    service.add_params()->set_name("Speed");
    EXPECT_THAT(findParamIndex(service, "Roon").refusal().message, HasSubstr("it has \"Speed\""));
    EXPECT_EQ(findParamIndex(service, "Speed").value(), 1);
}

TEST(InQuotes, ShowsAnythingSafely) {
    EXPECT_EQ(inQuotes("a\n\x01\xFF"), "\"a???\"");
    EXPECT_EQ(inQuotes("\xC3\xA9\xC3\xA9", 3), "\"\xC3\xA9...\"") << "cut at the edge of a character";
}

}  // namespace
}  // namespace axon
