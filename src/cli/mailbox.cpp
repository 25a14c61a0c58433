// SPDX-License-Identifier: GPL-2.0-or-later
#include <algorithm>

#include "cli/session.hpp"

namespace axon::cli {

void Mailbox::post(Json event, bool droppable) {
    {
        const std::lock_guard lock(mutex_);
        if (letters_.size() >= kLimit) {
            const auto oldest = std::find_if(letters_.begin(), letters_.end(),
                                             [](const Letter& letter) { return letter.droppable; });
            if (oldest != letters_.end()) {
                letters_.erase(oldest);
                ++dropped_;
            } else if (droppable) {
                ++dropped_;
                return;
            }
        }
        letters_.push_back({std::move(event), droppable});
    }
    changed_.notify_all();
}

void Mailbox::interrupt() {
    {
        const std::lock_guard lock(mutex_);
        ++interrupts_;
    }
    changed_.notify_all();
}

std::optional<Json> Mailbox::wait(std::optional<std::chrono::steady_clock::time_point> deadline) {
    std::unique_lock lock(mutex_);
    const auto ready = [this] { return !letters_.empty() || interrupts_ != interrupts_taken_; };
    if (deadline) {
        changed_.wait_until(lock, *deadline, ready);
    } else {
        changed_.wait(lock, ready);
    }
    // An interrupt goes before what has piled up: who presses Ctrl-C does not want to read a thousand samples
    // first.
    if (letters_.empty() || interrupts_ != interrupts_taken_) return std::nullopt;
    auto event = std::move(letters_.front().event);
    letters_.pop_front();
    return event;
}

bool Mailbox::takeInterrupt() {
    const std::lock_guard lock(mutex_);
    // One by one: two that come at once mean more than one.
    const bool any = interrupts_ != interrupts_taken_;
    if (any) ++interrupts_taken_;
    return any;
}

std::size_t Mailbox::takeDropped() {
    const std::lock_guard lock(mutex_);
    return std::exchange(dropped_, 0);
}

}  // namespace axon::cli
