// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/sessions/entity_audit.hpp"

#include <string_view>

#include "audit/commands.hpp"
#include "entity_server/sessions/holder_log.hpp"

namespace axon::entity_server {

using audit::Kind;

void EntityAudit::joined(const Registration& registration) const {
    trail_.note({.kind = Kind::Session,
                 .name = registration.name,
                 .entity = registration.entity,
                 .what = "entity joined",
                 .outcome = "OK"});
}

void EntityAudit::left(const std::string& entity, const std::string& name, const std::string& why) const {
    const auto what = "entity left: " + why;
    trail_.note({.kind = Kind::Session, .name = name, .entity = entity, .what = what});
}

void EntityAudit::holder(const std::string& name, const EntityStatus& before, const EntityStatus& now) const {
    const auto &was = before.holder, &is = now.holder;
    if (was.id == is.id) return;
    const bool taken = isTaken(before, now);
    const auto what = name + (taken            ? " is taken from " + was.name + " (" + was.id + ")"
                              : is.id.empty()  ? " is free, held by " + was.name + " (" + was.id + ") before"
                              : was.id.empty() ? std::string(" is checked out")
                                               : " is still held, by another session than " + was.id);
    trail_.note({.kind = taken ? Kind::TakeOver : Kind::Ownership,
                 .name = is.name,
                 .client = is.id,
                 .entity = now.entity,
                 .what = now.reason.empty() ? what : what + ": " + now.reason});
}

void EntityAudit::stoppedForLostClient(const EntityStatus& status) const {
    trail_.note({.kind = Kind::Stop,
                 .name = status.holder.name,
                 .client = status.holder.id,
                 .entity = status.entity,
                 .what = "its holder's front-end server is gone"});
}

void EntityAudit::signal(const char* what, const Header& head, std::size_t entities) const {
    const auto text = head.entity.empty()
                          ? std::string(what) + " to " +
                                (entities == 0 ? std::string("all") : std::to_string(entities)) + " entities"
                          : std::string(what);
    trail_.note({.kind = std::string_view(what) == "drill" ? Kind::Command : Kind::Stop,
                 .name = head.sender.name,
                 .client = head.sender.id,
                 .entity = head.entity,
                 .what = text});
}

void EntityAudit::command(const Header& head) const {
    const bool rearm = head.msg_type == kMsgRearm;
    if (!rearm && !audit::isCommand(head.msg_type)) return;
    trail_.note({.kind = rearm ? Kind::Rearm : Kind::Command,
                 .name = head.sender.name,
                 .client = head.sender.id,
                 .entity = head.entity,
                 .what = head.msg_type,
                 .outcome = "OK"});
}

}  // namespace axon::entity_server
