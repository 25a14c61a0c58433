// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/process/descriptor_limit.hpp"

#include <sys/resource.h>

namespace axon::transport {

void raiseDescriptorLimit() {
    rlimit limit{};
    if (::getrlimit(RLIMIT_NOFILE, &limit) != 0 || limit.rlim_cur == limit.rlim_max) return;
    limit.rlim_cur = limit.rlim_max;
    ::setrlimit(RLIMIT_NOFILE, &limit);
}

}  // namespace axon::transport
