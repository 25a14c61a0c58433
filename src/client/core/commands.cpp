// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/commands.hpp"

#include <axon/messages.pb.h>

#include <utility>

#include "client/core/content.hpp"
#include "client/core/entities.hpp"
#include "client/core/leases.hpp"
#include "common/utf8.hpp"
#include "messages/text.hpp"
#include "messages/values.hpp"

namespace axon::client {
namespace {

constexpr std::size_t kChunkMax = 64 * 1024;

}  // namespace

void Commands::set(const Held& held, std::string_view service, const Argument& argument, Done done) {
    const auto refusal = parts_.leases.ready(held);
    if (!refusal.ok()) return done(refusal);
    const auto& services = parts_.leases.find(held)->services;
    const auto index = findServiceIndex(services, service);
    if (!index) return done(index.refusal());
    auto params = toParams(services.services(index.value()), {argument});
    if (!params) return done(params.refusal());
    const auto id = Id128::random(parts_.context.random);
    proto::ToEntity body;
    auto& request = *body.mutable_set_param();
    request.set_service(services.services(index.value()).name());
    *request.mutable_param() = std::move(params->front());
    request.set_request_id(id.bytes());
    const auto sequence = parts_.context.send(held.entity, kMsgParam, held.lease, body);
    parts_.requests.await(id, {.entity = held.entity,
                               .lease = held.lease,
                               .sequence = sequence,
                               .what = request::Confirmed{std::move(done)}});
}

Result<void> Commands::sendText(const Held& held, std::string_view text) {
    const auto refusal = parts_.leases.ready(held);
    if (!refusal.ok()) return refusal;
    if (!isUtf8(text))
        return Refusal{RefusalCode::Malformed, "A text must be UTF-8; send other bytes as raw data.", {}};
    proto::ToEntity body;
    body.mutable_text()->set_text(std::string(text));
    parts_.context.send(held.entity, kMsgText, held.lease, body);
    return {};
}

Result<void> Commands::sendRaw(const Held& held, std::string_view bytes) {
    const auto refusal = parts_.leases.ready(held);
    if (!refusal.ok()) return refusal;
    parts_.context.link.sendToEntityDataSeq(parts_.context.header(held.entity, kMsgRaw, held.lease),
                                            rawMessage(bytes));
    return {};
}

Result<void> Commands::reset(const Held& held, std::int64_t sequence) {
    const auto refusal = parts_.leases.ready(held);
    if (!refusal.ok()) return refusal;
    if (const auto* facts = parts_.entities.facts(held.entity); facts != nullptr && facts->latched) {
        return Refusal{
            RefusalCode::Latched, parts_.entities.label(held.entity) + " was stopped. Rearm it first.", {}};
    }
    auto head = parts_.context.header(held.entity, kMsgReset, held.lease);
    head.sequence = sequence > 0 ? sequence : parts_.context.marks.nextSequence();
    parts_.context.link.sendReset(head);
    return {};
}

Result<void> Commands::clear(const Held& held, std::int64_t sequence) {
    const auto refusal = parts_.leases.ready(held);
    if (!refusal.ok()) return refusal;
    auto head = parts_.context.header(held.entity, kMsgClear, held.lease);
    head.sequence = sequence > 0 ? sequence : parts_.context.marks.nextSequence();
    parts_.context.link.sendClear(head);
    return {};
}

void Commands::rearm(const std::string& entity, Done done) {
    if (!parts_.context.connected) return done(CoreContext::notConnected());
    const auto known = parts_.entities.entity(entity);
    if (!known) return done(known.refusal());
    const auto* mine = parts_.leases.of(entity);
    const auto lease = mine == nullptr ? LeaseNumber{} : mine->number;
    const auto id = Id128::random(parts_.context.random);
    proto::ToEntity body;
    body.mutable_rearm()->set_request_id(id.bytes());
    const auto sequence = parts_.context.send(entity, kMsgRearm, lease, body);
    parts_.requests.await(id, {.entity = entity,
                               .lease = lease,
                               .sequence = sequence,
                               .what = request::Confirmed{std::move(done)}});
}

Id128 Commands::offer(const Held& held, std::string_view service, std::string_view resource,
                      const std::string& file_name, std::uint64_t size, const std::string& sha256,
                      Done done) {
    const auto id = Id128::random(parts_.context.random);
    const auto refusal = parts_.leases.ready(held);
    if (!refusal.ok()) {
        done(refusal);
        return id;
    }
    const auto& services = parts_.leases.find(held)->services;
    const auto index = findServiceIndex(services, service);
    if (!index) {
        done(index.refusal());
        return id;
    }
    const auto& chosen = services.services(index.value());
    const auto place = findResourceIndex(chosen, resource);
    if (!place) {
        done(place.refusal());
        return id;
    }
    proto::ToEntity body;
    auto& offer = *body.mutable_resource_offer();
    offer.set_transfer_id(id.bytes());
    offer.set_service(chosen.name());
    offer.set_resource(chosen.resources(place.value()).name());
    offer.set_file_name(file_name);
    offer.set_size(size);
    offer.set_sha256(sha256);
    const auto sequence = parts_.context.send(held.entity, kMsgResource, held.lease, body);
    parts_.requests.await(id, {.entity = held.entity,
                               .lease = held.lease,
                               .sequence = sequence,
                               .what = request::Upload{std::move(done)}});
    return id;
}

Result<void> Commands::sendChunk(const Id128& transfer, std::uint64_t offset, std::string_view content) {
    const auto* upload = parts_.requests.find<request::Upload>(transfer);
    if (upload == nullptr) return Refusal{RefusalCode::Cancelled, "The transfer has ended already.", {}};
    if (content.size() > kChunkMax) {
        return Refusal{RefusalCode::TooLarge, "A chunk holds at most 65536 bytes.", {}};
    }
    proto::ToEntity body;
    auto& chunk = *body.mutable_resource_chunk();
    chunk.set_transfer_id(transfer.bytes());
    chunk.set_offset(offset);
    chunk.set_content(std::string(content));
    // Not among the data that servers may drop: the window keeps it small enough to be kept.
    parts_.context.send(upload->entity, kMsgResource, upload->lease, body);
    return {};
}

void Commands::onResourceCredit(const proto::ResourceCredit& credit) {
    const auto id = Id128::fromBytes(credit.transfer_id());
    if (!id) return;
    const auto key = Requests::keyOf<request::Upload>(*id);
    if (!parts_.requests.contains(key)) return;
    parts_.requests.postpone(key, parts_.context.clock.now() + parts_.context.settings.timeout);
    if (credit.window() == 0) return;  // it is not forgotten
    parts_.context.observer.onTransferCredit(*id, credit.offset(), credit.offset() + credit.window());
}

}  // namespace axon::client
