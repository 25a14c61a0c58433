// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/line.hpp"

#include <gtest/gtest.h>

#include <algorithm>

#include "audit/note.hpp"

namespace axon::audit {
namespace {

Record whole() {
    return {7,
            "2026-11-28T14:35:06.123456Z",
            "stop",
            "ann",
            "ann's tablet",
            "c1",
            "192.168.0.5:4444",
            "a-uuid",
            "stop of \"all\"\n\x1b[1m",
            "OK",
            hashOf("the line before")};
}

TEST(AuditLine, IsReadBackAsItWas) {
    const auto line = lineOf(whole());
    EXPECT_EQ(std::count(line.begin(), line.end(), '\n'), 0);
    EXPECT_EQ(readLine(line), whole());
    Record least;
    least.number = 1;
    least.at = utcTime(0);
    least.kind = "started";
    least.before = kNoHash;
    EXPECT_EQ(lineOf(least),
              R"({"n":1,"at":"1970-01-01T00:00:00.000000Z","kind":"started","before":")" + kNoHash + "\"}");
    EXPECT_EQ(readLine(lineOf(least)), least);
}

TEST(AuditLine, EveryKindHasANameOfItsOwn) {
    for (std::size_t i = 0; i < kKinds.size(); ++i) {
        EXPECT_EQ(toString(static_cast<Kind>(i)), kKinds.at(i));
        EXPECT_EQ(std::count(kKinds.begin(), kKinds.end(), kKinds.at(i)), 1);
    }
    EXPECT_EQ(toString(Kind::Lost), "lost");
}

TEST(AuditLine, HasTheHashThatSha256sumPrints) {
    EXPECT_EQ(hashOf("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
    EXPECT_EQ(hashOf("").size(), kNoHash.size());
}

TEST(AuditLine, WhatIsNoUtf8IsWrittenAsAReplacement) {
    auto record = whole();
    record.name = "\xff\xfe";
    const auto read = readLine(lineOf(record));
    ASSERT_TRUE(read);
    EXPECT_EQ(read->name, "\xEF\xBF\xBD\xEF\xBF\xBD");
}

TEST(AuditLine, TimesSortAsTheirTexts) {
    EXPECT_EQ(utcTime(1'000'001), "1970-01-01T00:00:01.000001Z");
    EXPECT_LT(utcTime(999'999), utcTime(1'000'000));
    EXPECT_LT(utcTime(1'790'000'000'000'000), utcTime(1'790'000'000'000'001));
}

TEST(AuditLine, WhatIsNoRecordIsRefused) {
    const auto line = lineOf(whole());
    for (std::size_t cut = 0; cut < line.size(); ++cut) EXPECT_FALSE(readLine(line.substr(0, cut))) << cut;
    const auto hash = "\"before\":\"" + kNoHash + "\"}";
    for (const auto& text :
         {std::string("{}"), std::string("[]"), std::string("null"), std::string("\0", 1),
          std::string(R"({"n":1,"at":"t","kind":"stop"})"), R"({"n":0,"at":"t","kind":"stop",)" + hash,
          R"({"n":18446744073709551615,"at":"t","kind":"stop",)" + hash,
          R"({"n":-1,"at":"t","kind":"stop",)" + hash, R"({"n":1.5,"at":"t","kind":"stop",)" + hash,
          R"({"n":"1","at":"t","kind":"stop",)" + hash, R"({"n":1,"at":3,"kind":"stop",)" + hash,
          R"({"n":1,"at":"t","kind":"",)" + hash, R"({"n":1,"at":"t","kind":"stop","user":[],)" + hash,
          std::string(R"({"n":1,"at":"t","kind":"stop","before":"ABC"})"), std::string(10'000, '['),
          std::string(kLineMax + 1, ' ') + lineOf(whole())})
        EXPECT_FALSE(readLine(text)) << text.substr(0, 80);
    EXPECT_TRUE(readLine(R"({"n":1,"at":"t","kind":"of a later release","more":{"x":[1]},)" + hash));
}

}  // namespace
}  // namespace axon::audit
