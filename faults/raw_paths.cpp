// SPDX-License-Identifier: GPL-2.0-or-later
#include "raw_paths.hpp"

#include <axon/messages.pb.h>

#include <algorithm>
#include <utility>
#include <vector>

#include "direct/always_relayed.hpp"

namespace axon::faults {

namespace {

using namespace std::chrono_literals;
using client::DirectLink;
using client::DirectLinks;
using client::DirectPath;
using direct::Keeping;

constexpr std::size_t kPathsMax = 64;
constexpr Duration kOpening = 2s;
constexpr Duration kLongestSleep = 50ms;

}  // namespace

RawPaths::RawPaths(const client::LaneHome& signal, Relay relay, Hear hear)
    : signal_(signal),
      relay_(std::move(relay)),
      hear_(std::move(hear)),
      links_(clock_, kPathsMax, [this](const client::DirectOffer& offer) {
          return std::make_shared<client::NetworkPath>(readers_, signal_, offer, Id128::random(random_),
                                                       backlog_, clock_, weak_from_this());
      }) {}

RawPaths::~RawPaths() {
    close();
}

void RawPaths::start(const std::string& client) {
    client_ = client;
    thread_ = std::thread([this] { run(); });
}

void RawPaths::close() {
    {
        const std::lock_guard lock(wake_mutex_);
        closing_ = true;
    }
    woken_.notify_all();
    if (thread_.joinable()) thread_.join();
    sessionLost();
    readers_->end();
}

void RawPaths::close(const DirectLinks::Closing& closing, const char* why) {
    for (const auto& path : closing) path->close(why);
    directChanged();
}

void RawPaths::offer(const std::string& entity, LeaseNumber lease, const std::string& key,
                     const std::string& data_endpoint, const std::string& signal_endpoint) {
    {
        const std::lock_guard lock(mutex_);
        links_.offer({entity, lease, key, client_, data_endpoint, signal_endpoint});
    }
    directChanged();
}
void RawPaths::withdraw(const std::string& entity, LeaseNumber lease) {
    {
        const std::lock_guard lock(mutex_);
        links_.withdraw({entity, lease});
    }
    directChanged();
}
void RawPaths::left(const std::string& entity) {
    DirectLinks::Closing closing;
    {
        const std::lock_guard lock(mutex_);
        closing = links_.leave(entity);
    }
    close(closing, "the entity has left");
}
void RawPaths::sessionLost() {
    DirectLinks::Closing closing;
    {
        const std::lock_guard lock(mutex_);
        closing = links_.clear();
    }
    close(closing, "the session has ended");
}
void RawPaths::markRefused(const std::string& entity) {
    DirectLinks::Closing closing;
    {
        const std::lock_guard lock(mutex_);
        closing = links_.markRefused(entity);
    }
    close(closing, "the servers have refused its mark");
}

void RawPaths::send(Header head, const std::string& bytes) {
    const std::lock_guard lock(mutex_);
    head.sequence = ++sequence_;
    fallBackFromEnded();
    const auto link = links_.linkOf(head.entity);
    // What is kept under an earlier lease goes before whatever belongs to this one.
    if (const auto before = by_path_.find(head.entity); before != by_path_.end() && before->second != link) {
        before->second->by->close("another lease takes its place");
        fallBack(before->second);
    }
    if (link && link->out.direct() && head.msg_type == kMsgRelease) {
        link->by->close("the entity is released");
        fallBack(link);
    }
    if (link && link->out.direct() && !direct::alwaysRelayed(head.msg_type) && sendByPath(*link, head, bytes))
        return;
    relay_(head, bytes);
}

bool RawPaths::sendByPath(DirectLink& link, const Header& head, const std::string& bytes) {
    link.out.acknowledged(link.by->acknowledged);
    if (!link.out.hasRoom(bytes.size())) {
        link.by->close("the Entity Manager acknowledges too little");
        fallBack(by_path_.at(head.entity));
        return false;
    }
    const auto message = std::make_shared<const std::string>(bytes);
    link.by->send(Keeping::Kept, head, message);
    link.out.keep(head.sequence, bytes.size(), {head, message});
    if (link.by->enliven()) directChanged();
    ++sent_;
    return true;
}

/// The path is over: what the Entity Manager may not have goes by the servers.
void RawPaths::fallBack(const std::shared_ptr<DirectLink>& link) {
    const auto its = link;  // which may be the one that is erased
    std::erase_if(by_path_, [&](const auto& one) { return one.second == its; });
    its->out.acknowledged(its->by->acknowledged);
    its->by = nullptr;
    for (const auto& kept : its->out.end())
        if (!its->forget) relay_(kept.message.head, *kept.message.message);
}

void RawPaths::fallBackFromEnded() {
    std::vector<std::shared_ptr<DirectLink>> ended;
    for (const auto& [entity, link] : by_path_)
        if (link->by->ended()) ended.push_back(link);
    for (const auto& link : ended) fallBack(link);
}

void RawPaths::signal(const std::string& entity, const std::function<void(const DirectPath&)>& order) const {
    const auto paths = links_.paths();
    if (!paths) return;
    for (const auto& [its, path] : *paths)
        if (entity.empty() || entity == its) order(*path);
}

void RawPaths::relayed(Header head, std::string_view bytes) {
    const std::lock_guard ordered(order_);
    std::vector<std::pair<Header, std::string>> held;
    bool pass = false;
    {
        const std::lock_guard lock(mutex_);
        pass = links_.relayed(Keeping::Kept, head, bytes, [&](const Header& its, std::string_view message) {
            held.emplace_back(its, message);
        });
    }
    for (const auto& [its, message] : held) hear_(its, message);
    if (pass) hear_(head, bytes);
}

void RawPaths::newDirectMsg(const DirectPath& path, Keeping keeping, Header head, std::string_view bytes) {
    const std::lock_guard ordered(order_);
    DirectLinks::Arrival arrival;
    {
        const std::lock_guard lock(mutex_);
        arrival = links_.arrived(path, keeping, head, bytes);
    }
    if (arrival.close) arrival.close->close(arrival.why);
    if (arrival.acknowledge) path.beat();
    if (arrival.pass) hear_(head, bytes);
}

void RawPaths::newDirectReceipt(const DirectPath& /*path*/, const Header& head, std::string_view bytes) {
    hear_(head, bytes);
}

void RawPaths::directChanged() {
    {
        const std::lock_guard lock(wake_mutex_);
        changed_ = true;
    }
    woken_.notify_all();
}

bool RawPaths::awaitOpen(const std::string& entity, std::chrono::milliseconds time) {
    const auto end = std::chrono::steady_clock::now() + time;
    for (;;) {
        {
            const std::lock_guard lock(mutex_);
            if (by_path_.contains(entity)) return true;
        }
        if (std::chrono::steady_clock::now() >= end) return false;
        std::this_thread::sleep_for(500us);
    }
}

void RawPaths::run() {
    std::unique_lock lock(wake_mutex_);
    while (!closing_) {
        changed_ = false;
        lock.unlock();
        auto next = std::min(turn(), clock_.now() + kLongestSleep);
        const auto paths = links_.paths();
        for (const auto& [entity, path] : *paths) next = std::min(next, path->beatIfDue(false, true).first);
        lock.lock();
        woken_.wait_for(lock, std::max(next - clock_.now(), Duration{}),
                        [this] { return changed_ || closing_; });
    }
}

TimePoint RawPaths::turn() {
    DirectLinks::Turn turn;
    {
        const std::lock_guard lock(mutex_);
        turn = links_.turn();
        fallBackFromEnded();
        for (const auto& [link, path] : turn.begun) {
            // The mark: the last that goes by the servers until the path is over.
            proto::ToEntity mark;
            mark.mutable_way()->set_path(path->number().bytes());
            Header head;
            head.entity = path->entity();
            head.msg_type = kMsgWay;
            head.sequence = ++sequence_;
            relay_(head, mark.SerializeAsString());
            link->by = path;
            link->out.begin();
            by_path_[path->entity()] = link;
        }
    }
    for (const auto& begun : turn.begun) begun.second->beat();
    for (const auto& path : turn.open) path->open(kOpening);
    for (const auto& [path, why] : turn.close) path->close(why);
    return turn.close.empty() ? turn.next : clock_.now();
}

}  // namespace axon::faults
