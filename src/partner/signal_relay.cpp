// SPDX-License-Identifier: GPL-2.0-or-later
#include "partner/signal_relay.hpp"

#include "partner/translation.hpp"

namespace axon::partner {

void SignalRelay::stopBy(SessionNumber session, const Sender& me,
                         std::shared_ptr<const client::StopLanes> lanes, bool shared) {
    const std::lock_guard lock(mutex_);
    (shared ? shared_ : alone_) = {session, me, std::move(lanes)};
    if (standing().session == session) forgetStops();
}

void SignalRelay::noStopBy(SessionNumber session) {
    const std::lock_guard lock(mutex_);
    const bool was = standing().session == session;
    for (auto* one : {&alone_, &shared_})
        if (one->session == session) *one = {};
    if (was) forgetStops();
}

void SignalRelay::forgetStops() {
    given_.clear();
    origins_.clear();
    of_client_.clear();
    recent_.clear();
    recent_order_.clear();
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
    auto& its = of_client_[head.sender.id];
    its.push_back(number);
    if (its.size() > kRememberedOfOne)
        forget(its.front());
    else if (origins_.size() > kRemembered)
        forget(origins_.begin()->first);
    return number;
}

void SignalRelay::forget(std::int64_t number) {
    const auto origin = origins_.find(number);
    if (origin == origins_.end()) return;
    const auto& client = origin->second.client.id;
    given_.erase({client, origin->second.sequence});
    // It is the oldest of its client, as it is the oldest of all or was taken from there.
    if (const auto its = of_client_.find(client); its != of_client_.end()) {
        its->second.pop_front();
        if (its->second.empty()) of_client_.erase(its);
    }
    origins_.erase(origin);
}

bool SignalRelay::justSent(const Header& head, const std::string& entity) {
    const auto given = given_.find({head.sender.id, head.sequence});
    if (given == given_.end()) return false;
    const auto sent = recent_.find({given->second, entity});
    return sent != recent_.end() && clock_.now() - sent->second < kRepeat;
}

void SignalRelay::noteSent(std::int64_t number, const std::string& entity) {
    const auto now = clock_.now();
    while (!recent_order_.empty() &&
           (recent_order_.size() >= kRecent || now - recent_.at(recent_order_.front()) >= kRepeat)) {
        recent_.erase(recent_order_.front());
        recent_order_.pop_front();
    }
    if (recent_.emplace(Sent{number, entity}, now).second) recent_order_.emplace_back(number, entity);
}

bool SignalRelay::tooMany(const std::string& client) {
    if (const auto now = clock_.now(); now - second_ >= std::chrono::seconds{1}) {
        second_ = now;
        common_ = aside_ = 0;
        of_one_.clear();
    }
    const auto found = of_one_.find(client);
    const auto its = found == of_one_.end() ? 0 : found->second;
    if (its < kSharedLeast && aside_ < kSharedAside)
        ++aside_;
    else if (its < kSharedOfOne && common_ < kSharedCommon)
        ++common_;
    else
        return true;
    ++of_one_[client];
    return false;
}

SignalRelay::Passed SignalRelay::stop(const std::string& entity, const Header& head, StopCause cause) {
    auto its = head;
    its.entity = entity;
    its.sender = {};
    std::shared_ptr<const client::StopLanes> lanes;
    {
        const std::lock_guard lock(mutex_);
        const auto visitor = visitors_.find(head.sender.id);
        // A number of a server's own would be none there; and one that is sent again goes as it went.
        const bool again = given_.contains({head.sender.id, head.sequence});
        const auto& stops = standing().lanes;
        if (visitor != visitors_.end() && head.sequence < kServerSequences && !(again && stops)) {
            lanes = visitor->second.lanes.stops;
        } else if (stops) {
            lanes = stops;
            if (justSent(head, entity)) return Passed::Sent;
            if (!alone_.lanes && tooMany(head.sender.id)) return Passed::TooMany;
            its.sequence = numberOf(head);
            noteSent(its.sequence, entity);
        } else if (visitor != visitors_.end()) {
            lanes = visitor->second.lanes.stops;
            its.sequence = 0;
        }
    }
    if (!lanes) return Passed::NoSession;
    lanes->sendStopSignal(Lane::Signal, its, cause == StopCause::Drill ? cause : StopCause::Requested);
    return Passed::Sent;
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
    if (const auto& its = standing(); its.lanes && id->sender == its.me.id) {
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
