// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/timer_thread.hpp"

#include <pthread.h>
#include <sched.h>

#include "common/waiting.hpp"
#include "transport/ice/communicator.hpp"

namespace axon::transport {

TimerThread::TimerThread(std::string name, Lane lane, Duration pause, const Clock& clock,
                         std::function<TimePoint()> tick)
    : name_(std::move(name)),
      lane_(lane),
      pause_(pause),
      clock_(clock),
      tick_(std::move(tick)),
      thread_([this] { run(); }) {}

TimerThread::~TimerThread() {
    end();
}

void TimerThread::end() {
    {
        const std::lock_guard lock(mutex_);
        stopping_ = true;
    }
    changed_.notify_one();
    if (thread_.joinable()) thread_.join();
}

void TimerThread::wake() {
    {
        const std::lock_guard lock(mutex_);
        woken_ = true;
    }
    changed_.notify_one();
}

void TimerThread::run() {
    pthread_setname_np(pthread_self(), name_.c_str());
    if (lane_ == Lane::Signal) {
        sched_param parameters{};
        parameters.sched_priority = kStopPriority;
        // Refused where not permitted; the signal lane's communicator says so for both. What it starts, such
        // as the readers of direct paths, is ordinary.
        ::sched_setscheduler(0, SCHED_RR | SCHED_RESET_ON_FORK, &parameters);
    }
    while (true) {
        const auto due = tick_();
        std::unique_lock lock(mutex_);
        // The pause spares the processor, so it is one of the machine's time, whatever the clock counts.
        if (pause_ > Duration{}) changed_.wait_for(lock, pause_, [this] { return stopping_; });
        waitUntil(changed_, lock, clock_, due, [this] { return woken_ || stopping_; });
        if (stopping_) return;
        woken_ = false;
    }
}

}  // namespace axon::transport
