// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/stops/stop_desk.hpp"

#include <axon/status.pb.h>

#include <algorithm>
#include <charconv>
#include <iterator>

#include "client/core/content.hpp"

namespace axon::client {
namespace {

constexpr std::ptrdiff_t kListedAtOnce = 4096;  // half of what a server takes (sessions.md, "Limits")

/// The sequence at the end of a stop_id ("sender:sequence"), or -1.
std::int64_t sequenceOf(std::string_view stop_id) {
    std::size_t begin = stop_id.size();
    while (begin > 0 && stop_id[begin - 1] >= '0' && stop_id[begin - 1] <= '9') --begin;
    std::int64_t sequence = -1;
    const auto digits = stop_id.substr(begin);
    const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), sequence);
    return error == std::errc{} && !digits.empty() ? sequence : -1;
}

/// For people: what the application that is missing was last known to do.
std::string lossOf(const proto::StopReceipt& receipt) {
    if (!receipt.absence_reason().empty()) return receipt.absence_reason();
    return receipt.absence() == proto::StopReceipt::SILENT
               ? "the robot application is silent"
               : "the robot application has gone without a good-bye";
}

}  // namespace

void StopDesk::onConnected(const Sender& self) {
    connected_ = true;
    self_ = self;
    // The entities come with the next profiles.
    for (auto& [sequence, order] : orders_) {
        if (order.repeats) schedule(order, clock_.now());
    }
}

void StopDesk::onDisconnected() {
    listAll();  // while their names are known
    connected_ = false;
    names_.clear();
}

void StopDesk::onEntity(Presence presence, const std::string& id, const std::string& name, bool ready) {
    listAll();  // by the names that they have now
    if (presence == Presence::Left) {
        names_.remove(id);
    } else {
        names_.put(id, name, ready);
        for (const auto sequence : everything_) add(orders_.at(sequence), id);
    }
}

Header StopDesk::header(const Order& order, const std::string& entity, bool again) const {
    Header head;
    head.sender = self_;
    head.entity = entity;
    head.msg_type = kMsgStop;
    // Who knows the generation that the stop itself has raised means another one by its number
    // (stop_generations.hpp).
    head.stop_generation = entity.empty() || again ? 0 : marks_.of(entity);
    head.sequence = order.sequence;
    head.sent_at_us = toMicroseconds(clock_.now());
    return head;
}

void StopDesk::send(const Order& order, Lane lane, std::vector<std::string> ids, bool again) {
    if (ids.empty() && order.everything) {
        // One request, fanned out by the servers.
        link_.sendStopSignal(lane, header(order, {}, again), order.cause);
    } else if (ids.size() == 1) {
        link_.sendStopSignal(lane, header(order, ids.front(), again), order.cause);
    } else {
        for (auto first = ids.begin(); first != ids.end();) {
            const auto end = first + std::min<std::ptrdiff_t>(ids.end() - first, kListedAtOnce);
            link_.sendStopSignals(lane, header(order, {}, again),
                                  {std::make_move_iterator(first), std::make_move_iterator(end)},
                                  order.cause);
            first = end;
        }
    }
}

void StopDesk::stop(const std::vector<std::string>& names, Duration deadline, Done done,
                    Duration standstill) {
    if (!connected_) {
        done(Refusal{RefusalCode::NotConnected,
                     "There is no connection to the server, so no stop can be sent. What this client held is "
                     "being stopped by the server's own watchdog; for the rest use the robot's own stop.",
                     {}});
        return;
    }
    Order order;
    order.everything = names.empty();
    order.rests_by = clock_.now() + standstill;
    give(std::move(order), names, deadline, std::move(done));
}

void StopDesk::drill(const std::vector<std::string>& names, Duration deadline, Done done) {
    if (!connected_) {
        done(Refusal{RefusalCode::NotConnected, "There is no connection to the server.", {}});
        return;
    }
    Order order;
    order.cause = StopCause::Drill;
    order.repeats = false;
    give(std::move(order), names.empty() ? names_.ids() : names, deadline, std::move(done));
}

void StopDesk::give(Order order, const std::vector<std::string>& names, Duration deadline, Done done) {
    order.sequence = marks_.nextSequence();
    order.given = order.heard_at = clock_.now();
    order.deadline = order.given + deadline;
    order.done = std::move(done);

    std::vector<std::string> ids;
    for (const auto& name : names) {
        auto found = names_.resolveAll(name);
        if (!found) {
            order.unknown = found.refusal();
            continue;
        }
        ids.insert(ids.end(), found->begin(), found->end());
    }
    std::sort(ids.begin(), ids.end());
    ids.erase(std::unique(ids.begin(), ids.end()), ids.end());
    if (!order.unknown.ok() && !ids.empty()) {
        order.unknown.message +=
            order.cause == StopCause::Drill ? " The others were drilled." : " The others were stopped.";
    }
    order.named = ids;
    const auto sequence = order.sequence;
    auto& given = orders_.emplace(sequence, std::move(order)).first->second;
    if (given.everything) everything_.insert(sequence);
    schedule(given, given.repeats ? given.given + kStopFirstResend : TimePoint::max());
    send(given, Lane::Signal, std::move(ids), false);
    finishIfSettled(given);
}

void StopDesk::await(const std::string& entity, std::int64_t sequence, Duration deadline, Done done) {
    Order order;
    order.sequence = sequence;
    order.repeats = false;
    order.given = order.heard_at = order.rests_by = clock_.now();
    order.deadline = order.given + deadline;
    order.named = {entity};
    order.done = std::move(done);
    auto& given = orders_.emplace(sequence, std::move(order)).first->second;
    list(given);
    schedule(given, TimePoint::max());
}

void StopDesk::withdraw(std::int64_t sequence) {
    if (orders_.contains(sequence)) take(sequence);
}

void StopDesk::onReply(const std::string& entity, std::string_view request_id, const Refusal& refusal) {
    const auto whose = request_id.substr(0, request_id.rfind(':'));
    if (refusal.ok() || uuidOf(whose) != uuidOf(self_.id)) return;
    onRefusal(sequenceOf(request_id), entity, refusal);
}

void StopDesk::list(Order& order) const {
    if (std::exchange(order.listed, true)) return;
    for (const auto& id : order.everything ? names_.ids() : std::exchange(order.named, {})) add(order, id);
}

void StopDesk::listAll() {
    for (auto& [sequence, order] : orders_) list(order);
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
    if (order.unconfirmed > 0 || !order.named.empty()) return false;
    if (order.rolling > 0 && order.given < order.rests_by) return false;
    return !order.everything || allKnown(order);
}

bool StopDesk::allKnown(const Order& order) {
    return order.reached && order.receipts.size() >= static_cast<std::size_t>(*order.reached);
}

void StopDesk::schedule(Order& order, TimePoint resend) {
    due_.erase({order.due, order.sequence});
    order.resend = resend;
    order.due = std::min(order.deadline, resend);
    due_.insert({order.due, order.sequence});
}

StopDesk::Order StopDesk::take(std::int64_t sequence) {
    const auto found = orders_.find(sequence);
    list(found->second);
    auto order = std::move(found->second);
    orders_.erase(found);
    everything_.erase(sequence);
    due_.erase({order.due, sequence});
    return order;
}

void StopDesk::finishIfSettled(const Order& order) {
    if (settled(order)) finish(order.sequence);
}

StopDesk::Order* StopDesk::find(std::int64_t sequence) {
    const auto found = orders_.find(sequence);
    if (found == orders_.end()) return nullptr;
    list(found->second);
    return &found->second;
}

void StopDesk::onStopAccepted(std::int64_t sequence, const std::string& entity, int entities) {
    const auto now = clock_.now();  // before the receipts of thousands are made
    Order* order = find(sequence);
    if (order == nullptr) return;
    const Seconds after = now - order->given;
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
    const auto now = clock_.now();
    marks_.raise(entity, generation);
    // By a datagram it comes with the UUID alone.
    const auto whose = std::string_view(incoming.stop_id()).substr(0, incoming.stop_id().rfind(':'));
    if (uuidOf(whose) != uuidOf(self_.id)) return;
    Order* order = find(sequenceOf(incoming.stop_id()));
    if (order == nullptr) return;
    const auto entry = order->receipts.find(entity);
    if (entry == order->receipts.end() && !order->everything) return;

    order->heard_at = now;
    Receipt& receipt = entry == order->receipts.end() ? add(*order, entity) : entry->second;
    const bool was_confirmed = receipt.confirmed();
    const bool rolled = was_confirmed && !receipt.atRest();
    const Seconds after = now - order->given;
    receipt.stop_generation = std::max(receipt.stop_generation, generation);
    // The other copy of an earlier one may come after a later one (several servers: directly, and by the
    // topic).
    if (auto& said_at = order->said_at[entity]; incoming.at_us() >= said_at) {
        said_at = incoming.at_us();
        receipt.state = stateFromProto(incoming.state()).value_or(receipt.state);
        receipt.fault = incoming.fault();
        receipt.application_lost =
            incoming.absence() > proto::StopReceipt::NONE ? lossOf(incoming) : std::string();
        receipt.application_lost_for.reset();
        if (!receipt.application_lost.empty())
            receipt.application_lost_for = std::chrono::milliseconds(incoming.absent_for_ms());
        receipt.standstill_follows = incoming.standstill_follows();
        receipt.tasks_ended = static_cast<int>(incoming.tasks_ended());
        receipt.tasks_removed = static_cast<int>(incoming.tasks_removed());
    }
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
            if (incoming.absence() <= proto::StopReceipt::NONE) receipt.no_application = true;
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
    const bool rolls = receipt.confirmed() && !receipt.atRest();
    if (rolls && !rolled) ++order->rolling;
    if (rolled && !rolls) --order->rolling;
    finishIfSettled(*order);
}

void StopDesk::onRefusal(std::int64_t sequence, const std::string& entity, const Refusal& refusal) {
    const Order* order = find(sequence);
    if (order == nullptr) return;
    if (order->repeats && refusal.code == RefusalCode::Overloaded) return;  // the next one may be taken
    // With several entities the others may still answer: the one that is gone stays without times.
    if (order->receipts.size() > 1 && !entity.empty()) return;
    take(sequence).done(refusal);
}

void StopDesk::finish(std::int64_t sequence) {
    const auto ended = take(sequence);
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
    while (!due_.empty() && due_.begin()->first <= now) {
        auto& order = orders_.at(due_.begin()->second);
        if (now >= order.deadline) {
            const bool comes_to_rest = order.unconfirmed == 0 && order.rolling > 0 && now < order.rests_by;
            if (!comes_to_rest) {
                finish(order.sequence);
                continue;
            }
            order.deadline = order.rests_by;
        }
        if (const auto quiet = std::min(order.heard_at + kStopFirstResend, order.given + kStopPatience);
            now < quiet) {
            schedule(order, quiet);
            continue;
        }
        if (!order.repeats) {
            schedule(order, TimePoint::max());
            continue;
        }
        schedule(order, now + kStopResendPeriod);
        if (!connected_) continue;
        // Of everything only those that are missing, once all that it has reached are known: thousands that
        // have answered are not asked again.
        std::vector<std::string> ids;
        if (!order.everything || allKnown(order)) {
            list(order);
            for (const auto& [id, receipt] : order.receipts) {
                if (!receipt.confirmed()) ids.push_back(id);
            }
            if (ids.empty()) continue;  // they come to rest
        }
        send(order, Lane::Signal, ids, true);
        send(order, Lane::Data, std::move(ids), true);
    }
}

void StopDesk::endOrders() {
    while (!orders_.empty()) finish(orders_.begin()->first);
}

TimePoint StopDesk::nextDeadline() const {
    return due_.empty() ? TimePoint::max() : due_.begin()->first;
}

}  // namespace axon::client
