// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/clock_file.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/mman.h>
#include <sys/stat.h>

#include <cstring>
#include <stdexcept>

namespace axon::lab {

namespace {
constexpr Duration kFirstTime = std::chrono::seconds{1000};  // so that "never" and "at the start" differ
}

ClockFile::ClockFile(const std::string& path)
    : file_(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644)) {
    struct stat status {};
    if (!file_.open() || ::fstat(file_.get(), &status) != 0) failWithErrno("--clock " + path);
    // Until this process ends, however it does.
    if (::flock(file_.get(), LOCK_EX | LOCK_NB) != 0)
        throw std::runtime_error(
            "--clock " + path +
            ": another laboratory writes its time there; fix: give each a file of its own");
    const bool fresh = status.st_size == 0;
    const auto foreign = [&] {
        throw std::runtime_error(
            "--clock " + path +
            ": it exists and is not the clock file of a laboratory; fix: choose another name, or delete it");
    };
    if (!fresh && status.st_size != static_cast<off_t>(sizeof(SharedClockPage))) foreign();
    if (fresh && ::ftruncate(file_.get(), sizeof(SharedClockPage)) != 0) failWithErrno("--clock " + path);
    void* at = ::mmap(nullptr, sizeof(SharedClockPage), PROT_READ | PROT_WRITE, MAP_SHARED, file_.get(), 0);
    if (at == MAP_FAILED) failWithErrno("--clock " + path);
    page_ = static_cast<SharedClockPage*>(at);
    const auto real = SteadyClock{}.now();
    if (!fresh && std::string_view(page_->magic, sizeof page_->magic) != SharedClockPage::kMagic) {
        ::munmap(page_, sizeof(SharedClockPage));
        foreign();
    }
    begin_ = fresh ? kFirstTime : Duration{page_->time_ns};
    if (fresh) page_->told_ns = real.time_since_epoch().count();
    tell({}, 0, real);
    std::memcpy(page_->magic, SharedClockPage::kMagic.data(), sizeof page_->magic);
}

ClockFile::~ClockFile() {
    ::munmap(page_, sizeof(SharedClockPage));
}

void ClockFile::tell(Duration age, double rate, TimePoint real) {
    begin_ += page_->alone(real);  // where the readers are by now
    page_->told_ns.store(real.time_since_epoch().count(), std::memory_order_release);
    page_->rate.store(rate, std::memory_order_relaxed);
    page_->time_ns.store((begin_ + age).count(), std::memory_order_release);
}

}  // namespace axon::lab
