// SPDX-License-Identifier: MIT
#include "common/snapshot_table.hpp"

#include <gtest/gtest.h>

#include <set>
#include <string>

namespace axon {
namespace {

using Text = std::shared_ptr<const std::string>;

Text text(const std::string& of) {
    return std::make_shared<const std::string>(of);
}

TEST(SnapshotTable, FindsOnEachLaneWhatWasPutAndNothingElse) {
    SnapshotTable<Text, 2> table;
    EXPECT_EQ(table.find("a"), nullptr);
    const auto a = text("a");
    table.put(*a, a);
    EXPECT_EQ(table.find("a", 0), a);
    EXPECT_EQ(table.find("a", 1), a);
    EXPECT_EQ(table.find("b", 1), nullptr);
    EXPECT_EQ(table.size(), 1U);
    table.erase("b");
    EXPECT_EQ(table.size(), 1U);
    table.erase("a");
    EXPECT_EQ(table.find("a", 1), nullptr);
    EXPECT_EQ(table.size(), 0U);
}

TEST(SnapshotTable, AReplacedValueTakesItsKeyWithIt) {
    SnapshotTable<Text> table;
    {
        const auto first = text("a key that is too long for the string itself");
        table.put(*first, first);
    }
    const auto second = text("a key that is too long for the string itself");
    table.put(*second, second);  // frees the first
    EXPECT_EQ(table.find(*second), second);
    EXPECT_EQ(table.size(), 1U);
}

TEST(SnapshotTable, AWalkSeesEachOnceThoughOthersLeaveMeanwhile) {
    SnapshotTable<Text> table;
    for (int i = 0; i < 1000; ++i) {
        const auto value = text(std::to_string(i));
        table.put(*value, value);
    }
    std::set<std::string> seen;
    table.each([&](const Text& value) {
        EXPECT_TRUE(seen.insert(*value).second);
        table.erase(*value);
    });
    EXPECT_EQ(seen.size(), 1000U);
    EXPECT_EQ(table.size(), 0U);
}

}  // namespace
}  // namespace axon
