// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/session_core.hpp"

#include <axon/messages.pb.h>

#include <algorithm>
#include <utility>

#include "client/core/content.hpp"
#include "common/planted_bug.hpp"
#include "messages/values.hpp"

namespace axon::client {

Header CoreContext::header(const std::string& entity, const char* msg_type, LeaseNumber lease) {
    Header head;
    head.sender = self;
    head.entity = entity;
    head.msg_type = msg_type;
    head.held = lease;
    head.stop_generation = marks.of(entity);
    head.sequence = ++sequence;
    head.sent_at_us = toMicroseconds(clock.now());
    return head;
}

std::int64_t CoreContext::send(const std::string& entity, const char* msg_type, LeaseNumber lease,
                               const proto::ToEntity& body) {
    const auto head = header(entity, msg_type, lease);
    link.sendToEntity(head, body.SerializeAsString());
    return head.sequence;
}

SessionCore::SessionCore(SessionCoreSettings settings, const Clock& clock, RandomSource& random,
                         ServerLink& link, SessionObserver& observer, SignalMarks& marks)
    : context_{settings, clock, random, link, observer, marks},
      requests_(clock, settings.timeout,
                [this](const std::string& entity, LeaseNumber under, const Refusal& why) {
                    leases_.onRefusal(entity, under, why);
                }),
      entities_(parts_),
      leases_(parts_),
      check_outs_(parts_),
      tasks_(parts_),
      runs_(parts_),
      watches_(parts_),
      commands_(parts_),
      parts_{context_, requests_, entities_, leases_, check_outs_, tasks_, runs_, watches_, server_},
      server_(parts_) {}

void SessionCore::onConnected(const Sender& self, int entities, const Watchdogs& watchdogs) {
    context_.connected = true;
    context_.self = self;
    entities_.onConnected(entities);
    server_.onConnected(watchdogs);
    leases_.sendResumes();
    watches_.sendAll();
}

void SessionCore::onDisconnected(const std::string& reason, bool for_good) {
    const bool was_connected = std::exchange(context_.connected, false);
    server_.onDisconnected();
    const Refusal lost{RefusalCode::NotConnected, "The connection to the server was lost: " + reason, {}};
    const Refusal unknown{RefusalCode::OutcomeUnknown,
                          "The connection to the server was lost while it was under way: " + reason,
                          {}};
    check_outs_.onDisconnected(lost);
    leases_.onDisconnected(lost, was_connected, for_good);
    for (const auto key : requests_.all()) {
        auto* pending = requests_.find(key);
        if (pending == nullptr) continue;
        const bool ends = Requests::visit(
            *pending, []<class One>(const One&) { return !request::kOutlivesConnection<One>; });
        if (ends) requests_.settle(key, unknown);
    }
    // Those of a lease that may be resumed are asked after then; the others nobody can ask after.
    tasks_.finishUnheld(unknown);
    runs_.finishUnheld(unknown);
    entities_.onDisconnected();
}

void SessionCore::onServerText(int code, const std::string& text) {
    context_.observer.onServerText(code, text);
}

void SessionCore::onProfile(Presence presence, const Registration& registration, std::string_view profile) {
    server_.heard();
    if (presence != Presence::Left) return entities_.onProfile(registration, profile);
    const std::string& id = registration.entity;
    if (entities_.facts(id) == nullptr) return;
    const Refusal why{
        RefusalCode::Unavailable,
        entities_.label(id) + " has left: its Entity Manager is no longer connected to the server.",
        {}};
    leases_.onLeft(id, why);
    check_outs_.onLeft(id, why);
    for (const auto key : requests_.of(id)) {
        auto* pending = requests_.find(key);
        if (pending == nullptr) continue;
        const bool ends =
            Requests::visit(*pending, []<class One>(const One&) { return !request::kOutlivesEntity<One>; });
        if (ends) requests_.settle(key, why);
    }
    entities_.onLeft(id);
}

void SessionCore::onStatus(const EntityStatus& status) {
    server_.heard();
    context_.marks.raise(status.entity, status.stop_generation);
    const bool joins = entities_.onStatus(status);
    leases_.onStatus(status);
    check_outs_.wakeParked();
    server_.pace();
    if (!joins) entities_.tellChanged(status.entity);
}

void SessionCore::onEntityMsg(const Header& head, std::string_view bytes, bool of_server) {
    if (of_server) server_.heard();
    proto::ToClient message;
    if (!parse(message, bytes)) {
        ++context_.malformed;
        return;
    }
    const std::string& entity = head.entity;
    const auto* mine = leases_.of(entity);
    switch (message.body_case()) {
        case proto::ToClient::kCheckOut:
            onCheckOutReply(head, message.check_out());
            break;
        case proto::ToClient::kLeaseEnded:
            leases_.onLeaseEnded(entity, message.lease_ended());
            break;
        case proto::ToClient::kReply:
            onReply(head, message.reply());
            break;
        case proto::ToClient::kTask:
            tasks_.onEvent(entity, message.task());
            break;
        case proto::ToClient::kStatus:
            onStatusMsg(head, message.status());
            break;
        case proto::ToClient::kReceipt:
            break;
        case proto::ToClient::kResourceCredit:
            commands_.onResourceCredit(message.resource_credit());
            break;
        case proto::ToClient::kResourceDone: {
            const auto id = Id128::fromBytes(message.resource_done().transfer_id());
            if (id) requests_.settle<request::Upload>(*id, toRefusal(message.resource_done().refusal()));
            break;
        }
        case proto::ToClient::kText:
            if (mine != nullptr) context_.observer.onText({entity, mine->number}, message.text().text());
            break;
        case proto::ToClient::kRaw:
            if (mine == nullptr) break;
            for (const auto& piece : message.raw().data())
                context_.observer.onRaw({entity, mine->number}, piece);
            break;
        case proto::ToClient::kSample: {
            if (!watches_.contains(entity)) break;
            const auto& sample = message.sample();
            context_.observer.onSample(
                {entity, sample.stream(), sample.sequence(), sample.SerializeAsString()});
            break;
        }
        case proto::ToClient::kService:
            leases_.onService(entity, message.service());
            break;
        case proto::ToClient::kHandOver:
            leases_.onHandOver(entity, message.hand_over());
            break;
        case proto::ToClient::kRun:
            runs_.onEvent(entity, message.run());
            break;
        case proto::ToClient::kRunHistory:
            runs_.onHistory(entity, message.run_history());
            break;
        case proto::ToClient::kGlobalServices:
            if (entity.empty())
                runs_.onServices(message.global_services());  // of the server, which is no entity
            break;
        case proto::ToClient::kWay:
            break;  // of the direct path, which the core does not know
        case proto::ToClient::BODY_NOT_SET:
            ++context_.malformed;  // or a message of a newer version: nothing this one could do with it
            break;
    }
}

void SessionCore::onCheckOutReply(const Header& head, const proto::CheckOutReply& reply) {
    context_.marks.raise(head.entity, static_cast<std::int32_t>(reply.stop_generation()));
    const auto request = Id128::fromBytes(reply.request_id());
    if (request && leases_.onResumeReply(head.entity, *request, reply)) return;
    check_outs_.onReply(head, reply);
}

void SessionCore::onReply(const Header& head, const proto::Reply& reply) {
    const auto id = Id128::fromBytes(reply.request_id());
    const auto refusal = toRefusal(reply.refusal());
    if (!id) {
        // Text, raw data, reset and the like have no request of their own: a refusal is all that comes back.
        // The entity's header says which lease it obeys now; while that is ours, the refusal is about an
        // earlier one.
        if (refusal.ok()) {
            ++context_.malformed;
            return;
        }
        if (const auto* mine = leases_.of(head.entity); mine != nullptr && head.held != mine->number)
            leases_.onRefusal(head.entity, mine->number, refusal);
        context_.observer.onServerText(static_cast<int>(refusal.code),
                                       entities_.label(head.entity) + ": " + refusal.message);
        return;
    }
    if (requests_.settle<request::Confirmed>(*id, refusal) ||
        requests_.settle<request::Release>(*id, refusal) || refusal.ok())
        return;
    if (requests_.settle<request::FetchDetails>(*id, refusal) ||
        requests_.settle<request::Control>(*id, refusal) || requests_.settle<request::Upload>(*id, refusal) ||
        requests_.settle<request::FetchGlobalServices>(*id, refusal) ||
        requests_.settle<request::FetchRunRecords>(*id, refusal))
        return;
    // Of the request itself: once an event has come, a refusal is of something else, and the robots may move.
    if (tasks_.contains(*id)) {
        if (requests_.contains(Requests::keyOf<request::StartTask>(*id)))
            tasks_.finish(*id, TaskState::Refused, refusal);
    } else {
        runs_.onRefused(*id, head.entity, refusal);
    }
}

void SessionCore::onRefusal(const Header& head, const Refusal& refusal) {
    server_.heard();
    if (check_outs_.onRefused(head.sequence, head.entity, refusal)) return;
    if (const auto key = requests_.bySequence(head.sequence);
        key && requests_.find(*key)->entity == head.entity)
        return onRequestRefused(*key, head.entity, refusal);
    if (leases_.of(head.entity) != nullptr) leases_.onRefusal(head.entity, head.held, refusal);
    context_.observer.onServerText(static_cast<int>(refusal.code), refusal.message);
}

void SessionCore::onRequestRefused(Requests::Key key, const std::string& entity, const Refusal& refusal) {
    Requests::visit(*requests_.find(key), [&]<class One>(const One&) {
        if constexpr (std::is_same_v<One, request::StartTask>) {
            tasks_.finish(key.id, TaskState::Refused, refusal);
        } else if constexpr (std::is_same_v<One, request::StartRun>) {
            runs_.finish(key.id, RunState::Refused, refusal);
        } else if constexpr (std::is_same_v<One, request::ResumeLease>) {
            leases_.onResumeRefused(key.id, entity);
        } else {
            requests_.settle(key, refusal);
        }
    });
}

void SessionCore::onStatusMsg(const Header& head, const proto::EntityStatus& status) {
    context_.marks.raise(head.entity, static_cast<std::int32_t>(status.stop_generation()));
    entities_.onOwnStatus(head.entity, status);
    for (const auto& event : status.tasks()) tasks_.onEvent(head.entity, event);
    for (const auto& event : status.ended()) tasks_.onEvent(head.entity, event);
    server_.pace();

    const auto asked = Id128::fromBytes(status.request_id());
    if (!asked) return;
    if (!tasks_.onAnswer(*asked, status)) entities_.onDetails(*asked, status);
}

TimePoint SessionCore::nextDeadline() const {
    if (AXON_PLANTED(RequestsWaitForEver)) return TimePoint::max();
    return std::min({requests_.nextDeadline(), check_outs_.nextDeadline(), leases_.nextDeadline()});
}

void SessionCore::onTimer() {
    const auto now = context_.clock.now();
    while (const auto key = requests_.due(now)) onRequestDue(*key);
    check_outs_.onTimer();
    leases_.onTimer();
}

void SessionCore::onRequestDue(Requests::Key key) {
    Requests::visit(*requests_.find(key), [&]<class One>(const One&) {
        if constexpr (std::is_same_v<One, request::StartTask>) {
            tasks_.onDue(key.id);
        } else if constexpr (std::is_same_v<One, request::StartRun>) {
            runs_.onDue(key.id);
        } else if constexpr (std::is_same_v<One, request::ResumeLease>) {
            leases_.onResumeDue(key.id);
        } else if constexpr (std::is_same_v<One, request::AskAfterRuns>) {
            runs_.onAskAfterDue(key.id);
        } else if constexpr (std::is_same_v<One, request::AskAfterTasks>) {
            tasks_.onAskAfterDue(key.id);
        } else {
            const auto seconds = std::to_string(Seconds(context_.settings.timeout).count()).substr(0, 4);
            const Refusal late{RefusalCode::TimedOut, "No answer within " + seconds + " s.", {}};
            if constexpr (std::is_same_v<One, request::Release>) {
                requests_.take(key)->template as<One>().done(late);
            } else {
                requests_.settle(key, late);
            }
        }
    });
}

}  // namespace axon::client
