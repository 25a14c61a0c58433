// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/request_reader.hpp"

#include <cstddef>
#include <string>

#include "entity_manager/core/turn/incident.hpp"
#include "entity_manager/ports/core_settings.hpp"
#include "messages/text.hpp"

namespace axon::entity_manager {

namespace {

constexpr std::size_t kReadOfStrangers = 16 * 1024;

Event eventOf(const proto::ToEntity& body) {
#define AXON_FACT(name)
#define AXON_REQUEST(name, needs, wish, is, refuse) \
    if (is) return Event::name;
#include "entity_manager/core/turn/events.def"
#undef AXON_FACT
#undef AXON_REQUEST
    return Event::Quit;
}

}  // namespace

std::optional<RequestReader::Request> RequestReader::read(const Header& head, std::string_view bytes,
                                                          bool partner) {
    if (isTooLargeFor(head, bytes, partner)) return std::nullopt;
    if (!message_.ParseFromArray(bytes.data(), static_cast<int>(bytes.size()))) {
        ++turn_.count().malformed;
        refuse(head, {},
               {RefusalCode::Malformed, "The message could not be read as an axon.proto.ToEntity.", {}});
        return std::nullopt;
    }
    const Request request{rightOf(message_.body_case()), eventOf(message_), &message_};
    if (request.right == nullptr) {
        refuse(head, {},
               {RefusalCode::NotSupported,
                "The Entity Manager does not know this kind of request. Is the client newer than it?",
                {}});
        return std::nullopt;
    }
    // By the header alone servers and both ends of a direct path know what it is. Nor does a run's message
    // come by such a path.
    const auto& right = *request.right;
    const bool of_run = right.peers == Peers::OfRun && right.who == Who::Nobody;
    const bool of_holder = turn_.holder() != nullptr && turn_.holder()->id == head.sender.id;
    if (head.msg_type == right.msg_type && !(of_run && of_holder)) return request;
    ++turn_.count().malformed;
    const Refusal refusal{RefusalCode::Malformed,
                          "The header's msgType is " + inQuotes(head.msg_type) + ", and the message is " +
                              std::string(right.body) + ", which has \"" + std::string(right.msg_type) + '"' +
                              (of_run ? " and is for entities to say." : "."),
                          {}};
    if (isRequest(request.event) && !of_run)
        turn_.refuse({request.event, &head, &message_}, refusal);
    else
        refuse(head, {}, refusal);
    return std::nullopt;
}

void RequestReader::refuse(const Header& head, const std::string& request_id, const Refusal& refusal) {
    journal_.noteRefusal(head.sender, head.held, refusal);
    turn_.reply(head.sender, request_id, refusal);
}

/// What is large takes its time to be read, in which nothing else is done: only of who holds the entity, or
/// its fellows.
bool RequestReader::isTooLargeFor(const Header& head, std::string_view bytes, bool partner) {
    if (bytes.size() <= kReadOfStrangers || head.msg_type == kMsgCollaboration || partner) return false;
    auto refusal = turn_.checkLease(head.sender, head.held);
    if (refusal.ok()) return false;
    refusal.message = "A message of more than " + std::to_string(kReadOfStrangers / 1024) +
                      " KiB is not read. " + refusal.message;
    refuse(head, {}, refusal);
    return true;
}

void RequestReader::refuseOther(const Header& head, const Request& other) {
    const bool control = other.body->has_task_control();
    auto refusal = other.right->who == Who::Holder ? turn_.checkLease(head.sender, head.held) : Refusal{};
    if (refusal.ok())
        refusal = {control ? RefusalCode::Malformed : RefusalCode::NotSupported,
                   control ? "The action must be PAUSE, RESUME or CANCEL."
                           : "This is no request to an Entity Manager.",
                   {}};
    refuse(head, control ? other.body->task_control().task_id() : std::string(), refusal);
}

}  // namespace axon::entity_manager
