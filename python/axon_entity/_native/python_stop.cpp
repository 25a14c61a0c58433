// SPDX-License-Identifier: MIT
#include "python_stop.hpp"

#include <pthread.h>
#include <signal.h>

#include <stdexcept>
#include <utility>

namespace axon::python {

PythonStop::PythonStop(Function function, std::chrono::nanoseconds bound)
    : function_(std::move(function)), bound_(bound) {
    sigset_t all, former;
    sigfillset(&all);
    pthread_sigmask(SIG_SETMASK, &all, &former);  // signals are for the threads of the program
    thread_ = std::thread([this] { serve(); });
    pthread_sigmask(SIG_SETMASK, &former, nullptr);
    pthread_setname_np(thread_.native_handle(), "axon-py-stop");
}

PythonStop::~PythonStop() {
    end();
}

void PythonStop::end() {
    {
        const std::lock_guard lock(mutex_);
        ending_ = true;
    }
    changed_.notify_all();
    if (thread_.joinable()) thread_.join();
}

void PythonStop::moverReturned() {
    const std::lock_guard lock(mutex_);
    ++movers_;
}

void PythonStop::call(const StopSignal& signal) {
    std::unique_lock lock(mutex_);
    const bool same =
        overdue_ && overdue_->cause == signal.cause && overdue_->generation == signal.generation;
    const bool runs = begun_ > done_ && movers_when_begun_ == movers_;
    const bool waits = asked_ > begun_;
    // An overdue call that still waits for the interpreter, or that runs for this very stop, is this call.
    if (!waits && !(same && runs)) ++asked_;
    const auto ticket = asked_;
    signal_ = signal;
    overdue_.reset();
    changed_.notify_all();
    if (!changed_.wait_for(lock, bound_, [&] { return done_ >= ticket || ending_; }) || done_ < ticket) {
        overdue_ = signal;
        throw std::runtime_error(
            "the Python function on_stop has not returned within " +
            std::to_string(std::chrono::duration_cast<std::chrono::milliseconds>(bound_).count()) +
            " ms: it is too slow, or something keeps the interpreter; fix: give the robot a native stop "
            "action (axon_entity.native), which needs no interpreter");
    }
    if (!failed_.empty()) throw std::runtime_error(std::exchange(failed_, {}));
}

void PythonStop::serve() {
    std::unique_lock lock(mutex_);
    while (true) {
        changed_.wait(lock, [&] { return asked_ > begun_ || ending_; });
        if (asked_ == begun_) return;
        begun_ = asked_;
        movers_when_begun_ = movers_;
        const auto signal = signal_;
        lock.unlock();
        auto failed = function_(signal);
        lock.lock();
        failed_ = std::move(failed);
        done_ = begun_;
        changed_.notify_all();
    }
}

}  // namespace axon::python
