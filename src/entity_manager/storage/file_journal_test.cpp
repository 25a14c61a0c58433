// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/storage/file_journal.hpp"

#include <gtest/gtest.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <thread>

#include "support/loopback.hpp"

namespace axon::entity_manager {
namespace {

namespace fs = std::filesystem;
using Kind = JournalRecord::Kind;

struct FileJournalTest : testing::Test {
    FileJournalTest() {
        std::string name = (fs::temp_directory_path() / "axon-journal-XXXXXX").string();
        folder = ::mkdtemp(name.data());
    }
    ~FileJournalTest() override { fs::remove_all(folder); }
    std::vector<JournalRecord> readBack() {
        FileJournal journal(folder, bounds);
        std::vector<JournalRecord> records;
        journal.replay([&](const JournalRecord& record) { records.push_back(record); });
        findings = journal.findings();
        return records;
    }
    std::string text(const char* name = "tasks.jsonl") const {
        std::stringstream all;
        all << std::ifstream(folder / name, std::ios::binary).rdbuf();
        return all.str();
    }
    void write(const std::string& content) const {
        std::ofstream(folder / "tasks.jsonl", std::ios::binary | std::ios::app) << content;
    }
    static bool answerOf(const Later<bool>& answer) {
        EXPECT_TRUE(test::waitUntil([&] { return answer.ready(); }));
        return answer.value();
    }
    static JournalRecord dispatched(std::uint64_t seed) {
        SeededRandom random(seed);
        return {.kind = Kind::Dispatched,
                .lease = {3, 4},
                .generation = 7,
                .at_us = 12,
                .who = "client1@lab",
                .task = Id128::random(random),
                .service = "Driving"};
    }

    fs::path folder;
    FileJournal::Bounds bounds;
    std::vector<std::string> findings;
};

TEST_F(FileJournalTest, WhatWasWrittenIsReadBackWhole) {
    auto ended = dispatched(1);
    ended.kind = Kind::TaskEnded;
    ended.code = "TASK_FAILED";
    ended.text = "A \"quoted\" line\nand another, \xff not UTF-8";
    {
        FileJournal journal(folder, bounds);
        EXPECT_TRUE(journal.append(dispatched(1)));
        EXPECT_TRUE(journal.append(ended));
    }
    ended.text = "A \"quoted\" line\nand another, \xEF\xBF\xBD not UTF-8";
    EXPECT_EQ(readBack(), (std::vector{dispatched(1), ended}));
    EXPECT_TRUE(findings.empty());
}

TEST_F(FileJournalTest, ADispatchIsInTheFileWhenItIsAnswered) {
    FileJournal journal(folder, bounds);
    std::atomic<int> answers{0};
    journal.onAnswer([&] { ++answers; });
    EXPECT_TRUE(answerOf(journal.appendDispatch(dispatched(1))));
    EXPECT_TRUE(test::waitUntil([&] { return answers == 1; }));
    EXPECT_EQ(readBack().size(), 1U);  // by another, as after a kill of the first
}

TEST_F(FileJournalTest, ATornLastLineIsCutOffSaidAndDoesNotSpoilTheNext) {
    { FileJournal(folder, bounds).append(dispatched(1)); }
    write(R"({"at":"2026-01-01T00:00:00.000Z","kind":"dispat)");
    {
        FileJournal journal(folder, bounds);
        ASSERT_EQ(journal.findings().size(), 1U);
        EXPECT_NE(journal.findings()[0].find("torn"), std::string::npos);
        EXPECT_TRUE(journal.append(dispatched(2)));
    }
    EXPECT_EQ(readBack(), (std::vector{dispatched(1), dispatched(2)}));
    EXPECT_TRUE(findings.empty());
}

TEST_F(FileJournalTest, BadLinesArePassedOverAndToldOnceWithTheNumberOfTheFirst) {
    { FileJournal(folder, bounds).append(dispatched(1)); }
    write("not JSON\n[1, 2]\n{\"kind\":\"dispatched\",\"task\":\"short\"}\n{\"kind\":\"dreamt\"}\n");
    write("{\"kind\":\"granted\",\"lease\":\"12 monkeys\"}\n" + std::string(20'000, 'x') + '\n');
    { FileJournal(folder, bounds).append(dispatched(2)); }
    EXPECT_EQ(readBack(), (std::vector{dispatched(1), dispatched(2)}));
    ASSERT_EQ(findings.size(), 1U);
    EXPECT_NE(findings[0].find("tasks.jsonl:2: expected a JSON object"), std::string::npos) << findings[0];
    EXPECT_NE(findings[0].find("5 more lines"), std::string::npos) << findings[0];
}

TEST_F(FileJournalTest, ItStaysWithinItsBoundsAndKeepsTheNewest) {
    bounds = {.file_bytes = 1000, .files = 3};
    {
        FileJournal journal(folder, bounds);
        for (std::uint64_t i = 1; i <= 100; ++i) ASSERT_TRUE(journal.append(dispatched(i)));
    }
    std::uintmax_t bytes = 0;
    int files = 0;
    for (const auto& entry : fs::directory_iterator(folder)) {
        if (!entry.path().filename().string().starts_with("tasks")) continue;
        bytes += entry.file_size();
        ++files;
    }
    EXPECT_EQ(files, 3);
    EXPECT_LE(bytes, 3000U);
    const auto kept = readBack();
    ASSERT_GE(kept.size(), 8U);
    for (std::size_t i = 0; i < kept.size(); ++i) EXPECT_EQ(kept[i], dispatched(100 - kept.size() + 1 + i));
}

TEST_F(FileJournalTest, NoFloodOfOtherEntriesDrivesTheIdOfATaskOut) {
    bounds = {.file_bytes = 1000, .files = 2};
    {
        FileJournal journal(folder, bounds);
        ASSERT_TRUE(journal.append(dispatched(1)));
        for (int i = 0; i < 500; ++i)
            journal.append({.kind = Kind::Refused, .who = "client2@lab", .code = "NOT_HOLDER"});
    }
    const auto kept = readBack();
    EXPECT_EQ(std::count(kept.begin(), kept.end(), dispatched(1)), 1);
}

/// A pipe that nobody reads is a disk that does not answer.
TEST_F(FileJournalTest, NobodyWaitsForTheDiskThatIsToTakeADispatch) {
    const auto file = folder / "tasks.jsonl";
    ASSERT_EQ(::mkfifo(file.c_str(), 0600), 0);
    std::thread reader;
    {
        FileJournal journal(folder, bounds);
        std::vector<Later<bool>> answers;
        do answers.push_back(journal.appendDispatch(dispatched(answers.size())));
        while (answers.size() < 100'000 && (!answers.back().ready() || answers.back().value()));
        EXPECT_GE(answers.size(), FileJournal::kWaiting);
        ASSERT_TRUE(answers.back().ready()) << "there is no bound";
        reader = std::thread([&] {
            std::ifstream pipe(file, std::ios::binary);
            for (std::string line; std::getline(pipe, line);) {
            }
        });
        EXPECT_TRUE(answerOf(answers[answers.size() / 2]));
    }
    reader.join();
}

/// Likewise.
TEST_F(FileJournalTest, AStopAndADispatchDoNotWaitForTheFileOfTheOthers) {
    const auto file = folder / "journal.jsonl";
    ASSERT_EQ(::mkfifo(file.c_str(), 0600), 0);
    std::string arrived;
    std::thread reader;
    {
        FileJournal journal(folder, bounds);
        const JournalRecord stop{.kind = Kind::Stopped, .text = std::string(400, 's')};
        std::size_t taken = 0;
        while (taken < 100'000 && journal.append(stop)) ++taken;
        EXPECT_GE(taken, FileJournal::kWaiting);
        EXPECT_LT(taken, 100'000U) << "there is no bound";
        EXPECT_TRUE(answerOf(journal.appendDispatch(dispatched(1))));
        EXPECT_NE(text().find(dispatched(1).task.toString()), std::string::npos);
        reader = std::thread([&] {
            std::ifstream pipe(file, std::ios::binary);
            for (std::string line; std::getline(pipe, line);) arrived += line;
        });
    }
    reader.join();
    EXPECT_NE(arrived.find("stopped"), std::string::npos);
}

TEST_F(FileJournalTest, OnlyTheOwnerMayReadIt) {
    { FileJournal(folder, bounds).append(dispatched(1)); }
    EXPECT_EQ(fs::status(folder / "tasks.jsonl").permissions(),
              fs::perms::owner_read | fs::perms::owner_write);
}

TEST_F(FileJournalTest, LongTextsAreCut) {
    auto record = dispatched(1);
    record.text = std::string(100'000, 'x');
    { FileJournal(folder, bounds).append(record); }
    EXPECT_LT(text().size(), 1000U);
    ASSERT_EQ(readBack().size(), 1U);
}

TEST_F(FileJournalTest, AFolderThatCannotBeMadeIsAMisconfiguration) {
    std::ofstream(folder / "file") << "x";
    EXPECT_THROW(FileJournal(folder / "file" / "state"), fs::filesystem_error);
}

}  // namespace
}  // namespace axon::entity_manager
