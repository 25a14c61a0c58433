// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <map>
#include <string>
#include <vector>

#include "common/refusal.hpp"
#include "common/routed.hpp"

/// Who plays which role of a global service. Pure functions; any thread.
namespace axon::collaboration {

/// What one step asks of whoever plays its role.
struct Need {
    std::string service;             ///< global id, else name
    std::vector<std::string> given;  ///< parameters to which the step, or a step before it, gives a value
};

struct Role {
    int number = 0;
    std::string category, type;  ///< ROBOT or MACHINE, MOBILE or STATIONARY; empty = any
    std::vector<Need> needs;
};

/// A service of an entity, as far as a role needs to know it.
struct Offer {
    std::string name, global_id;
    bool active = true;
    std::vector<std::string> missing;  ///< required parameters and resources without a value
};

/// An entity that might play.
struct Candidate {
    std::string entity;  ///< UUID
    std::string name;    ///< that means only this one
    std::string category, type;
    EntityState state = EntityState::UNAV;
    bool latched = false;
    std::string holder;      ///< empty = free
    bool held_here = false;  ///< by the client that asks
    std::vector<Offer> offers;
    std::string silent;  ///< why its services are not known; empty = they are
};

/// Why one candidate cannot play a role.
struct Unfit {
    std::string entity, name;
    Refusal why;       ///< the message is a predicate: "is held by ana@lab, and was stopped"
    int distance = 0;  ///< how much is missing, 1 to 8 (axon/global.hpp)
};

/// What was found for one role.
struct RoleOutlook {
    int role = 0;
    std::string wanted;             ///< "ROBOT/MOBILE with drive, look"
    std::string kind;               ///< "ROBOT/MOBILE"
    std::vector<std::string> able;  ///< names of the candidates that could play it now
    std::vector<Unfit> unfit;       ///< the other candidates, smallest distance first
    std::string entity, name;       ///< the candidate that is proposed; empty = none
};

struct Proposal {
    std::vector<RoleOutlook> roles;          ///< in order of their numbers
    std::vector<std::string> nobody_offers;  ///< services that no candidate of any kind offers
    Refusal why;  ///< why roles have no entity, one line per role; OK = all have one

    bool complete() const { return why.ok(); }
};

/// Gives each role an entity of its own, whatever the order in which roles and candidates come: as many roles
/// as possible are played (a maximum matching), by candidates that are held already where that can be, then
/// by the first in order of name and UUID. `chosen` (role → UUID) is kept to, and checked like everything
/// else. The same input gives the same proposal.
Proposal propose(std::vector<Role> roles, std::vector<Candidate> candidates,
                 const std::map<int, std::string>& chosen = {});

}  // namespace axon::collaboration
