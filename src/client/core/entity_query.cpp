// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/entity_query.hpp"

#include <algorithm>
#include <charconv>
#include <optional>

#include "messages/text.hpp"

namespace axon::client {
namespace {

constexpr std::string_view kSpace = " \t\r\n";
constexpr const char* kExample = " For example: 2 ROBOT/MOBILE + 1 ROBOT/STATIONARY with Gripping";

Refusal malformed(const std::string& what) {
    return {RefusalCode::Malformed, what + kExample, {}};
}

/// The first word, which is taken off.
std::string_view takeWord(std::string_view& text) {
    text = trimmed(text);
    const auto end = std::min(text.find_first_of(kSpace), text.size());
    const auto word = text.substr(0, end);
    text = trimmed(text.substr(end));
    return word;
}

/// "ROBOT" for "robot", nothing for what is none of them.
std::optional<std::string> oneOf(std::string_view word, std::initializer_list<const char*> tokens) {
    for (const auto* token : tokens) {
        if (equalIgnoringCase(word, token)) return token;
    }
    return std::nullopt;
}

std::optional<std::string> category(std::string_view word) {
    return oneOf(word, {"ROBOT", "MACHINE"});
}
std::optional<std::string> type(std::string_view word) {
    return oneOf(word, {"MOBILE", "STATIONARY"});
}

std::string didYouMean(std::string_view word, const std::vector<std::string_view>& tokens) {
    const auto near = nearNames(word, tokens);
    return near.empty() ? "." : "; did you mean " + alternatives(near) + "?";
}

Refusal readKind(std::string_view word, QueryItem& item) {
    const auto slash = word.find('/');
    if (slash == std::string_view::npos) {
        if (const auto found = category(word)) {
            item.category = *found;
        } else if (const auto kind = type(word)) {
            item.type = *kind;
        } else {
            return malformed(
                "Expected ROBOT or MACHINE, MOBILE or STATIONARY, or both with / between them; "
                "found " +
                inQuotes(word) + didYouMean(word, {"ROBOT", "MACHINE", "MOBILE", "STATIONARY"}));
        }
        return {};
    }
    const auto before = word.substr(0, slash);
    const auto after = word.substr(slash + 1);
    const auto found = category(before);
    if (!found) {
        return malformed("Expected ROBOT or MACHINE before the /, found " + inQuotes(before) +
                         didYouMean(before, {"ROBOT", "MACHINE"}));
    }
    const auto kind = type(after);
    if (!kind) {
        return malformed("Expected MOBILE or STATIONARY after the /, found " + inQuotes(after) +
                         didYouMean(after, {"MOBILE", "STATIONARY"}));
    }
    item.category = *found;
    item.type = *kind;
    return {};
}

Result<QueryItem> readItem(std::string_view text) {
    QueryItem item;
    auto rest = text;
    auto word = takeWord(rest);
    if (word.empty()) return malformed("Expected what to check out before and after each +, found nothing.");
    if (word.front() == '-' || (word.front() >= '0' && word.front() <= '9')) {
        const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), item.count);
        if (error != std::errc{} || end != word.data() + word.size() || item.count == 0 ||
            item.count > kQueryMax) {
            return malformed("Expected how many (1 to " + std::to_string(kQueryMax) + "), found " +
                             inQuotes(word) + ".");
        }
        word = takeWord(rest);
        if (word.empty()) return malformed("Expected a kind after the number in " + inQuotes(text) + ".");
    }
    if (auto refusal = readKind(word, item); !refusal.ok()) return refusal;
    if (rest.empty()) return item;
    const auto with = takeWord(rest);
    if (!equalIgnoringCase(with, "with")) {
        return malformed("Expected \"with SERVICE\" or + after the kind, found " + inQuotes(with) + ".");
    }
    if (rest.size() >= 2 && (rest.front() == '"' || rest.front() == '\'') && rest.back() == rest.front()) {
        rest = trimmed(rest.substr(1, rest.size() - 2));
    }
    if (rest.empty()) return malformed("Expected the name of a service after \"with\".");
    item.service = std::string(rest);
    return item;
}

/// The items; a + in quotes belongs to a name.
std::vector<std::string_view> split(std::string_view text) {
    std::vector<std::string_view> parts;
    std::size_t begin = 0;
    char quote = 0;
    for (std::size_t i = 0; i < text.size(); ++i) {
        const char c = text[i];
        if (quote != 0) {
            if (c == quote) quote = 0;
        } else if ((c == '"' || c == '\'') && i > 0 && kSpace.find(text[i - 1]) != std::string_view::npos) {
            quote = c;
        } else if (c == '+') {
            parts.push_back(text.substr(begin, i - begin));
            begin = i + 1;
        }
    }
    parts.push_back(text.substr(begin));
    return parts;
}

}  // namespace

bool EntityQuery::needsServices() const {
    return std::any_of(items.begin(), items.end(), [](const QueryItem& one) { return !one.service.empty(); });
}

std::size_t EntityQuery::count() const {
    std::size_t sum = 0;
    for (const auto& item : items) sum += item.count;
    return sum;
}

Result<EntityQuery> parseQuery(std::string_view text) {
    if (trimmed(text).empty()) return malformed("Expected what to check out, found nothing.");
    EntityQuery query;
    for (const auto part : split(text)) {
        auto item = readItem(part);
        if (!item) return item.refusal();
        query.items.push_back(std::move(item).value());
        if (query.count() > kQueryMax) {
            return malformed("Expected " + std::to_string(kQueryMax) + " entities at most in one query.");
        }
    }
    return query;
}

std::string toText(const QueryItem& item) {
    auto text = std::to_string(item.count) + " " + item.category;
    if (!item.category.empty() && !item.type.empty()) text += "/";
    text += item.type;
    if (!item.service.empty()) text += " with " + item.service;
    return text;
}

bool Assignment::complete() const {
    return std::all_of(lacking.begin(), lacking.end(), [](std::size_t number) { return number == 0; });
}

Assignment assign(const EntityQuery& query, std::size_t candidates,
                  const std::function<bool(const QueryItem& item, std::size_t candidate)>& serves) {
    // A maximum matching of places and candidates by augmenting paths (Kuhn).
    constexpr auto kNobody = static_cast<std::size_t>(-1);
    std::vector<std::size_t> item_of;  // by place
    for (std::size_t i = 0; i < query.items.size(); ++i)
        item_of.insert(item_of.end(), query.items[i].count, i);
    std::vector<std::size_t> place_of(candidates, kNobody);
    std::vector<bool> tried;
    const std::function<bool(std::size_t)> seat = [&](std::size_t place) {
        for (std::size_t candidate = 0; candidate < candidates; ++candidate) {
            if (tried[candidate] || !serves(query.items[item_of[place]], candidate)) continue;
            tried[candidate] = true;
            if (place_of[candidate] == kNobody || seat(place_of[candidate])) {
                place_of[candidate] = place;
                return true;
            }
        }
        return false;
    };
    Assignment result;
    result.lacking.assign(query.items.size(), 0);
    for (std::size_t place = 0; place < item_of.size(); ++place) {
        tried.assign(candidates, false);
        if (!seat(place)) ++result.lacking[item_of[place]];
    }
    std::vector<std::size_t> candidate_of(item_of.size(), kNobody);
    for (std::size_t candidate = 0; candidate < candidates; ++candidate) {
        if (place_of[candidate] != kNobody) candidate_of[place_of[candidate]] = candidate;
    }
    for (const auto candidate : candidate_of) {
        if (candidate != kNobody) result.chosen.push_back(candidate);
    }
    return result;
}

}  // namespace axon::client
