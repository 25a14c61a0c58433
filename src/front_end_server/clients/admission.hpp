// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>

#include "common/clock.hpp"
#include "common/result.hpp"
#include "common/routed.hpp"
#include "front_end_server/clients/client.hpp"
#include "front_end_server/entities/entities.hpp"

namespace axon::front_end_server {

/// Whether the server passes a client's message of this size on to an entity, and otherwise why not. Clients
/// may send what the table of rights says; to an entity that it does not hold each sends little.
///
/// Notes of which entities the client asks what they remember: their Entity Managers take a check-out and a
/// watch under these two msgTypes alone. Returns whether the client now wants to check this entity out for
/// the first time. Any thread, and for a message of another kind without a lock but that of the client's own
/// list.
Result<bool> admit(Client& client, const Header& head, std::size_t bytes, const Entities& entities,
                   const Clock& clock);

/// Whether the message is within what the client's user may send in a second. `droppable`: only its bytes
/// count.
Result<void> admitToShare(Client& client, std::size_t bytes, bool droppable,
                          const FrontEndCoreSettings& settings, const Clock& clock);

/// Whether the client's user may check out one more entity. What is being asked for at this moment is not
/// counted, and what belongs to a check-out that was passed on is passed on: its commit, its abort.
Result<void> admitCheckOut(const Client& client, const Header& head, const FrontEndCoreSettings& settings);

}  // namespace axon::front_end_server
