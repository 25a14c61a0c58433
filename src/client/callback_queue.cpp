// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/callback_queue.hpp"

#include <pthread.h>
#include <spdlog/logger.h>

#include <algorithm>
#include <exception>

#include "client/base/log.hpp"

namespace axon::client {

CallbackQueue::CallbackQueue() : thread_([this] { runOnOwnThread(); }) {}

CallbackQueue::~CallbackQueue() {
    close();
}

bool CallbackQueue::post(std::function<void()> callback, bool may_be_left_out) {
    std::function<void()> oldest;  // destroyed outside the lock: it may own what the user captured
    {
        const std::lock_guard lock(mutex_);
        if (closed_) return true;
        if (queue_.size() >= kBound && optional_ > 0) {
            const auto victim = std::find_if(queue_.begin(), queue_.end(),
                                             [](const Entry& entry) { return entry.may_be_left_out; });
            oldest = std::move(victim->callback);
            queue_.erase(victim);
            --optional_;
            ++left_out_;
        } else if (queue_.size() >= (may_be_left_out ? kBound : kMost)) {
            if (may_be_left_out) ++left_out_;
            return may_be_left_out;
        }
        queue_.push_back({std::move(callback), may_be_left_out});
        if (may_be_left_out) ++optional_;
    }
    return true;
}

void CallbackQueue::wake() {
    const std::lock_guard lock(mutex_);
    if (runner_ != std::thread::id{}) return;  // it looks again before it ends
    woken_ = true;
    changed_.notify_all();
}

void CallbackQueue::runHere() {
    std::unique_lock lock(mutex_);
    if (runner_ != std::thread::id{}) return;
    run(lock, kRunHere);
}

bool CallbackQueue::isThisThread() const {
    const std::lock_guard lock(mutex_);
    return runner_ == std::this_thread::get_id();
}

bool CallbackQueue::crowded() const {
    const std::lock_guard lock(mutex_);
    return queue_.size() > kRunHere;
}

std::uint64_t CallbackQueue::leftOut() const {
    const std::lock_guard lock(mutex_);
    return left_out_;
}

void CallbackQueue::close() {
    std::deque<Entry> discarded;
    {
        std::unique_lock lock(mutex_);
        closed_ = true;
        discarded.swap(queue_);
        optional_ = 0;
        changed_.notify_all();
        changed_.wait(lock, [this] { return runner_ == std::thread::id{}; });
    }
    if (thread_.joinable()) thread_.join();
}

void CallbackQueue::runOnOwnThread() {
    pthread_setname_np(pthread_self(), "axon-callbacks");
    std::unique_lock lock(mutex_);
    while (true) {
        changed_.wait(lock, [this] { return closed_ || (woken_ && runner_ == std::thread::id{}); });
        if (closed_) return;
        run(lock, kMost);
    }
}

void CallbackQueue::run(std::unique_lock<std::mutex>& lock, std::size_t most) {
    runner_ = std::this_thread::get_id();
    for (; most > 0 && !closed_ && !queue_.empty(); --most) {
        Entry entry = std::move(queue_.front());
        queue_.pop_front();
        if (entry.may_be_left_out) --optional_;
        lock.unlock();
        try {
            entry.callback();
        } catch (const std::exception& error) {
            log().warn("client: a callback of the program threw: {}", error.what());
        } catch (...) {
            log().warn("client: a callback of the program threw something that is not a std::exception");
        }
        entry.callback = nullptr;
        lock.lock();
    }
    runner_ = {};
    woken_ = !queue_.empty();
    // Under the lock: close(), which may be followed by the destructor, goes on after it.
    if (closed_ || woken_) changed_.notify_all();
}

}  // namespace axon::client
