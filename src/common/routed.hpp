// SPDX-License-Identifier: MIT
#pragma once
#include <cstdint>
#include <string>
#include <string_view>

#include "common/axon/states.hpp"

namespace axon {

// The plain mirror of api/slice/axon/commutil.ice, for cores that must not know Ice. The transport layer
// converts; enumerators and their numbers are the same (transport's conversion test compares them).

enum class Lane : std::uint8_t { Signal, Data };
enum class ClientChange : std::uint8_t { Lost, Ended };

/// Why a stop was given; numbers are those of axon.proto.StopCause.
enum class StopCause : std::uint8_t {
    Unspecified,
    Requested,
    ClientLost,
    Released,
    Improper,
    ServerLost,
    LinkLost,
    Reset,
    Clear,
    Cancel,
    Shutdown,
    Fault,
    Drill
};

const char* toString(StopCause cause);

/// Which lease a command is given under; {0, 0} = none.
struct LeaseNumber {
    std::int32_t epoch = 0;
    std::int32_t number = 0;

    auto operator<=>(const LeaseNumber&) const = default;
};

/// Header of every routed operation (docs/reference/sessions.md, "The header").
struct Header {
    Sender sender;
    std::string entity;    ///< UUID
    std::string msg_type;  ///< the routing key, one of kMsg* below
    LeaseNumber held;
    std::int32_t stop_generation = 0;
    std::int64_t sequence = 0;
    std::int64_t sent_at_us = 0;
};

/// What servers may know of an entity: from its registration …
struct Registration {
    std::string entity;
    std::string name;
    std::string category;
    std::string type;
    std::int32_t heartbeat_busy_ms = 50;
    std::int32_t heartbeat_idle_ms = 2000;
    std::string server;  ///< which of several entity servers it is connected to; empty where there is one

    bool operator==(const Registration&) const = default;
};

/// … and from its status.
struct EntityStatus {
    std::string entity;
    EntityState state = EntityState::UNAV;
    bool latched = false;
    std::int32_t stop_generation = 0;
    Sender holder;
    LeaseNumber held;
    std::string reason;
    bool orphaned = false;
    std::int32_t waiting = 0;
    std::int32_t stop_latency_us = 0;
    std::string server;  ///< as in the registration

    bool operator==(const EntityStatus&) const = default;
};

/// What its texts take in a message, in bytes.
inline std::size_t textBytes(const EntityStatus& status) {
    return status.entity.size() + status.holder.id.size() + status.holder.name.size() + status.reason.size() +
           status.server.size();
}

/// What a server of several tells the others of itself.
struct ServerAnnouncement {
    std::string name;
    std::string instance;        ///< another one at each start
    std::string signals;         ///< where it takes signals directly; for the transport layer
    std::int64_t published = 0;  ///< registrations and statuses, by an entity server until now
    std::string messages = {};   ///< where it takes all else directly; for the transport layer

    bool operator==(const ServerAnnouncement&) const = default;
};

/// The id of a client of one of several front-end servers is `name:instance:uuid`, so that whoever misses the
/// server knows whom it served; of the only one it is `uuid`.
struct ClientOrigin {
    std::string_view server;
    std::string_view instance;
};
ClientOrigin originOf(std::string_view client_id);
std::string_view uuidOf(std::string_view client_id);
/// 1 to 32 letters, digits, '-', '_'.
bool isServerName(std::string_view name);

// Routing keys (thesis: msgType). Towards an entity:
inline constexpr const char* kMsgCheckOut = "CHECKOUT";
inline constexpr const char* kMsgRelease = "RELEASE";
inline constexpr const char* kMsgParam = "PARAM";
inline constexpr const char* kMsgTask = "TASK";
inline constexpr const char* kMsgTaskControl = "TASK_CONTROL";
inline constexpr const char* kMsgResource = "RESOURCE";
inline constexpr const char* kMsgText = "TEXT";
inline constexpr const char* kMsgRaw = "RAW";
inline constexpr const char* kMsgRearm = "REARM";
inline constexpr const char* kMsgStatus = "STATUS";
inline constexpr const char* kMsgWatch = "WATCH";
inline constexpr const char* kMsgHandOver = "HAND_OVER";
inline constexpr const char* kMsgWay = "WAY";  ///< either way: what follows comes by the direct path
inline constexpr const char* kMsgRun = "RUN";  ///< a global service: its request, its events, its history
// … and towards a client, besides the above:
inline constexpr const char* kMsgReply = "REPLY";
inline constexpr const char* kMsgReceipt = "RECEIPT";
inline constexpr const char* kMsgStream = "STREAM";
inline constexpr const char* kMsgService = "SERVICE";
// … and between an entity server and its Entity Managers: a drill of the server's own, and its answer once
// the Entity Interfacer has acknowledged. Such a drill is answered to the server alone.
inline constexpr const char* kMsgDrill = "DRILL";
// … from entity to entity, besides RAW, …
inline constexpr const char* kMsgCollaboration = "COLLABORATION";
// … and to a front-end server itself.
inline constexpr const char* kMsgGlobalServices = "GLOBAL_SERVICES";

/// Sequence numbers from here on are those of stops that a server gives in the name of a client that is gone;
/// a client's own are below. A stop is known by sender and number, so neither may look like the other.
inline constexpr std::int64_t kServerSequences = std::int64_t{1} << 52U;
/// From here on those of entity servers that have lost the front-end server of a client.
inline constexpr std::int64_t kEntityServerSequences = kServerSequences + (std::int64_t{1} << 51U);

}  // namespace axon
