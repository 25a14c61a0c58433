// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/log/client_log.hpp"

#include <algorithm>
#include <cstdint>
#include <utility>

#include "audit/commands.hpp"

namespace axon::front_end_server {
namespace {

constexpr std::uint32_t kLinesPerSecond = 8;  // of a kind
constexpr std::size_t kNamed = 16;

audit::Kind kindOf(std::string_view what) {
    return what == "rearm" ? audit::Kind::Rearm : what == "drill" ? audit::Kind::Command : audit::Kind::Stop;
}

}  // namespace

ClientLog::ClientLog(const Clock& clock, Note note, audit::AuditTrail* trail)
    : clock_(clock),
      note_(std::move(note)),
      trail_(audit::orNone(trail)),
      doubts_(kLinesPerSecond),
      excesses_(kLinesPerSecond) {}

void ClientLog::audit(const char* what, const Sender& who, const std::vector<std::string>& entities,
                      std::size_t known) const {
    std::string to;
    for (std::size_t i = 0; i < std::min(entities.size(), kNamed); ++i)
        to += (i == 0 ? "" : ", ") + entities[i].substr(0, 64);
    if (entities.size() > kNamed) to += " and " + std::to_string(entities.size() - kNamed) + " more";
    if (entities.size() == 1 && to.empty()) to = "all " + std::to_string(known) + " entities";
    note_(std::string("audit: ") + what + " by " + who.name + " (" + toString(who.role) + ", " + who.id +
          ") to " + to);
    const bool one = entities.size() == 1;
    const auto text = !one ? what + (" of " + std::to_string(entities.size())) + " entities: " + to
                      : entities[0].empty() ? what + (" to " + to)
                                            : std::string(what);
    trail_.note({.kind = kindOf(what),
                 .name = who.name,
                 .client = who.id,
                 .entity = one ? std::string_view(entities[0]) : std::string_view(),
                 .what = text,
                 .outcome = "OK"});
}

void ClientLog::joined(const Sender& who, const std::string& user) const {
    trail_.note({.kind = audit::Kind::Session,
                 .user = user,
                 .name = who.name,
                 .client = who.id,
                 .what = who.role == Role::Admin      ? "joined as admin"
                         : who.role == Role::Observer ? "joined as observer"
                                                      : "joined as operator",
                 .outcome = "OK"});
}

void ClientLog::left(const Sender& who, std::string_view how, const std::string& why) const {
    const auto what = std::string(how) + ": " + why;
    trail_.note({.kind = audit::Kind::Session, .name = who.name, .client = who.id, .what = what});
}

void ClientLog::command(const Header& head) const {
    if (!audit::isCommand(head.msg_type)) return;
    trail_.note({.kind = audit::Kind::Command,
                 .name = head.sender.name,
                 .client = head.sender.id,
                 .entity = head.entity,
                 .what = head.msg_type,
                 .outcome = "OK"});
}

void ClientLog::refused(const Header& head, const Refusal& refusal) const {
    const auto what = head.msg_type + ": " + refusal.message;
    trail_.note({.kind = audit::Kind::Refusal,
                 .name = head.sender.name,
                 .client = head.sender.id,
                 .entity = head.entity,
                 .what = what,
                 .outcome = refusalName(refusal.code)});
}

void ClientLog::holder(const EntityStatus& status) const {
    const bool free = status.holder.id.empty();
    trail_.note({.kind = audit::Kind::Ownership,
                 .name = status.holder.name,
                 .client = status.holder.id,
                 .entity = status.entity,
                 .what = free ? std::string_view(status.reason.empty() ? "free" : status.reason)
                              : std::string_view("checked out")});
}

void ClientLog::excess(const Sender& client, const Refusal& refusal) {
    if (refusal.code != RefusalCode::Overloaded && refusal.code != RefusalCode::TooLarge) return;
    if (excesses_.admit(clock_.now()))
        note_("client " + client.name + " (" + client.id + ") is refused: " + refusal.message);
}

void ClientLog::slowClient(const Sender& client, const std::string& entity) {
    if (doubts_.admit(clock_.now()))
        note_("client " + client.name + " reads slowly, and entity " + entity +
              " sends it more than its share of the queue: left out");
}

void ClientLog::unaskedHolder(const std::string& entity, const std::string& holder) {
    if (doubts_.admit(clock_.now()))
        note_("entity " + entity + " is not believed: it names " + holder +
              " as its holder, but that client has not asked for it");
}

}  // namespace axon::front_end_server
