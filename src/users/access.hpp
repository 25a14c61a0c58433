// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <string>
#include <string_view>
#include <vector>

#include "common/rights.hpp"
#include "common/routed.hpp"

namespace axon::users {

/// Which entities a user may see, check out, take over by force and rearm: the lines of users.cfg that begin
/// with '@'.
///
/// A line restricts one right to entities of a pattern: `@checkout arm-* ann @admin` says that only ann and
/// administrators may check out entities whose name or UUID is `arm-` and anything. Of several lines of one
/// right that fit an entity, the first counts; where none fits, everybody has the right. No line gives more
/// than the role does, and whoever does not see an entity has no other right over it. There is no line for
/// stops: who sees an entity may stop it.
///
/// Immutable once filled; any thread. No I/O. Failure: expected…() say what is wrong with a line.
class Access {
  public:
    struct Rule {
        EntityRight right = EntityRight::See;
        std::string entity;            ///< a pattern: '*' is anything, '?' one character
        std::vector<std::string> who;  ///< users, "@ROLE", or "*" for everybody; "-" for nobody
        bool operator==(const Rule&) const = default;
    };

    static constexpr std::size_t kRulesMax = 1000;

    /// Adds the line of these words, the first of which begins with '@'. Returns what was expected instead,
    /// or an empty text.
    std::string add(const std::vector<std::string_view>& words);
    const std::vector<Rule>& rules() const { return rules_; }
    bool empty() const { return rules_.empty(); }
    bool operator==(const Access&) const = default;

    /// `uuid`, `name`: of the entity.
    bool allows(const std::string& user, Role role, EntityRight right, std::string_view uuid,
                std::string_view name) const;

  private:
    bool has(const std::string& user, Role role, EntityRight right, std::string_view uuid,
             std::string_view name) const;

    std::vector<Rule> rules_;
};

/// Letters, digits, '.', '-' and '_', at most 64: names of users appear in logs, files and names of senders.
bool isUserName(std::string_view name);

/// Whether the text is one of the pattern.
bool fits(std::string_view pattern, std::string_view text);

}  // namespace axon::users
