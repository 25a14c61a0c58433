// SPDX-License-Identifier: MIT
#include "messages/values.hpp"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <cstdint>
#include <optional>
#include <system_error>
#include <utility>
#include <vector>

#include "common/utf8.hpp"
#include "messages/text.hpp"

namespace axon {
namespace {

constexpr std::size_t kTextMax = 64 * 1024;
constexpr double kTwoTo63 = 9223372036854775808.0;

/// The shortest text that is this number; whole ones as people write them, 100000 and not 1e+05.
std::string numberText(double number) {
    char buffer[64];
    if (std::abs(number) < 1e15 && number == std::trunc(number) && (number != 0 || !std::signbit(number)))
        return {buffer, std::to_chars(buffer, buffer + sizeof buffer, static_cast<std::int64_t>(number)).ptr};
    const auto end = std::to_chars(buffer, buffer + sizeof buffer, number).ptr;
    return {buffer, end};
}

template <class Number>
std::optional<Number> parseWhole(std::string_view text) {
    if (!text.empty() && text.front() == '+') {
        text.remove_prefix(1);
        if (!text.empty() && text.front() == '-') return {};
    }
    Number number{};
    const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), number);
    if (error != std::errc{} || end != text.data() + text.size()) return {};
    return number;
}

std::optional<std::int64_t> wholeNumber(double number) {
    if (!(number >= -kTwoTo63 && number < kTwoTo63) || number != std::trunc(number)) return {};
    return static_cast<std::int64_t>(number);
}

std::optional<bool> parseBool(std::string_view text) {
    for (const auto yes : {"true", "1", "yes", "on"})
        if (equalIgnoringCase(text, yes)) return true;
    for (const auto no : {"false", "0", "no", "off"})
        if (equalIgnoringCase(text, no)) return false;
    return {};
}

std::string nameOf(const proto::CtrlParam& meta) {
    return meta.name().empty() ? "the parameter" : "parameter " + inQuotes(meta.name());
}

Refusal wrongType(const proto::CtrlParam& meta, const std::string& found) {
    return {RefusalCode::WrongType, nameOf(meta) + " takes " + describeValues(meta) + "; found " + found, {}};
}

std::string kindName(const proto::Value& value) {
    switch (value.kind_case()) {
        case proto::Value::kInt:
            return "the INT " + toText(value);
        case proto::Value::kDbl:
            return "the DBL " + toText(value);
        case proto::Value::kStr:
            return "the STR " + inQuotes(value.str());
        case proto::Value::kBool:
            return "the BOOL " + toText(value);
        case proto::Value::KIND_NOT_SET:
            break;
    }
    return "an empty value";
}

/// The value in the parameter's type, or nothing where it cannot be.
std::optional<proto::Value> converted(proto::DataType type, const proto::Value& value) {
    proto::Value out;
    switch (type) {
        case proto::INT:
            if (value.has_int_()) return value;
            if (value.has_dbl()) {
                if (const auto whole = wholeNumber(value.dbl())) {
                    out.set_int_(*whole);
                    return out;
                }
            }
            return {};
        case proto::DBL:
            if (value.has_dbl()) return value;
            if (value.has_int_()) {
                out.set_dbl(static_cast<double>(value.int_()));
                return out;
            }
            return {};
        case proto::STR:
            if (value.has_str()) return value;
            return {};
        case proto::BOOL:
            if (value.has_bool_()) return value;
            return {};
        default:
            return {};
    }
}

/// Splits `1000 mm` into the number and its unit; the unit is empty where there is none.
std::pair<std::string_view, std::string_view> splitUnits(std::string_view text) {
    text = trimmed(text);
    double ignored{};
    std::string_view digits = text;
    if (!digits.empty() && digits.front() == '+') digits.remove_prefix(1);
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), ignored);
    if (error == std::errc::invalid_argument) return {text, {}};
    const auto length = static_cast<std::size_t>(end - text.data());
    return {text.substr(0, length), trimmed(text.substr(length))};
}

/// Exact names first, in the order the lists are given; then the only candidate that differs in case alone.
Result<int> findIndex(std::string_view wanted, const std::vector<std::vector<std::string_view>>& lists,
                      RefusalCode code, const std::string& what, const std::string& where,
                      const std::vector<std::string_view>* offered = nullptr) {
    for (const auto& list : lists) {
        for (std::size_t i = 0; i < list.size(); ++i)
            if (!wanted.empty() && list[i] == wanted) return static_cast<int>(i);
    }
    std::vector<int> matches;
    for (const auto& list : lists) {
        for (std::size_t i = 0; i < list.size(); ++i) {
            const int index = static_cast<int>(i);
            if (!wanted.empty() && equalIgnoringCase(list[i], wanted) &&
                std::find(matches.begin(), matches.end(), index) == matches.end())
                matches.push_back(index);
        }
    }
    if (matches.size() == 1) return matches.front();

    const auto& names = offered == nullptr ? lists.front() : *offered;
    std::string message = "no " + what + " " + inQuotes(wanted) + " " + where;
    std::vector<std::string> candidates;
    if (matches.empty()) {
        std::vector<std::string_view> all;
        if (offered != nullptr)
            all = *offered;
        else
            for (const auto& list : lists) all.insert(all.end(), list.begin(), list.end());
        candidates = nearNames(wanted, all);
    } else {
        for (std::size_t i = 0; i < matches.size() && i < 8; ++i)
            candidates.emplace_back(lists.front()[static_cast<std::size_t>(matches[i])]);
    }
    if (!candidates.empty()) {
        message += "; did you mean " + alternatives(candidates) + "?";
    } else if (names.empty()) {
        message += lists.front().empty() ? "; it has none" : "; it has none that can be set";
    } else {
        message += "; it has ";
        for (std::size_t i = 0; i < names.size() && i < 8; ++i)
            message += (i > 0 ? ", " : "") + inQuotes(names[i]);
        if (names.size() > 8) message += " and " + std::to_string(names.size() - 8) + " more";
    }
    return Refusal{code, std::move(message), {}};
}

template <class List>
std::vector<std::string_view> namesOf(const List& list) {
    std::vector<std::string_view> names;
    names.reserve(static_cast<std::size_t>(list.size()));
    for (const auto& item : list) names.emplace_back(item.name());
    return names;
}

}  // namespace

std::string describeValues(const proto::CtrlParam& meta) {
    std::string out;
    switch (meta.data_type()) {
        case proto::INT:
            out = "INT";
            break;
        case proto::DBL:
            out = "DBL";
            break;
        case proto::STR:
            out = "STR";
            break;
        case proto::BOOL:
            out = "BOOL (true or false)";
            break;
        default:
            out = "a value of a data type that its profile does not give";
            break;
    }
    if (meta.multiple()) out += " list";
    if (meta.has_minimum() && meta.has_maximum()) {
        out += " from " + numberText(meta.minimum()) + " to " + numberText(meta.maximum());
    } else if (meta.has_minimum()) {
        out += " of at least " + numberText(meta.minimum());
    } else if (meta.has_maximum()) {
        out += " of at most " + numberText(meta.maximum());
    }
    if (!meta.units().empty()) out += " in " + meta.units();
    if (meta.choices_size() > 0) {
        out += ", one of ";
        for (int i = 0; i < meta.choices_size() && i < 12; ++i) {
            if (i > 0) out += ", ";
            out += meta.choices(i).has_str() ? inQuotes(meta.choices(i).str()) : toText(meta.choices(i));
        }
        if (meta.choices_size() > 12) out += ", ...";
    }
    return out;
}

Result<proto::Value> parseValue(const proto::CtrlParam& meta, std::string_view text) {
    proto::Value value;
    switch (meta.data_type()) {
        case proto::INT: {
            const auto digits = trimmed(text);
            auto whole = parseWhole<std::int64_t>(digits);
            if (!whole) {
                if (const auto number = parseWhole<double>(digits)) whole = wholeNumber(*number);
            }
            if (!whole) return wrongType(meta, inQuotes(text));
            value.set_int_(*whole);
            return value;
        }
        case proto::DBL: {
            const auto number = parseWhole<double>(trimmed(text));
            if (!number || !std::isfinite(*number)) return wrongType(meta, inQuotes(text));
            value.set_dbl(*number);
            return value;
        }
        case proto::BOOL: {
            const auto flag = parseBool(trimmed(text));
            if (!flag) return wrongType(meta, inQuotes(text));
            value.set_bool_(*flag);
            return value;
        }
        case proto::STR:
            if (!isUtf8(text)) return wrongType(meta, "bytes that are not UTF-8 text: " + inQuotes(text));
            value.set_str(std::string(text));
            return value;
        default:
            return wrongType(meta, inQuotes(text));
    }
}

Result<proto::Param> parseParam(const proto::CtrlParam& meta, std::string_view text) {
    proto::Param param;
    param.set_name(meta.name());
    const bool numeric = meta.data_type() == proto::INT || meta.data_type() == proto::DBL;
    std::string_view rest = text;
    while (true) {
        const std::size_t comma = meta.multiple() ? rest.find(',') : std::string_view::npos;
        std::string_view item = rest.substr(0, comma);
        if (numeric) {
            const auto [digits, units] = splitUnits(item);
            const bool own_units = !units.empty() && units == meta.units();
            if (own_units ||
                (!units.empty() && units.find_first_of("0123456789.,;:") == std::string_view::npos &&
                 isUtf8(units))) {
                if (!own_units) {
                    return Refusal{
                        RefusalCode::WrongUnits,
                        nameOf(meta) + " takes " + describeValues(meta) + "; found the unit " +
                            inQuotes(units) +
                            (meta.units().empty() ? ": leave the unit out" : ": convert the value"),
                        {}};
                }
                param.set_units(std::string(units));
                item = digits;
            }
        }
        auto value = parseValue(meta, item);
        if (!value) return value.refusal();
        *param.add_values() = std::move(value).value();
        if (comma == std::string_view::npos) break;
        rest.remove_prefix(comma + 1);
    }
    return acceptParam(meta, param);
}

Refusal checkValue(const proto::CtrlParam& meta, const proto::Value& value) {
    const auto outOfRange = [&] {
        return Refusal{RefusalCode::OutOfRange,
                       nameOf(meta) + " takes " + describeValues(meta) + "; found " +
                           (value.has_str() ? inQuotes(value.str()) : toText(value)),
                       {}};
    };
    if (value.has_dbl() && !std::isfinite(value.dbl())) return outOfRange();
    if (value.has_int_() || value.has_dbl()) {
        // long double holds every int64 exactly where it has 64 bits of mantissa or more (x86-64, aarch64).
        const long double number =
            value.has_int_() ? static_cast<long double>(value.int_()) : static_cast<long double>(value.dbl());
        if (meta.has_minimum() && number < static_cast<long double>(meta.minimum())) return outOfRange();
        if (meta.has_maximum() && number > static_cast<long double>(meta.maximum())) return outOfRange();
    }
    if (meta.choices_size() > 0) {
        for (const auto& choice : meta.choices())
            if (equalValues(choice, value)) return {};
        return outOfRange();
    }
    return {};
}

Result<proto::Param> acceptParam(const proto::CtrlParam& meta, const proto::Param& param) {
    if (param.values_size() == 0) return wrongType(meta, "no value");
    if (param.values_size() > 1 && !meta.multiple())
        return wrongType(meta, std::to_string(param.values_size()) + " values where one is allowed");
    if (!param.units().empty() && param.units() != meta.units()) {
        return Refusal{RefusalCode::WrongUnits,
                       nameOf(meta) + " takes " + describeValues(meta) + "; found the unit " +
                           inQuotes(param.units()) +
                           (meta.units().empty() ? ": leave the unit out" : ": convert the value"),
                       {}};
    }
    proto::Param out;
    out.set_name(param.name());
    out.set_units(param.units());
    for (const auto& given : param.values()) {
        auto value = converted(meta.data_type(), given);
        if (!value) return wrongType(meta, kindName(given));
        if (value->str().size() > kTextMax)
            return Refusal{RefusalCode::TooLarge,
                           nameOf(meta) + " takes texts of at most " + std::to_string(kTextMax) +
                               " bytes: upload a file as a resource",
                           {}};
        if (auto refusal = checkValue(meta, *value); !refusal.ok()) return refusal;
        *out.add_values() = std::move(*value);
    }
    return out;
}

Refusal checkParam(const proto::CtrlParam& meta, const proto::Param& param) {
    const auto accepted = acceptParam(meta, param);
    return accepted ? Refusal{} : accepted.refusal();
}

std::string toText(const proto::Value& value) {
    switch (value.kind_case()) {
        case proto::Value::kInt:
            return std::to_string(value.int_());
        case proto::Value::kDbl:
            return numberText(value.dbl());
        case proto::Value::kStr:
            return value.str();
        case proto::Value::kBool:
            return value.bool_() ? "true" : "false";
        case proto::Value::KIND_NOT_SET:
            break;
    }
    return {};
}

bool equalValues(const proto::Value& a, const proto::Value& b) {
    if (a.kind_case() != b.kind_case()) return false;
    switch (a.kind_case()) {
        case proto::Value::kInt:
            return a.int_() == b.int_();
        case proto::Value::kDbl:
            return a.dbl() == b.dbl();
        case proto::Value::kStr:
            return a.str() == b.str();
        case proto::Value::kBool:
            return a.bool_() == b.bool_();
        case proto::Value::KIND_NOT_SET:
            break;
    }
    return true;
}

Refusal checkResourceUrl(std::string_view path) {
    const auto bad = [&](const std::string& reason) {
        return Refusal{RefusalCode::BadName,
                       "a path below the folder of the profiles is expected, such as maps/lab.map, or an "
                       "absolute one; " +
                           inQuotes(path) + " " + reason,
                       {}};
    };
    if (path.empty()) return bad("is empty");
    if (path.size() > 512) return bad("is longer than 512 bytes");
    if (!isUtf8(path)) return bad("is not UTF-8 text");
    for (const char c : path) {
        if (static_cast<unsigned char>(c) < 0x20U || c == 0x7F) return bad("has a control character");
        if (c == '\\' || c == ':')
            return bad("has a \\ or a colon: write steps with / and leave drive or scheme out");
    }
    std::string_view rest = path.substr(path.front() == '/' ? 1 : 0);
    while (true) {
        const std::size_t slash = rest.find('/');
        const auto step = rest.substr(0, slash);
        if (step == "..") return bad("leaves the folder by \"..\"");
        if (step.empty() || step == ".") return bad("has an empty step or \".\"");
        if (slash == std::string_view::npos) return {};
        rest.remove_prefix(slash + 1);
    }
}

Refusal toRefusal(const proto::Refusal& refusal) {
    return {static_cast<RefusalCode>(refusal.code()), refusal.message(), refusal.holder()};
}

proto::Refusal toProto(const Refusal& refusal) {
    proto::Refusal out;
    out.set_code(static_cast<proto::RefusalCode>(refusal.code));
    out.set_message(refusal.message);
    out.set_holder(refusal.holder);
    return out;
}

Result<int> findServiceIndex(const proto::ServicesProfile& profile, std::string_view name_or_global_id) {
    std::vector<std::string_view> ids;
    ids.reserve(static_cast<std::size_t>(profile.services_size()));
    for (const auto& service : profile.services()) ids.emplace_back(service.global_id());
    return findIndex(name_or_global_id, {namesOf(profile.services()), ids}, RefusalCode::UnknownService,
                     "service", "is offered by this entity");
}

const proto::Service* findService(const proto::ServicesProfile& profile, std::string_view name_or_global_id) {
    const auto index = findServiceIndex(profile, name_or_global_id);
    return index ? &profile.services(index.value()) : nullptr;
}

Result<int> findParamIndex(const proto::Service& service, std::string_view name) {
    // A parameter that only the robot sets is no suggestion.
    std::vector<std::string_view> settable;
    for (const auto& param : service.params())
        if (param.type() != proto::OUTPUT && param.type() != proto::FEEDBACK)
            settable.emplace_back(param.name());
    return findIndex(name, {namesOf(service.params())}, RefusalCode::UnknownParameter, "parameter",
                     "in service " + inQuotes(service.name()), &settable);
}

Result<int> findResourceIndex(const proto::Service& service, std::string_view name) {
    return findIndex(name, {namesOf(service.resources())}, RefusalCode::UnknownResource, "resource",
                     "in service " + inQuotes(service.name()));
}

}  // namespace axon
