// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/links/datagrams/datagram_desk.hpp"

#include <spdlog/spdlog.h>

#include <system_error>

namespace axon::entity_manager {

DatagramDesk::DatagramDesk(DatagramSettings settings, const Clock& clock, StopGenerations& stop_generations,
                           std::string entity, Stop stop)
    : settings_(std::move(settings)),
      clock_(clock),
      stop_generations_(stop_generations),
      entity_(std::move(entity)),
      stop_(std::move(stop)) {}

std::string DatagramDesk::open(const std::string& way_to_server) {
    if (!settings_.offered) return {};
    const auto address =
        datagrams::parseAddress(settings_.address.empty() ? way_to_server : settings_.address);
    if (!address) return {};
    const datagrams::Endpoint wanted{*address, settings_.port};
    if (lane_ && bound_ == wanted) return lane_->local().toString();
    lane_.reset();
    try {
        lane_ = std::make_unique<datagrams::DatagramLane>(
            "axon-datagrams", wanted, clock_,
            [this](const datagrams::DatagramLane& lane, const datagrams::Endpoint& from,
                   std::string_view bytes) { return received(lane, from, bytes); },
            nullptr);
    } catch (const std::system_error& error) {
        spdlog::warn(
            "stops are not received as datagrams: {} (expected an address of this machine and a free port; "
            "see "
            "Axon.Datagrams)",
            error.what());
        return {};
    }
    bound_ = wanted;
    return lane_->local().toString();
}

void DatagramDesk::hold(const LeaseBook::Held* held) {
    const auto number = held != nullptr ? held->number : LeaseNumber{};
    if (number == held_ && (held == nullptr || held->holder.id == holder_)) return;
    if (number != held_) tellCounts();
    held_ = number;
    if (held == nullptr) {
        sentry_.end();
        return;
    }
    holder_ = held->holder.id;
    sentry_.hold(number, held->key.bytes(), held->holder);
}

/// Of the lease that ends: refused ones may be somebody's attempt, or a network that is set up wrongly.
void DatagramDesk::tellCounts() {
    const auto now = sentry_.counters();
    const auto refused = [](const datagrams::StopSentry::Counters& of) {
        return of.unreadable + of.foreign + of.old;
    };
    const auto stops = now.accepted - told_.accepted, copies = now.again - told_.again;
    const auto others = refused(now) - refused(told_);
    told_ = now;
    if (stops + copies + others > 0)
        spdlog::info("datagrams: {} stops and {} copies of them, {} refused", stops, copies, others);
}

void DatagramDesk::close() {
    lane_.reset();
}

bool DatagramDesk::received(const datagrams::DatagramLane& lane, const datagrams::Endpoint& from,
                            std::string_view bytes) {
    const auto judged = sentry_.judge(bytes);
    if (judged.verdict == datagrams::StopSentry::Verdict::Refused) return false;
    const auto& datagram = judged.datagram;
    if (judged.verdict == datagrams::StopSentry::Verdict::New) {
        Header head;
        head.sender = judged.sender;
        head.entity = entity_;
        head.held = datagram.lease;
        head.stop_generation = static_cast<std::int32_t>(datagram.generation);
        head.sequence = datagram.sequence;
        head.sent_at_us = datagram.sent_at_us;
        stop_(std::move(head), datagram.cause);
    }
    auto answer = datagram;
    answer.kind = datagrams::StopDatagram::Kind::Ack;
    answer.generation = stop_generations_.raisedBy(judged.sender.id, datagram.sequence).value_or(0);
    const auto encoded = datagrams::encode(answer, judged.key);
    lane.send(from, {encoded.data(), encoded.size()});
    // Copies without end are a flood as well: whoever replays one must not keep this thread from resting.
    return judged.verdict == datagrams::StopSentry::Verdict::New;
}

}  // namespace axon::entity_manager
