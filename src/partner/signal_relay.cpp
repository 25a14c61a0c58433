// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/signal_relay.hpp"

#include "partner/translation.hpp"

namespace axon::partner {

void SignalRelay::watch(const Sender& me, Lanes lanes) {
    const std::lock_guard lock(mutex_);
    watch_ = std::move(lanes);
    watcher_ = me;
    given_.clear();
    origins_.clear();
}

void SignalRelay::unwatch() {
    const std::lock_guard lock(mutex_);
    watch_ = {};
}

void SignalRelay::visit(const Sender& client, const Sender& there, Lanes lanes) {
    const std::lock_guard lock(mutex_);
    visitors_[client.id] = {there, std::move(lanes)};
    clients_[there.id] = client;
}

void SignalRelay::end(const std::string& client) {
    const std::lock_guard lock(mutex_);
    const auto found = visitors_.find(client);
    if (found == visitors_.end()) return;
    ended_.push_back(found->second.there.id);
    visitors_.erase(found);
    if (ended_.size() <= kRemembered) return;
    clients_.erase(ended_.front());
    ended_.pop_front();
}

std::int64_t SignalRelay::numberOf(const Header& head) {
    const std::pair key{head.sender.id, head.sequence};
    const bool numbered = head.sequence > 0;  // without a number it is always a new one
    if (numbered)
        if (const auto found = given_.find(key); found != given_.end()) return found->second;
    const auto number = ++last_;
    origins_[number] = {head.sender, head.sequence};
    if (numbered) given_[key] = number;
    if (origins_.size() > kRemembered) {
        const auto oldest = origins_.begin();
        given_.erase({oldest->second.client.id, oldest->second.sequence});
        origins_.erase(oldest);
    }
    return number;
}

bool SignalRelay::stop(const std::string& entity, const Header& head, StopCause cause) {
    auto its = head;
    its.entity = entity;
    its.sender = {};
    std::shared_ptr<const client::StopLanes> lanes;
    {
        const std::lock_guard lock(mutex_);
        const auto visitor = visitors_.find(head.sender.id);
        // A number of a server's own would be none there; and one that is sent again goes as it went.
        const bool again = given_.contains({head.sender.id, head.sequence});
        if (visitor != visitors_.end() && head.sequence < kServerSequences && !(again && watch_.stops)) {
            lanes = visitor->second.lanes.stops;
        } else if (watch_.stops) {
            lanes = watch_.stops;
            its.sequence = numberOf(head);
        } else if (visitor != visitors_.end()) {
            lanes = visitor->second.lanes.stops;
            its.sequence = 0;
        }
    }
    if (!lanes) return false;
    lanes->sendStopSignal(Lane::Signal, its, cause == StopCause::Drill ? cause : StopCause::Requested);
    return true;
}

bool SignalRelay::command(client::Operation operation, const std::string& entity, const Header& head) {
    auto its = head;
    its.entity = entity;
    its.sender = {};
    std::shared_ptr<const client::DataLane> lane;
    {
        const std::lock_guard lock(mutex_);
        const auto visitor = visitors_.find(head.sender.id);
        if (visitor == visitors_.end()) return false;
        lane = visitor->second.lanes.commands;
    }
    lane->send(operation, its, {});
    return true;
}

std::optional<SignalRelay::Origin> SignalRelay::originOf(std::string_view signal_id) const {
    const auto id = SignalId::parse(signal_id);
    if (!id) return std::nullopt;
    const std::lock_guard lock(mutex_);
    if (id->sender == watcher_.id) {
        const auto found = origins_.find(id->sequence);
        return found == origins_.end() ? std::nullopt : std::optional(found->second);
    }
    const auto client = clients_.find(id->sender);
    if (client == clients_.end()) return std::nullopt;
    return Origin{client->second, id->sequence};
}

std::optional<Sender> SignalRelay::translate(proto::StopReceipt& receipt) const {
    auto origin = originOf(receipt.stop_id());
    if (!origin) return std::nullopt;
    receipt.set_stop_id(SignalId{origin->client.id, origin->sequence}.text());
    receipt.set_by(origin->client.name);
    return std::move(origin->client);
}

}  // namespace axon::partner
