// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/process/descriptor_limit.hpp"

#include <gtest/gtest.h>
#include <sys/resource.h>

namespace axon::transport {
namespace {

TEST(DescriptorLimit, IsRaisedAsFarAsTheUserIsAllowed) {
    rlimit before{};
    ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &before), 0);
    rlimit low{.rlim_cur = 256, .rlim_max = before.rlim_max};
    ASSERT_EQ(::setrlimit(RLIMIT_NOFILE, &low), 0);
    raiseDescriptorLimit();
    rlimit now{};
    ASSERT_EQ(::getrlimit(RLIMIT_NOFILE, &now), 0);
    EXPECT_EQ(now.rlim_cur, before.rlim_max);
    EXPECT_EQ(now.rlim_max, before.rlim_max);
    ::setrlimit(RLIMIT_NOFILE, &before);
}

}  // namespace
}  // namespace axon::transport
