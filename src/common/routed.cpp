// SPDX-License-Identifier: MIT
#include "common/routed.hpp"

#include <cstddef>
#include <iterator>

namespace axon {

namespace {

struct StateRow {
    const char* token;
    Availability availability;
};
constexpr StateRow kStates[] = {
#define AXON_STATE(name, availability) {#name, Availability::availability},
#include "common/axon/states.def"
#undef AXON_STATE
};

/// Null for a number that is no state: servers pass on what a peer has said.
const StateRow* rowOf(EntityState state) {
    const auto index = static_cast<std::size_t>(state);
    return index < std::size(kStates) ? &kStates[index] : nullptr;
}

}  // namespace

const char* toString(EntityState state) {
    const auto* row = rowOf(state);
    return row != nullptr ? row->token : "?";
}

Availability availability(EntityState state) {
    const auto* row = rowOf(state);
    return row != nullptr ? row->availability : Availability::Away;
}

const char* toString(StopCause cause) {
    switch (cause) {
        case StopCause::Unspecified:
            return "unspecified";
        case StopCause::Requested:
            return "requested";
        case StopCause::ClientLost:
            return "client lost";
        case StopCause::Released:
            return "released";
        case StopCause::Improper:
            return "improper client";
        case StopCause::ServerLost:
            return "server lost";
        case StopCause::LinkLost:
            return "link lost";
        case StopCause::Reset:
            return "reset";
        case StopCause::Clear:
            return "clear";
        case StopCause::Cancel:
            return "cancel";
        case StopCause::Shutdown:
            return "shutdown";
        case StopCause::Fault:
            return "fault";
        case StopCause::Drill:
            return "drill";
    }
    return "?";
}

const char* toString(Role role) {
    switch (role) {
        case Role::Observer:
            return "observer";
        case Role::Operator:
            return "operator";
        case Role::Admin:
            return "admin";
    }
    return "?";
}

ClientOrigin originOf(std::string_view client_id) {
    const auto first = client_id.find(':');
    const auto last = client_id.rfind(':');
    if (first == std::string_view::npos || first == last) return {};
    return {client_id.substr(0, first), client_id.substr(first + 1, last - first - 1)};
}

std::string_view uuidOf(std::string_view client_id) {
    return client_id.substr(client_id.rfind(':') + 1);
}

bool isServerName(std::string_view name) {
    constexpr std::string_view kAllowed = "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_";
    return !name.empty() && name.size() <= 32 && name.find_first_not_of(kAllowed) == std::string_view::npos;
}

}  // namespace axon
