// SPDX-License-Identifier: MIT
#include "common/shared_clock.hpp"

#include <fcntl.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <cstring>
#include <stdexcept>

#include "common/descriptor.hpp"

namespace axon {

namespace {

// Time moves in steps of the laboratory's: who is woken a little early looks again after so long.
constexpr Duration kShortestWait = std::chrono::microseconds{500};

const SharedClockPage* mapPage(const std::string& path) {
    const auto fail = [&](const std::string& what) {
        throw std::runtime_error("AXON_CLOCK=" + path + ": " + what);
    };
    constexpr auto* kFix =
        "start the laboratory first, with axon-lab --clock and this file, or unset AXON_CLOCK to use the "
        "time of this machine";
    const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
    if (!file.open()) fail(std::string(std::strerror(errno)) + "; fix: " + kFix);
    struct stat status {};
    const bool whole = ::fstat(file.get(), &status) == 0 && S_ISREG(status.st_mode) &&
                       status.st_size == static_cast<off_t>(sizeof(SharedClockPage));
    void* at =
        whole ? ::mmap(nullptr, sizeof(SharedClockPage), PROT_READ, MAP_SHARED, file.get(), 0) : MAP_FAILED;
    const auto* page = at == MAP_FAILED ? nullptr : static_cast<const SharedClockPage*>(at);
    if (page != nullptr && std::string_view(page->magic, sizeof page->magic) == SharedClockPage::kMagic) {
        // Of an earlier start of this machine it may even lie ahead.
        const auto told = TimePoint{Duration{page->told_ns.load()}};
        const auto silent = SteadyClock{}.now() - told;
        if (silent >= Duration::zero() && silent <= SharedClockPage::kGoneAfter) return page;
        ::munmap(at, sizeof(SharedClockPage));
        fail(std::string("the laboratory that wrote its time here is gone; fix: ") + kFix);
    }
    if (page != nullptr) ::munmap(at, sizeof(SharedClockPage));
    fail("expected " + std::string(SharedClockPage::kMagic) + " of " +
         std::to_string(sizeof(SharedClockPage)) +
         " bytes, but this is not the clock file of a laboratory; fix: " + kFix);
    return nullptr;
}

}  // namespace

SharedClock::SharedClock(const std::string& path) : path_(path), page_(mapPage(path)) {}

SharedClock::~SharedClock() {
    // As it was mapped; nothing is written.
    ::munmap(const_cast<SharedClockPage*>(page_), sizeof(SharedClockPage));
}

TimePoint SharedClock::now() const {
    // First the time: who reads it with the sign of life of an earlier one would go too far ahead.
    auto time_ns = page_->time_ns.load(std::memory_order_acquire);
    auto latest = latest_ns_.load(std::memory_order_relaxed);
    const auto alone = page_->alone(SteadyClock{}.now());
    if (alone == Duration::zero()) return TimePoint{Duration{std::max(time_ns, latest)}};
    if (!gone_.exchange(true))
        std::fprintf(stderr,
                     "axon: the laboratory has not written its time to %s for %lld s and counts as gone; "
                     "time goes on at the pace of this machine\n",
                     path_.c_str(),
                     static_cast<long long>(SharedClockPage::kGoneAfter / std::chrono::seconds{1}));
    time_ns += alone.count();
    while (latest < time_ns && !latest_ns_.compare_exchange_weak(latest, time_ns)) {
    }
    return TimePoint{Duration{std::max(time_ns, latest)}};
}

Duration SharedClock::realTimeUntil(TimePoint deadline) const {
    const auto left = deadline - now();
    if (left <= Duration::zero()) return left;
    const auto rate = page_->rate.load(std::memory_order_relaxed);
    if (!(rate > 0) || left > kLongestWait * rate) return kLongestWait;
    return std::clamp(std::chrono::duration_cast<Duration>(left / rate), kShortestWait, kLongestWait);
}

std::shared_ptr<const Clock> clockFromEnvironment() {
    const char* file = std::getenv("AXON_CLOCK");
    if (file == nullptr || *file == '\0') return std::make_shared<SteadyClock>();
    auto clock = std::make_shared<SharedClock>(file);
    std::fprintf(stderr,
                 "axon: all time, watchdogs included, is the laboratory's time in %s (AXON_CLOCK); use this "
                 "for trials, never for real robots\n",
                 file);
    return clock;
}

}  // namespace axon
