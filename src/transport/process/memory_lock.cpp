// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/process/memory_lock.hpp"

#include <linux/capability.h>
#include <malloc.h>
#include <spdlog/spdlog.h>
#include <sys/mman.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>

namespace axon::transport {
namespace {

bool mayLockAll() {
    rlimit limit{};
    if (::getrlimit(RLIMIT_MEMLOCK, &limit) == 0 && limit.rlim_cur == RLIM_INFINITY) return true;
    __user_cap_header_struct header{_LINUX_CAPABILITY_VERSION_3, 0};
    std::array<__user_cap_data_struct, 2> sets{};
    return ::syscall(SYS_capget, &header, sets.data()) == 0 &&
           (sets[0].effective & (1U << CAP_IPC_LOCK)) != 0;
}

}  // namespace

void lockMemory() {
    // What is freed stays with the process: the next message of the size would fault its pages in again.
    ::mallopt(M_TRIM_THRESHOLD, 64 << 20);
    ::mallopt(M_MMAP_THRESHOLD, 8 << 20);
    // ONFAULT: the stacks of all threads would otherwise be filled with pages that nobody uses.
    const bool may = mayLockAll();
    if (may && ::mlockall(MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT) == 0) return;
    spdlog::info(
        "memory is not locked ({}): when memory is short, a stop may have to wait for a page from the disk; "
        "fix: LimitMEMLOCK=infinity in the systemd unit, or 'ulimit -l unlimited'; LockMemory=0 silences "
        "this line",
        may ? std::strerror(errno) : "there is a limit on locked memory");
}

}  // namespace axon::transport
