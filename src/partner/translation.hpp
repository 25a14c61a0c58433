// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <axon/messages.pb.h>

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "common/refusal.hpp"
#include "common/routed.hpp"

// What differs between a message there and the same message at home. Pure functions: any thread.
namespace axon::partner {

/// 1 to 32 letters, digits, '-' and '_'.
bool isLaboratoryName(std::string_view name);

/// What the entity is called at home; nothing: it is not shown. That is so for an entity that its laboratory
/// shows for a partner of its own, so that two laboratories that show each other's do not show their own ones
/// again and again; and for a name that no server would take with the laboratory's before it.
std::optional<std::string> nameAtHome(std::string_view laboratory, std::string_view name);

/// What a client of `laboratory` is called there. A server with users replaces what is before the last '@'
/// with the user's name, so all of the client's name comes after it.
std::string displayName(std::string_view laboratory, std::string_view client);

/// "ID:SEQ", the stop_id of a receipt and the request_id of a refused reset or clear.
struct SignalId {
    std::string sender;
    std::int64_t sequence = 0;

    static std::optional<SignalId> parse(std::string_view text);
    std::string text() const { return sender + ':' + std::to_string(sequence); }
};

/// The answer with which an Entity Manager refuses a message to it.
proto::ToClient refused(const proto::ToEntity& message, const Refusal& refusal);

/// Why a client of home may not send this there, whatever the account may that this gateway has there; OK: it
/// may. Roles are given by the laboratory of the client, and the partner sees only the role of the account.
/// `account`: that role, `holds`: the client was granted the entity.
Refusal mayNotPass(const proto::ToEntity& message, Role client, Role account, bool holds);

}  // namespace axon::partner
