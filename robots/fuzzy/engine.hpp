// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <span>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

namespace axon::fuzzy {

/// Rules that cannot be used. The message begins with file and line and says what was expected.
class BadRules : public std::runtime_error {
    using std::runtime_error::runtime_error;
};

/// A zero-order Sugeno system: fuzzy sets over the inputs, rules, and for each output the mean of the
/// constants that the rules conclude, weighted by how far each rule holds (T. Takagi and M. Sugeno, "Fuzzy
/// identification of systems and its applications to modeling and control", IEEE Trans. SMC 15(1), 1985).
/// Small on purpose: no "or" (write two rules), no defuzzification of areas, hence no centroid that drives a
/// robot straight at what it should pass on either side.
///
/// Rules are read from text, a statement a line, `#` begins a comment:
///
///     conjunction product             or: min, which is the default
///     input front                     the terms that follow are its fuzzy sets
///     term near below 200 600         1 up to 200, 0 from 600 on
///     term middle triangle 200 600 1200
///     term wide trapezoid 200 600 900 1200
///     term far above 600 1200         0 up to 600, 1 from 1200 on
///     output speed 0                  0: its value when no rule about it holds
///     term stop 0
///     term fast 100
///     rule if front is near then speed is stop
///     rule if front is not near and left is far then speed is fast, turn is none weight 0.5
///
/// A value type, immutable after parse(); any thread may evaluate. Units are the rule file's.
class Engine {
  public:
    /// `name` is what errors call the text: the file. Throws BadRules.
    static Engine parse(std::string_view text, const std::string& name);
    /// Throws BadRules, also when the file cannot be read.
    static Engine load(const std::filesystem::path& file);

    /// The outputs in the order of the text, for inputs in the order of the text; as many as inputs() has,
    /// and none of them NaN (std::invalid_argument).
    std::vector<double> evaluate(std::span<const double> values) const;

    const std::vector<std::string>& inputs() const { return input_names_; }
    const std::vector<std::string>& outputs() const { return output_names_; }
    /// Throws BadRules when inputs or outputs are not exactly these, in this order: for programs that feed
    /// them.
    void require(const std::vector<std::string>& inputs, const std::vector<std::string>& outputs) const;

    /// How far a value belongs to a set: 0 up to a, rising to 1 at b, 1 up to c, falling to 0 at d. Infinite
    /// corners make shoulders.
    struct Trapezoid {
        double a = 0, b = 0, c = 0, d = 0;
        double operator()(double value) const;
    };

  private:
    friend class RuleParser;
    struct Premise {
        std::size_t input = 0;
        std::size_t term = 0;
        bool negated = false;
    };
    struct Conclusion {
        std::size_t output = 0;
        double value = 0;
    };
    struct Rule {
        std::vector<Premise> premises;
        std::vector<Conclusion> conclusions;
        double weight = 1;
    };

    std::string name_;
    bool product_ = false;
    std::vector<std::string> input_names_;
    std::vector<std::vector<Trapezoid>> sets_;  // of each input
    std::vector<std::string> output_names_;
    std::vector<double> otherwise_;  // of each output
    std::vector<Rule> rules_;
};

}  // namespace axon::fuzzy
