// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/access.hpp"

#include <algorithm>
#include <cctype>

namespace axon::users {
namespace {

constexpr std::size_t kPatternMax = 256;

bool isRole(std::string_view name) {
    return name == toString(Role::Observer) || name == toString(Role::Operator) ||
           name == toString(Role::Admin);
}

}  // namespace

bool isUserName(std::string_view name) {
    return !name.empty() && name.size() <= 64 && std::all_of(name.begin(), name.end(), [](unsigned char c) {
        return std::isalnum(c) != 0 || c == '.' || c == '-' || c == '_';
    });
}

bool fits(std::string_view pattern, std::string_view text) {
    // Where the last '*' was, and how much of the text it has taken so far.
    std::size_t star = std::string_view::npos, taken = 0;
    std::size_t p = 0, t = 0;
    while (t < text.size()) {
        if (p < pattern.size() && pattern[p] == '*') {
            star = p++;
            taken = t;
        } else if (p < pattern.size() && (pattern[p] == '?' || pattern[p] == text[t])) {
            ++p;
            ++t;
        } else if (star != std::string_view::npos) {
            p = star + 1;
            t = ++taken;
        } else {
            return false;
        }
    }
    while (p < pattern.size() && pattern[p] == '*') ++p;
    return p == pattern.size();
}

std::string Access::add(const std::vector<std::string_view>& words) {
    if (rules_.size() >= kRulesMax)
        return "expected at most " + std::to_string(kRulesMax) + " lines that begin with '@'";
    const auto right = entityRight(words[0].substr(1));
    if (!right) return "expected @see, @checkout, @force or @rearm at the beginning of a line with '@'";
    if (words.size() < 3)
        return "expected '@" + std::string(toString(*right)) + " ENTITY WHO …', such as '@" +
               toString(*right) + " arm-* ann @admin'";
    if (words[1].size() > kPatternMax)
        return "expected a pattern of entities of at most " + std::to_string(kPatternMax) + " bytes";
    Rule rule{*right, std::string(words[1]), {}};
    for (std::size_t i = 2; i < words.size(); ++i) {
        const auto word = words[i];
        const bool one = word == "*" || word == "-";
        if (one && words.size() > 3) return "expected '*' (everybody) or '-' (nobody) alone";
        if (!one && !(word.starts_with('@') ? isRole(word.substr(1)) : isUserName(word)))
            return "expected users and roles (@observer, @operator, @admin), '*' for everybody or '-' for "
                   "nobody after the entity";
        rule.who.emplace_back(word);
    }
    rules_.push_back(std::move(rule));
    return {};
}

bool Access::has(const std::string& user, Role role, EntityRight right, std::string_view uuid,
                 std::string_view name) const {
    const auto rule = std::find_if(rules_.begin(), rules_.end(), [&](const Rule& one) {
        return one.right == right && (fits(one.entity, name) || fits(one.entity, uuid));
    });
    if (rule == rules_.end()) return true;
    const std::string_view its_role = toString(role);
    return std::any_of(rule->who.begin(), rule->who.end(), [&](const std::string& who) {
        return who == "*" || who == user ||
               (who.front() == '@' && std::string_view(who).substr(1) == its_role);
    });
}

bool Access::allows(const std::string& user, Role role, EntityRight right, std::string_view uuid,
                    std::string_view name) const {
    if (!has(user, role, EntityRight::See, uuid, name)) return false;
    if (right == EntityRight::Force && !has(user, role, EntityRight::CheckOut, uuid, name)) return false;
    return right == EntityRight::See || has(user, role, right, uuid, name);
}

}  // namespace axon::users
