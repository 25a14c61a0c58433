// SPDX-License-Identifier: GPL-2.0-or-later
#include "keep_running.hpp"

#include <pthread.h>

#include <algorithm>

#include "gil.hpp"

namespace axon::python {

using Clock = std::chrono::steady_clock;

KeepRunning::KeepRunning(std::chrono::duration<double> longest)
    : longest_(std::chrono::duration_cast<Clock::duration>(longest)),
      last_(Clock::now()),
      thread_([this] { run(); }) {
    pthread_setname_np(thread_.native_handle(), "axon-python");
}

KeepRunning::~KeepRunning() {
    end();
}

bool KeepRunning::runs() const {
    return Clock::now() - last_.load() <= longest_;
}

void KeepRunning::end() {
    {
        const std::lock_guard lock(mutex_);
        ended_ = true;
    }
    changed_.notify_all();
    const std::lock_guard lock(end_mutex_);
    if (thread_.joinable()) thread_.join();
}

void KeepRunning::run() {
    const auto period = std::min<Clock::duration>(longest_ / 4, std::chrono::milliseconds(250));
    std::unique_lock lock(mutex_);
    while (!changed_.wait_for(lock, period, [this] { return ended_; })) {
        lock.unlock();
        {
            const WithGil gil;
            if (!gil) return;
            last_ = Clock::now();
        }
        lock.lock();
    }
}

}  // namespace axon::python
