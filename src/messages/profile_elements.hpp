// SPDX-License-Identifier: MIT
#pragma once
#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <map>
#include <optional>
#include <set>
#include <string>
#include <string_view>
#include <system_error>
#include <utility>
#include <vector>

#include "messages/profile_reader.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"
#include "messages/xml_document.hpp"

// What the readers of the three kinds of profiles have in common. For profile_reader.cpp and its parts alone.
namespace axon::profiles {

using Severity = Finding::Severity;

inline constexpr std::size_t kMaxNameCharacters = 128;

/// Where the findings of one file come together.
class Findings {
  public:
    explicit Findings(std::string_view file) : file_(file) {}

    void add(Severity severity, int line, std::string element, std::string expected, std::string fix) {
        if (severity == Severity::Error) ++errors_;
        if (findings_.size() >= kMaxFindings) {
            ++left_out_;
            return;
        }
        findings_.push_back({file_, line, severity, std::move(element), std::move(expected), std::move(fix)});
    }
    void error(int line, std::string element, std::string expected, std::string fix) {
        add(Severity::Error, line, std::move(element), std::move(expected), std::move(fix));
    }
    void warning(int line, std::string element, std::string expected, std::string fix) {
        add(Severity::Warning, line, std::move(element), std::move(expected), std::move(fix));
    }

    std::vector<Finding> take() {
        std::stable_sort(findings_.begin(), findings_.end(),
                         [](const Finding& a, const Finding& b) { return a.line < b.line; });
        if (left_out_ > 0) {
            findings_.push_back({file_, 0, errors_ > 0 ? Severity::Error : Severity::Warning, "document",
                                 "at most " + std::to_string(kMaxFindings) + " findings, there are " +
                                     std::to_string(left_out_) + " more",
                                 "fix the ones above and check again"});
        }
        return std::move(findings_);
    }

  private:
    std::string file_;
    std::vector<Finding> findings_;
    std::size_t left_out_ = 0;
    std::size_t errors_ = 0;
};

template <class Enum>
struct Spelling {
    std::string_view text;
    Enum value;
    std::string_view fix = {};  ///< not empty: a tolerated spelling, and what to write instead
};

/// One element under reading: its attributes and children are taken by name, and what nobody took is
/// reported.
class Reader {
  public:
    Reader(const XmlElement& element, Findings& findings)
        : element_(element),
          findings_(findings),
          label_(element.name),
          taken_(element.attributes.size(), false) {}

    const XmlElement& element() const { return element_; }
    int line() const { return element_.line; }
    const std::string& label() const { return label_; }
    void nameIt(std::string_view name) { label_ = element_.name + " " + inQuotes(name); }

    void error(int line, std::string_view attribute, std::string expected, std::string fix) {
        findings_.error(line, about(attribute), std::move(expected), std::move(fix));
    }
    void warning(int line, std::string_view attribute, std::string expected, std::string fix) {
        findings_.warning(line, about(attribute), std::move(expected), std::move(fix));
    }

    const XmlAttribute* take(std::string_view name) {
        if (std::find(known_.begin(), known_.end(), name) == known_.end()) known_.push_back(name);
        for (std::size_t i = 0; i < element_.attributes.size(); ++i) {
            if (element_.attributes[i].name != name) continue;
            taken_[i] = true;
            return &element_.attributes[i];
        }
        return nullptr;
    }

    int lineOf(std::string_view attribute) const {
        for (const auto& candidate : element_.attributes)
            if (candidate.name == attribute) return candidate.line;
        return element_.line;
    }

    std::string text(std::string_view attribute) {
        const auto* found = take(attribute);
        return found == nullptr ? std::string() : found->value;
    }

    /// A name by the rules of all names; empty where it is unusable, which then is an error already reported.
    std::string name(std::string_view attribute, bool required = true) {
        const auto* found = take(attribute);
        if (found == nullptr) {
            if (required) missing(attribute, "a name");
            return {};
        }
        const auto stripped = trimmed(found->value);
        if (!stripped.empty() && stripped.size() != found->value.size())
            warning(found->line, attribute, "a name without white space at its ends",
                    "write " + inQuotes(stripped));
        const std::size_t characters = countCharacters(stripped);
        const bool control = std::any_of(stripped.begin(), stripped.end(), [](char c) {
            return static_cast<unsigned char>(c) < 0x20U || c == 0x7F;
        });
        if (stripped.empty()) {
            error(found->line, attribute, "a name that is not empty", "give it a name");
        } else if (characters > kMaxNameCharacters) {
            error(found->line, attribute,
                  "a name of at most " + std::to_string(kMaxNameCharacters) + " characters, found " +
                      std::to_string(characters),
                  "shorten it and move the rest to descr");
        } else if (control) {
            error(found->line, attribute, "a name without line ends and control characters",
                  "write it in one line");
        } else {
            return std::string(stripped);
        }
        return {};
    }

    bool flag(std::string_view attribute, bool fallback) {
        const auto* found = take(attribute);
        if (found == nullptr) return fallback;
        return flagOf(*found).value_or(fallback);
    }

    /// A flag that the thesis' text and its figures call by different names.
    bool flag(std::string_view attribute, std::string_view figure_spelling, bool fallback) {
        const auto* found = take(attribute);
        const auto* legacy = take(figure_spelling);
        if (legacy == nullptr) return found == nullptr ? fallback : flagOf(*found).value_or(fallback);
        const auto value = flagOf(*legacy);
        const auto preferred = found == nullptr ? value : flagOf(*found);
        if (value && preferred && *value != *preferred) {
            error(legacy->line, figure_spelling,
                  "the same value as " + std::string(attribute) + ", whose other spelling it is",
                  "remove " + std::string(figure_spelling));
        } else {
            warning(legacy->line, figure_spelling,
                    std::string(attribute) + ", as the thesis' text calls this flag",
                    "rename it to " + std::string(attribute));
        }
        return preferred.value_or(fallback);
    }

    std::optional<double> number(std::string_view attribute, std::string_view what) {
        const auto* found = take(attribute);
        if (found == nullptr) return {};
        const auto value = parseNumber<double>(found->value);
        if (value && std::isfinite(*value)) return value;
        error(found->line, attribute, std::string(what) + ", found " + inQuotes(found->value),
              "write a number with a decimal point and no unit, such as 12.5");
        return {};
    }

    std::optional<std::int32_t> count(std::string_view attribute, std::string_view what) {
        const auto* found = take(attribute);
        if (found == nullptr) return {};
        const auto value = parseNumber<std::int32_t>(found->value);
        if (value && *value >= 0) return value;
        error(found->line, attribute, std::string(what) + ", found " + inQuotes(found->value),
              "write a whole number from 0, such as 1");
        return {};
    }

    /// A count that the file states and the reader counts itself; a difference is a warning (figures 3.3 and
    /// A.1).
    void statedCount(std::string_view attribute, std::size_t counted, std::string_view what) {
        const auto stated = count(attribute, "the number of " + std::string(what));
        if (stated && static_cast<std::size_t>(*stated) != counted)
            warning(lineOf(attribute), attribute,
                    "the number of " + std::string(what) + ", which is " + std::to_string(counted) +
                        ", found " + std::to_string(*stated),
                    "write " + std::to_string(counted) + " or leave the attribute out");
    }

    template <class Enum>
    std::optional<Enum> choice(std::string_view attribute, const std::vector<Spelling<Enum>>& spellings,
                               bool required) {
        std::vector<std::string> allowed;
        for (const auto& spelling : spellings)
            if (spelling.fix.empty()) allowed.emplace_back(spelling.text);
        const std::string expected = "one of " + joined(allowed);
        const auto* found = take(attribute);
        if (found == nullptr) {
            if (required) missing(attribute, expected);
            return {};
        }
        const auto text = trimmed(found->value);
        for (const auto& spelling : spellings) {
            if (spelling.text != text) continue;
            if (!spelling.fix.empty())
                warning(found->line, attribute, expected + ", found " + inQuotes(text),
                        std::string(spelling.fix));
            return spelling.value;
        }
        std::string fix = "write one of them";
        for (const auto& name : allowed)
            if (equalIgnoringCase(name, text)) fix = "write " + name;
        error(found->line, attribute, expected + ", found " + inQuotes(found->value), std::move(fix));
        return {};
    }

    void missing(std::string_view attribute, std::string expected) {
        error(line(), attribute, std::move(expected) + "; the attribute is missing",
              "add " + std::string(attribute) + "=\"...\"");
    }

    /// Reports the attributes that nobody took. Call it after everything that is taken.
    void reportUnknownAttributes() {
        for (std::size_t i = 0; i < taken_.size(); ++i) {
            const auto& attribute = element_.attributes[i];
            // Hints for editors (xsi:noNamespaceSchemaLocation, xml:lang) are nobody's mistake.
            if (taken_[i] || attribute.name.starts_with("xsi:") || attribute.name.starts_with("xml:"))
                continue;
            const auto near = nearNames(attribute.name, known_);
            warning(attribute.line, attribute.name,
                    "one of the attributes " + joined(known_) + "; this one is ignored",
                    near.empty() ? "remove it" : "did you mean " + alternatives(near) + "?");
        }
    }

    /// Calls `read` for each child by its name. A known element at a wrong place is an error, since a
    /// parameter or a resource would be lost without a word; any other element is a warning. So is text.
    template <class Read>
    void children(std::initializer_list<std::string_view> names, const Read& read) {
        static const std::set<std::string_view> kKnown = {
            "BasicProfile", "ServiceProfile", "ServicesProfile", "GlobalProfile", "Service",   "Parameters",
            "Param",        "Values",         "Value",           "Choices",       "Choice",    "Resources",
            "Resource",     "Services",       "ServiceRef",      "entity",        "key_value", "compensate"};
        const std::vector<std::string_view> allowed(names);
        const std::string expected = allowed.empty() ? "no elements in " + element_.name
                                                     : "only " + joined(allowed) + " in " + element_.name;
        for (const auto& child : element_.children) {
            if (std::find(allowed.begin(), allowed.end(), child.name) != allowed.end()) {
                read(child);
                continue;
            }
            const std::string label = child.name + " in " + label_;
            const auto near = nearNames(child.name, allowed);
            const bool slip = std::any_of(allowed.begin(), allowed.end(),
                                          [&](auto name) { return equalIgnoringCase(name, child.name); });
            if (kKnown.contains(child.name) || slip) {
                findings_.error(child.line, label, expected,
                                slip ? "write " + alternatives(near)
                                     : "move it to where docs/reference/profiles.md has it");
            } else {
                findings_.warning(child.line, label,
                                  expected + "; this one is ignored with all that is in it",
                                  near.empty() ? "remove it" : "did you mean " + alternatives(near) + "?");
            }
        }
        const auto stray = trimmed(element_.text);
        if (!stray.empty())
            warning(line(), {}, "no text directly in " + element_.name + ", found " + inQuotes(stray, 30),
                    "write it as an attribute, or as a comment");
    }

    Findings& findings() { return findings_; }

    template <class Names>
    static std::string joined(const Names& names) {
        std::string out;
        for (const auto& name : names) {
            if (!out.empty()) out += ", ";
            out += name;
        }
        return out;
    }

  private:
    std::string about(std::string_view attribute) const {
        return attribute.empty() ? label_ : label_ + " " + std::string(attribute);
    }

    std::optional<bool> flagOf(const XmlAttribute& attribute) {
        const auto text = trimmed(attribute.value);
        if (text == "true" || text == "1") return true;
        if (text == "false" || text == "0") return false;
        error(attribute.line, attribute.name, "one of true, false, found " + inQuotes(attribute.value),
              "write true or false");
        return {};
    }

    template <class Number>
    static std::optional<Number> parseNumber(std::string_view text) {
        text = trimmed(text);
        if (text.size() > 1 && text[0] == '+' && text[1] != '-') text.remove_prefix(1);
        Number value{};
        const auto [end, failure] = std::from_chars(text.data(), text.data() + text.size(), value);
        if (failure != std::errc{} || end != text.data() + text.size()) return {};
        return value;
    }

    const XmlElement& element_;
    Findings& findings_;
    std::string label_;
    std::vector<bool> taken_;
    std::vector<std::string_view> known_;
};

inline const std::vector<Spelling<proto::Category>> kCategories = {{"ROBOT", proto::ROBOT},
                                                                   {"MACHINE", proto::MACHINE}};
inline const std::vector<Spelling<proto::Mobility>> kMobilities = {{"MOBILE", proto::MOBILE},
                                                                   {"STATIONARY", proto::STATIONARY}};

/// Names that must differ within one list; says where the first one stands.
class UniqueNames {
  public:
    explicit UniqueNames(std::string what) : what_(std::move(what)) {}

    bool claim(Reader& reader, std::string_view attribute, const std::string& name) {
        if (name.empty()) return true;
        const int line = reader.lineOf(attribute);
        const auto [first, fresh] = lines_.emplace(name, line);
        if (!fresh)
            reader.error(line, attribute,
                         what_ + " that no other has; " + inQuotes(name) + " is also in line " +
                             std::to_string(first->second),
                         "rename one of the two");
        return fresh;
    }

  private:
    std::string what_;
    std::map<std::string, int> lines_;
};

/// Of a file whose outermost element is the right one; what is wrong comes together in `findings`.
proto::ServicesProfile readServices(const XmlElement& root, Findings& findings);
proto::GlobalProfile readGlobal(const XmlElement& root, Findings& findings);

}  // namespace axon::profiles
