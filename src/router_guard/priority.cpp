// SPDX-License-Identifier: GPL-2.0-or-later
#include "router_guard/priority.hpp"

#include <fcntl.h>
#include <sched.h>
#include <sys/resource.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <filesystem>

namespace axon::router_guard {
namespace {

constexpr int kNice = -10;
constexpr int kRealTime = 5;  // as Entity Managers and receipts, below all that passes on a signal
constexpr auto kLooks = std::chrono::milliseconds{10};

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
bool schedule(pid_t thread, bool real_time) {
    sched_param parameters{};
    parameters.sched_priority = real_time ? kRealTime : 0;
    return ::sched_setscheduler(thread, real_time ? SCHED_FIFO : SCHED_OTHER, &parameters) == 0;
}

void scheduleAll(bool real_time) {
    std::error_code error;
    for (const auto& thread : std::filesystem::directory_iterator("/proc/self/task", error))
        schedule(std::stoi(thread.path().filename()), real_time);  // one that has ended meanwhile: nothing
}

CpuBudget::Duration processorTime() {
    timespec time{};
    ::clock_gettime(CLOCK_PROCESS_CPUTIME_ID, &time);
    return std::chrono::seconds{time.tv_sec} + std::chrono::nanoseconds{time.tv_nsec};
}

}  // namespace

bool CpuBudget::allows(Duration used, Duration passed) {
    left_ = std::clamp(left_ + passed / kPart - used, Duration{}, kBurst);
    real_time_ = left_ > (real_time_ ? Duration{} : kBurst / 2);
    return real_time_;
}

void Priority::begin() {
    goBeforeOrdinaryPrograms();
    if (schedule(0, true)) {
        watch_ = std::jthread([this](const std::stop_token& ended) { watch(ended); });
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
    CpuBudget budget;
    bool real_time = true;
    auto used = processorTime();
    auto at = std::chrono::steady_clock::now();
    std::unique_lock lock(mutex_);
    while (!end_.wait_for(lock, ended, kLooks, [&] { return ended.stop_requested(); })) {
        const auto used_now = processorTime();
        const auto now = std::chrono::steady_clock::now();
        const bool allowed = budget.allows(used_now - used, now - at);
        used = used_now;
        at = now;
        if (allowed != real_time) scheduleAll(allowed);
        real_time = allowed;
    }
}

}  // namespace axon::router_guard
