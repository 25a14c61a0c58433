// SPDX-License-Identifier: MIT
#pragma once
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>

namespace axon {

/// Who may send a message. An operator may do everything that an observer may, and an administrator
/// everything that an operator may, unless a value says otherwise.
enum class Who : std::uint8_t {
    Anyone,
    Operator,  ///< not an observer: PERMISSION_DENIED
    Holder,    ///< of the present lease: NOT_HOLDER and the like
    HolderOrAdmin,
    Nobody  ///< what is not for Entity Managers at all
};

/// Whether entities may send it to each other, by sendToPeer.
enum class Peers : std::uint8_t {
    No,     ///< PERMISSION_DENIED, of the entity server
    OfRun,  ///< the master of a run and those who take part in it, among themselves; its invitation is sealed
            ///< by the client
};

/// What a list of users.cfg may keep from a user for one entity (docs/reference/server_configuration.md).
/// There is none for stops: whoever sees an entity may stop it.
enum class EntityRight : std::uint8_t {
    See,       ///< otherwise it is UNKNOWN_ENTITY
    CheckOut,  ///< PERMISSION_DENIED, as for the others
    Force,     ///< of an administrator: to take it over. In a payload, so its role is kept from the message
    Rearm
};
inline constexpr std::array kEntityRights{EntityRight::See, EntityRight::CheckOut, EntityRight::Force,
                                          EntityRight::Rearm};
/// "see", "checkout", "force", "rearm".
const char* toString(EntityRight right);
std::optional<EntityRight> entityRight(std::string_view text);

/// One kind of message to an entity, or one signal.
struct Right {
    std::string_view msg_type;  ///< Header.msgType; of a signal the operation
    std::string_view body;      ///< the field of axon.proto.ToEntity; of a signal empty
    int number;                 ///< of that field; of a signal 0
    Who who;                    ///< of the clients
    Peers peers;
    /// What a list may keep from a client; nothing: no list is asked.
    std::optional<EntityRight> needs = EntityRight::See;
};

/// Who may send an entity what: the one table that front-end servers, entity servers and Entity Managers ask,
/// and from which docs/reference/rights.md is made. Servers know a message by its msgType alone, so each body
/// has one; that it is what it says is for the Entity Manager to see. Immutable; any thread. Source of the
/// signals: thesis, 3.3.1.
std::span<const Right> rights();
/// Of a field of ToEntity; null for one that this edition does not know.
const Right* rightOf(int body);
/// Of a signal, by its operation, which is in the table.
const Right& rightOfSignal(std::string_view operation);

/// What a front-end server passes on for a client. A msgType that the table does not know is the Entity
/// Manager's business: servers need not change for a new one.
bool clientsMaySend(std::string_view msg_type);
/// What a front-end server asks its lists before it passes a client's message on. A msgType that the table
/// does not know needs what any other message needs: See.
EntityRight neededFor(std::string_view msg_type);
/// What an entity server passes on from one entity to another.
bool entitiesMaySend(std::string_view msg_type);

inline constexpr std::string_view kStopOperation = "sendStopSignal";
inline constexpr std::string_view kResetOperation = "sendResetSignal";
inline constexpr std::string_view kClearOperation = "sendClearSignal";

/// docs/reference/rights.md.
std::string rightsPage();

}  // namespace axon
