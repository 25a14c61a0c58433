// SPDX-License-Identifier: GPL-2.0-or-later
#include "collaboration/bindings.hpp"

#include <algorithm>
#include <functional>
#include <optional>
#include <set>
#include <tuple>

namespace axon::collaboration {
namespace {

constexpr std::size_t kNobody = static_cast<std::size_t>(-1);
/// Of the candidates that cannot, so many are named.
constexpr std::size_t kNearest = 3;

enum Distance : int { kLatched = 1, kBusy, kHeld, kAway, kLacking, kInactive, kNotOffered, kOtherKind };

std::string joined(const std::vector<std::string>& parts, const char* last) {
    std::string text;
    for (std::size_t i = 0; i < parts.size(); ++i) {
        if (i > 0) text += i + 1 == parts.size() ? last : ", ";
        text += parts[i];
    }
    return text;
}

std::string kindOf(const std::string& category, const std::string& type) {
    if (category.empty() && type.empty()) return "any entity";
    return category + (category.empty() || type.empty() ? "" : "/") + type;
}

std::string wantedBy(const Role& role) {
    const auto text = kindOf(role.category, role.type);
    std::vector<std::string> services;
    for (const auto& need : role.needs) {
        if (std::find(services.begin(), services.end(), need.service) == services.end())
            services.push_back(need.service);
    }
    return services.empty() ? text : text + " with " + joined(services, ", ");
}

const Offer* offerOf(const Candidate& candidate, const std::string& service) {
    const auto named = [&](auto member) {
        return std::find_if(candidate.offers.begin(), candidate.offers.end(),
                            [&](const Offer& offer) { return offer.*member == service; });
    };
    auto found = named(&Offer::global_id);
    if (found == candidate.offers.end()) found = named(&Offer::name);
    return found == candidate.offers.end() ? nullptr : &*found;
}

/// The reasons why a candidate cannot play a role, the weightiest of them first.
class Lacks {
  public:
    void add(Distance distance, RefusalCode code, std::string what) {
        if (std::any_of(all_.begin(), all_.end(), [&](const Lack& lack) { return lack.what == what; }))
            return;
        all_.push_back({distance, code, std::move(what)});
    }
    std::optional<Unfit> of(const Candidate& candidate) {
        if (all_.empty()) return std::nullopt;
        std::stable_sort(all_.begin(), all_.end(),
                         [](const Lack& a, const Lack& b) { return a.distance > b.distance; });
        std::vector<std::string> parts;
        for (const auto& lack : all_) parts.push_back(lack.what);
        Unfit unfit{
            candidate.entity, candidate.name, {all_[0].code, joined(parts, ", and "), {}}, all_[0].distance};
        if (!candidate.held_here) unfit.why.holder = candidate.holder;
        return unfit;
    }

  private:
    struct Lack {
        Distance distance;
        RefusalCode code;
        std::string what;
    };
    std::vector<Lack> all_;
};

void lookAtServices(const Role& role, const Candidate& candidate, Lacks& lacks) {
    if (!candidate.silent.empty()) {
        lacks.add(kAway, RefusalCode::Unavailable, "does not tell its services (" + candidate.silent + ")");
        return;
    }
    for (const auto& need : role.needs) {
        const auto* offer = offerOf(candidate, need.service);
        if (offer == nullptr) {
            lacks.add(kNotOffered, RefusalCode::UnknownService, "does not offer " + need.service);
            continue;
        }
        if (!offer->active)
            lacks.add(kInactive, RefusalCode::InactiveService, "has " + need.service + " inactive");
        std::vector<std::string> missing;
        for (const auto& name : offer->missing) {
            if (std::find(need.given.begin(), need.given.end(), name) == need.given.end())
                missing.push_back(name);
        }
        if (!missing.empty()) {
            lacks.add(kLacking, RefusalCode::MissingDependency,
                      "lacks " + joined(missing, " and ") + " of " + need.service);
        }
    }
}

std::optional<Unfit> unfitness(const Role& role, const Candidate& candidate) {
    Lacks lacks;
    const bool other_category = !role.category.empty() && role.category != candidate.category;
    const bool other_type = !role.type.empty() && role.type != candidate.type;
    if (other_category || other_type)
        lacks.add(kOtherKind, RefusalCode::WrongType, "is " + kindOf(candidate.category, candidate.type));
    lookAtServices(role, candidate, lacks);
    switch (availability(candidate.state)) {
        case Availability::Ready:
            break;
        case Availability::Working:
            if (candidate.held_here)
                lacks.add(kBusy, RefusalCode::Blocked, std::string("is ") + toString(candidate.state));
            break;
        case Availability::Away:
            lacks.add(kAway, RefusalCode::Unavailable, std::string("is ") + toString(candidate.state));
    }
    if (!candidate.held_here && !candidate.holder.empty())
        lacks.add(kHeld, RefusalCode::AlreadyHeld, "is held by " + candidate.holder);
    if (candidate.latched) lacks.add(kLatched, RefusalCode::Latched, "was stopped and is not rearmed");
    return lacks.of(candidate);
}

/// Why nobody plays the role, as a line of its own.
std::string explained(const RoleOutlook& outlook, const std::string& chosen, const std::string& chosen_name,
                      const std::set<std::string>& unoffered) {
    auto text = "role " + std::to_string(outlook.role) + " (" + outlook.kind + "): ";
    if (!chosen.empty()) {
        for (const auto& unfit : outlook.unfit) {
            if (unfit.entity == chosen) return text + unfit.name + " " + unfit.why.message;
        }
        return text + (chosen_name.empty() ? "the entity chosen for it is not there"
                                           : chosen_name + " was chosen for another role as well");
    }
    if (!outlook.able.empty()) {
        return text + joined(outlook.able, " and ") + (outlook.able.size() == 1 ? " plays" : " play") +
               " other roles that nobody else can; one more such entity is missing";
    }
    if (outlook.unfit.empty()) return text + "there is no entity at all";
    std::vector<std::string> parts;
    for (const auto& unfit : outlook.unfit) {
        if (parts.size() == kNearest) break;
        // What is of another kind is worth a word only where nothing is nearer.
        if (unfit.distance == kOtherKind && !parts.empty()) break;
        parts.push_back(unfit.name + " " + unfit.why.message);
    }
    if (!unoffered.empty()) {
        text += "nobody offers " + joined({unoffered.begin(), unoffered.end()}, " and ") + "; ";
    }
    text += parts[0];
    for (std::size_t i = 1; i < parts.size(); ++i) text += "; " + parts[i];
    const auto near = static_cast<std::size_t>(
        std::count_if(outlook.unfit.begin(), outlook.unfit.end(),
                      [](const Unfit& unfit) { return unfit.distance != kOtherKind; }));
    if (near > parts.size()) text += "; and " + std::to_string(near - parts.size()) + " more";
    return text;
}

}  // namespace

Proposal propose(std::vector<Role> roles, std::vector<Candidate> candidates,
                 const std::map<int, std::string>& chosen) {
    std::sort(roles.begin(), roles.end(), [](const Role& a, const Role& b) { return a.number < b.number; });
    std::sort(candidates.begin(), candidates.end(), [](const Candidate& a, const Candidate& b) {
        return std::tuple(!a.held_here, a.name, a.entity) < std::tuple(!b.held_here, b.name, b.entity);
    });
    Proposal proposal;
    std::set<std::string> unoffered;
    for (const auto& role : roles) {
        for (const auto& need : role.needs) {
            const bool offered = std::any_of(candidates.begin(), candidates.end(), [&](const Candidate& one) {
                return offerOf(one, need.service) != nullptr;
            });
            if (!offered) unoffered.insert(need.service);
        }
    }
    proposal.nobody_offers.assign(unoffered.begin(), unoffered.end());

    const auto choiceOf = [&](const Role& role) {
        const auto choice = chosen.find(role.number);
        return choice == chosen.end() ? std::string() : choice->second;
    };
    std::vector<std::vector<bool>> fits(roles.size(), std::vector<bool>(candidates.size(), false));
    for (std::size_t r = 0; r < roles.size(); ++r) {
        auto& outlook = proposal.roles.emplace_back();
        outlook.role = roles[r].number;
        outlook.wanted = wantedBy(roles[r]);
        outlook.kind = kindOf(roles[r].category, roles[r].type);
        const auto choice = choiceOf(roles[r]);
        for (std::size_t c = 0; c < candidates.size(); ++c) {
            if (auto unfit = unfitness(roles[r], candidates[c])) {
                outlook.unfit.push_back(*std::move(unfit));
                continue;
            }
            outlook.able.push_back(candidates[c].name);
            fits[r][c] = choice.empty() || choice == candidates[c].entity;
        }
        std::stable_sort(outlook.unfit.begin(), outlook.unfit.end(),
                         [](const Unfit& a, const Unfit& b) { return a.distance < b.distance; });
    }
    // A choice is not to be had for another role, not even where its own role cannot be played by it.
    for (const auto& [role, entity] : chosen) {
        for (std::size_t c = 0; c < candidates.size(); ++c) {
            if (candidates[c].entity != entity) continue;
            for (std::size_t r = 0; r < roles.size(); ++r) {
                if (roles[r].number != role && choiceOf(roles[r]) != entity) fits[r][c] = false;
            }
        }
    }

    // Augmenting paths from the candidates' side: who has a role once keeps one, so the first in order, which
    // are those that are held, are used before the others.
    std::vector<std::size_t> player(roles.size(), kNobody);
    std::vector<bool> tried;
    const std::function<bool(std::size_t)> seat = [&](std::size_t candidate) {
        // A free role, before anybody has to change his.
        for (const bool free : {true, false}) {
            for (std::size_t r = 0; r < roles.size(); ++r) {
                if (tried[r] || !fits[r][candidate] || (player[r] == kNobody) != free) continue;
                tried[r] = true;
                if (free || seat(player[r])) {
                    player[r] = candidate;
                    return true;
                }
            }
        }
        return false;
    };
    for (std::size_t c = 0; c < candidates.size(); ++c) {
        tried.assign(roles.size(), false);
        seat(c);
    }

    for (std::size_t r = 0; r < roles.size(); ++r) {
        auto& outlook = proposal.roles[r];
        if (player[r] != kNobody) {
            outlook.entity = candidates[player[r]].entity;
            outlook.name = candidates[player[r]].name;
            continue;
        }
        const auto choice = choiceOf(roles[r]);
        std::set<std::string> its_unoffered;
        for (const auto& need : roles[r].needs) {
            if (unoffered.count(need.service) != 0) its_unoffered.insert(need.service);
        }
        if (proposal.why.ok()) {
            proposal.why.code = RefusalCode::Unavailable;
            const auto about =
                std::find_if(outlook.unfit.begin(), outlook.unfit.end(),
                             [&](const Unfit& unfit) { return choice.empty() || unfit.entity == choice; });
            if (about != outlook.unfit.end() && (outlook.able.empty() || !choice.empty())) {
                proposal.why.code = about->why.code;
                proposal.why.holder = about->why.holder;
            }
            if (!its_unoffered.empty() && choice.empty()) proposal.why.code = RefusalCode::UnknownService;
        }
        if (!proposal.why.message.empty()) proposal.why.message += '\n';
        const auto named = std::find_if(candidates.begin(), candidates.end(),
                                        [&](const Candidate& one) { return one.entity == choice; });
        proposal.why.message +=
            explained(outlook, choice, named == candidates.end() ? "" : named->name, its_unoffered);
    }
    return proposal;
}

}  // namespace axon::collaboration
