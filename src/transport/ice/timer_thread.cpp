// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/timer_thread.hpp"

#include <pthread.h>
#include <sched.h>

#include <algorithm>

#include "common/waiting.hpp"
#include "transport/ice/communicator.hpp"

namespace axon::transport {
namespace {

/// Another clock, for which nobody waits longer than until `turn` of real time.
class Bounded final : public Clock {
  public:
    Bounded(const Clock& clock, TimePoint turn) : clock_(clock), turn_(turn) {}
    TimePoint now() const override { return clock_.now(); }
    Duration realTimeUntil(TimePoint deadline) const override {
        return std::min<Duration>(clock_.realTimeUntil(deadline), turn_ - SteadyClock{}.now());
    }

  private:
    const Clock& clock_;
    const TimePoint turn_;
};

}  // namespace

TimerThread::TimerThread(std::string name, Lane lane, Duration pause, const Clock& clock,
                         std::function<TimePoint()> tick, std::function<Duration()> turned)
    : name_(std::move(name)),
      lane_(lane),
      pause_(pause),
      clock_(clock),
      tick_(std::move(tick)),
      turned_(std::move(turned)),
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
        const Bounded clock(clock_, turned_ ? SteadyClock{}.now() + turned_() : TimePoint::max());
        std::unique_lock lock(mutex_);
        // The pause spares the processor, so it is one of the machine's time, whatever the clock counts.
        if (pause_ > Duration{}) changed_.wait_for(lock, pause_, [this] { return stopping_; });
        waitUntil(changed_, lock, clock, due, [this] { return woken_ || stopping_; });
        if (stopping_) return;
        woken_ = false;
    }
}

}  // namespace axon::transport
