// SPDX-License-Identifier: GPL-2.0-or-later
#include "robots/fuzzy/engine.hpp"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <fstream>
#include <limits>
#include <map>
#include <sstream>
#include <utility>

namespace axon::fuzzy {
namespace {

constexpr double kInfinity = std::numeric_limits<double>::infinity();

/// Words of a line; a comma is a word of its own.
std::vector<std::string> wordsOf(std::string_view line) {
    std::vector<std::string> words;
    std::string word;
    const auto end = [&] {
        if (!word.empty()) words.push_back(std::exchange(word, {}));
    };
    for (const char c : line.substr(0, line.find('#'))) {
        if (c == ' ' || c == '\t' || c == '\r') {
            end();
        } else if (c == ',') {
            end();
            words.emplace_back(",");
        } else {
            word += c;
        }
    }
    end();
    return words;
}

}  // namespace

/// One text on its way to an Engine.
class RuleParser {
  public:
    RuleParser(std::string_view text, std::string name) : text_(text) { engine_.name_ = std::move(name); }

    Engine parse() {
        std::size_t begin = 0;
        while (begin <= text_.size()) {
            const auto end = std::min(text_.find('\n', begin), text_.size());
            ++line_;
            words_ = wordsOf(text_.substr(begin, end - begin));
            at_ = 0;
            if (!words_.empty()) statement();
            begin = end + 1;
        }
        if (engine_.rules_.empty())
            fail("there is no rule: expected lines such as \"rule if front is near then speed is stop\"");
        return std::move(engine_);
    }

  private:
    struct Term {
        std::string name;
        double value = 0;  // of an output
    };
    enum class Section { None, Input, Output };

    [[noreturn]] void fail(const std::string& message) const {
        throw BadRules(fmt::format("{}:{}: {}", engine_.name_, line_, message));
    }
    std::string next(std::string_view expected) {
        if (at_ >= words_.size()) fail(fmt::format("the line ends where {} was expected", expected));
        return words_[at_++];
    }
    bool accept(std::string_view word) {
        const bool found = at_ < words_.size() && words_[at_] == word;
        at_ += found ? 1 : 0;
        return found;
    }
    void expect(std::string_view word) {
        const auto found = next(fmt::format("\"{}\"", word));
        if (found != word) fail(fmt::format("\"{}\" where \"{}\" was expected", found, word));
    }
    double number(std::string_view expected) {
        const auto word = next(expected);
        double value = 0;
        const auto result = std::from_chars(word.data(), word.data() + word.size(), value);
        if (result.ec != std::errc{} || result.ptr != word.data() + word.size() || !std::isfinite(value))
            fail(fmt::format("\"{}\" where {}, a number, was expected", word, expected));
        return value;
    }
    std::string newName(std::string_view expected, const std::vector<std::string>& taken) {
        auto name = next(expected);
        static constexpr std::string_view kWords[] = {"if", "is", "not", "and", "then", "weight", ","};
        if (std::find(std::begin(kWords), std::end(kWords), name) != std::end(kWords))
            fail(fmt::format("\"{}\" cannot be a name, it is a word of rules", name));
        if (std::find(taken.begin(), taken.end(), name) != taken.end())
            fail(fmt::format("there is a \"{}\" already", name));
        return name;
    }
    std::size_t find(std::string_view kind, const std::string& name,
                     const std::vector<std::string>& names) const {
        const auto found = std::find(names.begin(), names.end(), name);
        if (found == names.end())
            fail(fmt::format("there is no {} \"{}\": there are {}", kind, name, fmt::join(names, ", ")));
        return static_cast<std::size_t>(found - names.begin());
    }

    void statement() {
        const auto word = next("a statement");
        if (word == "conjunction") {
            const auto kind = next("min or product");
            if (kind != "min" && kind != "product")
                fail(fmt::format("conjunction {}: expected min or product", kind));
            engine_.product_ = kind == "product";
        } else if (word == "input") {
            engine_.input_names_.push_back(newName("the input's name", engine_.input_names_));
            engine_.sets_.emplace_back();
            input_terms_.emplace_back();
            section_ = Section::Input;
        } else if (word == "output") {
            engine_.output_names_.push_back(newName("the output's name", engine_.output_names_));
            engine_.otherwise_.push_back(number("its value when no rule holds"));
            output_terms_.emplace_back();
            output_values_.emplace_back();
            section_ = Section::Output;
        } else if (word == "term") {
            term();
        } else if (word == "rule") {
            rule();
        } else {
            fail(fmt::format("\"{}\": expected conjunction, input, output, term or rule", word));
        }
        if (at_ < words_.size()) fail(fmt::format("\"{}\" is too much on this line", words_[at_]));
    }

    void term() {
        if (section_ == Section::None) fail("a term belongs below an input or an output");
        if (section_ == Section::Output) {
            auto name = newName("the term's name", output_terms_.back());
            output_values_.back().push_back(number("the term's value"));
            output_terms_.back().push_back(std::move(name));
            return;
        }
        auto name = newName("the term's name", input_terms_.back());
        const auto shape = next("below, above, triangle or trapezoid");
        Engine::Trapezoid set;
        if (shape == "below") {
            const double c = number("the end of the plateau");
            set = {-kInfinity, -kInfinity, c, number("where it falls to 0")};
        } else if (shape == "above") {
            const double a = number("where it rises from 0");
            set = {a, number("the begin of the plateau"), kInfinity, kInfinity};
        } else if (shape == "triangle") {
            const double a = number("the left corner");
            const double b = number("the top");
            set = {a, b, b, number("the right corner")};
        } else if (shape == "trapezoid") {
            const double a = number("corner 1 of 4");
            const double b = number("corner 2 of 4");
            const double c = number("corner 3 of 4");
            set = {a, b, c, number("corner 4 of 4")};
        } else {
            fail(fmt::format("\"{}\": expected below, above, triangle or trapezoid", shape));
        }
        if (!(set.a <= set.b && set.b <= set.c && set.c <= set.d)) fail("the corners must not descend");
        engine_.sets_.back().push_back(set);
        input_terms_.back().push_back(std::move(name));
    }

    void rule() {
        Engine::Rule rule;
        expect("if");
        do {
            Engine::Premise premise;
            premise.input = find("input", next("an input"), engine_.input_names_);
            expect("is");
            premise.negated = accept("not");
            premise.term = find("term", next("a term"), input_terms_[premise.input]);
            rule.premises.push_back(premise);
        } while (accept("and"));
        expect("then");
        do {
            Engine::Conclusion conclusion;
            conclusion.output = find("output", next("an output"), engine_.output_names_);
            expect("is");
            const auto term = find("term", next("a term"), output_terms_[conclusion.output]);
            conclusion.value = output_values_[conclusion.output][term];
            for (const auto& other : rule.conclusions) {
                if (other.output == conclusion.output) fail("a rule says two things about one output");
            }
            rule.conclusions.push_back(conclusion);
        } while (accept(","));
        if (accept("weight")) {
            rule.weight = number("the weight");
            if (!(rule.weight > 0 && rule.weight <= 1)) fail("a weight is above 0 and at most 1");
        }
        engine_.rules_.push_back(std::move(rule));
    }

    const std::string_view text_;
    Engine engine_;
    int line_ = 0;
    std::vector<std::string> words_;
    std::size_t at_ = 0;
    Section section_ = Section::None;
    std::vector<std::vector<std::string>> input_terms_;
    std::vector<std::vector<std::string>> output_terms_;
    std::vector<std::vector<double>> output_values_;
};

double Engine::Trapezoid::operator()(double value) const {
    if (value >= b && value <= c) return 1;
    if (value <= a || value >= d) return 0;
    return value < b ? (value - a) / (b - a) : (d - value) / (d - c);
}

Engine Engine::parse(std::string_view text, const std::string& name) {
    return RuleParser(text, name).parse();
}

Engine Engine::load(const std::filesystem::path& file) {
    std::ifstream in(file);
    if (!in) throw BadRules(fmt::format("{}:0: the rules cannot be read: is the file there?", file.string()));
    std::ostringstream text;
    text << in.rdbuf();
    return parse(text.str(), file.string());
}

std::vector<double> Engine::evaluate(std::span<const double> values) const {
    if (values.size() != input_names_.size() ||
        std::any_of(values.begin(), values.end(), [](double v) { return std::isnan(v); }))
        throw std::invalid_argument(
            fmt::format("{}: expected a number for each of {}", name_, fmt::join(input_names_, ", ")));
    std::vector<double> sum(output_names_.size());
    std::vector<double> weights(output_names_.size());
    for (const auto& rule : rules_) {
        double truth = 1;
        for (const auto& premise : rule.premises) {
            double part = sets_[premise.input][premise.term](values[premise.input]);
            if (premise.negated) part = 1 - part;
            truth = product_ ? truth * part : std::min(truth, part);
        }
        truth *= rule.weight;
        for (const auto& conclusion : rule.conclusions) {
            sum[conclusion.output] += truth * conclusion.value;
            weights[conclusion.output] += truth;
        }
    }
    for (std::size_t i = 0; i < sum.size(); ++i)
        sum[i] = weights[i] > 0 ? sum[i] / weights[i] : otherwise_[i];
    return sum;
}

void Engine::require(const std::vector<std::string>& inputs, const std::vector<std::string>& outputs) const {
    if (inputs == input_names_ && outputs == output_names_) return;
    throw BadRules(fmt::format(
        "{}:0: the program needs the inputs {} and the outputs {}, in this order; the rules have {} and {}",
        name_, fmt::join(inputs, ", "), fmt::join(outputs, ", "), fmt::join(input_names_, ", "),
        fmt::join(output_names_, ", ")));
}

}  // namespace axon::fuzzy
