// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/sending/stop_sender.hpp"

#include <axon/messages.pb.h>

#include <algorithm>
#include <utility>

#include "client/base/durations.hpp"
#include "client/core/content.hpp"
#include "messages/values.hpp"

namespace axon::client {

void StopSender::sendStopSignal(Lane lane, const Header& head, StopCause cause) {
    noted_.push_back({lane, head, {}, cause});
}

void StopSender::sendStopSignals(Lane lane, const Header& head, std::vector<std::string> entities,
                                 StopCause cause) {
    noted_.push_back({lane, head, std::move(entities), cause});
}

StopSender::Leaving StopSender::collect() {
    return {std::exchange(noted_, {}), timer_.mustWakeFor(desk_.nextDeadline())};
}

void StopSender::depart(const Leaving& leaving) noexcept {
    if (!leaving.stops.empty()) {
        sendByLanes(leaving.stops);
        sendAsDatagrams(leaving.stops);
    }
    if (leaving.wake) wake_();
}

void StopSender::sendByLanes(const std::vector<Outgoing>& stops) const {
    const auto paths = links_.paths();
    const auto lanes = lanes_.load();
    for (const auto& stop : stops) {
        // One message to the servers reaches many sooner than one to each.
        const bool one = stop.entities.empty() ? !stop.head.entity.empty() : stop.entities.size() == 1;
        const auto directly = [&] {
            if (stop.lane == Lane::Signal) DirectLinks::stop(*paths, stop.head, stop.entities, stop.cause);
        };
        if (one) directly();
        if (lanes && stop.entities.empty()) lanes->sendStopSignal(stop.lane, stop.head, stop.cause);
        if (lanes && !stop.entities.empty())
            lanes->sendStopSignals(stop.lane, stop.head, stop.entities, stop.cause);
        if (!one) directly();
    }
}

void StopSender::sendAsDatagrams(const std::vector<Outgoing>& stops) const {
    for (const auto& stop : stops) {
        // A datagram is a stop: a drill is none.
        if (stop.lane != Lane::Signal || stop.cause == StopCause::Drill) continue;
        if (stop.entities.empty()) datagram_(stop.head.entity, stop.head.sequence, stop.head.stop_generation);
        for (const auto& entity : stop.entities) datagram_(entity, stop.head.sequence, marks_.of(entity));
    }
}

TimePoint StopSender::onTimer() {
    withDesk([this](StopDesk& desk) {
        timer_.begin();
        desk.onTimer();
    });
    const std::lock_guard lock(mutex_);
    return timer_.end(std::min(desk_.nextDeadline(), clock_.now() + kLongestSleep));
}

bool StopSender::onReceipt(const Header& head, std::string_view message) {
    if (head.msg_type != kMsgReceipt) return false;
    proto::ToClient body;
    if (!parse(body, message) || !body.has_receipt()) return false;
    withDesk([&](StopDesk& desk) { desk.onReceipt(head.entity, body.receipt()); });
    return true;
}

void StopSender::onReply(const Header& head, std::string_view message) {
    proto::ToClient body;
    if (!parse(body, message) || !body.has_reply()) return;
    withDesk([&](StopDesk& desk) {
        desk.onReply(head.entity, body.reply().request_id(), toRefusal(body.reply().refusal()));
    });
}

void StopSender::onDatagramAcknowledged(const std::string& entity, const std::string& sender,
                                        std::int64_t sequence, std::uint32_t generation) {
    // The Entity Manager has the stop: its stage, by another way.
    proto::StopReceipt receipt;
    receipt.set_stop_id(sender + ':' + std::to_string(sequence));
    receipt.set_stage(proto::StopReceipt::MANAGER);
    receipt.set_stop_generation(generation);
    withDesk([&](StopDesk& desk) { desk.onReceipt(entity, receipt); });
}

}  // namespace axon::client
