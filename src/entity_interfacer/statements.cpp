// SPDX-License-Identifier: MIT
#include "entity_interfacer/statements.hpp"

#include <axon/link.pb.h>

#include "common/utf8.hpp"

namespace axon {

void Statements::positionIs(double x, double y, double z) {
    const std::lock_guard lock(mutex_);
    position_ = {x, y, z};
}

void Statements::activeIs(std::string_view service, bool active, std::string_view reason, const Send& send) {
    const auto name = validUtf8(service);
    const std::lock_guard lock(mutex_);
    active_[name] = {active, validUtf8(reason)};
    send(activityOf(name));
}

proto::EiToEm Statements::activityOf(const std::string& service) const {
    proto::EiToEm message;
    auto& body = *message.mutable_active();
    body.set_service(service);
    const auto said = active_.find(service);
    body.set_active(said == active_.end() || said->second.first);
    if (said != active_.end()) body.set_reason(said->second.second);
    const auto not_taken = not_taken_.lower_bound({service, {}});
    if (body.active() && not_taken != not_taken_.end() && not_taken->first.first == service) {
        body.set_active(false);
        body.set_reason(not_taken->second);
    }
    return message;
}

void Statements::valueTaken(const std::string& service, const std::string& parameter,
                            const std::optional<std::string>& why_not, const Send& send) {
    const std::lock_guard lock(mutex_);
    if (why_not) {
        not_taken_[{service, parameter}] = validUtf8(*why_not);
    } else if (not_taken_.erase({service, parameter}) == 0) {
        return;
    }
    send(activityOf(service));
    if (why_not) return;
    // The application may have switched it off by another of its names.
    for (const auto& [name, state] : active_)
        if (!state.first) send(activityOf(name));
}

std::optional<std::string> Statements::whyNotTaken(const std::string& service) const {
    const std::lock_guard lock(mutex_);
    const auto at = not_taken_.lower_bound({service, {}});
    if (at == not_taken_.end() || at->first.first != service) return std::nullopt;
    return at->second;
}

void Statements::repeat(const Send& send, const std::function<void()>& publish) {
    const std::lock_guard lock(mutex_);
    // Before the senders see the link, so that these are not followed by older values.
    if (position_) {
        proto::EiToEm message;
        message.mutable_position()->set_xpos(position_->at(0));
        message.mutable_position()->set_ypos(position_->at(1));
        message.mutable_position()->set_zpos(position_->at(2));
        send(message);
    }
    not_taken_.clear();
    for (const auto& [service, state] : active_) send(activityOf(service));
    publish();
}

}  // namespace axon
