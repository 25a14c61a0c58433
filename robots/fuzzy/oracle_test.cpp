// SPDX-License-Identifier: GPL-2.0-or-later
// The engine beside fuzzylite, which nobody here wrote: the PeopleBot's own rules, at thousands of inputs.
#include <fl/Headers.h>
#include <fmt/format.h>
#include <gtest/gtest.h>

#include <fstream>
#include <random>
#include <sstream>

#include "robots/fuzzy/engine.hpp"

namespace axon::fuzzy {
namespace {

/// The same rules in fuzzylite's language (FLL). Reads the lines on its own, so that a mistake of the
/// engine's reader is not repeated here.
std::string inFuzzyliteLanguage(const std::string& file) {
    std::ifstream in(file);
    std::string engine = "Engine: robot\n";
    std::string rules;
    std::string conjunction = "Minimum";
    std::string line;
    while (std::getline(in, line)) {
        std::istringstream words(line.substr(0, line.find('#')));
        std::string kind;
        if (!(words >> kind)) continue;
        std::string name;
        if (kind == "conjunction") {
            words >> name;
            conjunction = name == "product" ? "AlgebraicProduct" : "Minimum";
        } else if (kind == "input") {
            words >> name;
            engine += fmt::format(
                "InputVariable: {}\n  enabled: true\n  range: -10000 10000\n  lock-range: false\n", name);
        } else if (kind == "output") {
            double otherwise = 0;
            words >> name >> otherwise;
            engine += fmt::format(
                "OutputVariable: {}\n  enabled: true\n  range: -10000 10000\n  lock-range: false\n  "
                "aggregation: none\n"
                "  defuzzifier: WeightedAverage TakagiSugeno\n  default: {}\n  lock-previous: false\n",
                name, otherwise);
        } else if (kind == "term") {
            std::string shape;
            words >> name >> shape;
            double a = 0;
            double b = 0;
            double c = 0;
            double d = 0;
            if (shape == "below") {
                words >> c >> d;
                engine += fmt::format("  term: {} Trapezoid -inf -inf {} {}\n", name, c, d);
            } else if (shape == "above") {
                words >> a >> b;
                engine += fmt::format("  term: {} Trapezoid {} {} inf inf\n", name, a, b);
            } else if (shape == "triangle") {
                words >> a >> b >> c;
                engine += fmt::format("  term: {} Triangle {} {} {}\n", name, a, b, c);
            } else if (shape == "trapezoid") {
                words >> a >> b >> c >> d;
                engine += fmt::format("  term: {} Trapezoid {} {} {} {}\n", name, a, b, c, d);
            } else {
                engine += fmt::format("  term: {} Constant {}\n", name, shape);
            }
        } else if (kind == "rule") {
            std::string rule = line.substr(line.find("if"));
            // A comma joins conclusions in ours, "and" in fuzzylite's.
            for (auto at = rule.find(','); at != std::string::npos; at = rule.find(','))
                rule.replace(at, 1, " and");
            if (const auto at = rule.find(" weight "); at != std::string::npos) rule.replace(at, 8, " with ");
            rules += "  rule: " + rule + "\n";
        }
    }
    return engine + "RuleBlock: rules\n  enabled: true\n  conjunction: " + conjunction +
           "\n  disjunction: none\n  implication: none\n  activation: General\n" + rules;
}

void compare(const std::string& file) {
    const auto ours = Engine::load(file);
    const std::unique_ptr<fl::Engine> theirs(fl::FllImporter().fromString(inFuzzyliteLanguage(file)));
    std::string status;
    ASSERT_TRUE(theirs->isReady(&status)) << status;
    std::mt19937 chance(1);
    int compared = 0;
    for (int i = 0; i < 5000; ++i) {
        std::vector<double> values;
        for (const auto& name : ours.inputs()) {
            const double part = static_cast<double>(chance()) / static_cast<double>(std::mt19937::max());
            const bool side = name == "favour" || name == "route";
            // Mostly near, where the sets overlap.
            values.push_back(side ? 2.4 * part - 1.2 : 5000 * part * part * part);
            theirs->setInputValue(name, values.back());
        }
        theirs->process();
        const auto wish = ours.evaluate(values);
        for (std::size_t k = 0; k < wish.size(); ++k, ++compared) {
            ASSERT_NEAR(wish[k], theirs->getOutputValue(ours.outputs()[k]), 1e-6)
                << file << ": " << ours.outputs()[k] << " at " << ::testing::PrintToString(values);
        }
    }
    EXPECT_EQ(compared, 10000);
}

TEST(FuzzyOracle, WanderRulesMeanTheSameToFuzzylite) {
    compare("robots/peoplebot/wander.rules");
}
TEST(FuzzyOracle, NavigationRulesMeanTheSameToFuzzylite) {
    compare("robots/peoplebot/navigation.rules");
}

}  // namespace
}  // namespace axon::fuzzy

// The library of fuzzylite has a main() of its own, which would be taken instead of GoogleTest's.
int main(int argc, char** argv) {
    ::testing::InitGoogleTest(&argc, argv);
    return RUN_ALL_TESTS();
}
