// SPDX-License-Identifier: MIT
#include "bounded_job.hpp"

#include <pthread.h>
#include <signal.h>

#include <atomic>
#include <condition_variable>
#include <exception>
#include <mutex>
#include <thread>
#include <utility>

namespace axon::python {

struct BoundedJob::Run {
    explicit Run(Job of_caller) : job(std::move(of_caller)) {}
    const Job job;
    std::atomic<bool> abandoned{false};
    std::exception_ptr failed;  // constant once done
    bool done = false;          // guarded by the mutex of the state
};

struct BoundedJob::State {
    std::mutex mutex;  // never held while a job runs
    std::condition_variable changed;
    std::shared_ptr<Run> current;  // guarded by mutex; none = no job runs
    bool ending = false;           // guarded by mutex
};

BoundedJob::BoundedJob() : state_(std::make_shared<State>()) {
    sigset_t all, former;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &former);  // signals are for the threads of the program
    std::thread thread([state = state_] { serve(*state); });
    pthread_sigmask(SIG_SETMASK, &former, nullptr);
    pthread_setname_np(thread.native_handle(), "axon-py-write");
    thread.detach();
}

BoundedJob::~BoundedJob() {
    {
        const std::lock_guard lock(state_->mutex);
        state_->ending = true;
    }
    state_->changed.notify_all();
}

BoundedJob::Outcome BoundedJob::run(Job job, Clock::time_point until,
                                    const std::function<bool()>& interrupted) {
    std::unique_lock lock(state_->mutex);
    bool in_time = true;
    const auto wait = [&] { in_time = state_->changed.wait_until(lock, until) != std::cv_status::timeout; };
    while (state_->current && in_time && !interrupted()) wait();
    if (interrupted()) return Outcome::Interrupted;
    if (state_->current) return Outcome::Late;
    const auto run = std::make_shared<Run>(std::move(job));
    state_->current = run;
    state_->changed.notify_all();
    in_time = true;
    while (!run->done && in_time && !interrupted()) wait();
    if (!run->done) {
        run->abandoned = true;
        return in_time ? Outcome::Interrupted : Outcome::Late;
    }
    if (run->failed) std::rethrow_exception(run->failed);
    return Outcome::Done;
}

void BoundedJob::interrupt() {
    { const std::lock_guard lock(state_->mutex); }
    state_->changed.notify_all();
}

void BoundedJob::serve(State& state) {
    std::unique_lock lock(state.mutex);
    while (true) {
        state.changed.wait(lock, [&] { return state.current || state.ending; });
        if (!state.current) return;
        const auto run = state.current;
        lock.unlock();
        try {
            run->job([&] { return run->abandoned.load(); });
        } catch (...) {
            run->failed = std::current_exception();
        }
        lock.lock();
        run->done = true;
        state.current.reset();
        state.changed.notify_all();
    }
}

}  // namespace axon::python
