// SPDX-License-Identifier: MIT
#pragma once
#include <array>
#include <cstdint>
#include <string>

/// What servers report about clients and entities. The numbers are those in api/slice/axon/commutil.ice.
namespace axon {

enum class Role : std::uint8_t { Observer, Operator, Admin };
enum class Presence : std::uint8_t { Joined, Changed, Left };

/// The nine states of an Entity Manager (thesis 3.3.1), named as in the contracts.
enum class EntityState : std::uint8_t {
#define AXON_STATE(name, availability) name,
#include "states.def"
#undef AXON_STATE
};
inline constexpr std::array kEntityStates{
#define AXON_STATE(name, availability) EntityState::name,
#include "states.def"
#undef AXON_STATE
};

/// What a client can do with an entity that is in a state.
enum class Availability : std::uint8_t {
    Away,     ///< nobody can hold it: it is not reachable, it is starting, or it is out of order
    Ready,    ///< it can be checked out, or its holder can give it a task
    Working,  ///< it carries out a task or takes part in a collaboration
};

const char* toString(EntityState state);
Availability availability(EntityState state);
const char* toString(Role role);

/// Who has sent a message. The server fills it in from the session and never takes it from the peer
/// (ARCHITECTURE.md, section 5, invariant 9).
struct Sender {
    std::string id;    ///< UUID of a client's session, or UUID of an entity
    std::string name;  ///< for people: user@host, or the name of the entity
    Role role = Role::Operator;

    bool operator==(const Sender&) const = default;
};

}  // namespace axon
