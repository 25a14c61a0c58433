// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/connection/datagram_sender.hpp"

#include <spdlog/logger.h>

#include <system_error>
#include <utility>

#include "client/base/log.hpp"

namespace axon::client {

DatagramSender::DatagramSender(const Clock& clock, Acknowledged acknowledged)
    : clock_(clock), acknowledged_(std::move(acknowledged)), repeater_(clock) {}

DatagramSender::~DatagramSender() {
    close();
}

void DatagramSender::admit(const std::string& entity, LeaseNumber lease, std::string_view endpoint,
                           const std::string& key, std::string_view sender) {
    const auto to = datagrams::Endpoint::parse(endpoint);
    const auto self = Id128::parse(uuidOf(sender));
    if (!to || to->port == 0 || !self) return forget(entity, lease);
    if (!lane()) return;
    const std::lock_guard lock(mutex_);
    repeater_.admit(entity, {*to, lease, key, *self});
}

void DatagramSender::forget(const std::string& entity, LeaseNumber lease) {
    const std::lock_guard lock(mutex_);
    repeater_.forget(entity, lease);
}

/// The socket and its thread, made outside the lock.
std::shared_ptr<datagrams::DatagramLane> DatagramSender::lane() {
    {
        const std::lock_guard lock(mutex_);
        if (lane_ || failed_ || closed_) return lane_;
    }
    std::shared_ptr<datagrams::DatagramLane> made;
    try {
        made = std::make_shared<datagrams::DatagramLane>(
            "axon-datagrams", datagrams::Endpoint{}, clock_,
            [this](const datagrams::DatagramLane&, const datagrams::Endpoint& from, std::string_view bytes) {
                return received(from, bytes);
            },
            [this](const datagrams::DatagramLane& lane) { return onDue(lane); });
    } catch (const std::system_error& error) {
        log().warn("stops are not sent as datagrams: {}", error.what());
    }
    const std::lock_guard lock(mutex_);
    failed_ = !made;
    if (!lane_ && !closed_) lane_ = made;
    return lane_;
}

void DatagramSender::stop(const std::string& entity, std::int64_t sequence, std::int32_t generation) {
    std::vector<datagrams::StopRepeater::Outgoing> outgoing;
    std::shared_ptr<datagrams::DatagramLane> lane;
    {
        const std::lock_guard lock(mutex_);
        if (!lane_ || repeater_.empty()) return;
        lane = lane_;
        repeater_.stop(entity, sequence, static_cast<std::uint32_t>(generation));
        outgoing = repeater_.take();
    }
    if (outgoing.empty()) return;
    for (const auto& out : outgoing) lane->send(out.to, {out.bytes.data(), out.bytes.size()});
    lane->wake();
}

bool DatagramSender::received(const datagrams::Endpoint& from, std::string_view bytes) {
    std::optional<datagrams::StopRepeater::Acknowledged> acknowledged;
    {
        const std::lock_guard lock(mutex_);
        acknowledged = repeater_.onDatagram(from, bytes);
    }
    if (acknowledged) acknowledged_(*acknowledged);
    return acknowledged.has_value();
}

TimePoint DatagramSender::onDue(const datagrams::DatagramLane& lane) {
    std::vector<datagrams::StopRepeater::Outgoing> outgoing;
    TimePoint next;
    {
        const std::lock_guard lock(mutex_);
        repeater_.onTimer();
        outgoing = repeater_.take();
        next = repeater_.nextDeadline();
    }
    for (const auto& out : outgoing) lane.send(out.to, {out.bytes.data(), out.bytes.size()});
    return next;
}

void DatagramSender::close() {
    std::shared_ptr<datagrams::DatagramLane> ended;
    {
        const std::lock_guard lock(mutex_);
        closed_ = true;
        ended = std::move(lane_);
    }
}

}  // namespace axon::client
