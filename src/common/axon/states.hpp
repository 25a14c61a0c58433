// SPDX-License-Identifier: MIT
#pragma once
#include <cstdint>
#include <string>

/// What servers say of clients and entities. The numbers are those of api/slice/axon/commutil.ice.
namespace axon {

enum class Role : std::uint8_t { Observer, Operator, Admin };
enum class Presence : std::uint8_t { Joined, Changed, Left };

/// The nine states of the Entity Manager (thesis 3.3.1), by its tokens.
enum class EntityState : std::uint8_t { UNAV, INIT, ENVCONN, IDLE, REG, COLLAB, SLAVE, BUSY, ERR };

/// What a client can do with an entity that is in a state.
enum class Availability : std::uint8_t {
    Away,     ///< nobody can hold it: it is not reachable, it is starting, or it is out of order
    Ready,    ///< it can be checked out, or its holder can give it a task
    Working,  ///< it carries out a task or takes part in a collaboration
};

const char* toString(EntityState state);
Availability availability(EntityState state);
const char* toString(Role role);

/// Who sends. Filled in by the server from the session, never taken from the peer (invariant 9).
struct Sender {
    std::string id;    ///< session UUID of a client, or UUID of an entity
    std::string name;  ///< for people: user@host, or the entity's name
    Role role = Role::Operator;

    bool operator==(const Sender&) const = default;
};

}  // namespace axon
