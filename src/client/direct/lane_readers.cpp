// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/direct/lane_readers.hpp"

#include <pthread.h>

#include <algorithm>
#include <cerrno>
#include <limits>
#include <system_error>
#include <utility>
#include <vector>

namespace axon::client {
namespace {

using direct::lane::Spinner;

constexpr std::uint32_t kAnyLane = EPOLLIN | EPOLLET;
constexpr std::uint32_t kWatched = EPOLLIN | EPOLLOUT | EPOLLRDHUP | EPOLLET;
// Numbers of what is no lane.
constexpr std::uint64_t kWake = 0;
constexpr std::uint64_t kLanes = std::numeric_limits<std::uint64_t>::max();

bool watch(int set, int operation, int descriptor, std::uint32_t events, std::uint64_t number) {
    epoll_event event{};
    event.events = events;
    event.data.u64 = number;
    return ::epoll_ctl(set, operation, descriptor, &event) == 0;
}

bool has(TimePoint deadline) {
    return deadline != TimePoint::max();
}

}  // namespace

LaneReaders::~LaneReaders() {
    end();
}

/// Under mutex_.
bool LaneReaders::start() {
    if (epoll_.open()) return true;
    Descriptor set(::epoll_create1(EPOLL_CLOEXEC));
    wake_.emplace();
    if (!set.open() || !wake_->open()) return false;
    Descriptor sleepers;
    if (Spinner(spin_).spins()) {
        sleepers = Descriptor(::epoll_create1(EPOLL_CLOEXEC));
        // Without it they sleep in the first one, and do not spin.
        if (sleepers.open() && !watch(sleepers.get(), EPOLL_CTL_ADD, set.get(), kAnyLane, kLanes))
            sleepers = Descriptor();
    }
    if (!watch((sleepers.open() ? sleepers : set).get(), EPOLL_CTL_ADD, wake_->fd(), EPOLLIN, kWake))
        return false;
    epoll_ = std::move(set);
    sleepers_ = std::move(sleepers);
    try {
        for (auto& thread : threads_) thread = std::thread([this] { run(); });
    } catch (const std::system_error&) {
        // One is not enough, since a callback may block it. Without lanes a thread takes no lock.
        over_ = true;
        wake_->wake();
        if (threads_.front().joinable()) threads_.front().join();
        return false;
    }
    return true;
}

bool LaneReaders::add(std::uint64_t number, std::shared_ptr<Lane> lane, TimePoint deadline) {
    const std::lock_guard lock(mutex_);
    if (over_ || !start()) return false;
    const int descriptor = lane->descriptor();
    lanes_.emplace(number, Entry{std::move(lane), deadline});
    if (!watch(epoll_.get(), EPOLL_CTL_ADD, descriptor, kWatched, number)) {
        lanes_.erase(number);
        return false;
    }
    if (has(deadline)) {
        ++deadlines_;
        wake_->wake();
    }
    return true;
}

void LaneReaders::due(std::uint64_t number, TimePoint deadline) {
    const std::lock_guard lock(mutex_);
    const auto found = lanes_.find(number);
    if (found == lanes_.end()) return;
    if (has(found->second.deadline)) --deadlines_;
    found->second.deadline = deadline;
    if (!has(deadline)) return;
    ++deadlines_;
    wake_->wake();
}

void LaneReaders::again(std::uint64_t number) {
    const std::lock_guard lock(mutex_);
    if (const auto found = lanes_.find(number); found != lanes_.end())
        watch(epoll_.get(), EPOLL_CTL_MOD, found->second.lane->descriptor(), kWatched, number);
}

void LaneReaders::remove(std::uint64_t number) {
    std::shared_ptr<Lane> last;  // perhaps; let go of without the lock
    const std::lock_guard lock(mutex_);
    const auto found = lanes_.find(number);
    if (found == lanes_.end()) return;
    if (has(found->second.deadline)) --deadlines_;
    ::epoll_ctl(epoll_.get(), EPOLL_CTL_DEL, found->second.lane->descriptor(), nullptr);
    last = std::move(found->second.lane);
    lanes_.erase(found);
}

void LaneReaders::end() {
    std::map<std::uint64_t, Entry> left;
    std::array<std::thread, 2> threads;
    {
        const std::lock_guard lock(mutex_);
        over_ = true;
        left = std::exchange(lanes_, {});
        threads = std::exchange(threads_, {});
        if (wake_) wake_->wake();
    }
    for (auto& thread : threads)
        if (thread.joinable()) thread.join();
}

std::shared_ptr<LaneReaders::Lane> LaneReaders::laneOf(std::uint64_t number) const {
    const std::lock_guard lock(mutex_);
    const auto found = lanes_.find(number);
    return found == lanes_.end() ? nullptr : found->second.lane;
}

/// For epoll_wait: until the next deadline.
int LaneReaders::timeout() {
    if (deadlines_ == 0) return -1;
    auto next = TimePoint::max();
    {
        const std::lock_guard lock(mutex_);
        for (const auto& [number, entry] : lanes_) next = std::min(next, entry.deadline);
    }
    if (!has(next)) return -1;
    const auto time = std::max(clock_.realTimeUntil(next), Duration{});
    return static_cast<int>(std::chrono::duration_cast<std::chrono::milliseconds>(time).count()) + 1;
}

void LaneReaders::tellOverdue() {
    if (deadlines_ == 0) return;
    std::vector<std::shared_ptr<Lane>> overdue;
    {
        const std::lock_guard lock(mutex_);
        const auto now = clock_.now();
        for (auto& [number, entry] : lanes_) {
            if (now < entry.deadline) continue;
            entry.deadline = TimePoint::max();
            --deadlines_;
            overdue.push_back(entry.lane);
        }
    }
    for (const auto& lane : overdue) lane->overdue();
}

/// While this thread looks at the lanes itself, the other one is not to be woken for them. When that ends,
/// the kernel looks whether there is something left.
void LaneReaders::wakeSleepers(bool whether) const {
    watch(sleepers_.get(), EPOLL_CTL_MOD, epoll_.get(), whether ? kAnyLane : 0, kLanes);
}

/// Of a lane, after sleep. The edge of the set has been told to this thread alone, so a second lane that is
/// ready is put back, which makes another edge.
int LaneReaders::takeOne(epoll_event& event) {
    std::array<epoll_event, 2> ready{};
    const int count = ::epoll_wait(epoll_.get(), ready.data(), static_cast<int>(ready.size()), 0);
    if (count == 2) {
        again(ready[1].data.u64);
        wakeSleepers(true);  // it may be gone or read by now, and a third one ready
    }
    event = ready[0];
    return std::min(count, 1);
}

/// One at a time: what else is ready is the other thread's while this one is inside a callback. As
/// epoll_wait.
int LaneReaders::await(Spinner& spinner, epoll_event& event) {
    if (!sleepers_.open()) return ::epoll_wait(epoll_.get(), &event, 1, timeout());
    int count = 0;
    const bool found =
        spinner.spin([this] { wakeSleepers(false); },
                     [&] { return (count = ::epoll_wait(epoll_.get(), &event, 1, 0)) != 0 || over_; },
                     [this] { wakeSleepers(true); });
    if (found) return count;
    count = ::epoll_wait(sleepers_.get(), &event, 1, timeout());
    spinner.came();
    return count > 0 && event.data.u64 == kLanes ? takeOne(event) : count;
}

void LaneReaders::run() {
    ::pthread_setname_np(::pthread_self(), "axon-direct");
    Spinner spinner(spin_);
    while (!over_) {
        epoll_event event{};
        const int count = await(spinner, event);
        if (over_) break;
        if (count > 0 && event.data.u64 == kWake) {
            wake_->drain();
        } else if (count > 0) {
            // While this thread is inside a callback, the other one keeps the deadlines.
            if (deadlines_ != 0) wake_->wake();
            if (const auto lane = laneOf(event.data.u64))
                lane->ready({(event.events & (EPOLLIN | EPOLLRDHUP | EPOLLHUP | EPOLLERR)) != 0,
                             (event.events & EPOLLOUT) != 0,
                             (event.events & (EPOLLRDHUP | EPOLLHUP | EPOLLERR)) != 0});
        } else if (count < 0 && errno != EINTR) {
            break;  // the set is no set: a bug, which is not to be repeated for ever
        }
        tellOverdue();
    }
    wake_->wake();  // the sign that ended this thread may have been the only one
}

}  // namespace axon::client
