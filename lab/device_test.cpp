// SPDX-License-Identifier: GPL-2.0-or-later
#include "lab/device.hpp"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <stdexcept>

namespace axon::lab {
namespace {

using ::testing::AllOf;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

const DeviceKind kArm{.word = "cyton", .label = "Cyton", .noun = "arm", .first_port = 8201};
const DeviceKind kHead{.word = "pantilt", .label = "PanTilt", .noun = "head", .first_port = 8601};

/// Empty: they are accepted.
std::string refusalOf(std::vector<DeviceKind> kinds) {
    try {
        distinct(std::move(kinds));
    } catch (const std::invalid_argument& error) {
        return error.what();
    }
    return {};
}

TEST(DeviceKinds, ThatDifferAreKeptInTheirOrder) {
    const auto kinds = distinct({kHead, kArm});
    ASSERT_EQ(kinds.size(), 2U);
    EXPECT_EQ(kinds[0].word, "pantilt");
    EXPECT_EQ(kinds[1].word, "cyton");
}

TEST(DeviceKinds, OfOneNounAreRefusedWithBothNamesAndTheRemedy) {
    auto head = kHead;
    head.noun = kArm.noun;
    EXPECT_THAT(refusalOf({kArm, head}),
                AllOf(HasSubstr("PanTilt"), HasSubstr("noun \"arm\" is that of Cyton already"),
                      HasSubstr("fix: choose another noun in pantiltKind()")));
}

TEST(DeviceKinds, OfOneWordOrOnePortAreRefused) {
    auto head = kHead;
    head.word = kArm.word;
    EXPECT_THAT(refusalOf({kArm, head}), HasSubstr("word \"cyton\" is that of Cyton already"));
    head = kHead;
    head.first_port = kArm.first_port;
    EXPECT_THAT(refusalOf({kArm, head}), HasSubstr("first_port \"8201\" is that of Cyton already"));
}

TEST(DeviceKinds, DoNotTakeTheLaboratorysOwnWordsAndOptions) {
    for (const auto word : kOtherWords) {
        auto head = kHead;
        head.word = word;
        EXPECT_THAT(refusalOf({head}), HasSubstr("is a word of the laboratory already"));
    }
    for (const auto option : kOtherOptions) {
        auto head = kHead;
        head.noun = option;
        EXPECT_THAT(refusalOf({head}), HasSubstr("is an option of the laboratory already"));
    }
}

TEST(DeviceKinds, ThatThereAreDiffer) {
    EXPECT_THAT(refusalOf(deviceKinds()), IsEmpty());
}

}  // namespace
}  // namespace axon::lab
