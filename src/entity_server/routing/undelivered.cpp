// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_server/routing/undelivered.hpp"

#include <utility>

#include "common/queue_share.hpp"
#include "common/refuse.hpp"

namespace axon::entity_server {
namespace {

constexpr std::uint32_t kLinesPerSecond = 20;
constexpr std::size_t kRemembered = 4096;

}  // namespace

Refusal slowEntity(const Header& head) {
    return queueShareFull("entity " + head.entity.substr(0, 64));
}

Undelivered::Undelivered(bool alone, const Clock& clock, FrontEndTopic& topic, Note note)
    : alone_(alone), clock_(clock), topic_(topic), note_(std::move(note)), lines_(kLinesPerSecond) {}

void Undelivered::unknown(Lane lane, const Header& head, Via via) {
    if (alone_ || via == Via::Straight) topic_.entityRefusal(lane, head, unknownEntity(head.entity));
}

void Undelivered::unknownData(const Header& head, Via via) {
    if (!toldLately(head.sender.id)) unknown(Lane::Data, head, via);
}

void Undelivered::slow(Lane lane, const Header& head) {
    topic_.entityRefusal(lane, head, slowEntity(head));
    noteSlow(head);
}

void Undelivered::slow(const Header& head, const std::vector<std::string>& entities) {
    auto refused = head;
    for (const auto& entity : entities) {
        refused.entity = entity;
        slow(Lane::Signal, refused);
    }
}

void Undelivered::noteSlow(const Header& head) {
    if (lines_.admit(clock_.now()))
        note_("entity " + head.entity.substr(0, 64) + " reads slowly, and " + head.sender.name + " (" +
              head.sender.id + ") sends it more than its share of the queue: refused");
}

bool Undelivered::toldLately(const std::string& sender) {
    const auto now = clock_.now();
    const std::lock_guard lock(mutex_);
    const auto found = told_.find(sender);
    if (found != told_.end() && now - found->second < std::chrono::seconds{1}) return true;
    if (found == told_.end() && told_.size() >= kRemembered) told_.clear();
    told_[sender] = now;
    return false;
}

}  // namespace axon::entity_server
