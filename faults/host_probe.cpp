// SPDX-License-Identifier: GPL-2.0-or-later
#include "host_probe.hpp"

#include <pthread.h>
#include <sched.h>

#include <algorithm>

#include "board.hpp"

namespace axon::faults {

namespace {

/// Above the Entity Interfacer's stop thread (30), Axon's highest.
constexpr int kPriority = 31;

bool raised() {
    sched_param parameters{};
    parameters.sched_priority = kPriority;
    return pthread_setschedparam(pthread_self(), SCHED_RR, &parameters) == 0;
}

bool earlier(const Stall& a, const Stall& b) {
    return a.begin < b.begin;
}

}  // namespace

HostProbe::HostProbe() {
    cpu_set_t allowed;
    CPU_ZERO(&allowed);
    bool permitted = false;
    std::thread([&permitted] { permitted = raised(); }).join();
    if (!permitted || sched_getaffinity(0, sizeof allowed, &allowed) != 0) {
        watch(kAny);
        return;
    }
    for (int processor = 0; processor < CPU_SETSIZE; ++processor)
        if (CPU_ISSET(processor, &allowed)) watch(processor);
}

HostProbe::~HostProbe() {
    ending_ = true;
    for (auto& watcher : watchers_) watcher.thread.join();
}

void HostProbe::watch(int processor) {
    auto& watcher = watchers_.emplace_back();
    watcher.thread = std::thread([this, &watcher, processor] {
        if (processor != kAny) {
            cpu_set_t mine;
            CPU_ZERO(&mine);
            CPU_SET(processor, &mine);
            pthread_setaffinity_np(pthread_self(), sizeof mine, &mine);
            raised();
        }
        run(watcher);
    });
}

void HostProbe::run(Watcher& watcher) {
    while (!ending_) {
        const auto due = nowNs() + kSleepNs;
        watcher.due = due;
        std::this_thread::sleep_for(std::chrono::nanoseconds{kSleepNs});
        const auto woken = nowNs();
        if (woken - due < kStallNs) continue;
        const std::lock_guard lock(mutex_);
        stalls_.push_back({due, woken});
    }
}

std::vector<Stall> HostProbe::stalls() const {
    std::vector<Stall> all;
    // Those that last first: one that ends meanwhile is then among the others, too.
    for (const auto& watcher : watchers_)
        if (const Stall lasting{watcher.due, nowNs()};
            lasting.begin != 0 && lasting.end - lasting.begin >= kStallNs)
            all.push_back(lasting);
    {
        const std::lock_guard lock(mutex_);
        all.insert(all.end(), stalls_.begin(), stalls_.end());
    }
    std::sort(all.begin(), all.end(), earlier);
    std::vector<Stall> merged;
    for (const auto& stall : all) {
        if (!merged.empty() && stall.begin <= merged.back().end)
            merged.back().end = std::max(merged.back().end, stall.end);
        else
            merged.push_back(stall);
    }
    return merged;
}

std::int64_t HostProbe::overlap(std::int64_t begin, std::int64_t end) const {
    std::int64_t sum = 0;
    for (const auto& stall : stalls())
        sum += std::max<std::int64_t>(0, std::min(end, stall.end) - std::max(begin, stall.begin));
    return sum;
}

Burners::Burners(unsigned count) {
    for (unsigned i = 0; i < count; ++i)
        threads_.emplace_back([this] {
            volatile std::uint64_t work = 0;
            while (!ending_) work = work * 6364136223846793005ULL + 1;
        });
}

Burners::~Burners() {
    ending_ = true;
    for (auto& thread : threads_) thread.join();
}

}  // namespace axon::faults
