// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/fuzzy/engine.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <limits>

namespace axon::fuzzy {
namespace {

using ::testing::HasSubstr;

constexpr auto kSmall = R"(
input distance
term near below 200 600
term middle triangle 200 600 1000
term far above 600 1000
output speed 7     # when nothing holds
term stop 0
term fast 100
rule if distance is near then speed is stop
rule if distance is far then speed is fast
)";

double speedAt(const Engine& engine, double distance) {
    return engine.evaluate(std::vector{distance}).at(0);
}
std::string complaint(const std::string& text) {
    try {
        Engine::parse(text, "x.rules");
    } catch (const BadRules& error) {
        return error.what();
    }
    return "no complaint";
}

TEST(FuzzyEngine, ShouldersPlateausAndSlopes) {
    const Engine::Trapezoid set{1, 2, 3, 5};
    EXPECT_EQ(set(0), 0);
    EXPECT_EQ(set(1.5), 0.5);
    EXPECT_EQ(set(2.5), 1);
    EXPECT_EQ(set(4), 0.5);
    EXPECT_EQ(set(6), 0);
    const Engine::Trapezoid point{2, 2, 2, 2};
    EXPECT_EQ(point(2), 1);
    EXPECT_EQ(point(2.1), 0);
}

TEST(FuzzyEngine, MixesTheRulesThatHoldAndFallsBackWhereNoneDoes) {
    const auto engine = Engine::parse(kSmall, "small");
    EXPECT_EQ(speedAt(engine, -5), 0);
    EXPECT_EQ(speedAt(engine, 5000), 100);
    EXPECT_EQ(speedAt(engine, 600), 7);
}

TEST(FuzzyEngine, NotWeightAndBothConjunctions) {
    const std::string text = R"(
input a
term high above 0 1
input b
term high above 0 1
output y 0
term no 0
term yes 1
rule if a is high and b is not high then y is yes
rule if a is high then y is no weight 0.5
)";
    const std::vector values{0.5, 0.6};
    EXPECT_DOUBLE_EQ(Engine::parse(text, "min").evaluate(values).at(0), 0.4 / (0.4 + 0.25));
    EXPECT_DOUBLE_EQ(Engine::parse("conjunction product\n" + text, "product").evaluate(values).at(0),
                     0.2 / (0.2 + 0.25));
}

TEST(FuzzyEngine, ErrorsNameFileAndLineAndWhatWasExpected) {
    EXPECT_THAT(complaint(""), HasSubstr("there is no rule"));
    EXPECT_THAT(complaint("input a\nterm x bellow 1 2"),
                HasSubstr("x.rules:2: \"bellow\": expected below, above"));
    EXPECT_THAT(complaint("input a\nterm x below 1 zwei"), HasSubstr("x.rules:2: \"zwei\" where"));
    EXPECT_THAT(complaint("input a\nterm x below 3 2"), HasSubstr("must not descend"));
    EXPECT_THAT(complaint("term x below 3 2"), HasSubstr("belongs below an input"));
    EXPECT_THAT(complaint("input a\ninput a"), HasSubstr("x.rules:2: there is a \"a\" already"));
    EXPECT_THAT(complaint("input a\nterm x below 1 2\nrule if b is x then y is z"),
                HasSubstr("x.rules:3: there is no input \"b\": there are a"));
    EXPECT_THAT(complaint("input a\nterm x below 1 2\nrule if a is"),
                HasSubstr("the line ends where a term"));
    EXPECT_THAT(complaint("output y"), HasSubstr("its value when no rule holds"));
    EXPECT_THAT(complaint(std::string(kSmall) + "rule if distance is far then speed is fast faster"),
                HasSubstr("too much"));
    EXPECT_THAT(complaint(std::string(kSmall) + "rule if distance is far then speed is fast, speed is stop"),
                HasSubstr("two things"));
    EXPECT_THAT(complaint("hello"), HasSubstr("x.rules:1: \"hello\": expected conjunction"));
    EXPECT_THROW(Engine::load("no/such.rules"), BadRules);
}

TEST(FuzzyEngine, WrongInputsAreRefused) {
    const auto engine = Engine::parse(kSmall, "small");
    EXPECT_THROW(engine.evaluate({}), std::invalid_argument);
    EXPECT_THROW(speedAt(engine, std::numeric_limits<double>::quiet_NaN()), std::invalid_argument);
    EXPECT_EQ(speedAt(engine, std::numeric_limits<double>::infinity()), 100);
    EXPECT_NO_THROW(engine.require({"distance"}, {"speed"}));
    EXPECT_THROW(engine.require({"distance"}, {"turn"}), BadRules);
}

}  // namespace
}  // namespace axon::fuzzy
