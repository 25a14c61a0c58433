// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/arguments.hpp"

#include <algorithm>
#include <cctype>

#include "messages/text.hpp"

namespace axon::cli {
namespace {

char folded(char c) {
    if (c == '_' || c == '-') return ' ';
    return static_cast<char>(std::tolower(static_cast<unsigned char>(c)));
}

std::string nameList(const std::vector<std::string_view>& names) {
    std::vector<std::string> list(names.begin(), names.end());
    return alternatives(list);
}

/// The one of `things` that a person means by `name`. `eligible`: whether it may be named instead of one that
/// there is not.
template <class Thing, class NameOf, class Eligible>
Result<const Thing*> findByName(const std::vector<Thing>& things, std::string_view name, NameOf nameOf,
                                RefusalCode unknown, const std::string& owner, const std::string& kind,
                                Eligible eligible) {
    std::vector<std::string_view> names;
    std::vector<const Thing*> similar;
    for (const auto& thing : things) {
        if (nameOf(thing) == name) return &thing;
        if (eligible(thing)) names.push_back(nameOf(thing));
        if (sameToAPerson(nameOf(thing), name)) similar.push_back(&thing);
    }
    if (similar.size() == 1) return similar.front();
    if (similar.size() > 1) {
        std::vector<std::string_view> candidates;
        for (const auto* thing : similar) candidates.push_back(nameOf(*thing));
        return Refusal{unknown,
                       inQuotes(name) + " may mean " + nameList(candidates) + ": write the exact name"};
    }
    auto message = owner + " has no " + kind + " " + inQuotes(name);
    if (const auto near = nearNames(name, names); !near.empty()) {
        message += ": did you mean " + alternatives(near) + "?";
    } else if (names.empty()) {
        message += things.empty() ? "; it has none" : "; it has none that can be set";
    } else if (names.size() <= 8) {
        message += "; it has " + nameList(names);
    }
    return Refusal{unknown, message};
}

constexpr auto kAny = [](const auto&) { return true; };

bool maySet(const Parameter& parameter) {
    return parameter.kind != client::ParameterKind::Output &&
           parameter.kind != client::ParameterKind::Feedback;
}

/// The choice of the parameter that a person means by `value`, as its profile writes it; `value` itself where
/// there is none, or more than one.
std::string asChosen(const Parameter& parameter, std::string value) {
    const std::string* meant = nullptr;
    for (const auto& choice : parameter.choices) {
        const auto* text = std::get_if<std::string>(&choice);
        if (text == nullptr || !sameToAPerson(*text, value)) continue;
        if (*text == value) return value;
        if (meant != nullptr) return value;
        meant = text;
    }
    return meant == nullptr ? value : *meant;
}

}  // namespace

bool sameToAPerson(std::string_view a, std::string_view b) {
    return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                      [](char x, char y) { return folded(x) == folded(y); });
}

Result<const Service*> findService(const std::vector<Service>& services, std::string_view name) {
    auto by_name = findByName(
        services, name, [](const Service& s) -> std::string_view { return s.name; },
        RefusalCode::UnknownService, "the entity", "service", kAny);
    if (by_name) return by_name;
    for (const auto& service : services) {
        if (!service.global_id.empty() && service.global_id == name) return &service;
    }
    return by_name;
}

Result<const client::GlobalService*> findGlobalService(const std::vector<client::GlobalService>& services,
                                                       std::string_view name) {
    return findByName(
        services, name, [](const client::GlobalService& s) -> std::string_view { return s.name; },
        RefusalCode::UnknownService, "the server", "global service", kAny);
}

Result<const Parameter*> findParameter(const Service& service, std::string_view name) {
    return findByName(
        service.parameters, name, [](const Parameter& p) -> std::string_view { return p.name; },
        RefusalCode::UnknownParameter, inQuotes(service.name), "parameter", maySet);
}

Result<const client::Resource*> findResource(const Service& service, std::string_view name) {
    return findByName(
        service.resources, name, [](const client::Resource& r) -> std::string_view { return r.name; },
        RefusalCode::UnknownResource, inQuotes(service.name), "resource", kAny);
}

std::optional<Measure> splitMeasure(std::string_view text) {
    const auto digit = [&](std::size_t at) {
        return at < text.size() && std::isdigit(static_cast<unsigned char>(text[at])) != 0;
    };
    std::size_t i = 0;
    if (i < text.size() && (text[i] == '+' || text[i] == '-')) ++i;
    const auto first = i;
    while (digit(i)) ++i;
    auto digits = i - first;
    if (i < text.size() && text[i] == '.') {
        const auto point = ++i;
        while (digit(i)) ++i;
        digits += i - point;
    }
    if (digits == 0) return std::nullopt;
    if (i < text.size() && (text[i] == 'e' || text[i] == 'E')) {
        auto exponent = i + 1;
        if (exponent < text.size() && (text[exponent] == '+' || text[exponent] == '-')) ++exponent;
        if (digit(exponent)) {
            i = exponent;
            while (digit(i)) ++i;
        }
    }
    const auto units = trimmed(text.substr(i));
    // A letter, a sign such as % or °; not a second number ("1,2", "1:30").
    if (units.empty()) return std::nullopt;
    const auto lead = static_cast<unsigned char>(units.front());
    if (std::isalpha(lead) == 0 && lead != '%' && lead < 0x80U) return std::nullopt;
    return Measure{std::string(text.substr(0, i)), std::string(units)};
}

Result<std::vector<Argument>> readArguments(const Service& service, const std::vector<std::string>& words) {
    std::vector<Argument> arguments;
    for (const auto& word : words) {
        const auto equals = word.find('=');
        if (equals == std::string::npos || equals == 0) {
            return Refusal{RefusalCode::Malformed, "expected PARAMETER=VALUE, found " + inQuotes(word)};
        }
        const auto parameter = findParameter(service, trimmed(std::string_view(word).substr(0, equals)));
        if (!parameter) return parameter.refusal();
        const auto& meta = *parameter.value();
        auto value = word.substr(equals + 1);
        std::string units;
        const bool number =
            meta.data_type == client::DataType::Integer || meta.data_type == client::DataType::Double;
        if (number && !meta.units.empty()) {
            // No unit has a digit, unless it is this parameter's own: 0x10 is a number that nobody can read.
            const auto measure = splitMeasure(value);
            if (measure && (measure->units == meta.units ||
                            measure->units.find_first_of("0123456789") == std::string::npos)) {
                value = measure->number;
                units = measure->units;
            }
        }
        if (!number) value = asChosen(meta, std::move(value));
        const auto same = std::find_if(arguments.begin(), arguments.end(),
                                       [&](const Argument& a) { return a.name == meta.name; });
        if (same == arguments.end()) {
            arguments.push_back({meta.name, {value}, units, true});
        } else {
            if (!meta.multiple) {
                return Refusal{RefusalCode::WrongType, inQuotes(meta.name) + " takes only one value"};
            }
            if (same->units.empty()) same->units = units;
            if (!units.empty() && units != same->units) {
                return Refusal{RefusalCode::WrongUnits, inQuotes(meta.name) + " was given in " +
                                                            inQuotes(same->units) + " and in " +
                                                            inQuotes(units)};
            }
            same->values.emplace_back(value);
        }
    }
    return arguments;
}

}  // namespace axon::cli
