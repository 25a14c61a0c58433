// SPDX-License-Identifier: MIT
#include "testing/entity/step_clock.hpp"

#include <algorithm>
#include <utility>
#include <vector>

#include "testing/entity/axon/testing/manual_clock.hpp"

namespace axon::testing {

namespace {
using namespace std::chrono_literals;
constexpr Duration kLook = 250us;     // how often a waiting thread looks at the time
constexpr Duration kBegin = 5ms;      // for threads that have just begun, to be known before time passes
constexpr Duration kFollows = 100ms;  // what a thread gets to go on, or else it has ended
}  // namespace

TimePoint StepClock::now() const {
    const std::lock_guard lock(mutex_);
    return now_;
}

std::size_t StepClock::waiting() const {
    const std::lock_guard lock(mutex_);
    return static_cast<std::size_t>(
        std::count_if(threads_.begin(), threads_.end(), [](const auto& one) { return one.second.waits; }));
}

Duration StepClock::realTimeUntil(TimePoint deadline) const {
    const std::lock_guard lock(mutex_);
    const bool waits = deadline > now_;
    // A thread that asks for the first time after its deadline has not waited.
    const auto known = threads_.find(std::this_thread::get_id());
    if (known != threads_.end())
        known->second = {deadline, waits};
    else if (waits)
        threads_.emplace(std::this_thread::get_id(), Thread{deadline, waits});
    asked_.notify_all();
    return waits ? std::min<Duration>(deadline - now_, kLook) : deadline - now_;
}

TimePoint StepClock::next(TimePoint limit) const {
    for (const auto& [id, thread] : threads_)
        if (thread.waits && thread.deadline > now_) limit = std::min(limit, thread.deadline);
    return limit;
}

void StepClock::moveTo(TimePoint time) {
    std::unique_lock lock(mutex_);
    now_ = time;
    const auto behind = [&](const Thread& thread) { return !thread.waits || thread.deadline <= now_; };
    asked_.wait_for(lock, kFollows, [&] {
        return std::none_of(threads_.begin(), threads_.end(),
                            [&](const auto& one) { return behind(one.second); });
    });
    std::erase_if(threads_, [&](const auto& one) { return behind(one.second); });
}

void StepClock::advance(Duration time) {
    auto end = now();
    if (time > Duration::zero()) {
        end += time;
        std::this_thread::sleep_for(kBegin);
    }
    while (now() < end) {
        follow();
        TimePoint to;
        {
            const std::lock_guard lock(mutex_);
            to = next(end);
        }
        moveTo(to);
    }
}

void StepClock::step(Duration at_most) {
    follow();
    std::unique_lock lock(mutex_);
    asked_.wait_for(lock, kLook);
    const auto to = next(now_ + at_most);
    lock.unlock();
    moveTo(to);
}

std::shared_ptr<void> StepClock::follow(Follower follower) {
    auto token = std::make_shared<Follower>(std::move(follower));
    const std::lock_guard lock(mutex_);
    followers_.emplace(token.get(), token);
    return token;
}

void StepClock::follow() {
    std::vector<std::shared_ptr<Follower>> all;
    {
        const std::lock_guard lock(mutex_);
        std::erase_if(followers_, [](const auto& one) { return one.second.expired(); });
        for (const auto& [id, follower] : followers_)
            if (auto one = follower.lock()) all.push_back(std::move(one));
    }
    for (const auto& one : all) (*one)();
}

ManualClock::ManualClock() : clock_(std::make_shared<StepClock>()) {}
void ManualClock::advance(std::chrono::nanoseconds time) {
    clock_->advance(time);
}
std::chrono::nanoseconds ManualClock::elapsed() const {
    return clock_->elapsed();
}
std::shared_ptr<const Clock> ManualClock::shared() const {
    return clock_;
}

}  // namespace axon::testing
