// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/direct/direct_links.hpp"

#include <axon/messages.pb.h>

#include <algorithm>
#include <utility>

#include "direct/always_relayed.hpp"

namespace axon::client {

namespace {

using direct::Verdict;

constexpr std::size_t kHeadBytes = 200;  // that a message costs here besides its own
}  // namespace

void DirectLinks::offer(const DirectOffer& offer) {
    auto& entry = entries_[offer.entity];
    if (entry.epoch != offer.lease.epoch) {
        entry.in = direct::IncomingWay<Came>();
        entry.epoch = offer.lease.epoch;
    }
    const bool same = entry.link && !entry.withdrawn && entry.offer.lease == offer.lease &&
                      entry.offer.client == offer.client && entry.offer.data_endpoint == offer.data_endpoint;
    if (same) return;
    // A path of the lease before ends in the next turn.
    entry.close_at = entry.path ? clock_.now() : TimePoint::max();
    entry.offer = offer;
    entry.withdrawn = false;
    replaceLink(entry, std::make_shared<DirectLink>());
    entry.try_at = clock_.now();
    entry.retry = {};
}

bool DirectLinks::withdraw(const Held& held) {
    const auto found = entries_.find(held.entity);
    if (found == entries_.end() || !found->second.link || found->second.offer.lease != held.lease)
        return false;
    auto& entry = found->second;
    entry.withdrawn = true;
    entry.try_at = TimePoint::max();
    entry.close_at = clock_.now();
    if (!entry.path) replaceLink(entry, nullptr);
    return true;
}

void DirectLinks::replaceLink(Entry& entry, std::shared_ptr<DirectLink> next) {
    std::erase_if(entry.former, [](const auto& link) { return link.expired(); });
    if (entry.link) entry.former.push_back(entry.link);
    entry.link = std::move(next);
}

void DirectLinks::forget(Entry& entry) {
    replaceLink(entry, nullptr);
    for (const auto& former : entry.former)
        if (const auto link = former.lock()) link->forget = true;
}

DirectLinks::Closing DirectLinks::leave(const std::string& entity) {
    const auto found = entries_.find(entity);
    if (found == entries_.end()) return {};
    Closing closing;
    if (found->second.path) closing.push_back(found->second.path);
    forget(found->second);
    entries_.erase(found);
    tellPaths();
    return closing;
}

DirectLinks::Closing DirectLinks::clear() {
    Closing closing;
    for (auto& [entity, entry] : entries_) {
        if (entry.path) closing.push_back(entry.path);
        forget(entry);
    }
    entries_.clear();
    tellPaths();
    return closing;
}

DirectLinks::Closing DirectLinks::markRefused(const std::string& entity) {
    const auto found = entries_.find(entity);
    if (found == entries_.end() || !found->second.path) return {};
    return {found->second.path};
}

void DirectLinks::stop(const Paths& paths, const Header& head, const std::vector<std::string>& entities,
                       StopCause cause) {
    const auto one = [&](const std::string& entity) {
        if (const auto path = paths.find(entity); path != paths.end())
            path->second->sendStopSignal(head, cause);
    };
    if (!entities.empty()) {
        for (const auto& entity : entities) one(entity);
    } else if (!head.entity.empty()) {
        one(head.entity);
    } else {
        for (const auto& [entity, path] : paths) path->sendStopSignal(head, cause);
    }
}

std::shared_ptr<DirectLink> DirectLinks::linkOf(const std::string& entity) const {
    if (entries_.empty()) return nullptr;
    const auto found = entries_.find(entity);
    return found == entries_.end() ? nullptr : found->second.link;
}

bool DirectLinks::direct(const std::string& entity) const {
    const auto found = entries_.find(entity);
    return found != entries_.end() && found->second.begun && found->second.path->isOpen();
}

void DirectLinks::tellPaths() {
    auto paths = std::make_shared<Paths>();
    for (const auto& [entity, entry] : entries_)
        if (entry.begun) paths->emplace(entity, entry.path);
    paths_.store(std::move(paths));
}

/// For the next beat.
void DirectLinks::told(Entry& entry) const {
    if (entry.path) entry.path->passed.store(entry.in.passed(), std::memory_order_release);
}

bool DirectLinks::relayed(direct::Keeping keeping, const Header& head, std::string_view message,
                          const Deliver& deliver) {
    if (entries_.empty() || direct::alwaysRelayed(head.msg_type)) return true;
    const auto found = entries_.find(head.entity);
    if (found == entries_.end()) return true;
    auto& entry = found->second;
    bool pass = false;
    if (head.msg_type == kMsgWay) {
        proto::ToClient mark;
        const auto path = mark.ParseFromArray(message.data(), static_cast<int>(message.size()))
                              ? Id128::fromBytes(mark.way().path())
                              : std::nullopt;
        if (path) entry.in.mark(*path, [&](const Came& came) { deliver(came.head, came.bytes); });
        entry.mark_due = TimePoint::max();
    } else {
        pass = entry.in.relayed(keeping, head.sequence) == Verdict::Pass;
    }
    told(entry);
    return pass;
}

DirectLinks::Arrival DirectLinks::arrived(const DirectPath& path, direct::Keeping keeping, Header& head,
                                          std::string_view message) {
    const auto found = entries_.find(path.entity());
    if (found == entries_.end() || found->second.path.get() != &path)
        return {};  // what counts of it comes by the servers
    auto& entry = found->second;
    if (direct::alwaysRelayed(head.msg_type))
        return {false, false, entry.path, "what goes by the servers came by it"};
    const auto size = message.size() + kHeadBytes;
    const auto sequence = head.sequence;
    Came came;
    if (entry.in.waits()) came = {head, std::string(message)};
    switch (entry.in.direct(path.number(), keeping, sequence, size, came)) {
        case Verdict::Pass:
            told(entry);
            return {true, keeping == direct::Keeping::Kept && entry.unacknowledged.add(size), nullptr, ""};
        case Verdict::HeldBack:
            if (entry.mark_due == TimePoint::max()) entry.mark_due = clock_.now() + direct::kMarkWithin;
            return {};
        case Verdict::Overflow:
            return {false, false, entry.path, "too much came before its beginning by the servers"};
        case Verdict::LeftOut:
            break;
    }
    return {};
}

DirectLinks::Turn DirectLinks::turn() {
    Turn turn;
    const auto now = clock_.now();
    bool changed = false;
    const auto later = [&turn](TimePoint at) { turn.next = std::min(turn.next, at); };
    auto paths =
        static_cast<std::size_t>(std::count_if(entries_.begin(), entries_.end(), [](const auto& one) {
            return one.second.path && !one.second.path->ended();
        }));
    for (auto& [entity, entry] : entries_) {
        if (entry.path && entry.path->ended()) {
            const auto stood = entry.begun ? now - entry.begun_at : Duration{};
            const auto again = entry.retry.after(stood);
            turn.news.push_back({entry.begun, (entry.begun ? "the direct path to " + entity + " has ended: "
                                                           : "no direct path to " + entity + ": ") +
                                                  entry.path->reason() + "; everything goes by the server"});
            turn.ended = turn.ended || entry.begun;
            entry.in.close(entry.path->number());
            entry.path = nullptr;
            changed = changed || entry.begun;
            entry.begun = false;
            entry.mark_due = TimePoint::max();
            if (entry.close_at <= now) {
                entry.close_at = TimePoint::max();  // that of the lease before
            } else if (!entry.withdrawn) {
                entry.try_at = now + again;
            }
            if (entry.withdrawn) replaceLink(entry, nullptr);
        }
        if (entry.path && entry.path->isOpen() && !entry.begun) {
            entry.begun = changed = true;
            entry.begun_at = now;
            turn.begun.emplace_back(entry.link, entry.path);
            turn.news.push_back({true, "direct path to " + entity});
        }
        if (entry.path) {
            if (now >= entry.mark_due && !entry.in.holdsBack()) entry.mark_due = TimePoint::max();
            if (now >= entry.close_at) {
                turn.close.emplace_back(entry.path, "its lease has ended");
            } else if (now >= entry.mark_due) {
                turn.close.emplace_back(entry.path, "the servers have not brought its beginning in time");
            } else if (entry.begun && now >= entry.path->liveness.deadline()) {
                turn.close.emplace_back(entry.path, "nothing was heard of the Entity Manager");
            } else {
                later(entry.close_at);
                later(entry.mark_due);
                if (entry.begun) later(entry.path->liveness.deadline());
            }
            continue;
        }
        if (!entry.link || entry.withdrawn) continue;
        if (now < entry.try_at) {
            later(entry.try_at);
            continue;
        }
        if (paths >= most_) {
            entry.try_at = now + direct::Retry::kLast;
            later(entry.try_at);
            continue;
        }
        ++paths;
        entry.try_at = TimePoint::max();
        entry.path = make_(entry.offer);
        entry.path->passed = entry.in.passed();
        entry.in.open(entry.path->number());
        turn.open.push_back(entry.path);
    }
    if (changed) tellPaths();
    return turn;
}

}  // namespace axon::client
