// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/name_index.hpp"

#include <algorithm>
#include <charconv>
#include <iterator>

#include "messages/text.hpp"

namespace axon::client {
namespace {

constexpr std::size_t kShortestPrefix = 4;
constexpr std::size_t kPrefixShown = 8;
constexpr std::size_t kCandidatesShown = 8;

std::string lower(std::string_view text) {
    std::string out(text);
    for (char& c : out) {
        if (c >= 'A' && c <= 'Z') c = static_cast<char>(c - 'A' + 'a');
    }
    return out;
}

}  // namespace

void NameIndex::put(const std::string& id, const std::string& name, bool ready) {
    const auto known = names_.find(id);
    if (known != names_.end()) {
        if (known->second == Known{name, ready}) return;
        remove(id);
    }
    names_[id] = {name, ready};
    (ready ? by_name_ : unready_)[name].insert(id);
}

void NameIndex::remove(const std::string& id) {
    const auto known = names_.find(id);
    if (known == names_.end()) return;
    auto& names = known->second.ready ? by_name_ : unready_;
    const auto same = names.find(known->second.name);
    same->second.erase(id);
    if (same->second.empty()) names.erase(same);
    names_.erase(known);
}

void NameIndex::clear() {
    names_.clear();
    by_name_.clear();
    unready_.clear();
}

std::vector<std::string> NameIndex::ids() const {
    std::vector<std::string> all;
    all.reserve(names_.size());
    for (const auto& [id, known] : names_) all.push_back(id);
    return all;
}

std::string NameIndex::label(const std::string& id) const {
    const auto known = names_.find(id);
    if (known == names_.end()) return id;
    const auto& [name, ready] = known->second;
    if (!ready)
        return by_name_.contains(name) || unready_.at(name).size() > 1 ? id.substr(0, kPrefixShown) : name;
    const auto& same = by_name_.at(name);
    if (same.size() == 1) return name;
    const auto place = std::distance(same.begin(), same.find(id)) + 1;
    return name + "#" + std::to_string(place);
}

Refusal NameIndex::ambiguous(std::string_view text, const std::vector<std::string>& candidates) const {
    std::string list;
    for (std::size_t i = 0; i < candidates.size() && i < kCandidatesShown; ++i) {
        if (i > 0) list += ", ";
        list += label(candidates[i]) + " (" + candidates[i] + ")";
    }
    if (candidates.size() > kCandidatesShown) {
        list += " and " + std::to_string(candidates.size() - kCandidatesShown) + " more";
    }
    return {RefusalCode::AmbiguousEntity,
            inQuotes(text) + " means " + std::to_string(candidates.size()) + " entities: " + list +
                ". Name one of them by its #number or by the beginning of its UUID.",
            {}};
}

Result<std::string> NameIndex::resolve(std::string_view text) const {
    auto candidates = meant(text, Scope::ReadyFirst);
    if (!candidates) return candidates.refusal();
    if (candidates->size() > 1) return ambiguous(text, candidates.value());
    return std::move(candidates->front());
}

Result<std::vector<std::string>> NameIndex::resolveAll(std::string_view text) const {
    return meant(text, Scope::All);
}

Result<std::vector<std::string>> NameIndex::meant(std::string_view text, Scope scope) const {
    if (text.empty()) {
        return Refusal{
            RefusalCode::UnknownEntity, "An empty name means no entity. Give a name or a UUID.", {}};
    }
    const std::string folded = lower(text);
    if (names_.count(folded) != 0) return std::vector{folded};
    if (names_.count(std::string(text)) != 0) return std::vector{std::string(text)};

    std::vector<std::string> same_name;
    for (const auto* names : {&by_name_, &unready_}) {
        if (!same_name.empty() && scope == Scope::ReadyFirst) break;
        if (const auto same = names->find(std::string(text)); same != names->end())
            same_name.insert(same_name.end(), same->second.begin(), same->second.end());
    }
    if (!same_name.empty()) return same_name;

    if (const auto hash = text.rfind('#'); hash != std::string_view::npos && hash + 1 < text.size()) {
        std::size_t place = 0;
        const auto digits = text.substr(hash + 1);
        const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), place);
        const auto same = by_name_.find(std::string(text.substr(0, hash)));
        if (error == std::errc{} && end == digits.data() + digits.size() && same != by_name_.end()) {
            if (place >= 1 && place <= same->second.size()) {
                return std::vector{*std::next(same->second.begin(), static_cast<std::ptrdiff_t>(place - 1))};
            }
            return Refusal{RefusalCode::UnknownEntity,
                           "There are only " + std::to_string(same->second.size()) + " entities named " +
                               inQuotes(text.substr(0, hash)) + ", counted from #1.",
                           {}};
        }
    }

    if (text.size() >= kShortestPrefix) {
        std::vector<std::string> candidates;
        for (auto it = names_.lower_bound(folded); it != names_.end() && it->first.starts_with(folded);
             ++it) {
            candidates.push_back(it->first);
        }
        if (!candidates.empty()) return candidates;
    }

    std::vector<std::string> folded_same;
    std::vector<std::string_view> all_names;
    for (const auto* names : {&by_name_, &unready_}) {
        const bool enough = !folded_same.empty() && scope == Scope::ReadyFirst;
        for (const auto& [name, ids] : *names) {
            if (names == &by_name_ || !by_name_.contains(name)) all_names.push_back(name);
            if (!enough && equalIgnoringCase(name, text))
                folded_same.insert(folded_same.end(), ids.begin(), ids.end());
        }
    }
    if (!folded_same.empty()) return folded_same;

    const auto near = nearNames(text, all_names);
    std::string fix;
    if (!near.empty()) {
        fix = " Did you mean " + alternatives(near) + "?";
    } else if (names_.empty()) {
        fix = " No entity is connected to the server: start an Entity Manager and its robot application.";
    } else {
        fix = " List the entities to see what is there.";
    }
    return Refusal{RefusalCode::UnknownEntity, "No entity is called " + inQuotes(text) + "." + fix, {}};
}

}  // namespace axon::client
