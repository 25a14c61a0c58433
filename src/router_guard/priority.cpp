// SPDX-License-Identifier: GPL-2.0-or-later
#include "router_guard/priority.hpp"

#include <dirent.h>
#include <fcntl.h>
#include <sched.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <cstring>
#include <ctime>
#include <memory>

namespace axon::router_guard {
namespace {

constexpr int kNice = -10;
constexpr int kRealTime = 5;  // as Entity Managers and receipts, below all else that passes on a signal
constexpr auto kLooks = std::chrono::milliseconds{10};
constexpr auto kAgain = std::chrono::milliseconds{100};

/// With kernel.sched_autogroup_enabled, Linux compares sessions first, and only within one its programs. 0,
/// or the error; ENOENT where there are no such groups.
int raiseSession() {
    constexpr int kTries = 20;
    const int file = ::open("/proc/self/autogroup", O_WRONLY | O_CLOEXEC);
    if (file < 0) return errno;
    const auto text = std::to_string(kNice);
    int error = EAGAIN;
    // Of all who are not root, one in 100 ms may.
    for (int tries = 0; tries < kTries && error == EAGAIN; ++tries) {
        if (tries > 0) std::this_thread::sleep_for(std::chrono::milliseconds{110});
        error = ::write(file, text.data(), text.size()) < 0 ? errno : 0;
    }
    ::close(file);
    return error;
}

/// False where that is not permitted. A thread keeps its nice value while it has real-time priority.
bool schedule(pid_t thread, int real_time) {
    sched_param parameters{};
    parameters.sched_priority = real_time;
    return ::sched_setscheduler(thread, real_time > 0 ? SCHED_FIFO : SCHED_OTHER, &parameters) == 0;
}

/// All threads of this process but those that need none (SCHED_BATCH). Opened once: a flood of connections
/// may leave no descriptor.
class Threads {
  public:
    void schedule(pid_t but, int real_time) const {
        if (directory_ == nullptr) return;
        ::rewinddir(directory_.get());
        while (const auto* entry = ::readdir(directory_.get())) {
            const auto thread = static_cast<pid_t>(std::atoi(entry->d_name));
            if (thread > 0 && thread != but && ::sched_getscheduler(thread) != SCHED_BATCH)
                router_guard::schedule(thread, real_time);  // it may have ended
        }
    }

  private:
    struct Close {
        void operator()(DIR* directory) const { ::closedir(directory); }
    };
    const std::unique_ptr<DIR, Close> directory_{::opendir("/proc/self/task")};
};

CpuBudget::Duration processorTime() {
    timespec time{};
    ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
    return std::chrono::seconds{time.tv_sec} + std::chrono::nanoseconds{time.tv_nsec};
}

}  // namespace

bool CpuBudget::allows(Duration used, Duration passed) {
    left_ = std::clamp(left_ + passed / kPart - used, Duration{}, kBurst);
    real_time_ = real_time_ ? left_ > Duration{} : left_ == kBurst;
    return real_time_;
}

void Priority::begin() {
    goBeforeOrdinaryPrograms();
    if (schedule(0, kRealTime)) {
        watch_ = std::jthread(watch);
        return;
    }
    tell_(
        "router guard: real-time scheduling is not permitted, so stops are slower under full load; fix: "
        "LimitRTPRIO=10 in the systemd unit, or start it as root");
}

void Priority::end() {
    watch_ = {};
}

void Priority::goBeforeOrdinaryPrograms() {
    if (::setpriority(PRIO_PROCESS, 0, kNice) != 0) {
        tell_(
            "router guard: a priority above that of other programs is not permitted, so stops are slower "
            "under full load; fix: LimitNICE=-10 in the systemd unit, or start it as root");
        return;
    }
    if (::getsid(0) != ::getpid()) return;  // a session that others share stays as it is
    if (const auto error = raiseSession(); error != 0 && error != ENOENT)
        tell_(std::string("router guard: the priority of its session could not be set (") +
              ::strerror(error) +
              "), so stops are slower under full load if kernel.sched_autogroup_enabled is 1; fix: start the "
              "router as root");
}

void Priority::watch(const std::stop_token& ended) {
    const auto self = ::gettid();
    schedule(self, kRealTime + 1);  // a flood at the priority of this thread would keep it from looking
    const Threads threads;
    CpuBudget budget;
    bool real_time = true;
    auto used = processorTime();
    auto at = std::chrono::steady_clock::now();
    auto again = at;
    for (; !ended.stop_requested(); std::this_thread::sleep_for(kLooks)) {
        const auto used_now = processorTime();
        const auto now = std::chrono::steady_clock::now();
        const bool allowed = budget.allows(used_now - used, now - at);
        used = used_now;
        at = now;
        // Now and then again: some may have begun meanwhile, by one that still had real time.
        if (allowed != real_time || (!allowed && now >= again)) {
            threads.schedule(self, allowed ? kRealTime : 0);
            again = now + kAgain;
        }
        real_time = allowed;
    }
}

}  // namespace axon::router_guard
