// SPDX-License-Identifier: GPL-2.0-or-later
#include "host_probe.hpp"

#include <pthread.h>
#include <sched.h>

#include <algorithm>

#include "board.hpp"

namespace axon::faults {

namespace {

constexpr int kPriority = 50;

bool earlier(const Stall& a, const Stall& b) {
    return a.begin < b.begin;
}

}  // namespace

HostProbe::HostProbe() {
    cpu_set_t allowed;
    CPU_ZERO(&allowed);
    if (sched_getaffinity(0, sizeof allowed, &allowed) != 0) return;
    for (int processor = 0; processor < CPU_SETSIZE; ++processor)
        if (CPU_ISSET(processor, &allowed)) {
            auto& watcher = watchers_.emplace_back();
            watcher.thread = std::thread([this, &watcher, processor] { run(watcher, processor); });
        }
}

HostProbe::~HostProbe() {
    ending_ = true;
    for (auto& watcher : watchers_) watcher.thread.join();
}

void HostProbe::run(Watcher& watcher, int processor) {
    cpu_set_t mine;
    CPU_ZERO(&mine);
    CPU_SET(processor, &mine);
    pthread_setaffinity_np(pthread_self(), sizeof mine, &mine);
    sched_param parameters{};
    parameters.sched_priority = kPriority;
    pthread_setschedparam(pthread_self(), SCHED_RR, &parameters);  // where not permitted, nobody else has it either
    while (!ending_) {
        const auto begin = nowNs();
        watcher.asleep_since = begin;
        std::this_thread::sleep_for(std::chrono::nanoseconds{kSleepNs});
        const auto end = nowNs();
        if (end - begin - kSleepNs < kStallNs) continue;
        const std::lock_guard lock(mutex_);
        stalls_.push_back({begin, end});
    }
}

std::vector<Stall> HostProbe::stalls() const {
    auto all = [this] {
        const std::lock_guard lock(mutex_);
        return stalls_;
    }();
    for (const auto& watcher : watchers_)
        if (const Stall now{watcher.asleep_since, nowNs()};
            now.begin != 0 && now.end - now.begin - kSleepNs >= kStallNs)
            all.push_back(now);
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
