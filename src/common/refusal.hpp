// SPDX-License-Identifier: MIT
#pragma once
#include <span>
#include <string>
#include <string_view>

#include "common/axon/refusal.hpp"  // public: part of what the client library's headers say

namespace axon {

/// One line of the list of refusals, axon/refusals.def, which explains the members.
struct RefusalEntry {
    RefusalCode code;
    std::string_view name;
    int exit;
    std::string_view decided_by, meaning, remedy;
};

/// The whole list, in the order of the numbers. Immutable; any thread.
std::span<const RefusalEntry> refusals();
/// What the list says about a code; for a number that is not in it, what it says about Internal.
const RefusalEntry& refusalEntry(RefusalCode code);
/// The remedy with these names in it; empty where only the message of the refusal has one.
std::string remedyFor(RefusalCode code, std::string_view entity, std::string_view holder);

}  // namespace axon
