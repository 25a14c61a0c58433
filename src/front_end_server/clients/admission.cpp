// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/clients/admission.hpp"

#include <string>
#include <utility>

#include "common/refuse.hpp"
#include "common/rights.hpp"

namespace axon::front_end_server {

Result<bool> admit(Client& client, const Header& head, std::size_t bytes, const Entities& entities,
                   const Clock& clock) {
    if (!clientsMaySend(head.msg_type))
        return refuse(RefusalCode::PermissionDenied,
                      head.msg_type + (entitiesMaySend(head.msg_type)
                                           ? " is a message between entities; send RUN to the master instead"
                                           : " is for the server itself: use sendRequest"));
    if (!client.entities.holds(head.entity)) {
        // Who has asked for it may have the grant before this server has the status that tells of it.
        if (bytes > kStrangersBytes && !client.entities.askedForCheckOut(head.entity))
            return refuse(RefusalCode::TooLarge,
                          "a message of more than " + std::to_string(kStrangersBytes / 1024) +
                              " KiB is accepted only from the holder of the entity; fix: check it out first");
        if (!client.bytes.admit(clock.now(), static_cast<std::uint32_t>(bytes)))
            return refuse(RefusalCode::Overloaded,
                          "a client may send at most " + std::to_string(kStrangersBytesPerSecond / 1024) +
                              " KiB in a second to entities that it does not hold; fix: send less, or check "
                              "them out");
    }
    const bool check_out = head.msg_type == kMsgCheckOut;
    if (check_out && !client.only_watches.empty())
        return refuse(RefusalCode::Overloaded, client.only_watches);
    if (!check_out && head.msg_type != kMsgWatch) return false;
    const bool for_itself = check_out && client.me.role != Role::Observer;
    const bool first = for_itself && !client.entities.askedForCheckOut(head.entity);
    if (!client.entities.ask(head.entity, for_itself, entities.has(head.entity, Lane::Data), head.sequence))
        return refuse(RefusalCode::NotConnected, "its session has ended");
    return first;
}

namespace {

/// "the user 'ann'", "a client".
std::string whose(const Client& client) {
    return client.user.empty() ? "a client" : "the user '" + client.user + "'";
}

}  // namespace

Result<void> admitToShare(Client& client, std::size_t bytes, bool droppable,
                          const FrontEndCoreSettings& settings, const Clock& clock) {
    const auto now = clock.now();
    if (!droppable && !client.share->messages.admit(now))
        return refuse(RefusalCode::Overloaded,
                      whose(client) + " may send at most " +
                          std::to_string(settings.user_messages_per_second) +
                          " messages in a second, in all sessions; fix: send fewer, or have "
                          "FrontEndServer.UserMessages raised");
    if (!client.share->bytes.admit(now, static_cast<std::uint32_t>(bytes)))
        return refuse(
            RefusalCode::Overloaded,
            whose(client) + " may send at most " + std::to_string(settings.user_bytes_per_second / 1024) +
                " KiB in a second, in all sessions; fix: send less, or have FrontEndServer.UserBytes "
                "raised");
    return {};
}

Result<void> admitCheckOut(const Client& client, const Header& head, const FrontEndCoreSettings& settings) {
    if (head.msg_type != kMsgCheckOut || client.entities.holds(head.entity) ||
        client.entities.wants(head.entity) ||
        client.share->held.load(std::memory_order_relaxed) < settings.user_check_outs)
        return {};
    return refuse(RefusalCode::Overloaded,
                  whose(client) + " holds " + std::to_string(settings.user_check_outs) +
                      " entities, which is the most; fix: release some, or have FrontEndServer.UserCheckOuts "
                      "raised");
}

}  // namespace axon::front_end_server
