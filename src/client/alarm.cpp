// SPDX-License-Identifier: GPL-2.0-or-later
#include "client/alarm.hpp"

#include <utility>

namespace axon::client {

void Alarm::start(const char* name, Lane lane, const Clock& clock, std::function<TimePoint()> tick) {
    const std::lock_guard lock(mutex_);
    thread_ = std::make_unique<transport::TimerThread>(name, lane, Duration{}, clock, std::move(tick));
}

void Alarm::wake() {
    const std::lock_guard lock(mutex_);
    if (thread_) thread_->wake();
}

void Alarm::end() {
    std::unique_ptr<transport::TimerThread> ended;
    {
        const std::lock_guard lock(mutex_);
        ended = std::move(thread_);
    }
}

}  // namespace axon::client
