// SPDX-License-Identifier: MIT
#pragma once
#include <sys/eventfd.h>
#include <unistd.h>

#include <cstdint>

#include "common/descriptor.hpp"

namespace axon {

/// Wakes a thread out of poll(2) or epoll_wait(2); any thread, and signal handlers, may call wake(). Failure:
/// where the process has no descriptor left it is not open, and wakes nobody.
class WakeUp {
  public:
    WakeUp() : fd_(::eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC)) {}
    int fd() const { return fd_.get(); }
    bool open() const { return fd_.open(); }
    void wake() const {
        const std::uint64_t one = 1;
        [[maybe_unused]] const auto written = ::write(fd_.get(), &one, sizeof one);
    }
    void drain() const {
        std::uint64_t count = 0;
        [[maybe_unused]] const auto got = ::read(fd_.get(), &count, sizeof count);
    }

  private:
    Descriptor fd_;
};

}  // namespace axon
