// SPDX-License-Identifier: GPL-2.0-or-later
#include "front_end_server/log/client_log.hpp"

#include <algorithm>
#include <cstdint>
#include <utility>

namespace axon::front_end_server {
namespace {

constexpr std::uint32_t kLinesPerSecond = 8;  // of a kind
constexpr std::size_t kNamed = 16;

}  // namespace

ClientLog::ClientLog(const Clock& clock, Note note)
    : clock_(clock), note_(std::move(note)), doubts_(kLinesPerSecond), excesses_(kLinesPerSecond) {}

void ClientLog::audit(const char* what, const Sender& who, const std::vector<std::string>& entities,
                      std::size_t known) const {
    std::string to;
    for (std::size_t i = 0; i < std::min(entities.size(), kNamed); ++i)
        to += (i == 0 ? "" : ", ") + entities[i].substr(0, 64);
    if (entities.size() > kNamed) to += " and " + std::to_string(entities.size() - kNamed) + " more";
    if (entities.size() == 1 && to.empty()) to = "all " + std::to_string(known) + " entities";
    note_(std::string("audit: ") + what + " by " + who.name + " (" + toString(who.role) + ", " + who.id +
          ") to " + to);
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
