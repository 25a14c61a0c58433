// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "common/result.hpp"

namespace axon::client {

/// "2 ROBOT/MOBILE with Driving": a number of entities of one kind. Empty = any.
struct QueryItem {
    std::size_t count = 1;
    std::string category;  ///< ROBOT or MACHINE
    std::string type;      ///< MOBILE or STATIONARY
    std::string service;   ///< name or global id
    bool operator==(const QueryItem&) const = default;
};

/// What to check out when it does not matter which: "2 ROBOT/MOBILE + 1 ROBOT/STATIONARY".
struct EntityQuery {
    std::vector<QueryItem> items;

    bool needsServices() const;
    std::size_t count() const;
};

/// The most that one query may ask for.
inline constexpr std::size_t kQueryMax = 64;

/// ITEM + ITEM …, each [COUNT] KIND [with SERVICE], where KIND is ROBOT or MACHINE, MOBILE or STATIONARY, or
/// both with '/' between them, in any case; a service may stand in quotes. MALFORMED says what was expected,
/// what was found and how to write it. Pure.
Result<EntityQuery> parseQuery(std::string_view text);
/// "2 ROBOT/MOBILE with Driving".
std::string toText(const QueryItem& item);

/// Who serves what: `chosen` are indices of candidates, the items' in order; `lacking`, one number for each
/// item, is how many are missing. As many as possible are served: "1 ROBOT + 1 MOBILE" does not give its only
/// mobile robot to the first item. Pure.
struct Assignment {
    std::vector<std::size_t> chosen;
    std::vector<std::size_t> lacking;
    bool complete() const;
};
Assignment assign(const EntityQuery& query, std::size_t candidates,
                  const std::function<bool(const QueryItem& item, std::size_t candidate)>& serves);

}  // namespace axon::client
