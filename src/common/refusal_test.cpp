// SPDX-License-Identifier: GPL-2.0-or-later
#include "common/refusal.hpp"

#include <axon/refusal.pb.h>
#include <gmock/gmock.h>

#include <cstdlib>
#include <fstream>
#include <sstream>

namespace axon {
namespace {

// Every line of the list is in the contract, under the same number; the first test looks the other way round.
#define AXON_REFUSAL(enumerator, name, number, ...) \
    static_assert(static_cast<int>(RefusalCode::enumerator) == proto::name);
#include "common/axon/refusals.def"
#undef AXON_REFUSAL

TEST(Refusal, EveryCodeOfTheContractIsInTheListUnderItsName) {
    const auto* contract = proto::RefusalCode_descriptor();
    EXPECT_EQ(static_cast<std::size_t>(contract->value_count()), refusals().size());
    for (int i = 0; i < contract->value_count(); ++i) {
        const auto* value = contract->value(i);
        EXPECT_EQ(refusalName(static_cast<RefusalCode>(value->number())), value->name());
    }
}

TEST(Refusal, AnUnknownNumberIsInternal) {
    EXPECT_EQ(refusalName(static_cast<RefusalCode>(9999)), "INTERNAL");
}

TEST(Refusal, TheListSaysOfEachWhatItMeansAndWhoDecidesIt) {
    for (const auto& entry : refusals()) {
        EXPECT_FALSE(entry.meaning.empty()) << entry.name;
        EXPECT_EQ(entry.decided_by.empty(), entry.code == RefusalCode::Ok) << entry.name;
        EXPECT_EQ(entry.exit == 0, entry.code == RefusalCode::Ok) << entry.name;
        EXPECT_THAT((std::vector{0, 1, 3, 4, 5}), testing::Contains(entry.exit)) << entry.name;
    }
}

TEST(Refusal, ARemedyNamesTheEntityAndTheHolderAsTheyAre) {
    EXPECT_EQ(
        remedyFor(RefusalCode::AlreadyHeld, "Cyton", "{entity}"),
        "ask {entity} for it: axon checkout Cyton --ask REASON; or wait until it is free: axon checkout "
        "Cyton --wait");
    EXPECT_EQ(remedyFor(RefusalCode::Denied, "Cyton", "user@host"), "");
    for (const auto& entry : refusals()) {
        EXPECT_THAT(remedyFor(entry.code, "E", "H"), testing::Not(testing::HasSubstr("{"))) << entry.name;
    }
}

/// The tables of docs/reference/refusals.md, between the two lines that mark them.
std::string tables() {
    std::string text;
    const auto table = [&text](const char* title, int from, int below) {
        text += std::string("\n## ") + title +
                "\n| code | number | meaning | fix | decided by | status |\n|---|---|---|---|---|---|\n";
        for (const auto& entry : refusals()) {
            const auto number = static_cast<int>(entry.code);
            if (number < from || number >= below) continue;
            const auto remedy = remedyFor(entry.code, "ENTITY", "the holder");
            std::ostringstream row;
            row << "| `" << entry.name << "` | " << number << " | " << entry.meaning << " | "
                << (remedy.empty() ? "see the message" : remedy) << " | " << entry.decided_by << " | "
                << entry.exit << " |\n";
            text += row.str();
        }
    };
    table("Ownership", 1, 20);
    table("Requests", 20, 60);
    table("States and links", 60, 10'000);
    return text + "\n";
}

TEST(Refusal, TheTablesInTheDocumentationAreFresh) {
    const char* path = "docs/reference/refusals.md";
    const std::string first =
        "<!-- Made by common_test from src/common/axon/refusals.def (AXON_RERECORD=1); do not edit. -->\n";
    const std::string last = "<!-- The end of what is made. -->\n";
    std::stringstream read;
    read << std::ifstream(path, std::ios::binary).rdbuf();
    auto page = read.str();
    const auto begin = page.find(first);
    auto end = page.find(last);
    ASSERT_NE(begin, std::string::npos) << path << ": expected the line " << first;
    ASSERT_NE(end, std::string::npos) << path << ": expected the line " << last;
    const auto at = begin + first.size();
    if (std::getenv("AXON_RERECORD") != nullptr) {
        page = page.substr(0, at) + tables() + page.substr(end);
        end = at + tables().size();
        std::ofstream(path, std::ios::binary) << page;
    }
    EXPECT_EQ(page.substr(at, end - at), tables()) << path << " is stale: run this test with AXON_RERECORD=1";
}

}  // namespace
}  // namespace axon
