// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/translation.hpp"

#include <algorithm>
#include <charconv>

#include "common/entity_name.hpp"
#include "common/laboratory_name.hpp"
#include "common/rights.hpp"
#include "messages/values.hpp"

namespace axon::partner {
namespace {

/// A server takes no longer text in a registration (docs/reference/sessions.md).
constexpr std::size_t kNameBytesMax = 1024;

/// With what the answer names its request: the client's library settles it by that.
std::string requestOf(const proto::ToEntity& message) {
    switch (message.body_case()) {
        case proto::ToEntity::kSetParam:
            return message.set_param().request_id();
        case proto::ToEntity::kTask:
            return message.task().task_id();
        case proto::ToEntity::kTaskControl:
            return message.task_control().task_id();
        case proto::ToEntity::kResourceOffer:
            return message.resource_offer().transfer_id();
        case proto::ToEntity::kResourceChunk:
            return message.resource_chunk().transfer_id();
        case proto::ToEntity::kRearm:
            return message.rearm().request_id();
        case proto::ToEntity::kStatusRequest:
            return message.status_request().request_id();
        case proto::ToEntity::kHandOverAnswer:
            return message.hand_over_answer().request_id();
        case proto::ToEntity::kCollaboration:
            return message.collaboration().run_id();
        case proto::ToEntity::kRunHistory:
            return message.run_history().request_id();
        default:
            return {};
    }
}

}  // namespace

bool isLaboratoryName(std::string_view name) {
    return isServerName(name);
}

std::optional<std::string> nameAtHome(std::string_view laboratory, std::string_view name) {
    if (name.empty() || name.find(kLaboratorySeparator) != std::string_view::npos) return std::nullopt;
    auto text = std::string(laboratory) + kLaboratorySeparator + std::string(name);
    if (text.size() > kNameBytesMax || !isEntityName(text)) return std::nullopt;
    return text;
}

std::string displayName(std::string_view laboratory, std::string_view client) {
    std::string text(laboratory);
    text += '@';
    for (const char c : client) c == '@' ? text += " at " : text += c;
    return text;
}

std::optional<SignalId> SignalId::parse(std::string_view text) {
    const auto colon = text.rfind(':');
    if (colon == std::string_view::npos || colon == 0) return std::nullopt;
    SignalId id{std::string(text.substr(0, colon)), 0};
    const auto digits = text.substr(colon + 1);
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), id.sequence);
    if (error != std::errc() || end != digits.data() + digits.size()) return std::nullopt;
    return id;
}

proto::ToClient refused(const proto::ToEntity& message, const Refusal& refusal) {
    proto::ToClient answer;
    if (message.has_check_out()) {
        auto& reply = *answer.mutable_check_out();
        reply.set_request_id(message.check_out().request_id());
        reply.set_phase(message.check_out().phase());
        *reply.mutable_refusal() = toProto(refusal);
        return answer;
    }
    answer.mutable_reply()->set_request_id(requestOf(message));
    *answer.mutable_reply()->mutable_refusal() = toProto(refusal);
    return answer;
}

Refusal mayNotPass(const proto::ToEntity& message, Role client, Role account, bool holds) {
    const auto* right = rightOf(message.body_case());
    if (right == nullptr)
        return {
            RefusalCode::NotSupported,
            "The gateway to that laboratory does not know this kind of request. Is the client newer than it?",
            {}};
    if (right->who == Who::Nobody)
        return {RefusalCode::PermissionDenied,
                "Entities of different laboratories do not take part in one run, so this message is not "
                "passed on.",
                {}};
    if (message.has_collaboration())
        return {
            RefusalCode::NotSupported,
            "A global service is not carried out by entities of another laboratory: their laboratory knows "
            "neither the roles nor the UUIDs of this one. Ask a client of that laboratory to run it.",
            {}};
    if (message.has_way())
        return {RefusalCode::NotSupported, "There is no direct path to another laboratory's entities.", {}};
    if (right->who == Who::Operator && client == Role::Observer)
        return {RefusalCode::PermissionDenied,
                "This client is an observer in its own laboratory, and observers do not check out.",
                {}};
    if (message.has_check_out() && message.check_out().force() && client != Role::Admin)
        return {RefusalCode::PermissionDenied,
                "Only an administrator of both laboratories may take an entity over by force.",
                {}};
    if (right->who == Who::HolderOrAdmin && client != Role::Admin && account == Role::Admin && !holds)
        return {RefusalCode::NotHolder, "This client does not hold the entity: check it out first.", {}};
    return {};
}

}  // namespace axon::partner
