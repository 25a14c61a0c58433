// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/stop_desk.hpp"

#include <axon/status.pb.h>

#include <algorithm>
#include <charconv>

#include "client/content.hpp"

namespace axon::client {
namespace {

/// The sequence at the end of a stop_id ("sender:sequence"), or -1.
std::int64_t sequenceOf(std::string_view stop_id) {
    std::size_t begin = stop_id.size();
    while (begin > 0 && stop_id[begin - 1] >= '0' && stop_id[begin - 1] <= '9') --begin;
    std::int64_t sequence = -1;
    const auto digits = stop_id.substr(begin);
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), sequence);
    return error == std::errc{} && !digits.empty() ? sequence : -1;
}

}  // namespace

void StopDesk::onConnected(const Sender& self) {
    connected_ = true;
    self_ = self;
    for (auto& order : orders_) order.resend = clock_.now();  // the entities come with the next profiles
}

void StopDesk::onDisconnected() {
    connected_ = false;
    names_.clear();
}

void StopDesk::onEntity(Presence presence, const std::string& id, const std::string& name) {
    if (presence == Presence::Left) {
        names_.remove(id);
    } else {
        names_.put(id, name);
        for (auto& order : orders_) {
            if (order.everything) add(order, id);
        }
    }
}

Header StopDesk::header(const Order& order, const std::string& entity) const {
    Header head;
    head.sender = self_;
    head.entity = entity;
    head.msg_type = kMsgStop;
    head.stop_generation = entity.empty() ? 0 : marks_.of(entity);
    head.sequence = order.sequence;
    head.sent_at_us = toMicroseconds(clock_.now());
    return head;
}

void StopDesk::send(const Order& order, Lane lane, bool only_unconfirmed) {
    if (order.everything) {
        // One request, fanned out by the servers; also the way to resend, whoever is missing.
        link_.sendStopSignal(lane, header(order, {}), StopCause::Requested);
        return;
    }
    std::vector<std::string> ids;
    for (const auto& [id, receipt] : order.receipts) {
        if (!only_unconfirmed || !receipt.confirmed()) ids.push_back(id);
    }
    if (ids.size() == 1) {
        link_.sendStopSignal(lane, header(order, ids.front()), StopCause::Requested);
    } else if (!ids.empty()) {
        link_.sendStopSignals(lane, header(order, {}), std::move(ids), StopCause::Requested);
    }
}

void StopDesk::stop(const std::vector<std::string>& names, Duration deadline, Done done) {
    if (!connected_) {
        done(Refusal{RefusalCode::NotConnected,
                     "There is no connection to the server, so no stop can be sent. What this client held is "
                     "being stopped by the server's own watchdog; for the rest use the robot's own stop.",
                     {}});
        return;
    }
    Order order;
    order.sequence = marks_.nextSequence();
    order.everything = names.empty();
    order.given = clock_.now();
    order.deadline = order.given + deadline;
    order.resend = order.given + kStopFirstResend;
    order.done = std::move(done);

    std::vector<std::string> ids;
    if (order.everything) {
        ids = names_.ids();
    } else {
        for (const auto& name : names) {
            auto found = names_.resolveAll(name);
            if (!found) {
                order.unknown = found.refusal();
                continue;
            }
            ids.insert(ids.end(), found->begin(), found->end());
        }
    }
    for (const auto& id : ids) add(order, id);
    if (!order.unknown.ok() && !order.receipts.empty()) order.unknown.message += " The others were stopped.";
    orders_.push_back(std::move(order));
    send(orders_.back(), Lane::Signal, false);
    finishIfSettled(orders_.back());
}

Receipt& StopDesk::add(Order& order, const std::string& entity) const {
    const auto [entry, is_new] = order.receipts.try_emplace(entity);
    Receipt& receipt = entry->second;
    if (is_new) {
        receipt.entity = entity;
        receipt.stop_generation = marks_.of(entity);
        receipt.server = order.accepted;
        ++order.unconfirmed;
    }
    receipt.name = names_.label(entity);
    return receipt;
}

bool StopDesk::settled(const Order& order) {
    if (order.unconfirmed > 0) return false;
    return !order.everything ||
           (order.reached && order.receipts.size() >= static_cast<std::size_t>(*order.reached));
}

void StopDesk::finishIfSettled(Order& order) {
    if (!settled(order)) return;
    finish(std::find_if(orders_.begin(), orders_.end(), [&](const Order& one) { return &one == &order; }));
}

StopDesk::Order* StopDesk::find(std::int64_t sequence) {
    const auto found = std::find_if(orders_.begin(), orders_.end(),
                                    [&](const Order& order) { return order.sequence == sequence; });
    return found == orders_.end() ? nullptr : &*found;
}

void StopDesk::onStopAccepted(std::int64_t sequence, const std::string& entity, int entities) {
    Order* order = find(sequence);
    if (order == nullptr) return;
    const Seconds after = clock_.now() - order->given;
    if (!order->everything && entity.empty()) {
        // Fewer than were named: which ones are not there is told by their refusals, and the rest by
        // receipts.
        if (entities < 0 || static_cast<std::size_t>(entities) < order->receipts.size()) return;
        for (auto& [id, receipt] : order->receipts) {
            if (!receipt.server) receipt.server = after;
        }
        return;
    }
    if (!order->everything) {
        const auto entry = order->receipts.find(entity);
        if (entry != order->receipts.end() && entities > 0 && !entry->second.server)
            entry->second.server = after;
        return;
    }
    order->reached = std::max(order->reached.value_or(0), entities);
    // When it reached fewer than there are receipts, nobody says which: their own answers must show it.
    if (entities > 0 && static_cast<std::size_t>(entities) >= order->receipts.size()) {
        if (!order->accepted) order->accepted = after;
        for (auto& [id, receipt] : order->receipts) {
            if (!receipt.server) receipt.server = after;
        }
    }
    finishIfSettled(*order);
}

void StopDesk::onReceipt(const std::string& entity, const proto::StopReceipt& incoming) {
    const auto generation = static_cast<std::int32_t>(incoming.stop_generation());
    marks_.raise(entity, generation);
    if (!incoming.stop_id().starts_with(self_.id)) return;
    Order* order = find(sequenceOf(incoming.stop_id()));
    if (order == nullptr) return;
    const auto entry = order->receipts.find(entity);
    if (entry == order->receipts.end() && !order->everything) return;

    Receipt& receipt = entry == order->receipts.end() ? add(*order, entity) : entry->second;
    const bool was_confirmed = receipt.confirmed();
    const Seconds after = clock_.now() - order->given;
    receipt.stop_generation = std::max(receipt.stop_generation, generation);
    receipt.state = stateFromProto(incoming.state()).value_or(receipt.state);
    const auto mark = [&](std::optional<Seconds>& stage) {
        if (!stage) stage = after;
    };
    switch (incoming.stage()) {
        case proto::StopReceipt::SERVER:
            mark(receipt.server);
            break;
        case proto::StopReceipt::MANAGER:
            mark(receipt.manager);
            break;
        case proto::StopReceipt::NO_APPLICATION:
            mark(receipt.manager);
            receipt.no_application = true;
            break;
        case proto::StopReceipt::STANDSTILL:
            mark(receipt.standstill);
            [[fallthrough]];  // an application that stands still has returned from its callback
        case proto::StopReceipt::CALLBACK_RETURNED:
            mark(receipt.callback_returned);
            mark(receipt.manager);
            break;
        default:
            break;
    }
    if (!was_confirmed && receipt.confirmed()) --order->unconfirmed;
    finishIfSettled(*order);
}

void StopDesk::onRefusal(std::int64_t sequence, const std::string& entity, const Refusal& refusal) {
    const auto order =
        std::find_if(orders_.begin(), orders_.end(), [&](const Order& o) { return o.sequence == sequence; });
    if (order == orders_.end()) return;
    // With several entities the others may still answer: the one that is gone stays without times.
    if (order->receipts.size() > 1 && !entity.empty()) return;
    auto done = std::move(order->done);
    orders_.erase(order);
    done(refusal);
}

void StopDesk::finish(std::list<Order>::iterator order) {
    const auto ended = std::move(*order);
    orders_.erase(order);
    if (!ended.unknown.ok()) {
        ended.done(ended.unknown);
        return;
    }
    std::vector<Receipt> receipts;
    for (const auto& [id, receipt] : ended.receipts) receipts.push_back(receipt);
    // Reached, and never heard of: not to be taken for stopped.
    while (receipts.size() < static_cast<std::size_t>(ended.reached.value_or(0))) {
        Receipt silent;
        silent.name = "(an entity that has not answered)";
        silent.server = ended.accepted;
        receipts.push_back(std::move(silent));
    }
    ended.done(std::move(receipts));
}

void StopDesk::onTimer() {
    const auto now = clock_.now();
    for (auto order = orders_.begin(); order != orders_.end();) {
        const auto current = order++;
        if (now >= current->deadline) {
            finish(current);
        } else if (now >= current->resend) {
            current->resend = now + kStopResendPeriod;
            if (!connected_) continue;
            send(*current, Lane::Signal, true);
            send(*current, Lane::Data, true);
        }
    }
}

void StopDesk::endOrders() {
    while (!orders_.empty()) finish(orders_.begin());
}

TimePoint StopDesk::nextDeadline() const {
    auto next = TimePoint::max();
    for (const auto& order : orders_) next = std::min({next, order.deadline, order.resend});
    return next;
}

}  // namespace axon::client
