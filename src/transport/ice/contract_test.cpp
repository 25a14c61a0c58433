// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/contract.hpp"

#include <axon/commutil.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "common/release.hpp"

namespace axon::transport {
namespace {

using testing::EndsWith;
using testing::HasSubstr;

constexpr int kOurs = Axon::CommUtil::ContractNumber;

std::optional<Refusal> withNumber(const std::string& text) {
    return otherContract({{kContextContract, text}});
}

TEST(Contract, TheSameIsAccepted) {
    EXPECT_FALSE(otherContract(contractContext()));
}

TEST(Contract, AnotherIsRefusedWithBothNumbersAndWhatToUpgrade) {
    const auto older = withNumber(std::to_string(kOurs - 1));
    ASSERT_TRUE(older);
    EXPECT_EQ(older->code, RefusalCode::NotSupported);
    EXPECT_THAT(older->message,
                HasSubstr("contract " + std::to_string(kOurs) + " (release " + kRelease + "),"));
    EXPECT_THAT(older->message, HasSubstr("contract " + std::to_string(kOurs - 1) + "; fix:"));
    EXPECT_THAT(older->message, EndsWith("upgrade that program"));
    const auto newer = withNumber(std::to_string(kOurs + 1));
    ASSERT_TRUE(newer);
    EXPECT_EQ(newer->code, RefusalCode::NotSupported);
    EXPECT_THAT(newer->message, HasSubstr("contract " + std::to_string(kOurs + 1) + "; fix:"));
    EXPECT_THAT(newer->message, EndsWith("upgrade the server"));
}

TEST(Contract, ARefusalNamesThePeersReleaseWhereThatIsOne) {
    const auto refused = [](const std::string& release) {
        return otherContract({{kContextContract, std::to_string(kOurs + 1)}, {kContextRelease, release}})
            .value_or(Refusal{})
            .message;
    };
    EXPECT_THAT(refused("7.1"), HasSubstr("contract " + std::to_string(kOurs + 1) + " (release 7.1); fix:"));
    for (const std::string& hostile : {std::string(kReleaseMax + 1, 'x'), std::string("7\n"), std::string()})
        EXPECT_THAT(refused(hostile), HasSubstr("contract " + std::to_string(kOurs + 1) + "; fix:"));
}

TEST(Contract, TheReleaseIsSentBesideItAndReadBounded) {
    EXPECT_EQ(releaseIn(contractContext()), kRelease);
    EXPECT_EQ(releaseIn(releaseContext()), kRelease);
    EXPECT_EQ(releaseIn({}), "");
    const auto cut = releaseIn({{kContextRelease, std::string(1'000'000, 'x')}});
    EXPECT_EQ(cut.size(), kReleaseMax + 1);
    EXPECT_FALSE(isRelease(cut));
}

TEST(Contract, NoneAndNonsenseAreRefused) {
    const auto none = otherContract({});
    ASSERT_TRUE(none);
    EXPECT_EQ(none->code, RefusalCode::NotSupported);
    EXPECT_THAT(none->message, HasSubstr("names none; fix: upgrade that program"));
    for (const std::string text : {"", "one", "1 ", "0x1", "99999999999999"}) {
        const auto refused = withNumber(text);
        ASSERT_TRUE(refused) << text;
        EXPECT_EQ(refused->code, RefusalCode::Malformed) << text;
    }
}

TEST(Contract, ATopicOfAnotherEditionIsAnotherTopic) {
    EXPECT_EQ(ofContract("Topic"), "Topic-" + std::to_string(kOurs));
    EXPECT_EQ(contractOfOther("Topic", ofContract("Topic")), std::nullopt);
    EXPECT_EQ(contractOfOther("Topic", "Topic-" + std::to_string(kOurs + 1)), kOurs + 1);
    EXPECT_EQ(contractOfOther("Topic", "Topic"), 1);
    for (const auto* other : {"Topic-", "Topic-2x", "Topical-2", "Other-2", "Topic-99999999999"})
        EXPECT_EQ(contractOfOther("Topic", other), std::nullopt) << other;
}

}  // namespace
}  // namespace axon::transport
