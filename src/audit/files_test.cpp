// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/files.hpp"

#include <fcntl.h>
#include <gmock/gmock.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <stdexcept>

#include "audit/testing.hpp"

namespace axon::audit {
namespace {

namespace fs = std::filesystem;
using testing::HasSubstr;
using testing::IsEmpty;

Record record(const std::string& what, const std::string& kind = "stop") {
    Record its;
    its.at = utcTime(1'790'000'000'000'000);
    its.kind = kind;
    its.what = what;
    return its;
}

struct AuditFiles : testing::Test {
    TrailFolder folder;
    Files::Bounds bounds;
};

TEST_F(AuditFiles, EachRecordNamesTheHashOfTheLineBeforeIt) {
    Files files(folder.path, "server", bounds);
    ASSERT_TRUE(files.append(record("one")));
    ASSERT_TRUE(files.append(record("two")));
    const auto text = folder.text("server.1.jsonl");
    const auto end = text.find('\n');
    const auto all = folder.records();
    ASSERT_EQ(all.size(), 2U);
    EXPECT_EQ(all[0].number, 1U);
    EXPECT_EQ(all[0].before, kNoHash);
    EXPECT_EQ(all[1].number, 2U);
    EXPECT_EQ(all[1].before, hashOf(text.substr(0, end)));
    EXPECT_TRUE(folder.chain().whole());
    struct stat facts {};
    ASSERT_EQ(::stat((folder.path / "server.1.jsonl").c_str(), &facts), 0);
    EXPECT_EQ(facts.st_mode & 0777U, 0600U);
}

TEST_F(AuditFiles, TheNextLifeGoesOn) {
    for (int life = 0; life < 3; ++life) {
        Files files(folder.path, "server", bounds);
        EXPECT_EQ(files.unfinished(), 0U);
        EXPECT_TRUE(files.append(record("a")));
        EXPECT_TRUE(files.append(record("b")));
    }
    const auto chain = folder.chain();
    EXPECT_THAT(chain.faults, IsEmpty());
    EXPECT_EQ(chain.records, 6U);
    EXPECT_EQ(chain.last, 6U);
}

TEST_F(AuditFiles, ANewFileGoesOnWithTheChainAndTheOldestIsDeleted) {
    bounds = {1000, 3};
    for (int life = 0; life < 4; ++life) {
        Files files(folder.path, "server", bounds);
        for (int i = 0; i < 10; ++i) ASSERT_TRUE(files.append(record(std::string(100, 'x'))));
    }
    const auto files = trailFiles(folder.path).at("server");
    EXPECT_EQ(files.size(), 3U);
    for (const auto& [number, path] : files) EXPECT_LE(fs::file_size(path), 1000U);
    const auto chain = folder.chain();
    EXPECT_THAT(chain.faults, IsEmpty());
    EXPECT_GT(chain.first, 1U);
    EXPECT_EQ(chain.last, 40U);
    EXPECT_EQ(chain.last - chain.first + 1, chain.records);
}

TEST_F(AuditFiles, FewerFilesThanBeforeAreKeptFromTheNextLifeOn) {
    bounds = {1000, 8};
    const auto fill = [this](int records) {
        Files files(folder.path, "server", bounds);
        for (int i = 0; i < records; ++i) ASSERT_TRUE(files.append(record(std::string(100, 'x'))));
    };
    fill(60);
    ASSERT_EQ(trailFiles(folder.path).at("server").size(), 8U);
    bounds.files = 2;
    fill(0);
    EXPECT_EQ(trailFiles(folder.path).at("server").size(), 2U);
    EXPECT_THAT(folder.chain().faults, IsEmpty());
    fill(30);
    EXPECT_EQ(trailFiles(folder.path).at("server").size(), 2U);
    EXPECT_THAT(folder.chain().faults, IsEmpty());
}

// What a kill between the next file and the deletion leaves, or a deletion that has failed.
TEST_F(AuditFiles, AnOldFileThatIsLeftIsDeletedWithTheNext) {
    bounds = {10, 2};
    Files files(folder.path, "server", bounds);
    for (int i = 0; i < 4; ++i) ASSERT_TRUE(files.append(record("a")));
    folder.write("server.1.jsonl", "left\n");
    ASSERT_TRUE(files.append(record("a")));
    EXPECT_FALSE(fs::exists(folder.path / "server.1.jsonl"));
    EXPECT_THAT(folder.chain().faults, IsEmpty());
}

TEST_F(AuditFiles, ARecordThatIsLargerThanAFileIsWrittenAllTheSame) {
    bounds = {10, 2};
    Files files(folder.path, "server", bounds);
    for (int i = 0; i < 3; ++i) EXPECT_TRUE(files.append(record("more than ten bytes")));
    EXPECT_TRUE(folder.chain().whole());
    EXPECT_EQ(folder.chain().records, 2U);
}

TEST_F(AuditFiles, AnEmptyNewFileDoesNotBreakTheChain) {
    {
        Files files(folder.path, "server", bounds);
        ASSERT_TRUE(files.append(record("one")));
    }
    folder.write("server.2.jsonl", "");
    Files files(folder.path, "server", bounds);
    ASSERT_TRUE(files.append(record("two")));
    EXPECT_EQ(folder.chain().last, 2U);
    EXPECT_TRUE(folder.chain().whole());
}

TEST_F(AuditFiles, WhatAFullDiskDoesNotTakeIsTriedAgainAndWhatItTookInPartIsFinished) {
    std::size_t room = 0;
    const auto write = [&room](int fd, const char* bytes, std::size_t count) -> ssize_t {
        const auto fits = std::min(room, count);
        if (fits == 0) {
            errno = ENOSPC;
            return -1;
        }
        room -= fits;
        return ::write(fd, bytes, fits);
    };
    Files files(folder.path, "server", bounds, write);
    // So many bytes of the record fit at first: none, some, all but the end of the line.
    const std::size_t length = lineOf(record("one")).size() + kNoHash.size();
    for (std::size_t first = 0; first < length; ++first) {
        room = first;
        const bool taken = files.append(record("one"));
        EXPECT_EQ(taken, first > 0);
        EXPECT_EQ(files.error(), ENOSPC);
        room = 1000;
        EXPECT_TRUE(files.finish());
        if (!taken) EXPECT_TRUE(files.append(record("one")));
    }
    const auto chain = folder.chain();
    EXPECT_THAT(chain.faults, IsEmpty());
    EXPECT_THAT(chain.unfinished, IsEmpty());
    EXPECT_EQ(chain.records, length);
}

// What a kill or a loss of power leaves of the last record, at each of its bytes.
TEST_F(AuditFiles, TheNextLifeEndsALineThatIsCutOffAnywhereAndGoesOn) {
    {
        Files files(folder.path, "server", bounds);
        ASSERT_TRUE(files.append(record("one")));
        ASSERT_TRUE(files.append(record("two")));
    }
    const auto text = folder.text("server.1.jsonl");
    const auto second = text.find('\n') + 1;
    for (auto cut = second; cut <= text.size(); ++cut) {
        folder.write("server.1.jsonl", text.substr(0, cut));
        const bool part = cut > second && cut < text.size() - 1;
        const auto before = folder.chain();
        EXPECT_TRUE(before.whole()) << cut;
        EXPECT_EQ(before.unfinished.size(), part ? 1U : 0U) << cut;
        {
            Files files(folder.path, "server", bounds);
            EXPECT_EQ(files.unfinished(), part ? cut - second : 0U) << cut;
            ASSERT_TRUE(files.append(record("on", "started")));
        }
        const auto after = folder.chain();
        EXPECT_TRUE(after.whole()) << cut;
        EXPECT_EQ(after.unfinished.size(), part ? 1U : 0U) << cut;
        EXPECT_EQ(after.last, part || cut == second ? 2U : 3U) << cut;
        EXPECT_EQ(folder.text("server.1.jsonl").compare(0, cut, text, 0, cut), 0) << "something was cut off";
    }
}

// A kill after the line was ended, and before the record that says so.
TEST_F(AuditFiles, ALineThatWasEndedByALifeThatWasKilledTooIsToldByTheNext) {
    {
        Files files(folder.path, "server", bounds);
        ASSERT_TRUE(files.append(record("one")));
    }
    const auto text = folder.text("server.1.jsonl") + "{\"n\":2,\"at";
    folder.write("server.1.jsonl", text + '\n');
    Files files(folder.path, "server", bounds);
    EXPECT_EQ(files.unfinished(), 10U);
    ASSERT_TRUE(files.append(record("on", "started")));
    EXPECT_THAT(folder.chain().faults, IsEmpty());
    EXPECT_EQ(folder.chain().unfinished.size(), 1U);
}

TEST_F(AuditFiles, AFileThatMayNotGrowIsTriedAgainLikeAFullDisk) {
    int tries = 0;
    const auto write = [&tries](int fd, const char* bytes, std::size_t count) -> ssize_t {
        if (++tries > 1) return ::write(fd, bytes, count);
        errno = EFBIG;
        return -1;
    };
    Files files(folder.path, "server", bounds, write);
    EXPECT_FALSE(files.append(record("one")));
    EXPECT_TRUE(files.append(record("one")));
}

// A real process, killed while it writes: all but the last record are whole.
TEST_F(AuditFiles, AKillCostsNoRecordButTheOneThatIsBeingWritten) {
    std::uint64_t told = 0;
    for (int round = 0; round < 3; ++round) {
        int written[2];
        ASSERT_EQ(::pipe(written), 0);
        ::fcntl(written[1], F_SETPIPE_SZ, 4096);  // the child is not far ahead of what is read
        const auto child = ::fork();
        ASSERT_GE(child, 0);
        if (child == 0) {
            Files files(folder.path, "server", bounds);
            for (int i = 0;; ++i) {
                if (!files.append(record("record of a process that is killed", i == 0 ? "started" : "stop")))
                    ::_exit(1);
                const char one = 1;
                if (::write(written[1], &one, 1) != 1) ::_exit(1);
            }
        }
        ::close(written[1]);
        char one = 0;
        const auto enough = told + 200;
        while (told < enough && ::read(written[0], &one, 1) == 1) ++told;
        ::kill(child, SIGKILL);
        int status = 0;
        ::waitpid(child, &status, 0);
        while (::read(written[0], &one, 1) == 1) ++told;
        ::close(written[0]);
        ASSERT_TRUE(WIFSIGNALED(status));
        const auto chain = folder.chain();
        EXPECT_THAT(chain.faults, IsEmpty());
        EXPECT_LE(chain.unfinished.size(), static_cast<std::size_t>(round + 1));
        EXPECT_GE(chain.records, told) << "a record that was told of is not there";
    }
}

TEST_F(AuditFiles, OnlyOneProcessHasATrail) {
    const Files files(folder.path, "server", bounds);
    const Files other(folder.path, "manager", bounds);
    try {
        const Files again(folder.path, "server", bounds);
        FAIL() << "two have one trail";
    } catch (const std::runtime_error& error) {
        EXPECT_THAT(error.what(), HasSubstr("Axon.Audit.Folder"));
    }
}

TEST_F(AuditFiles, AFolderThatCannotBeUsedIsNamedWithTheFix) {
    folder.write("file", "");
    try {
        const Files files(folder.path / "file", "server", bounds);
        FAIL() << "a file is no folder";
    } catch (const std::runtime_error& error) {
        EXPECT_THAT(error.what(), HasSubstr((folder.path / "file").string()));
        EXPECT_THAT(error.what(), HasSubstr("fix:"));
    }
    fs::create_symlink("/dev/null", folder.path / "server.1.jsonl");
    EXPECT_THROW(Files(folder.path, "server", bounds), std::runtime_error);
    ::mkfifo((folder.path / "pipe.1.jsonl").c_str(), 0600);
    EXPECT_THROW(Files(folder.path, "pipe", bounds), std::runtime_error);
}

TEST_F(AuditFiles, AFolderOrFileThatOthersMayWriteToIsRefused) {
    const auto complaint = [this] {
        try {
            const Files files(folder.path, "server", bounds);
        } catch (const std::runtime_error& error) {
            return std::string(error.what());
        }
        return std::string();
    };
    for (const auto mode : {0720U, 0702U, 0777U}) {
        ASSERT_EQ(::chmod(folder.path.c_str(), mode), 0);
        EXPECT_THAT(complaint(), HasSubstr("fix: chmod 700 " + folder.path.string()));
    }
    ASSERT_EQ(::chmod(folder.path.c_str(), 0755), 0);
    EXPECT_EQ(complaint(), "");
    const auto file = folder.path / "server.1.jsonl";
    ASSERT_EQ(::chmod(file.c_str(), 0660), 0);
    EXPECT_THAT(complaint(), HasSubstr("fix: chmod 600 " + file.string()));
    ASSERT_EQ(::chmod(file.c_str(), 0600), 0);
    if (::geteuid() != 0) return;
    ASSERT_EQ(::chown(file.c_str(), 12345, 12345), 0);
    EXPECT_THAT(complaint(), HasSubstr("belongs to another user"));
    ASSERT_EQ(::chown(file.c_str(), 0, 0), 0);
    ASSERT_EQ(::chown(folder.path.c_str(), 12345, 12345), 0);
    EXPECT_THAT(complaint(), HasSubstr("belongs to another user"));
}

TEST_F(AuditFiles, AFileIsOnTheDiskBeforeTheNextBegins) {
    bounds = {10, 8};
    int synced = 0;
    Files files(folder.path, "server", bounds, {}, [&](int fd) {
        struct stat facts {};
        EXPECT_EQ(::fstat(fd, &facts), 0);
        EXPECT_GT(facts.st_size, 10);
        ++synced;
        return 0;
    });
    files.sync();
    EXPECT_EQ(synced, 0) << "nothing was written";
    ASSERT_TRUE(files.append(record("one")));
    ASSERT_TRUE(files.append(record("two")));
    EXPECT_EQ(synced, 1);
    files.sync();
    files.sync();
    EXPECT_EQ(synced, 2);
}

TEST_F(AuditFiles, NoNameIsAPath) {
    EXPECT_EQ(safeName("axon-server_1"), "axon-server_1");
    EXPECT_EQ(safeName("../a.b"), "%2E%2E%2Fa%2Eb");
    EXPECT_EQ(safeName(""), "%");
    EXPECT_EQ(safeName(std::string(64, 'a')), std::string(64, 'a'));
    Files files(folder.path, "../a.b", bounds);
    ASSERT_TRUE(files.append(record("one")));
    EXPECT_TRUE(fs::exists(folder.path / "%2E%2E%2Fa%2Eb.1.jsonl"));
}

TEST_F(AuditFiles, NamesThatBeginAlikeHaveTrailsOfTheirOwnHoweverLong) {
    const std::string begin(64, 'a');
    EXPECT_NE(safeName(begin + "1"), safeName(begin + "2"));
    EXPECT_NE(safeName(begin), safeName(begin + "a"));
    // Of any length, and of bytes that take three characters each.
    for (const auto& name : {begin + "1", begin + "2", std::string(10'000, '/'), std::string(64, '/')}) {
        EXPECT_LT(safeName(name).size(), 230U);
        Files files(folder.path, name, bounds);
        EXPECT_TRUE(files.append(record("one")));
    }
    EXPECT_EQ(trailFiles(folder.path).size(), 4U);
}

TEST_F(AuditFiles, OtherFilesOfTheFolderAreNoTrail) {
    for (const auto* name : {"journal.jsonl", ".1.jsonl", "a.01.jsonl", "a.x.jsonl", "a.1.json", "a.-1.jsonl",
                             "a.99999999999999999999999.jsonl"})
        folder.write(name, "x\n");
    EXPECT_THAT(trailFiles(folder.path), IsEmpty());
}

}  // namespace
}  // namespace axon::audit
