// SPDX-License-Identifier: MIT
#include "messages/profile_reader.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <fstream>
#include <map>
#include <optional>
#include <set>
#include <system_error>
#include <utility>

#include "common/entity_name.hpp"
#include "messages/composites.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"
#include "messages/xml_document.hpp"

namespace axon {
namespace {

using Severity = Finding::Severity;

constexpr std::size_t kMaxNameCharacters = 128;
constexpr std::size_t kMaxChoices = 256;  // each value is compared with each choice
constexpr double kLongestDuration_s = 24 * 3600;

/// Where the findings of one file come together.
class Findings {
  public:
    explicit Findings(std::string_view file) : file_(file) {}

    void add(Severity severity, int line, std::string element, std::string expected, std::string mend) {
        if (severity == Severity::Error) ++errors_;
        if (findings_.size() >= kMaxFindings) {
            ++left_out_;
            return;
        }
        findings_.push_back(
            {file_, line, severity, std::move(element), std::move(expected), std::move(mend)});
    }
    void error(int line, std::string element, std::string expected, std::string mend) {
        add(Severity::Error, line, std::move(element), std::move(expected), std::move(mend));
    }
    void warning(int line, std::string element, std::string expected, std::string mend) {
        add(Severity::Warning, line, std::move(element), std::move(expected), std::move(mend));
    }

    std::vector<Finding> take() {
        std::stable_sort(findings_.begin(), findings_.end(),
                         [](const Finding& a, const Finding& b) { return a.line < b.line; });
        if (left_out_ > 0) {
            findings_.push_back({file_, 0, errors_ > 0 ? Severity::Error : Severity::Warning, "document",
                                 "at most " + std::to_string(kMaxFindings) + " findings, there are " +
                                     std::to_string(left_out_) + " more",
                                 "mend the ones above and check again"});
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
    std::string_view mend = {};  ///< not empty: a tolerated spelling, and what to write instead
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

    void error(int line, std::string_view attribute, std::string expected, std::string mend) {
        findings_.error(line, about(attribute), std::move(expected), std::move(mend));
    }
    void warning(int line, std::string_view attribute, std::string expected, std::string mend) {
        findings_.warning(line, about(attribute), std::move(expected), std::move(mend));
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
            if (spelling.mend.empty()) allowed.emplace_back(spelling.text);
        const std::string expected = "one of " + joined(allowed);
        const auto* found = take(attribute);
        if (found == nullptr) {
            if (required) missing(attribute, expected);
            return {};
        }
        const auto text = trimmed(found->value);
        for (const auto& spelling : spellings) {
            if (spelling.text != text) continue;
            if (!spelling.mend.empty())
                warning(found->line, attribute, expected + ", found " + inQuotes(text),
                        std::string(spelling.mend));
            return spelling.value;
        }
        std::string mend = "write one of them";
        for (const auto& name : allowed)
            if (equalIgnoringCase(name, text)) mend = "write " + name;
        error(found->line, attribute, expected + ", found " + inQuotes(found->value), std::move(mend));
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

const std::vector<Spelling<proto::Category>> kCategories = {{"ROBOT", proto::ROBOT},
                                                            {"MACHINE", proto::MACHINE}};
const std::vector<Spelling<proto::Mobility>> kMobilities = {{"MOBILE", proto::MOBILE},
                                                            {"STATIONARY", proto::STATIONARY}};
const std::vector<Spelling<proto::ServiceType>> kServiceTypes = {
    {"SMPL", proto::SMPL},
    {"CMPLX", proto::CMPLX},
    {"CPLX", proto::CMPLX, "write CMPLX; CPLX is figure 3.4's spelling of it"}};
const std::vector<Spelling<proto::ParamType>> kParamTypes = {
    {"INPUT", proto::INPUT},
    {"OUTPUT", proto::OUTPUT},
    {"CONFIG", proto::CONFIG},
    {"FEEDBACK", proto::FEEDBACK},
    {"SMPL", proto::FEEDBACK,
     "write FEEDBACK; the thesis lists SMPL where it describes a feedback parameter"}};
const std::vector<Spelling<proto::DataType>> kDataTypes = {
    {"INT", proto::INT}, {"DBL", proto::DBL}, {"STR", proto::STR}, {"BOOL", proto::BOOL}};
const std::vector<Spelling<proto::OnClientLoss>> kOnClientLoss = {
    {"stop", proto::STOP_TASK}, {"hold", proto::HOLD_TASK}, {"finish", proto::FINISH_TASK}};
const std::vector<Spelling<proto::OnFailure>> kOnFailure = {
    {"stop-all", proto::STOP_ALL}, {"hold-others", proto::HOLD_OTHERS}, {"compensate", proto::COMPENSATE}};

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

/// The texts of <Values> or <Choices>.
std::vector<std::pair<std::string, int>> readTexts(const XmlElement& list, std::string_view item,
                                                   Findings& findings) {
    std::vector<std::pair<std::string, int>> texts;
    Reader reader(list, findings);
    reader.children({item}, [&](const XmlElement& element) {
        Reader item_reader(element, findings);
        if (!element.children.empty())
            item_reader.error(element.children.front().line, {}, "text only in " + element.name,
                              "write < as &lt; where it is meant as text");
        item_reader.reportUnknownAttributes();
        texts.emplace_back(element.text, element.line);
    });
    reader.reportUnknownAttributes();
    return texts;
}

class ParamReader {
  public:
    ParamReader(const XmlElement& element, Findings& findings) : reader_(element, findings) {}

    Reader& reader() { return reader_; }

    proto::CtrlParam read() {
        param_.set_name(reader_.name("name"));
        if (!param_.name().empty()) reader_.nameIt(param_.name());
        if (const auto type = reader_.choice("type", kParamTypes, true)) param_.set_type(*type);
        if (const auto type = reader_.choice("data_type", kDataTypes, true)) param_.set_data_type(*type);
        param_.set_units(std::string(trimmed(reader_.text("units"))));
        param_.set_descr(reader_.text("descr"));
        param_.set_required(reader_.flag("required", false));
        param_.set_savable(reader_.flag("savable", "modifiable", param_.type() == proto::CONFIG));
        param_.set_multiple(reader_.flag("multiple", false));
        const bool stated_ready = reader_.flag("ready", "set", false);
        const bool states_ready = has("ready") || has("set");
        readRange();
        collectTexts();
        readChoices();
        readValues();
        param_.set_ready(param_.initial_size() > 0);
        checkFlags(states_ready, stated_ready);
        reader_.reportUnknownAttributes();
        return std::move(param_);
    }

  private:
    bool has(std::string_view attribute) const {
        const auto& all = reader_.element().attributes;
        return std::any_of(all.begin(), all.end(), [&](const auto& a) { return a.name == attribute; });
    }

    bool numeric() const { return param_.data_type() == proto::INT || param_.data_type() == proto::DBL; }

    void readRange() {
        const auto minimum = reader_.number("minimum", "the smallest value allowed, a number");
        const auto maximum = reader_.number("maximum", "the largest value allowed, a number");
        if (!minimum && !maximum) return;
        if (param_.data_type() != proto::DATA_TYPE_UNSPECIFIED && !numeric()) {
            const char* attribute = minimum ? "minimum" : "maximum";
            reader_.error(reader_.lineOf(attribute), attribute, "a range only for INT and DBL",
                          "remove minimum and maximum");
            return;
        }
        if (minimum && maximum && *minimum > *maximum) {
            reader_.error(reader_.lineOf("minimum"), "minimum", "a minimum that is not above the maximum",
                          "exchange the two");
            return;
        }
        if (minimum) param_.set_minimum(*minimum);
        if (maximum) param_.set_maximum(*maximum);
    }

    void collectTexts() {
        if (const auto* attribute = reader_.take("choices")) {
            std::string_view rest = attribute->value;
            while (true) {
                const auto bar = rest.find('|');
                choices_.emplace_back(std::string(trimmed(rest.substr(0, bar))), attribute->line);
                if (bar == std::string_view::npos) break;
                rest.remove_prefix(bar + 1);
            }
        }
        int value_lists = 0;
        reader_.children({"Values", "Choices"}, [&](const XmlElement& list) {
            if (list.name == "Choices") {
                if (!choices_.empty())
                    reader_.error(list.line, {}, "the choices once",
                                  "keep either the attribute choices or one <Choices>");
                for (auto& text : readTexts(list, "Choice", reader_.findings()))
                    choices_.push_back(std::move(text));
                if (list.children.empty())
                    reader_.error(list.line, {}, "at least one <Choice> in <Choices>",
                                  "add one, or remove <Choices>");
            } else {
                if (++value_lists > 1)
                    reader_.error(list.line, {}, "the values once", "put all <Value> in one <Values>");
                for (auto& text : readTexts(list, "Value", reader_.findings()))
                    values_.push_back(std::move(text));
            }
        });
        if (value_lists > 0 && !param_.multiple())
            reader_.error(reader_.line(), {}, "a list of values only where multiple=\"true\"",
                          "add multiple=\"true\", or write one value=\"...\"");
        if (const auto* attribute = reader_.take("value")) {
            if (value_lists > 0) {
                reader_.error(attribute->line, "value", "either value or <Values>", "keep one of the two");
            } else if (trimmed(attribute->value).empty() && param_.data_type() != proto::STR) {
                reader_.warning(attribute->line, "value", "a value, found nothing; it counts as not set",
                                "leave the attribute out");
            } else {
                values_.emplace_back(attribute->value, attribute->line);
            }
        }
    }

    void readChoices() {
        if (choices_.empty() || param_.data_type() == proto::DATA_TYPE_UNSPECIFIED) return;
        if (param_.data_type() == proto::BOOL) {
            reader_.error(choices_.front().second, "choices",
                          "choices only for INT, DBL and STR; a BOOL has its two", "remove the choices");
            return;
        }
        if (choices_.size() > kMaxChoices) {
            reader_.error(choices_.front().second, "choices",
                          "at most " + std::to_string(kMaxChoices) + " choices, found " +
                              std::to_string(choices_.size()),
                          "give a range by minimum and maximum instead");
            return;
        }
        proto::CtrlParam without_choices = param_;
        for (const auto& [text, line] : choices_) {
            auto value = acceptable(without_choices, text, line, "choices");
            if (!value) continue;
            const bool repeated =
                std::any_of(param_.choices().begin(), param_.choices().end(),
                            [&](const auto& choice) { return equalValues(choice, *value); });
            if (repeated) {
                reader_.warning(line, "choices", "each choice once, found " + inQuotes(text) + " again",
                                "remove it");
            } else {
                *param_.add_choices() = std::move(*value);
            }
        }
    }

    void readValues() {
        if (param_.data_type() == proto::DATA_TYPE_UNSPECIFIED) return;
        for (const auto& [text, line] : values_) {
            if (auto value = acceptable(param_, text, line, "value"))
                *param_.add_initial() = std::move(*value);
        }
    }

    std::optional<proto::Value> acceptable(const proto::CtrlParam& meta, const std::string& text, int line,
                                           std::string_view attribute) {
        auto value = parseValue(meta, text);
        if (!value) {
            reader_.error(line, attribute, describeValues(meta) + ", found " + inQuotes(text),
                          "write such a value, or change data_type");
            return {};
        }
        if (!checkValue(meta, value.value()).ok()) {
            reader_.error(line, attribute, describeValues(meta) + ", found " + inQuotes(text),
                          "write an allowed value, or allow this one (minimum, maximum, choices)");
            return {};
        }
        return std::move(value).value();
    }

    void checkFlags(bool states_ready, bool stated_ready) {
        const char* spelling = has("ready") ? "ready" : "set";
        if (states_ready && stated_ready && values_.empty())
            reader_.warning(reader_.lineOf(spelling), spelling,
                            "a value, since it says that the value is set; it counts as not set",
                            "add value=\"...\", or leave the attribute out");
        if (states_ready && !stated_ready && !values_.empty())
            reader_.warning(reader_.lineOf(spelling), spelling,
                            "true, since there is a value; it counts as set",
                            "remove the value, or leave the attribute out");
        const bool comes_from_robot = param_.type() == proto::OUTPUT || param_.type() == proto::FEEDBACK;
        if (param_.required() && comes_from_robot) {
            reader_.warning(reader_.lineOf("required"), "required",
                            "required only for INPUT and CONFIG; it is ignored",
                            "leave the attribute out: the robot gives this value");
            param_.set_required(false);
        }
        if (param_.type() == proto::CONFIG && !param_.savable()) {
            const char* attribute = has("savable") ? "savable" : "modifiable";
            reader_.warning(reader_.lineOf(attribute), attribute,
                            "true for CONFIG, whose value is always kept; it counts as true",
                            "leave the attribute out, or make the parameter an INPUT");
            param_.set_savable(true);
        }
    }

    Reader reader_;
    proto::CtrlParam param_;
    std::vector<std::pair<std::string, int>> values_;
    std::vector<std::pair<std::string, int>> choices_;
};

proto::Resource readResource(Reader& reader) {
    proto::Resource resource;
    resource.set_name(reader.name("name"));
    if (!resource.name().empty()) reader.nameIt(resource.name());
    if (const auto* url = reader.take("url"); url != nullptr) {
        resource.set_url(std::string(trimmed(url->value)));
        if (const auto refusal = checkResourceUrl(resource.url()); !refusal.ok())
            reader.error(url->line, "url", refusal.message,
                         "write a path with / between its steps, or leave the url out: then the Entity "
                         "Manager keeps the file");
    }
    resource.set_descr(reader.text("descr"));
    resource.set_ready(reader.flag("ready", "set", false));
    resource.set_required(reader.flag("required", false));
    resource.set_savable(reader.flag("savable", "modifiable", false));
    reader.reportUnknownAttributes();
    reader.children({}, [](const XmlElement&) {});
    return resource;
}

class ServicesReader {
  public:
    explicit ServicesReader(Findings& findings) : findings_(findings) {}

    proto::ServicesProfile read(const XmlElement& root) {
        Reader reader(root, findings_);
        reader.children({"Service"}, [&](const XmlElement& element) { readService(element); });
        reader.statedCount("count", static_cast<std::size_t>(profile_.services_size()), "services");
        if (profile_.services_size() == 0)
            reader.warning(reader.line(), {}, "at least one <Service>; the entity offers nothing", "add one");
        reader.reportUnknownAttributes();
        checkNames();
        checkComposites();
        return std::move(profile_);
    }

  private:
    struct Reference {
        int service;
        std::string to;
        int line;
    };

    void readService(const XmlElement& element) {
        Reader reader(element, findings_);
        const int id = profile_.services_size();
        auto& service = *profile_.add_services();
        lines_.push_back(element.line);
        service.set_id(id);
        service.set_name(reader.name("name"));
        if (!service.name().empty()) reader.nameIt(service.name());
        names_.claim(reader, "name", service.name());
        service.set_global_id(reader.name("global_id", false));
        global_ids_.claim(reader, "global_id", service.global_id());
        readType(reader, service);
        service.set_is_active(reader.flag("active", true));
        service.set_is_blocking(reader.flag("blocking", true));
        service.set_is_pausable(reader.flag("pausable", false));
        service.set_descr(reader.text("descr"));
        service.set_notes(reader.text("notes"));
        readClientLoss(reader, service);

        UniqueNames param_names("a parameter name");
        UniqueNames resource_names("a resource name");
        std::set<std::string_view> seen;
        bool has_references = false;
        reader.children({"Parameters", "Resources", "Services"}, [&](const XmlElement& list) {
            if (!seen.insert(list.name).second)
                findings_.warning(list.line, list.name + " in " + reader.label(),
                                  "one <" + list.name + "> in each service",
                                  "put the contents of both into one");
            Reader list_reader(list, findings_);
            if (list.name == "Parameters") {
                list_reader.children({"Param"}, [&](const XmlElement& item) {
                    ParamReader param(item, findings_);
                    auto message = param.read();
                    param_names.claim(param.reader(), "name", message.name());
                    *service.add_params() = std::move(message);
                });
            } else if (list.name == "Resources") {
                list_reader.children({"Resource"}, [&](const XmlElement& item) {
                    Reader resource(item, findings_);
                    auto message = readResource(resource);
                    resource_names.claim(resource, "name", message.name());
                    *service.add_resources() = std::move(message);
                });
            } else {
                list_reader.children({"ServiceRef"}, [&](const XmlElement& item) {
                    has_references = true;
                    Reader reference(item, findings_);
                    const auto name = reference.name("name");
                    if (!name.empty()) references_.push_back({id, name, item.line});
                    reference.reportUnknownAttributes();
                    reference.children({}, [](const XmlElement&) {});
                });
            }
            list_reader.reportUnknownAttributes();
        });
        reader.statedCount("parameter_count", static_cast<std::size_t>(service.params_size()), "parameters");
        reader.statedCount("resource_count", static_cast<std::size_t>(service.resources_size()), "resources");
        reader.reportUnknownAttributes();
        checkList(reader, service, seen.contains("Services"), has_references);
    }

    void readType(Reader& reader, proto::Service& service) {
        for (const auto& attribute : reader.element().attributes) {
            if (attribute.name != "type" || trimmed(attribute.value) != "ITRAV") continue;
            (void)reader.take("type");
            reader.error(attribute.line, "type",
                         "one of SMPL, CMPLX; ITRAV stands in figure 3.4 alone, and the thesis says nowhere "
                         "what it does",
                         "write SMPL, or CMPLX with a list of services");
            service.set_type(proto::SMPL);
            type_known_ = false;
            return;
        }
        const auto type = reader.choice("type", kServiceTypes, true);
        type_known_ = type.has_value();
        if (type) service.set_type(*type);
    }

    void readClientLoss(Reader& reader, proto::Service& service) {
        if (const auto reaction = reader.choice("on_client_loss", kOnClientLoss, false))
            service.set_on_client_loss(*reaction);
        if (service.on_client_loss() == proto::HOLD_TASK && !service.is_pausable())
            reader.warning(reader.lineOf("on_client_loss"), "on_client_loss",
                           "pausable=\"true\" beside \"hold\"; without it the task is stopped",
                           "add pausable=\"true\" and an onPause callback, or leave on_client_loss out");
        const bool finish = service.on_client_loss() == proto::FINISH_TASK;
        const bool given = reader.take("max_duration") != nullptr;
        const auto duration = reader.number("max_duration", "a duration in seconds");
        const int line = reader.lineOf("max_duration");
        if (duration && !(*duration > 0 && *duration <= kLongestDuration_s)) {
            reader.error(line, "max_duration", "more than 0 and at most 86400 seconds",
                         "write the longest time a task takes");
        } else if (duration) {
            service.set_max_duration_s(*duration);
            if (!finish)
                reader.warning(line, "max_duration",
                               "on_client_loss=\"finish\" beside it; alone it has no effect",
                               "add on_client_loss=\"finish\", or leave it out");
        } else if (finish && !given) {
            reader.error(
                reader.lineOf("on_client_loss"), "on_client_loss", "max_duration beside \"finish\"",
                "add max_duration=\"...\": the most seconds that a task without its client may go on");
        }
    }

    void checkList(Reader& reader, const proto::Service& service, bool has_list, bool has_references) {
        if (!type_known_) return;
        if (service.type() == proto::SMPL && has_list) {
            reader.error(reader.line(), {}, "a <Services> list only in a service of type CMPLX",
                         "write type=\"CMPLX\", or remove the list");
        } else if (service.type() == proto::CMPLX && !has_references) {
            reader.warning(reader.line(), {}, "a <Services> list in a service of type CMPLX",
                           "add <Services><ServiceRef name=\"...\"/></Services>");
        }
    }

    /// A global id that is another service's name would make requests by that word ambiguous; names win.
    void checkNames() {
        std::map<std::string_view, int> by_name;
        for (const auto& service : profile_.services()) by_name.emplace(service.name(), service.id());
        for (const auto& service : profile_.services()) {
            const auto other = by_name.find(service.global_id());
            if (service.global_id().empty() || other == by_name.end() || other->second == service.id())
                continue;
            findings_.warning(lines_[static_cast<std::size_t>(service.id())],
                              "Service " + inQuotes(service.name()) + " global_id",
                              "a global id that is not the name of another service; requests for " +
                                  inQuotes(service.global_id()) + " go to the service of that name",
                              "change one of the two");
        }
    }

    void checkComposites() {
        std::map<std::string_view, int> positions;
        for (const auto& service : profile_.services())
            if (!service.name().empty()) positions.emplace(service.name(), service.id());
        for (const auto& service : profile_.services())
            if (!service.global_id().empty()) positions.emplace(service.global_id(), service.id());
        std::vector<std::string_view> known;
        for (const auto& [name, position] : positions) known.push_back(name);

        std::vector<std::vector<std::pair<int, int>>> edges(
            static_cast<std::size_t>(profile_.services_size()));
        for (const auto& reference : references_) {
            auto& service = *profile_.mutable_services(reference.service);
            service.add_service_list(reference.to);
            const auto target = positions.find(reference.to);
            if (target != positions.end()) {
                edges[static_cast<std::size_t>(reference.service)].emplace_back(target->second,
                                                                                reference.line);
                continue;
            }
            const auto near = nearNames(reference.to, known);
            findings_.error(
                reference.line, "ServiceRef in Service " + inQuotes(service.name()),
                "the name or global id of a service of this profile, found " + inQuotes(reference.to),
                near.empty() ? "name a service that is declared here"
                             : "did you mean " + alternatives(near) + "?");
        }
        if (reportCycles(edges)) return;
        for (const auto& fault : readComposites(profile_).faults) {
            const int line = lines_[static_cast<std::size_t>(fault.service)];
            const auto element = "Service " + inQuotes(profile_.services(fault.service).name());
            if (fault.error)
                findings_.error(line, element, fault.expected, fault.mend);
            else
                findings_.warning(line, element, fault.expected, fault.mend);
        }
    }

    /// Depth first with an explicit stack: a chain of composites may be as long as the profile.
    bool reportCycles(const std::vector<std::vector<std::pair<int, int>>>& edges) {
        enum class Mark { Fresh, Open, Done };
        std::vector<Mark> marks(edges.size(), Mark::Fresh);
        bool found = false;
        for (std::size_t start = 0; start < edges.size(); ++start) {
            if (marks[start] != Mark::Fresh) continue;
            std::vector<std::pair<std::size_t, std::size_t>> stack{{start, 0}};
            marks[start] = Mark::Open;
            while (!stack.empty()) {
                auto& [service, next] = stack.back();
                if (next == edges[service].size()) {
                    marks[service] = Mark::Done;
                    stack.pop_back();
                    continue;
                }
                const auto [target, line] = edges[service][next++];
                const auto to = static_cast<std::size_t>(target);
                if (marks[to] == Mark::Open) {
                    found = true;
                    findings_.error(line,
                                    "ServiceRef in Service " +
                                        inQuotes(profile_.services(static_cast<int>(service)).name()),
                                    "a composite service that does not contain itself; " +
                                        inQuotes(profile_.services(target).name()) + " contains this one",
                                    "remove the reference that closes the circle");
                } else if (marks[to] == Mark::Fresh) {
                    marks[to] = Mark::Open;
                    stack.emplace_back(to, 0);
                }
            }
        }
        return found;
    }

    Findings& findings_;
    proto::ServicesProfile profile_;
    std::vector<int> lines_;
    std::vector<Reference> references_;
    UniqueNames names_{"a service name"};
    UniqueNames global_ids_{"a global id"};
    bool type_known_ = false;
};

proto::BasicProfile readBasic(const XmlElement& root, Findings& findings) {
    Reader reader(root, findings);
    proto::BasicProfile profile;
    profile.set_name(reader.name("name"));
    if (!profile.name().empty()) reader.nameIt(profile.name());
    if (!isEntityName(profile.name()))
        reader.error(reader.lineOf("name"), "name",
                     "a name that cannot mean another entity: no UUID, and no '#' with a number at its end",
                     "rename it; NAME#2 is the second of the entities that are called NAME");
    if (const auto category = reader.choice("category", kCategories, true)) profile.set_category(*category);
    if (const auto type = reader.choice("type", kMobilities, true)) profile.set_type(*type);
    profile.set_descr(reader.text("descr"));
    const auto position = [&](std::string_view attribute) {
        const bool given = reader.take(attribute) != nullptr;
        if (!given)
            reader.warning(reader.line(), attribute, "the position in millimetres; it counts as 0",
                           "add " + std::string(attribute) + "=\"0\"");
        return reader.number(attribute, "a position in millimetres").value_or(0);
    };
    profile.set_xpos(position("xpos"));
    profile.set_ypos(position("ypos"));
    profile.set_zpos(position("zpos"));
    reader.reportUnknownAttributes();
    reader.children({}, [](const XmlElement&) {});
    return profile;
}

/// The services of a global services profile. What refers to something else in its service (an output of an
/// earlier step, the participant of a compensation) is judged when the whole service has been read.
class GlobalReader {
  public:
    explicit GlobalReader(Findings& findings) : findings_(findings) {}

    proto::GlobalProfile read(const XmlElement& root) {
        Reader reader(root, findings_);
        proto::GlobalProfile profile;
        UniqueNames names("a service name");
        reader.children({"Service"}, [&](const XmlElement& element) {
            readService(element, names, *profile.add_services());
        });
        reader.statedCount("count", static_cast<std::size_t>(profile.services_size()), "services");
        reader.reportUnknownAttributes();
        return profile;
    }

  private:
    static constexpr int kMaxSteps = 1000;
    static constexpr std::size_t kMaxRoles = 256;
    static constexpr std::size_t kMaxStepNameBytes = 128;

    struct Role {
        int line = 0;
        proto::Category category = proto::CATEGORY_UNSPECIFIED;
        proto::Mobility type = proto::MOBILITY_UNSPECIFIED;

        bool known() const { return category != 0 && type != 0; }
    };
    /// One `param_from`, in the order of the sources of all steps.
    struct Source {
        const XmlAttribute* attribute = nullptr;
        std::string element;
    };

    void readService(const XmlElement& element, UniqueNames& names, proto::GlobalService& service) {
        Reader reader(element, findings_);
        service.set_name(reader.name("name"));
        if (!service.name().empty()) reader.nameIt(service.name());
        names.claim(reader, "name", service.name());
        service.set_descr(reader.text("descr"));
        const bool states_reaction = reader.take("on_failure") != nullptr;
        const auto reaction = reader.choice("on_failure", kOnFailure, false);
        if (reaction) service.set_on_failure(*reaction);
        reader.reportUnknownAttributes();

        roles_.clear();
        sources_.clear();
        UniqueNames step_names("a step's name");
        std::vector<const XmlElement*> compensations;
        reader.children({"entity", "compensate"}, [&](const XmlElement& item) {
            if (item.name == "compensate")
                compensations.push_back(&item);
            else
                readStep(item, service, step_names);
        });
        if (service.steps_size() == 0)
            reader.error(reader.line(), {}, "at least one <entity> step", "add one, or remove the service");
        if (service.steps_size() > kMaxSteps)
            reader.error(reader.line(), {},
                         "at most " + std::to_string(kMaxSteps) + " steps, found " +
                             std::to_string(service.steps_size()),
                         "divide it into several services");
        if (roles_.size() > kMaxRoles)
            reader.error(reader.line(), {},
                         "at most " + std::to_string(kMaxRoles) + " participants (different ids), found " +
                             std::to_string(roles_.size()),
                         "give steps of the same participant the same id, or divide the service");
        checkSources(service);

        std::map<int, int> compensated;
        for (const auto* item : compensations) readCompensation(*item, service, compensated);
        if (service.on_failure() == proto::COMPENSATE && compensations.empty())
            reader.error(reader.lineOf("on_failure"), "on_failure",
                         "at least one <compensate> beside \"compensate\"",
                         "add <compensate id=\"...\" service_global_id=\"...\"/> after the steps, or leave "
                         "on_failure out");
        if (service.on_failure() != proto::COMPENSATE && !compensations.empty() &&
            (reaction || !states_reaction))
            reader.warning(compensations.front()->line, {},
                           "on_failure=\"compensate\" beside <compensate>; without it no compensation runs",
                           "add on_failure=\"compensate\", or remove <compensate>");
    }

    int wholeNumber(Reader& reader, std::string_view attribute, std::string_view what) {
        if (reader.take(attribute) == nullptr) reader.missing(attribute, std::string(what));
        return reader.count(attribute, what).value_or(0);
    }

    void readStep(const XmlElement& element, proto::GlobalService& service, UniqueNames& step_names) {
        Reader reader(element, findings_);
        auto& step = *service.add_steps();
        step.set_service_global_id(reader.name("service_global_id"));
        if (!step.service_global_id().empty()) reader.nameIt(step.service_global_id());
        step.set_name(stepName(reader));
        step_names.claim(reader, "name", step.name());
        if (const auto category = reader.choice("category", kCategories, true)) step.set_category(*category);
        if (const auto type = reader.choice("type", kMobilities, true)) step.set_type(*type);
        step.set_role(wholeNumber(reader, "id", "the number of a participant"));
        step.set_preced(wholeNumber(reader, "preced", "the step's place in the order"));
        UniqueNames names("a parameter name");
        reader.children({"key_value"}, [&](const XmlElement& item) {
            Reader pair(item, findings_);
            const auto name = paramName(pair, names);
            const auto* value = pair.take("param_value");
            const auto* from = pair.take("param_from");
            if (value != nullptr && from != nullptr)
                pair.error(from->line, "param_from", "either param_value or param_from",
                           "keep one of the two");
            else if (value == nullptr && from == nullptr)
                pair.missing("param_value", "the value of the parameter");
            if (from != nullptr) {
                auto& source = *step.add_sources();
                source.set_param(name);
                const std::string_view text = trimmed(from->value);
                const auto dot = text.find('.');
                source.set_step(std::string(text.substr(0, dot)));
                if (dot != std::string_view::npos) source.set_output(std::string(text.substr(dot + 1)));
                sources_.push_back({from, pair.label()});
            } else {
                auto& param = *step.add_params();
                param.set_name(name);
                if (value != nullptr) param.add_values()->set_str(value->value);
            }
            pair.reportUnknownAttributes();
            pair.children({}, [](const XmlElement&) {});
        });
        reader.reportUnknownAttributes();
        claimRole(reader, step);
    }

    /// Optional; empty where it is unusable, which then is an error already reported.
    std::string stepName(Reader& reader) {
        auto name = reader.name("name", false);
        if (name.find('.') != std::string::npos) {
            reader.error(reader.lineOf("name"), "name",
                         "a step's name without '.', which in param_from ends it; found " + inQuotes(name),
                         "write - or _ instead");
            return {};
        }
        if (name.size() > kMaxStepNameBytes) {
            reader.error(reader.lineOf("name"), "name",
                         "a step's name of at most " + std::to_string(kMaxStepNameBytes) + " bytes, found " +
                             std::to_string(name.size()),
                         "shorten it");
            return {};
        }
        return name;
    }

    std::string paramName(Reader& pair, UniqueNames& names) {
        auto name = pair.name("param_name");
        if (!name.empty()) pair.nameIt(name);
        names.claim(pair, "param_name", name);
        return name;
    }

    void claimRole(Reader& reader, const proto::GlobalStep& step) {
        const Role role{reader.line(), step.category(), step.type()};
        const auto [first, fresh] = roles_.emplace(step.role(), role);
        const auto& same = first->second;
        if (!fresh && role.known() && same.known() &&
            (same.category != role.category || same.type != role.type))
            reader.error(reader.line(), "id",
                         "the category and type of line " + std::to_string(same.line) + ", since id " +
                             std::to_string(step.role()) + " is one participant",
                         "give it the same category and type, or another id");
    }

    void checkSources(const proto::GlobalService& service) {
        std::map<std::string_view, const proto::GlobalStep*> steps;
        std::vector<std::string_view> known;
        for (const auto& step : service.steps()) {
            if (step.name().empty() || !steps.emplace(step.name(), &step).second) continue;
            known.push_back(step.name());
        }
        auto place = sources_.begin();
        for (const auto& step : service.steps()) {
            for (const auto& source : step.sources()) {
                const auto& attribute = *place->attribute;
                const std::string label = (place++)->element + " param_from";
                const auto report = [&](std::string expected, std::string mend) {
                    findings_.error(attribute.line, label, std::move(expected), std::move(mend));
                };
                if (source.step().empty() || source.output().empty()) {
                    report("a step's name, '.', and the name of one of its OUTPUT parameters, found " +
                               inQuotes(attribute.value),
                           "write it as in param_from=\"locate.Position\"");
                    continue;
                }
                const auto found = steps.find(source.step());
                if (found == steps.end()) {
                    const auto near = nearNames(source.step(), known);
                    report("the name of a step of this service before the '.', found " +
                               inQuotes(source.step()) + ": the value can never be there in time",
                           near.empty() ? "give the step that provides it name=\"...\""
                                        : "did you mean " + alternatives(near) + "?");
                } else if (found->second->preced() >= step.preced()) {
                    report("a step with a lower preced than " + std::to_string(step.preced()) + "; that of " +
                               inQuotes(source.step()) + " is " + std::to_string(found->second->preced()) +
                               ": the value can never be there in time",
                           "raise the preced of this step, or lower the other's");
                }
            }
        }
    }

    void readCompensation(const XmlElement& element, proto::GlobalService& service,
                          std::map<int, int>& compensated) {
        Reader reader(element, findings_);
        auto& step = *service.add_compensation();
        step.set_service_global_id(reader.name("service_global_id"));
        if (!step.service_global_id().empty()) reader.nameIt(step.service_global_id());
        if (reader.take("id") == nullptr) reader.missing("id", "the number of a participant");
        if (const auto id = reader.count("id", "the number of a participant")) {
            step.set_role(*id);
            const int line = reader.lineOf("id");
            const auto role = roles_.find(*id);
            const auto [first, fresh] = compensated.emplace(*id, line);
            if (role == roles_.end()) {
                reader.error(
                    line, "id",
                    "the id of a participant, which one of the steps has; found " + std::to_string(*id),
                    "write the id of an <entity> of this service");
            } else if (!fresh) {
                reader.error(line, "id",
                             "one <compensate> for each participant; that of id " + std::to_string(*id) +
                                 " is in line " + std::to_string(first->second),
                             "keep one of the two: it may be a service that is a list of others");
            } else {
                step.set_category(role->second.category);
                step.set_type(role->second.type);
            }
        }
        UniqueNames names("a parameter name");
        reader.children({"key_value"}, [&](const XmlElement& item) {
            Reader pair(item, findings_);
            auto& param = *step.add_params();
            param.set_name(paramName(pair, names));
            const auto* value = pair.take("param_value");
            if (const auto* from = pair.take("param_from"))
                pair.error(from->line, "param_from",
                           "param_value in a compensation: which steps have given their outputs is not "
                           "known when it runs",
                           "write param_value=\"...\" instead");
            else if (value == nullptr)
                pair.missing("param_value", "the value of the parameter");
            if (value != nullptr) param.add_values()->set_str(value->value);
            pair.reportUnknownAttributes();
            pair.children({}, [](const XmlElement&) {});
        });
        reader.reportUnknownAttributes();
    }

    Findings& findings_;
    std::map<int, Role> roles_;  // of the service under reading, as are the sources
    std::vector<Source> sources_;
};

ProfileKind kindOf(std::string_view root) {
    if (root == "BasicProfile") return ProfileKind::Basic;
    if (root == "ServiceProfile" || root == "ServicesProfile") return ProfileKind::Services;
    if (root == "GlobalProfile") return ProfileKind::Global;
    return ProfileKind::Unknown;
}

std::string_view rootName(ProfileKind kind) {
    switch (kind) {
        case ProfileKind::Basic:
            return "BasicProfile";
        case ProfileKind::Services:
            return "ServiceProfile";
        case ProfileKind::Global:
            return "GlobalProfile";
        case ProfileKind::Unknown:
            break;
    }
    return "";
}

template <class Message, class Read>
Reading<Message> readProfile(std::string_view xml, std::string_view file_name, ProfileKind kind,
                             const Read& read) {
    Findings findings(file_name);
    Reading<Message> reading;
    const auto document = parseXml(xml);
    for (const auto& fault : document.faults)
        findings.error(fault.line, fault.element, fault.expected, fault.mend);
    if (document.root) {
        const auto& root = *document.root;
        if (kindOf(root.name) != kind) {
            findings.error(root.line, root.name,
                           "<" + std::string(rootName(kind)) + "> as the outermost element",
                           kindOf(root.name) == ProfileKind::Unknown
                               ? "rename it"
                               : "this is a " + std::string(profileKindName(kindOf(root.name))) +
                                     ": give it where one is asked for");
        } else {
            if (root.name != rootName(kind))
                findings.warning(root.line, root.name,
                                 "<" + std::string(rootName(kind)) + "> as the outermost element",
                                 "rename it, as in figure 3.3");
            reading.message = read(root, findings);
        }
    }
    reading.findings = findings.take();
    return reading;
}

}  // namespace

std::string Finding::toString() const {
    return file + ":" + std::to_string(line) + ": " + (severity == Severity::Error ? "error" : "warning") +
           ": " + element + ": " + expected + ": " + mend;
}

bool hasError(const std::vector<Finding>& findings) {
    return std::any_of(findings.begin(), findings.end(),
                       [](const auto& f) { return f.severity == Severity::Error; });
}

std::string_view profileKindName(ProfileKind kind) {
    switch (kind) {
        case ProfileKind::Basic:
            return "basic profile";
        case ProfileKind::Services:
            return "services profile";
        case ProfileKind::Global:
            return "global services profile";
        case ProfileKind::Unknown:
            break;
    }
    return "unknown";
}

ProfileKind detectKind(std::string_view xml) {
    while (true) {
        const auto tag = xml.find('<');
        if (tag == std::string_view::npos) return ProfileKind::Unknown;
        xml.remove_prefix(tag);
        std::string_view closing;
        if (xml.starts_with("<!--"))
            closing = "-->";
        else if (xml.starts_with("<?"))
            closing = "?>";
        else if (xml.starts_with("<!"))
            closing = ">";
        else
            return kindOf(xml.substr(1, xml.find_first_of(" \t\r\n/>", 1) - 1));
        const auto end = xml.find(closing);
        if (end == std::string_view::npos) return ProfileKind::Unknown;
        xml.remove_prefix(end + closing.size());
    }
}

Reading<proto::BasicProfile> readBasicProfile(std::string_view xml, std::string_view file_name) {
    return readProfile<proto::BasicProfile>(xml, file_name, ProfileKind::Basic, readBasic);
}

Reading<proto::ServicesProfile> readServicesProfile(std::string_view xml, std::string_view file_name) {
    return readProfile<proto::ServicesProfile>(
        xml, file_name, ProfileKind::Services,
        [](const XmlElement& root, Findings& findings) { return ServicesReader(findings).read(root); });
}

Reading<proto::GlobalProfile> readGlobalProfile(std::string_view xml, std::string_view file_name) {
    return readProfile<proto::GlobalProfile>(
        xml, file_name, ProfileKind::Global,
        [](const XmlElement& root, Findings& findings) { return GlobalReader(findings).read(root); });
}

ProfileText readProfileText(const std::filesystem::path& path, std::string_view shown_name) {
    ProfileText text;
    const auto unreadable = [&](std::string expected, std::string mend) {
        text.unreadable = Finding{std::string(shown_name), 0, Severity::Error, "file", std::move(expected),
                                  std::move(mend)};
        return text;
    };
    std::error_code failure;
    const auto status = std::filesystem::status(path, failure);
    if (!std::filesystem::exists(status))
        return unreadable("a file; there is none of this name", "check the path");
    if (!std::filesystem::is_regular_file(status))
        return unreadable("a regular file", "name the profile itself");
    std::ifstream file(path, std::ios::binary);
    if (!file) return unreadable("a file that may be read", "check its permissions");
    text.xml.resize(kMaxXmlBytes + 1);
    file.read(text.xml.data(), static_cast<std::streamsize>(text.xml.size()));
    if (file.bad()) return unreadable("a file that can be read", "check the disk, and try again");
    text.xml.resize(static_cast<std::size_t>(file.gcount()));
    return text;
}

ProfileCheck checkProfileFile(const std::filesystem::path& path) {
    ProfileCheck check;
    const std::string name = path.string();
    const auto text = readProfileText(path, name);
    if (text.unreadable) {
        check.findings.push_back(*text.unreadable);
        return check;
    }
    const auto& xml = text.xml;
    check.readable = true;
    check.kind = detectKind(xml);
    switch (check.kind) {
        case ProfileKind::Basic:
            check.findings = readBasicProfile(xml, name).findings;
            return check;
        case ProfileKind::Services:
            check.findings = readServicesProfile(xml, name).findings;
            return check;
        case ProfileKind::Global:
            check.findings = readGlobalProfile(xml, name).findings;
            return check;
        case ProfileKind::Unknown:
            break;
    }
    Findings findings(name);
    const auto document = parseXml(xml);
    for (const auto& fault : document.faults)
        findings.error(fault.line, fault.element, fault.expected, fault.mend);
    if (document.root)
        findings.error(document.root->line, document.root->name,
                       "one of <BasicProfile>, <ServiceProfile>, <GlobalProfile> as the outermost element",
                       "rename it");
    check.findings = findings.take();
    return check;
}

}  // namespace axon
