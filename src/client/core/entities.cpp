// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/core/entities.hpp"

#include <axon/messages.pb.h>

#include <algorithm>
#include <utility>

#include "client/core/check_outs.hpp"
#include "client/core/content.hpp"
#include "client/core/leases.hpp"
#include "client/core/server_watch.hpp"
#include "client/core/watches.hpp"

namespace axon::client {
namespace {

bool moves(EntityState state) {
    return availability(state) == Availability::Working;
}

}  // namespace

void Entities::onConnected(int promised) {
    asked_.clear();
    promised_ = promised;
}

void Entities::onDisconnected() {
    auto gone = std::move(entities_);
    entities_.clear();
    names_.clear();
    present_ = 0;
    promised_ = 0;
    for (auto& [id, known] : gone) {
        parts_.context.marks.forget(id);
        if (known.there() && known.facts.ready) parts_.context.observer.onEntity(Presence::Left, known.facts);
    }
    moving_.clear();
    busy_.clear();
}

void Entities::onLeft(const std::string& id) {
    const auto known = entities_.find(id);
    if (known == entities_.end()) return;
    const Entity facts = std::move(known->second.facts);
    const bool was_there = known->second.there();
    entities_.erase(known);
    names_.remove(id);
    parts_.context.marks.forget(id);
    countMoving(id);
    parts_.server.pace();  // the server beats slowly again
    if (was_there && facts.ready) parts_.context.observer.onEntity(Presence::Left, facts);
}

void Entities::onProfile(const Registration& registration, std::string_view profile) {
    proto::BasicProfile basic;
    if (!parse(basic, profile)) ++parts_.context.malformed;  // the registration alone is enough to show it
    const std::string& id = registration.entity;
    auto& known = entities_[id];
    Entity& facts = known.facts;
    const bool was_there = known.there();
    const bool was_told = was_there && facts.ready;
    known.announced = true;
    facts.id = id;
    facts.name = registration.name;
    facts.category = registration.category;
    facts.type = registration.type;
    facts.descr = basic.descr();
    facts.x_mm = basic.xpos();
    facts.y_mm = basic.ypos();
    facts.z_mm = basic.zpos();
    facts.ready = !profile.empty();
    if (!known.there()) return;
    if (!was_there) {
        join(known);
        return;
    }
    names_.put(id, facts.name, facts.ready);
    if (facts.ready)
        parts_.context.observer.onEntity(was_told ? Presence::Changed : Presence::Joined, facts);
    else if (was_told)
        parts_.context.observer.onEntity(Presence::Left, facts);
}

void Entities::join(const Known& known) {
    const auto& facts = known.facts;
    ++present_;
    names_.put(facts.id, facts.name, facts.ready);
    if (facts.ready) parts_.context.observer.onEntity(Presence::Joined, facts);
    if (!parts_.context.connected) return;
    parts_.leases.sendResume(facts.id);
    parts_.watches.send(facts.id);
}

bool Entities::onStatus(const EntityStatus& status) {
    auto& known = entities_[status.entity];
    const bool joins = known.announced && !known.heard;
    known.heard = true;
    Entity& facts = known.facts;
    facts.id = status.entity;
    known.told = facts.state = status.state;
    facts.latched = status.latched;
    facts.stop_generation = std::max(facts.stop_generation, status.stop_generation);
    facts.holder = status.holder;
    facts.reason = status.reason;
    facts.orphaned = status.orphaned;
    facts.waiting = status.waiting;
    facts.stop_latency.reset();
    if (status.stop_latency_us > 0) facts.stop_latency = std::chrono::microseconds(status.stop_latency_us);
    countMoving(status.entity);
    if (joins) join(known);
    return joins;
}

void Entities::onOwnStatus(const std::string& id, const proto::EntityStatus& status) {
    const auto known = entities_.find(id);
    if (known == entities_.end()) return;
    Entity& facts = known->second.facts;
    facts.state = stateFromProto(status.state()).value_or(facts.state);
    facts.latched = status.latched();
    facts.stop_generation =
        std::max(facts.stop_generation, static_cast<std::int32_t>(status.stop_generation()));
    facts.reason = status.reason();
    facts.orphaned = status.orphaned();
    facts.waiting = static_cast<int>(status.waiting());
    countMoving(id);
    tellChanged(known->second);
}

void Entities::onGranted(const std::string& id, std::int32_t stop_generation, bool latched) {
    auto& facts = entities_[id].facts;
    facts.stop_generation = stop_generation;
    facts.latched = latched;
    countMoving(id);
}

void Entities::onAskedFor(const std::string& id) {
    if (parts_.context.self.role == Role::Observer || !asked_.insert(id).second) return;
    countMoving(id);
    parts_.server.pace();
}

void Entities::countMoving(const std::string& id) {
    const auto known = entities_.find(id);
    // The server goes by what the entity says, of one that this session has asked for: until that has let go
    // of a client that released it, its watchdog is short.
    const bool named = known != entities_.end() && asked_.contains(id) &&
                       known->second.facts.holder.id == parts_.context.self.id;
    const bool counts = named || (known != entities_.end() && parts_.leases.of(id) != nullptr);
    const auto keep = [&](std::set<std::string>& in, bool member) {
        if (member) {
            in.insert(id);
        } else {
            in.erase(id);
        }
    };
    keep(moving_, counts && (moves(known->second.facts.state) || moves(known->second.told)));
    keep(busy_, named && known->second.told == EntityState::BUSY);
}

void Entities::tellChanged(const Known& known) {
    if (known.there() && known.facts.ready) parts_.context.observer.onEntity(Presence::Changed, known.facts);
}

void Entities::tellChanged(const std::string& id) {
    if (const auto known = entities_.find(id); known != entities_.end()) tellChanged(known->second);
}

std::vector<Entity> Entities::list(Listed listed) const {
    std::vector<Entity> entities;
    for (const auto* facts : all()) {
        if (facts->ready || listed == Listed::All) entities.push_back(*facts);
    }
    return entities;
}

std::vector<const Entity*> Entities::all() const {
    std::vector<const Entity*> entities;
    for (const auto& id : names_.ids()) entities.push_back(&entities_.at(id).facts);
    return entities;
}

std::vector<const Entity*> Entities::announced() const {
    std::vector<const Entity*> entities;
    for (const auto& [id, known] : entities_) {
        if (known.announced) entities.push_back(&known.facts);
    }
    return entities;
}

Result<Entity> Entities::find(std::string_view name) const {
    if (!parts_.context.connected) return CoreContext::notConnected();
    const auto id = names_.resolve(name);
    if (!id) return id.refusal();
    return entity(id.value());
}

Result<Entity> Entities::entity(const std::string& id) const {
    const auto known = entities_.find(id);
    if (known == entities_.end() || !known->second.there()) {
        return Refusal{
            RefusalCode::UnknownEntity, "The entity " + id + " is not connected to the server.", {}};
    }
    return known->second.facts;
}

const Entity* Entities::facts(const std::string& id) const {
    const auto known = entities_.find(id);
    return known == entities_.end() ? nullptr : &known->second.facts;
}

bool Entities::isThere(const std::string& id) const {
    const auto known = entities_.find(id);
    return known != entities_.end() && known->second.there();
}

void Entities::fetchDetails(const std::string& id, DetailsDone done) {
    if (!parts_.context.connected) return done(CoreContext::notConnected());
    const auto known = entity(id);
    if (!known) return done(known.refusal());
    const auto request = Id128::random(parts_.context.random);
    proto::ToEntity body;
    body.mutable_status_request()->set_request_id(request.bytes());
    body.mutable_status_request()->set_with_services(true);
    const auto sequence = parts_.context.send(id, kMsgStatus, {}, body);
    parts_.requests.await(
        request, {.entity = id, .sequence = sequence, .what = request::FetchDetails{std::move(done)}});
}

void Entities::fetchServices(const std::string& id, std::function<void(Result<std::vector<Service>>)> done) {
    fetchDetails(id, [done = std::move(done)](Result<Details> details) {
        if (!details) return done(details.refusal());
        done(std::move(details->services));
    });
}

void Entities::onDetails(Id128 request, const proto::EntityStatus& status) {
    auto pending = parts_.requests.take<request::FetchDetails>(request);
    if (!pending) return;
    Details details;
    for (const auto& service : status.services()) details.services.push_back(fromProto(service));
    for (const auto& margin : status.watchdogs()) {
        details.watchdogs.push_back({margin.hop(), std::chrono::milliseconds(margin.timeout_ms()),
                                     std::chrono::milliseconds(margin.longest_gap_ms())});
    }
    for (const auto& finding : status.findings())
        details.findings.push_back({finding.message(), finding.fix()});
    pending->as<request::FetchDetails>().done(std::move(details));
}

}  // namespace axon::client
