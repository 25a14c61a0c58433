// SPDX-License-Identifier: MIT
#include "common/backoff.hpp"

#include <gtest/gtest.h>

namespace axon {
namespace {

using namespace std::chrono_literals;

TEST(Backoff, DoublesUpToTheLongestAndBeginsWithTheShortestAfterAReset) {
    Backoff backoff(100ms, 1s);
    for (const auto expected : {100ms, 200ms, 400ms, 800ms, 1000ms, 1000ms})
        EXPECT_EQ(backoff.next(), expected);
    backoff.reset();
    EXPECT_EQ(backoff.next(), 100ms);
    EXPECT_EQ(backoff.next(), 200ms);
}

}  // namespace
}  // namespace axon
