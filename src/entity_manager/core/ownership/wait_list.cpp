// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/core/ownership/wait_list.hpp"

#include <algorithm>

namespace axon::entity_manager {

Refusal WaitList::mayJoin(const Sender& client, const std::string& request_id) const {
    for (const auto& place : waiting_) {
        if (place.claim.client.id != client.id) continue;
        if (place.claim.request_id == request_id) return {};
        return {RefusalCode::Duplicate,
                "You wait for it already, with another request. Send that one again, or abort it first.",
                {}};
    }
    if (waiting_.size() < kMax) return {};
    return {RefusalCode::Overloaded,
            std::to_string(kMax) + " clients wait for it already. Try again later, or choose another entity.",
            {}};
}

std::size_t WaitList::join(Claim claim, TimePoint now) {
    const auto until = now + kRefreshWithin;
    const auto place = placeOf(claim.client, claim.request_id);
    if (place != 0) {
        waiting_[place - 1].until = until;
        waiting_[place - 1].told = place;
        return place;
    }
    waiting_.push_back({std::move(claim), until, waiting_.size() + 1});
    return waiting_.size();
}

std::size_t WaitList::placeOf(const Sender& client, const std::string& request_id) const {
    for (std::size_t i = 0; i < waiting_.size(); ++i)
        if (waiting_[i].claim.client.id == client.id && waiting_[i].claim.request_id == request_id)
            return i + 1;
    return 0;
}

Claim WaitList::pop() {
    auto claim = std::move(waiting_.front().claim);
    waiting_.pop_front();
    return claim;
}

template <class Leaves>
std::vector<Claim> WaitList::remove(Leaves leaves) {
    std::vector<Claim> removed;
    for (const auto& place : waiting_)
        if (leaves(place)) removed.push_back(place.claim);
    std::erase_if(waiting_, leaves);
    return removed;
}

std::optional<Claim> WaitList::leave(const Sender& client, const std::string& request_id) {
    auto removed = remove([&](const Place& place) {
        return place.claim.client.id == client.id && place.claim.request_id == request_id;
    });
    if (removed.empty()) return std::nullopt;
    return std::move(removed.front());
}

std::vector<Claim> WaitList::forget(const std::string& client_id) {
    return remove([&](const Place& place) { return place.claim.client.id == client_id; });
}

std::vector<Claim> WaitList::clear() {
    return remove([](const Place&) { return true; });
}

std::vector<Claim> WaitList::expire(TimePoint now) {
    return remove([now](const Place& place) { return now >= place.until; });
}

std::optional<TimePoint> WaitList::nextExpiry() const {
    std::optional<TimePoint> next;
    for (const auto& place : waiting_) next = next ? std::min(*next, place.until) : place.until;
    return next;
}

std::vector<std::pair<Claim, std::size_t>> WaitList::takeChanges() {
    std::vector<std::pair<Claim, std::size_t>> changes;
    for (std::size_t i = 0; i < waiting_.size(); ++i) {
        if (waiting_[i].told == i + 1) continue;
        waiting_[i].told = i + 1;
        changes.emplace_back(waiting_[i].claim, i + 1);
    }
    return changes;
}

}  // namespace axon::entity_manager
