// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/convert.hpp"

#include <algorithm>
#include <array>
#include <utility>

namespace axon::transport {

namespace {

template <class Head>
std::array<decltype(&std::declval<Head&>().entity), 4> stringsOf(Head& head) {
    return {&head.sender.id, &head.sender.name, &head.entity, &head.msg_type};
}

}  // namespace

std::size_t stringBytes(const Header& head) {
    std::size_t bytes = 0;
    for (const auto* text : stringsOf(head)) bytes += text->size();
    return bytes;
}

bool isProper(const Header& head) {
    const auto strings = stringsOf(head);
    return std::all_of(strings.begin(), strings.end(),
                       [](const auto* text) { return text->size() <= kHeadStringMax; });
}

void cutStrings(Header& head) {
    for (auto* text : stringsOf(head)) {
        if (text->size() > kHeadStringMax) text->resize(kHeadStringMax);
    }
}

Sender fromIce(ice::Sender&& sender) {
    return {std::move(sender.id), std::move(sender.name), static_cast<Role>(sender.role)};
}

std::int64_t whole(double value) {
    constexpr double kLargest = 9007199254740992.0;  // 2^53
    return value >= 0 && value <= kLargest ? static_cast<std::int64_t>(value) : std::int64_t{0};
}

Header fromIce(ice::Header&& head) {
    Header out;
    out.sender = fromIce(std::move(head.sender));
    out.entity = std::move(head.entity);
    out.msg_type = std::move(head.msgType);
    out.held = {head.held.epoch, head.held.number};
    out.stop_generation = head.stopGeneration;
    out.sequence = whole(head.seq);
    out.sent_at_us = whole(head.sentAt);
    return out;
}

Registration fromIce(ice::Registration&& registration) {
    return {std::move(registration.entity), std::move(registration.name), std::move(registration.category),
            std::move(registration.type),   registration.heartbeatBusyMs, registration.heartbeatIdleMs,
            std::move(registration.server)};
}

EntityStatus fromIce(ice::EntityStatus&& status) {
    return {std::move(status.entity),
            static_cast<EntityState>(status.state),
            status.latched,
            status.stopGeneration,
            fromIce(std::move(status.holder)),
            {status.held.epoch, status.held.number},
            std::move(status.reason),
            status.orphaned,
            status.waiting,
            status.stopLatencyUs,
            std::move(status.server)};
}

ServerAnnouncement fromIce(ice::ServerAnnouncement&& server) {
    return {std::move(server.name), std::move(server.instance), std::move(server.signals),
            whole(server.published), std::move(server.messages)};
}

ice::Sender toIce(const Sender& sender) {
    return {sender.id, sender.name, static_cast<ice::Role>(sender.role)};
}

ice::Header toIce(const Header& head) {
    return {toIce(head.sender),
            head.entity,
            head.msg_type,
            {head.held.epoch, head.held.number},
            head.stop_generation,
            static_cast<double>(head.sequence),
            static_cast<double>(head.sent_at_us)};
}

ice::Registration toIce(const Registration& registration) {
    return {registration.entity,
            registration.name,
            registration.category,
            registration.type,
            registration.heartbeat_busy_ms,
            registration.heartbeat_idle_ms,
            registration.server};
}

ice::EntityStatus toIce(const EntityStatus& status) {
    return {status.entity,        static_cast<ice::EntityState>(status.state),
            status.latched,       status.stop_generation,
            toIce(status.holder), {status.held.epoch, status.held.number},
            status.reason,        status.orphaned,
            status.waiting,       status.stop_latency_us,
            status.server};
}

ice::ServerAnnouncement toIce(const ServerAnnouncement& server) {
    return {server.name, server.instance, server.signals, server.messages,
            static_cast<double>(server.published)};
}

ice::RequestRefused toIce(const Refusal& refusal) {
    return {static_cast<int>(refusal.code), refusal.message};
}

}  // namespace axon::transport
