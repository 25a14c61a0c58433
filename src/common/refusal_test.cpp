// SPDX-License-Identifier: GPL-2.0-or-later
#include "common/refusal.hpp"

#include <axon/refusal.pb.h>
#include <gtest/gtest.h>

namespace axon {
namespace {

TEST(RefusalCode, NamesAndNumbersAreThoseOfTheContract) {
    const auto* contract = proto::RefusalCode_descriptor();
    for (int i = 0; i < contract->value_count(); ++i) {
        const auto* value = contract->value(i);
        EXPECT_EQ(refusalName(static_cast<RefusalCode>(value->number())), value->name());
    }
}

TEST(RefusalCode, AnUnknownNumberIsInternal) {
    EXPECT_EQ(refusalName(static_cast<RefusalCode>(9999)), "INTERNAL");
}

}  // namespace
}  // namespace axon
