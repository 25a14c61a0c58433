// SPDX-License-Identifier: GPL-2.0-or-later
#include "open_entity.hpp"

#include <axon/messages.pb.h>
#include <spdlog/spdlog.h>

#include <asio/post.hpp>

#include "entity_manager/links/server/server_communicators.hpp"

namespace axon::bench {

using namespace axon::entity_manager;

OpenEntity::OpenEntity(const asio::any_io_executor& executor, std::string name, std::string uuid, Slot& slot)
    : strand_(asio::make_strand(executor)), name_(std::move(name)), uuid_(std::move(uuid)), slot_(slot) {}

std::shared_ptr<OpenEntity> OpenEntity::create(const asio::any_io_executor& executor,
                                               std::shared_ptr<ServerCommunicators> ice,
                                               const ServerAddress& server, const Clock& clock,
                                               RandomSource& random, std::string name, Slot& slot) {
    const std::shared_ptr<OpenEntity> self(
        new OpenEntity(executor, std::move(name), Id128::uuid(random).toString(), slot));
    self->server_ = std::make_unique<EntityCommunicator>(self->strand_, std::move(ice), server, clock, self);
    return self;
}

void OpenEntity::start() {
    asio::post(strand_, [self = shared_from_this()] { self->server_->wantConnection(true); });
}

void OpenEntity::serverUp() {
    Registration registration;
    registration.entity = uuid_;
    registration.name = name_;
    registration.category = "MACHINE";
    registration.type = "STATIONARY";
    proto::BasicProfile profile;
    profile.set_entity_id(uuid_);
    profile.set_name(name_);
    profile.set_category(proto::MACHINE);
    profile.set_type(proto::STATIONARY);
    server_->sendBasicPrfl(registration, profile);
    // Registered with a client, but which one it does not say: a client that holds it concludes from IDLE
    // that its lease has ended, and from a holder that the entity was given to that one.
    EntityStatus status;
    status.entity = uuid_;
    status.state = EntityState::REG;
    server_->sendStatus(status);
    joined_ = true;
}

void OpenEntity::serverDown(const std::string& reason) {
    spdlog::error("{}: {}", name_, reason);
}

void OpenEntity::clientMsg(Lane, Header head, std::string bytes) {
    asio::post(strand_, [self = shared_from_this(), head = std::move(head), bytes = std::move(bytes)] {
        self->answer(head, bytes);
    });
}

void OpenEntity::clientMsgDataSeq(Header, std::string bytes) {
    const auto now = nowNs();  // before the content is checked, as with the others' receivers
    proto::ToEntity message;
    if (!message.ParseFromString(bytes) || !message.has_raw()) {
        ++slot_.corrupt;
        return;
    }
    for (const auto& block : message.raw().data()) slot_.arrived(Kind::Data, now, block.data(), block.size());
}

void OpenEntity::stopSignal(Header head, StopCause cause) {
    if (cause == StopCause::Requested) slot_.stops.note(slot_.stops.next, nowNs());
    confirm(std::move(head), cause, ++generation_);
}

void OpenEntity::confirm(Header head, StopCause cause, std::uint32_t generation) {
    asio::post(strand_, [self = shared_from_this(), head = std::move(head), cause, generation] {
        proto::ToClient message;
        auto& receipt = *message.mutable_receipt();
        receipt.set_stop_id(head.sender.id + ':' + std::to_string(head.sequence));
        receipt.set_cause(static_cast<proto::StopCause>(cause));
        receipt.set_stop_generation(generation);
        for (const auto stage : {proto::StopReceipt::MANAGER, proto::StopReceipt::NO_APPLICATION}) {
            receipt.set_stage(stage);
            self->tell(Lane::Signal, head.sender, kMsgReceipt, message);
        }
    });
}

void OpenEntity::answer(const Header& head, const std::string& bytes) {
    proto::ToEntity asked;
    if (!asked.ParseFromString(bytes)) return;
    proto::ToClient message;
    if (asked.has_check_out()) {
        const auto& request = asked.check_out();
        if (request.phase() == proto::ABORT) return;
        auto& reply = *message.mutable_check_out();
        reply.set_request_id(request.request_id());
        reply.set_phase(request.phase());
        reply.set_stop_generation(generation_);
        if (request.phase() == proto::RESUME_LEASE) {
            *reply.mutable_lease() = request.resume();
        } else if (request.phase() != proto::RESERVE) {
            reply.mutable_lease()->set_epoch(1);
            reply.mutable_lease()->set_number(++leases_);
            reply.mutable_lease()->set_key(std::string(16, 'k'));
            reply.mutable_lease()->set_root(request.root());
            holders_.insert_or_assign(head.sender.id, head.sender);
        }
        tell(Lane::Data, head.sender, kMsgCheckOut, message);
    } else if (asked.has_release()) {
        holders_.erase(head.sender.id);
        auto& ended = *message.mutable_lease_ended();
        ended.mutable_lease()->set_epoch(static_cast<std::uint32_t>(head.held.epoch));
        ended.mutable_lease()->set_number(static_cast<std::uint32_t>(head.held.number));
        tell(Lane::Data, head.sender, kMsgRelease, message);
    } else if (asked.has_rearm()) {
        message.mutable_reply()->set_request_id(asked.rearm().request_id());
        tell(Lane::Data, head.sender, kMsgReply, message);
    }
}

void OpenEntity::speak(const std::string& bytes) {
    asio::post(strand_, [self = shared_from_this(), bytes] {
        proto::ToClient message;
        message.mutable_raw()->add_data(bytes);
        for (const auto& [id, holder] : self->holders_)
            self->server_->sendToClientDataSeq(self->headFor(holder, kMsgRaw), message);
    });
}

void OpenEntity::tell(Lane lane, const Sender& to, const char* type, const proto::ToClient& message) {
    server_->sendToClient(lane, headFor(to, type), message);
}

Header OpenEntity::headFor(const Sender& to, const char* type) {
    Header head;
    head.sender = to;
    head.entity = uuid_;
    head.msg_type = type;
    head.stop_generation = static_cast<std::int32_t>(generation_);
    head.sequence = ++sequence_;
    return head;
}

}  // namespace axon::bench
