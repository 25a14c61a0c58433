// SPDX-License-Identifier: GPL-2.0-or-later
#include "host_probe.hpp"

#include <algorithm>

#include "board.hpp"

namespace axon::faults {

HostProbe::HostProbe() : thread_([this] { run(); }) {}

HostProbe::~HostProbe() {
    ending_ = true;
    thread_.join();
}

void HostProbe::run() {
    while (!ending_) {
        const auto begin = nowNs();
        std::this_thread::sleep_for(std::chrono::milliseconds{1});
        const auto end = nowNs();
        const auto late = end - begin - 1'000'000;
        longest_ = std::max(longest_.load(), late);
        if (late < kStallNs) continue;
        const std::lock_guard lock(mutex_);
        stalls_.push_back({begin, end});
    }
}

std::vector<Stall> HostProbe::stalls() const {
    const std::lock_guard lock(mutex_);
    return stalls_;
}

std::int64_t HostProbe::overlap(std::int64_t begin, std::int64_t end) const {
    const std::lock_guard lock(mutex_);
    std::int64_t sum = 0;
    for (auto stall = stalls_.rbegin(); stall != stalls_.rend() && stall->end > begin; ++stall)
        sum += std::max<std::int64_t>(0, std::min(end, stall->end) - std::max(begin, stall->begin));
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
