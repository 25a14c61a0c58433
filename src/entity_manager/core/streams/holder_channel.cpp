// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/streams/holder_channel.hpp"

#include "entity_manager/ports/core_settings.hpp"

namespace axon::entity_manager {

namespace {

const Refusal kTooLargeForLink{RefusalCode::TooLarge,
                               "It is larger than the link to the robot application takes at once (1 MiB). "
                               "Send it in parts, or upload a resource.",
                               {}};

}  // namespace

void HolderChannel::passText(const Incident& incident) {
    proto::EmToEi message;
    message.mutable_text()->mutable_text()->swap(*incident.body->mutable_text()->mutable_text());
    message.mutable_text()->set_from(incident.head->sender.name);
    if (!turn_.toApplication(message)) turn_.refuse(incident, kTooLargeForLink);
}

void HolderChannel::passRaw(const Incident& incident) {
    auto& raw = *raw_to_link_.mutable_raw();
    raw.mutable_data()->Swap(incident.body->mutable_raw()->mutable_data());
    if (raw.from() != incident.head->sender.name) raw.set_from(incident.head->sender.name);
    raw.set_stop_generation(turn_.stops().generation);
    if (!turn_.toApplication(raw_to_link_)) turn_.refuse(incident, kTooLargeForLink);
}

void HolderChannel::refuseRaw(const Sender& to, const Refusal& refusal) {
    ++turn_.count().raw_refused;
    if (turn_.now() < raw_refused_ + kRawRefusalPeriod) return;
    raw_refused_ = turn_.now();
    turn_.reply(to, {}, refusal);
}

void HolderChannel::textCame(proto::LinkText& text) {
    if (turn_.holder() == nullptr) {
        ++turn_.count().undelivered;
        return;
    }
    proto::ToClient message;
    message.mutable_text()->mutable_text()->swap(*text.mutable_text());
    turn_.tell(*turn_.holder(), kMsgText, message);
}

void HolderChannel::rawCame(proto::LinkRaw& raw) {
    if (turn_.holder() == nullptr || !turn_.connected()) {
        ++turn_.count().undelivered;
        return;
    }
    raw_to_client_.mutable_raw()->mutable_data()->Swap(raw.mutable_data());
    turn_.tellDroppable(*turn_.holder(), kMsgRaw, raw_to_client_);
}

}  // namespace axon::entity_manager
