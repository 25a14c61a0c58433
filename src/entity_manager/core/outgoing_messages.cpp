// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/outgoing_messages.hpp"

#include "messages/values.hpp"

namespace axon::entity_manager {

Header OutgoingMessages::headFor(const Sender& to, const char* type) {
    Header head;
    head.sender = to;
    head.entity = entity_;
    head.msg_type = type;
    if (const auto* held = turn_.held()) head.held = held->number;
    head.stop_generation = static_cast<std::int32_t>(turn_.stops().generation);
    head.sequence = ++sequence_;
    head.sent_at_us = toMicroseconds(turn_.now());
    return head;
}

void OutgoingMessages::tell(const Sender& to, const char* type, const proto::ToClient& message, Lane lane) {
    if (!turn_.connected() || to.id.empty()) return;
    server_.sendToClient(lane, headFor(to, type), message);
}

void OutgoingMessages::tellDroppable(const Sender& to, const char* type, const proto::ToClient& message) {
    server_.sendToClientDataSeq(headFor(to, type), message);
}

void OutgoingMessages::tellPeer(Lane lane, const Sender& self, const std::string& peer, const char* type,
                                const proto::ToEntity& message) {
    if (!turn_.connected()) return;
    auto head = headFor(self, type);
    head.entity = peer;
    server_.sendToPeer(lane, head, message);
}

void OutgoingMessages::reply(const Sender& to, const std::string& request_id, const Refusal& refusal,
                             Lane lane) {
    proto::ToClient message;
    message.mutable_reply()->set_request_id(request_id);
    if (!refusal.ok()) *message.mutable_reply()->mutable_refusal() = toProto(refusal);
    tell(to, kMsgReply, message, lane);
}

}  // namespace axon::entity_manager
