// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/reader.hpp"

#include <gmock/gmock.h>

#include <filesystem>
#include <stdexcept>

#include "audit/files.hpp"
#include "audit/testing.hpp"

namespace axon::audit {
namespace {

namespace fs = std::filesystem;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;

std::vector<std::string> linesOf(const std::string& text) {
    std::vector<std::string> lines;
    std::istringstream all(text);
    for (std::string line; std::getline(all, line);) lines.push_back(line);
    return lines;
}

/// Three files of four records each, the last of which has two.
struct AuditReader : testing::Test {
    AuditReader() {
        Files files(folder.path, "server", {900, 8});
        for (int i = 1; i <= 10; ++i) {
            Record record;
            record.at = utcTime(1'790'000'000'000'000 + i);
            record.kind = i == 1 ? "started" : "stop";
            record.user = "user " + std::to_string(i);
            record.what = std::string(40, 'x');
            EXPECT_TRUE(files.append(record));
        }
        EXPECT_TRUE(fs::exists(folder.path / "server.3.jsonl"));
        lines = linesOf(folder.text("server.2.jsonl"));
    }
    void writeLines() const {
        std::string text;
        for (const auto& line : lines) text += line + '\n';
        folder.write("server.2.jsonl", text);
    }
    /// The only one.
    Fault fault() const {
        const auto chain = folder.chain();
        EXPECT_FALSE(chain.whole());
        EXPECT_EQ(chain.faults.size(), 1U);
        return chain.faults.empty() ? Fault{} : chain.faults.front();
    }
    std::string file(int number) const {
        return (folder.path / ("server." + std::to_string(number) + ".jsonl")).string();
    }

    TrailFolder folder;
    std::vector<std::string> lines;
};

TEST_F(AuditReader, FindsNothingWrongWithAWholeTrail) {
    const auto chain = folder.chain(hashOf(lines[1]));
    EXPECT_THAT(chain.faults, IsEmpty());
    EXPECT_EQ(chain.name, "server");
    EXPECT_EQ(chain.first, 1U);
    EXPECT_EQ(chain.last, 10U);
    EXPECT_EQ(chain.records, 10U);
    EXPECT_EQ(chain.hash, hashOf(linesOf(folder.text("server.3.jsonl")).back()));
    EXPECT_TRUE(chain.kept_found);
    EXPECT_FALSE(folder.chain(kNoHash).kept_found);
}

TEST_F(AuditReader, NamesTheLineThatWasChanged) {
    lines[1].replace(lines[1].find("user"), 4, "abcd");
    writeLines();
    EXPECT_EQ(fault().place(), file(2) + ":2");
    EXPECT_THAT(fault().text, HasSubstr("changed"));
}

TEST_F(AuditReader, NoByteCanBeChangedUnnoticedBeforeTheLastLine) {
    const auto whole = folder.text("server.2.jsonl");
    for (std::size_t i = 0; i < whole.size(); ++i) {
        auto changed = whole;
        changed[i] = static_cast<char>(changed[i] ^ 1);
        folder.write("server.2.jsonl", changed);
        ASSERT_FALSE(folder.chain().whole()) << i;
    }
}

TEST_F(AuditReader, NamesThePlaceWhereRecordsAreMissing) {
    lines.erase(lines.begin() + 1, lines.begin() + 3);
    writeLines();
    EXPECT_EQ(fault().place(), file(2) + ":2");
    EXPECT_THAT(fault().text, HasSubstr("2 records are missing before it"));
}

TEST_F(AuditReader, NoticesThatTheEndOfAFileThatIsNotTheLastIsCutOff) {
    lines.pop_back();
    writeLines();
    EXPECT_EQ(fault().place(), file(3) + ":1");
    EXPECT_THAT(fault().text, HasSubstr("1 record is missing"));
}

TEST_F(AuditReader, NoticesAMissingFileAndTheRecordsInIt) {
    fs::remove(file(2));
    const auto chain = folder.chain();
    ASSERT_EQ(chain.faults.size(), 2U);
    EXPECT_EQ(chain.faults[0].place(), file(3));
    EXPECT_THAT(chain.faults[0].text, HasSubstr("file 2 before it is missing"));
    EXPECT_THAT(chain.faults[1].text, HasSubstr("records are missing"));
}

TEST_F(AuditReader, NoticesARecordThatWasCopiedOrMoved) {
    lines.insert(lines.begin() + 2, lines[1]);
    writeLines();
    EXPECT_EQ(folder.chain().faults.at(0).place(), file(2) + ":3");
    lines = linesOf(folder.text("server.2.jsonl"));
    std::swap(lines[0], lines[1]);
    writeLines();
    EXPECT_FALSE(folder.chain().whole());
}

TEST_F(AuditReader, NoticesARecordThatIsNoneAnyMore) {
    for (const auto& text : {std::string("nonsense"), std::string(), std::string(kLineMax + 1, 'x'),
                             std::string(3, '\0'), std::string("\xff\xfe")}) {
        auto damaged = lines;
        damaged[2] = text;
        std::swap(damaged, lines);
        writeLines();
        std::swap(damaged, lines);
        EXPECT_EQ(fault().place(), file(2) + ":3");
        EXPECT_THAT(fault().text, HasSubstr("is no record"));
    }
}

TEST_F(AuditReader, ALineThatIsCutOffAtTheEndIsUnfinishedAndNoFault) {
    const auto text = folder.text("server.3.jsonl");
    folder.write("server.3.jsonl", text.substr(0, text.size() - 20));
    auto chain = folder.chain();
    EXPECT_TRUE(chain.whole());
    EXPECT_THAT(chain.unfinished, ElementsAre(file(3) + ":" + std::to_string(linesOf(text).size())));
    // What follows it must be the start of a life that knows of it.
    Files files(folder.path, "server", {900, 8});
    Record record;
    record.at = utcTime(0);
    record.kind = "stop";
    ASSERT_TRUE(files.append(record));
    EXPECT_FALSE(folder.chain().whole());
}

TEST_F(AuditReader, TheHashToKeepIsNotThatOfALineThatIsBeingWritten) {
    const auto text = folder.text("server.3.jsonl");
    const auto hash = folder.chain().hash;
    folder.write("server.3.jsonl", text + "{\"n\":11,\"at\":\"2026");
    EXPECT_EQ(folder.chain().hash, hash);
    // All but its end is there: nothing changes in it.
    folder.write("server.3.jsonl", text.substr(0, text.size() - 1));
    EXPECT_EQ(folder.chain().hash, hash);
    // A new life has ended it.
    folder.write("server.3.jsonl", text + "{\"n\":11,\"at\":\"2026\n");
    EXPECT_EQ(folder.chain().hash, hashOf("{\"n\":11,\"at\":\"2026"));
}

TEST_F(AuditReader, TwoLivesThatAreKilledAtOnceLeaveTwoUnfinishedLines) {
    const auto text = folder.text("server.3.jsonl");
    folder.write("server.3.jsonl", text + "{\"n\":11,\"at\n{\"n\":1");
    EXPECT_TRUE(folder.chain().whole());
    EXPECT_EQ(folder.chain().unfinished.size(), 2U);
    Files files(folder.path, "server", {900, 8});
    Record record;
    record.at = utcTime(0);
    record.kind = "started";
    ASSERT_TRUE(files.append(record));
    EXPECT_TRUE(folder.chain().whole());
    EXPECT_EQ(folder.chain().unfinished.size(), 2U);
}

TEST_F(AuditReader, AProgramThatIsKilledManyTimesLeavesManyUnfinishedLinesInOneFile) {
    fs::remove(file(1));
    fs::remove(file(2));
    fs::remove(file(3));
    const auto append = [this](const std::string& kind) {
        Files files(folder.path, "server", {});
        Record record;
        record.at = utcTime(0);
        record.kind = kind;
        EXPECT_TRUE(files.append(record));
    };
    append("started");
    constexpr std::size_t kKills = Chain::kFaults + 20;
    for (std::size_t i = 0; i < kKills; ++i) {
        append("stop");
        const auto text = folder.text("server.1.jsonl");
        // Each at another byte of the last record.
        folder.write("server.1.jsonl", text.substr(0, text.size() - 2 - i));
        append("started");
    }
    const auto chain = folder.chain();
    EXPECT_THAT(chain.faults, IsEmpty());
    EXPECT_EQ(chain.records, 1 + kKills);
    EXPECT_EQ(chain.unfinished_lines, kKills);
    ASSERT_EQ(chain.unfinished.size(), Chain::kFaults) << "only so many are named";
    EXPECT_EQ(chain.unfinished[0], file(1) + ":2");
    EXPECT_EQ(chain.unfinished[1], file(1) + ":4");
    // It is no way to hide a change: neither of an unfinished line …
    const auto text = folder.text("server.1.jsonl");
    auto lines_of_it = linesOf(text);
    lines_of_it[3][10] = '!';
    const auto all = [](const std::vector<std::string>& them) {
        std::string joined;
        for (const auto& line : them) joined += line + '\n';
        return joined;
    };
    folder.write("server.1.jsonl", all(lines_of_it));
    EXPECT_FALSE(folder.chain().whole());
    // … nor of a record that is made an unfinished one.
    lines_of_it = linesOf(text);
    lines_of_it[2].resize(40);
    folder.write("server.1.jsonl", all(lines_of_it));
    EXPECT_FALSE(folder.chain().whole());
}

TEST_F(AuditReader, NoticesARecordThatWasInsertedWhateverNumberAndHashItHas) {
    const auto whole = lines;
    for (const auto& number : {readLine(whole[1])->number, readLine(whole[1])->number + 1}) {
        auto record = *readLine(whole[1]);
        record.number = number;
        record.before = hashOf(whole[1]);
        record.what = "never happened";
        lines = whole;
        lines.insert(lines.begin() + 2, lineOf(record));
        writeLines();
        EXPECT_FALSE(folder.chain().whole()) << number;
    }
}

TEST_F(AuditReader, RecordsThatAreCutOffAtTheEndAreMissedOnlyByWhoHasKeptAHash) {
    const auto kept = folder.chain().hash;
    lines = linesOf(folder.text("server.3.jsonl"));
    lines.pop_back();
    std::string text;
    for (const auto& line : lines) text += line + '\n';
    folder.write("server.3.jsonl", text);
    EXPECT_TRUE(folder.chain().whole());
    EXPECT_FALSE(folder.chain(kept).kept_found);
    fs::remove(file(3));
    EXPECT_TRUE(folder.chain().whole());
    EXPECT_FALSE(folder.chain(kept).kept_found);
}

TEST_F(AuditReader, SeveralDamagedLinesAtTheEndAreAFault) {
    folder.write("server.3.jsonl", folder.text("server.3.jsonl") + "x\ny\n");
    EXPECT_EQ(folder.chain().faulty, 2U);
}

TEST_F(AuditReader, ATrailWhoseOldestFilesWereRotatedAwayIsWhole) {
    fs::remove(file(1));
    EXPECT_TRUE(folder.chain().whole());
    EXPECT_GT(folder.chain().first, 1U);
}

TEST_F(AuditReader, ReadsThousandsOfFaultsWithoutKeepingThemAll) {
    std::string text;
    for (int i = 0; i < 5000; ++i) text += "nonsense\n";
    folder.write("server.2.jsonl", text);
    const auto chain = folder.chain();
    EXPECT_EQ(chain.faults.size(), Chain::kFaults);
    EXPECT_GE(chain.faulty, 5000U);
    EXPECT_THAT(chain.unfinished, IsEmpty());
}

TEST_F(AuditReader, WhatIsNoFileIsAFaultAndAFolderThatIsNotThereIsSaid) {
    fs::create_directory(folder.path / "server.4.jsonl");
    EXPECT_THAT(fault().text, HasSubstr("is no file"));
    EXPECT_THROW(readTrails(folder.path / "none"), std::runtime_error);
}

TEST_F(AuditReader, EachTrailOfAFolderIsVerifiedByItself) {
    Files files(folder.path, "manager", {});
    Record record;
    record.at = utcTime(0);
    record.kind = "stop";
    ASSERT_TRUE(files.append(record));
    lines[0][10] = '!';
    writeLines();
    const auto chains = readTrails(folder.path);
    ASSERT_EQ(chains.size(), 2U);
    EXPECT_EQ(chains[0].name, "manager");
    EXPECT_TRUE(chains[0].whole());
    EXPECT_FALSE(chains[1].whole());
}

}  // namespace
}  // namespace axon::audit
