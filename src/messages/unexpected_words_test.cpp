// SPDX-License-Identifier: MIT
#include "messages/unexpected_words.hpp"

#include <gtest/gtest.h>

namespace axon {
namespace {

TEST(UnexpectedWords, AMisspeltOptionIsNamedWithTheOneThatMayBeMeant) {
    for (const std::vector<std::string>& words :
         {std::vector<std::string>{"0.0.0.0", "--liten"}, {"--liten", "0.0.0.0"}, {"--liten=0.0.0.0"}})
        EXPECT_EQ(unexpectedWords("axon-server", words, {"--users", "--listen"}),
                  "axon-server: unknown option \"--liten\"\nfix: did you mean \"--listen\"?");
}

TEST(UnexpectedWords, WhatIsLikeNoOptionLeadsToTheHelp) {
    EXPECT_EQ(unexpectedWords("axon-server", {"--verbose"}, {"--listen"}),
              "axon-server: unknown option \"--verbose\"\nfix: axon-server --help shows the options");
    EXPECT_EQ(unexpectedWords("axon-server", {"\x1b[1m"}, {}),
              "axon-server: unexpected word \"?[1m\"\nfix: leave it out, or see axon-server --help");
}

}  // namespace
}  // namespace axon
