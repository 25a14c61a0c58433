// SPDX-License-Identifier: MIT
#pragma once
#include <string_view>

namespace axon {

/// Between the name of a partner's laboratory and that of its entity: "b/PeopleBot".
inline constexpr char kLaboratorySeparator = '/';

/// Whether the certificate of an entity permits this name. One that ends in the separator, "b/", is that of a
/// partner's laboratory, and permits all names of its entities; any other permits the one name that it bears.
inline bool certificatePermits(std::string_view certified, std::string_view name) {
    if (certified == name) return certified.empty() || certified.back() != kLaboratorySeparator;
    return certified.size() > 1 && certified.back() == kLaboratorySeparator && name.starts_with(certified);
}

}  // namespace axon
