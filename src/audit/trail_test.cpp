// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/trail.hpp"

#include <gmock/gmock.h>
#include <pthread.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <mutex>
#include <system_error>
#include <thread>

#include "audit/testing.hpp"
#include "support/loopback.hpp"

namespace axon::audit {
namespace {

using namespace std::chrono_literals;
using test::waitUntil;
using testing::Contains;
using testing::ElementsAre;
using testing::HasSubstr;
using testing::IsEmpty;
using testing::SizeIs;

/// Stands still until it is moved. Threads: any.
struct SharedClock final : Clock {
    TimePoint now() const override { return TimePoint(Duration(ns)); }
    void advance(Duration by) { ns += by.count(); }
    std::atomic<std::int64_t> ns{1'000'000'000'000};
};

struct AuditTrailTest : testing::Test {
    AuditTrailTest() {
        settings.folder = folder.path;
        settings.retry_first = 1ms;
        settings.retry_most = 4ms;
    }
    Trail::Report report() {
        return [this](const std::string& line) {
            const std::lock_guard lock(mutex);
            reports.push_back(line);
        };
    }
    std::vector<std::string> reported() {
        const std::lock_guard lock(mutex);
        return reports;
    }
    /// A disk that fails with `error` while `full` says so.
    Files::Write disk() {
        return [this](int fd, const char* bytes, std::size_t count) -> ssize_t {
            ++tries;
            if (full) {
                errno = error;
                return -1;
            }
            return ::write(fd, bytes, count);
        };
    }
    bool recorded(std::size_t records) {
        return waitUntil([&] { return folder.records().size() >= records; });
    }

    TrailFolder folder;
    TrailSettings settings;
    std::mutex mutex;
    std::vector<std::string> reports;
    std::atomic<bool> full{false};
    std::atomic<int> error{ENOSPC};
    std::atomic<int> tries{0};
};

TEST_F(AuditTrailTest, EveryKindIsRecordedAfterTheStartOfTheProgram) {
    {
        Trail trail(settings, "server", "axon-server 1.0", report());
        for (std::size_t i = 1; i < kKinds.size(); ++i)
            trail.note({static_cast<Kind>(i), "u", "n", "c", "p", "e", "w", "OK"});
    }
    const auto all = folder.records();
    ASSERT_THAT(all, SizeIs(kKinds.size()));
    EXPECT_EQ(all[0].what, "axon-server 1.0");
    for (std::size_t i = 0; i < kKinds.size(); ++i) EXPECT_EQ(all[i].kind, kKinds.at(i));
    const auto& last = all.back();
    EXPECT_EQ(last.user + last.name + last.client + last.peer + last.entity + last.what + last.outcome,
              "uncpewOK");
    EXPECT_TRUE(folder.chain().whole());
    EXPECT_THAT(reported(), IsEmpty());
}

TEST_F(AuditTrailTest, ARecordIsWrittenWithoutAnotherOneAfterIt) {
    Trail trail(settings, "server", "", report());
    for (std::size_t i = 1; i < 50; ++i) {
        trail.note({.kind = Kind::Stop});
        ASSERT_TRUE(recorded(i + 1));
    }
}

TEST_F(AuditTrailTest, AFullDiskHoldsUpNobodyAndIsReportedOnce) {
    settings.waiting = 16;
    Trail trail(settings, "server", "", report(), disk());
    ASSERT_TRUE(recorded(1));
    full = true;
    // Far more than can wait. It returns: nobody waits for the disk.
    for (int i = 0; i < 1000; ++i) trail.note({.kind = Kind::Stop, .what = "while the disk was full"});
    EXPECT_TRUE(waitUntil([&] { return !reported().empty(); }));
    const int so_far = tries;
    EXPECT_TRUE(waitUntil([&] { return tries > so_far + 3; })) << "it is not tried again";
    EXPECT_THAT(reported(), SizeIs(1));
    EXPECT_THAT(reported().front(), HasSubstr("No space left"));
    EXPECT_GE(trail.lost(), 980U);
    full = false;
    EXPECT_TRUE(waitUntil([&] { return trail.lost() == 0; }));
    trail.note({.kind = Kind::Stop, .what = "afterwards"});
    EXPECT_TRUE(waitUntil([&] { return folder.records().back().what == "afterwards"; }));
    EXPECT_THAT(reported(), ElementsAre(HasSubstr("cannot be written"), "audit: records are written again"));
    std::uint64_t lost = 0;
    std::size_t kept = 0;
    for (const auto& record : folder.records()) {
        if (record.kind == "lost") lost += std::stoull(record.what);
        if (record.what == "while the disk was full") ++kept;
    }
    EXPECT_EQ(lost + kept, 1000U);
    EXPECT_TRUE(folder.chain().whole());
}

/// In a child: its exit status is 0 if all went as it should.
int underALimitOfFiles(const TrailSettings& settings) {
    std::signal(SIGXFSZ, SIG_DFL);
    rlimit before{};
    ::getrlimit(RLIMIT_FSIZE, &before);
    auto low = before;
    low.rlim_cur = 1000;
    if (::setrlimit(RLIMIT_FSIZE, &low) != 0) return 2;
    std::atomic<bool> told{false}, over{false};
    const auto report = [&](const std::string& line) {
        if (line.find("fix: raise the limit of this process") != std::string::npos) told = true;
        if (line.find("records are written again") != std::string::npos) over = true;
    };
    Trail trail(settings, "server", "", report);
    sigset_t blocked, waiting;
    pthread_sigmask(SIG_SETMASK, nullptr, &blocked);
    sigpending(&waiting);
    if (sigismember(&blocked, SIGXFSZ) != 0 || sigismember(&waiting, SIGXFSZ) != 0) return 3;
    for (int i = 0; i < 20; ++i) trail.note({.kind = Kind::Stop, .what = std::to_string(i)});
    if (!waitUntil([&] { return told.load(); })) return 4;
    ::setrlimit(RLIMIT_FSIZE, &before);
    return waitUntil([&] { return over.load(); }) ? 0 : 5;
}

TEST_F(AuditTrailTest, ALimitOnTheSizeOfFilesEndsNoProgramThatDoesNotKnowOfIt) {
    const auto child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) ::_exit(underALimitOfFiles(settings));
    int status = 0;
    ::waitpid(child, &status, 0);
    ASSERT_TRUE(WIFEXITED(status)) << "it is ended by signal " << WTERMSIG(status);
    EXPECT_EQ(WEXITSTATUS(status), 0);
    EXPECT_THAT(folder.records(), SizeIs(21));
    EXPECT_THAT(folder.chain().faults, IsEmpty());
}

TEST_F(AuditTrailTest, ItsThreadIsOneForWhomNobodyWaits) {
    std::atomic<int> policy{-1};
    const Trail trail(settings, "server", "", report(), [&](int fd, const char* bytes, std::size_t count) {
        policy = ::sched_getscheduler(0);
        return ::write(fd, bytes, count);
    });
    EXPECT_TRUE(waitUntil([&] { return policy != -1; }));
    EXPECT_EQ(policy, SCHED_BATCH);
}

TEST_F(AuditTrailTest, TheEndOfTheProgramDoesNotWaitForAFullDisk) {
    full = true;
    {
        Trail trail(settings, "server", "", report(), disk());
        trail.note({.kind = Kind::Stop, .what = "while the disk was full"});
        EXPECT_TRUE(waitUntil([&] { return tries > 0; }));
    }
    EXPECT_THAT(reported(), Contains(HasSubstr("waits for the next start")));
    { const Trail trail(settings, "server", "again", report()); }
    const auto all = folder.records();
    ASSERT_THAT(all, SizeIs(2));
    EXPECT_EQ(all[0].kind, "started");
    EXPECT_THAT(all[0].what, HasSubstr("again; 1 record of the life before follows"));
    EXPECT_EQ(all[1].what, "while the disk was full");
    { const Trail trail(settings, "server", "", report()); }
    EXPECT_THAT(folder.records(), SizeIs(3)) << "it is written twice";
}

TEST_F(AuditTrailTest, AKillCostsNoNoteThatWasMadeBefore) {
    constexpr int kNotes = 500, kRounds = 5;
    for (int round = 0; round < kRounds; ++round) {
        const auto child = ::fork();
        ASSERT_GE(child, 0);
        if (child == 0) {
            Trail trail(settings, "server", "", [](const std::string&) {});
            // Some are in the file by then, and some wait for the thread, which looks every 10 ms.
            for (int i = 0; i < kNotes; ++i) {
                const auto what = std::to_string(round) + '/' + std::to_string(i);
                trail.note({.kind = Kind::Stop, .what = what});
                if (i % 100 == 0) std::this_thread::yield();
            }
            ::kill(::getpid(), SIGKILL);
        }
        int status = 0;
        ::waitpid(child, &status, 0);
        ASSERT_TRUE(WIFSIGNALED(status));
    }
    { const Trail trail(settings, "server", "", report()); }
    EXPECT_THAT(folder.chain().faults, IsEmpty());
    std::map<std::string, int> found;
    for (const auto& record : folder.records())
        if (record.kind == "stop") ++found[record.what];
    EXPECT_THAT(found, SizeIs(kNotes * kRounds));
    for (const auto& [what, times] : found) EXPECT_EQ(times, 1) << what;
}

TEST_F(AuditTrailTest, WhoAsksForMuchDrivesNoStopOutOfTheTrail) {
    settings.shares = {5, 10, 10};
    {
        Trail trail(settings, "server", "", report());
        for (int i = 0; i < 500; ++i) trail.note({.kind = i % 2 == 0 ? Kind::Command : Kind::Refusal});
        for (int i = 0; i < 500; ++i) trail.note({.kind = Kind::Stop});
    }
    std::map<std::string, int> kinds;
    int left_out = 0;
    for (const auto& record : folder.records()) {
        ++kinds[record.kind];
        if (record.kind == "lost") left_out += std::stoi(record.what);
    }
    EXPECT_EQ(kinds["stop"], 500);
    const int admitted = kinds["command"] + kinds["refusal"];
    EXPECT_LE(admitted, 30) << "a loop that takes more than two seconds";
    EXPECT_EQ(admitted + left_out, 500);
}

TEST_F(AuditTrailTest, AFloodIsToldOfOnceASecond) {
    settings.shares = {1, 1, 1};
    SharedClock clock;
    const auto lost = [this] {
        std::vector<std::string> all;
        for (const auto& record : folder.records())
            if (record.kind == "lost") all.push_back(record.what);
        return all;
    };
    {
        Trail trail(settings, "server", "", report(), {}, &clock);
        ASSERT_TRUE(recorded(1));
        trail.note({.kind = Kind::Command, .what = "admitted"});
        const auto stops = [this] {
            const auto all = folder.records();
            return static_cast<std::size_t>(
                std::count_if(all.begin(), all.end(), [](const auto& one) { return one.kind == "stop"; }));
        };
        // Each time its thread has looked after a command was left out.
        for (std::size_t i = 1; i <= 20; ++i) {
            trail.note({.kind = Kind::Command});
            trail.note({.kind = Kind::Stop});
            ASSERT_TRUE(waitUntil([&] { return stops() == i; }));
        }
        EXPECT_LE(lost().size(), 1U);
        clock.advance(1s);
        EXPECT_TRUE(waitUntil([&] { return !lost().empty(); }));
        EXPECT_LE(lost().size(), 2U);
        trail.note({.kind = Kind::Command, .what = "admitted"});
        trail.note({.kind = Kind::Command});
    }
    std::uint64_t left_out = 0;
    for (const auto& what : lost()) left_out += std::stoull(what);
    EXPECT_EQ(left_out, 21U) << "what is left out just before the end is not told";
    EXPECT_LE(lost().size(), 3U);
}

TEST_F(AuditTrailTest, TheDiskHasWhatWasWrittenWithinASecondAndAtTheEnd) {
    SharedClock clock;
    std::atomic<int> synced{0};
    const auto sync = [&synced](int) { return ++synced, 0; };
    {
        Trail trail(settings, "server", "", report(), {}, &clock, sync);
        EXPECT_TRUE(waitUntil([&] { return synced == 1; })) << "the start";
        for (std::size_t i = 2; i <= 10; ++i) {
            trail.note({.kind = Kind::Stop});
            ASSERT_TRUE(recorded(i));
        }
        EXPECT_EQ(synced, 1);
        clock.advance(1s);
        EXPECT_TRUE(waitUntil([&] { return synced == 2; }));
        trail.note({.kind = Kind::Stop});
        ASSERT_TRUE(recorded(11));
        EXPECT_EQ(synced, 2);
    }
    EXPECT_EQ(synced, 3);
}

TEST_F(AuditTrailTest, TheFixFitsWhatIsWrong) {
    for (const auto& [failure, fix] : {std::pair{ENOSPC, "fix: make room"},
                                       {EDQUOT, "fix: make room"},
                                       {EFBIG, "fix: raise the limit"},
                                       {EROFS, "fix: let this user write"},
                                       {EACCES, "fix: let this user write"}}) {
        error = failure;
        full = true;
        { const Trail trail(settings, "server", "", report(), disk()); }
        EXPECT_THAT(reported().front(),
                    testing::AllOf(HasSubstr(std::generic_category().message(failure)), HasSubstr(fix)));
        reports.clear();
    }
    error = EIO;
    { const Trail trail(settings, "server", "", report(), disk()); }
    EXPECT_THAT(reported().front(), testing::Not(HasSubstr("fix:")));
}

TEST_F(AuditTrailTest, ALineThatWasNotFinishedIsReportedAndRecorded) {
    { const Trail trail(settings, "server", "", report()); }
    folder.write("server.1.jsonl", folder.text("server.1.jsonl") + "{\"n\":2,\"at");
    { const Trail trail(settings, "server", "again", report()); }
    EXPECT_THAT(reported(), ElementsAre(HasSubstr("was not finished")));
    const auto all = folder.records();
    ASSERT_THAT(all, SizeIs(2));
    EXPECT_THAT(all.back().what, HasSubstr("not finished (10 bytes)"));
    EXPECT_TRUE(folder.chain().whole());
    EXPECT_THAT(folder.chain().unfinished, SizeIs(1));
}

TEST_F(AuditTrailTest, AProcessThatIsKilledLeavesAWholeTrail) {
    const auto child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
        Trail trail(settings, "server", "", [](const std::string&) {});
        while (true) trail.note({.kind = Kind::Stop, .what = "a stop"});
    }
    EXPECT_TRUE(waitUntil([&] {
        std::error_code not_yet;
        const auto size = std::filesystem::file_size(folder.path / "server.1.jsonl", not_yet);
        return !not_yet && size > 50'000;
    }));
    ::kill(child, SIGKILL);
    int status = 0;
    ::waitpid(child, &status, 0);
    const auto chain = folder.chain();
    EXPECT_THAT(chain.faults, IsEmpty());
    EXPECT_LE(chain.unfinished.size(), 1U);
    { const Trail trail(settings, "server", "", report()); }
    EXPECT_TRUE(folder.chain().whole());
}

TEST_F(AuditTrailTest, WhereThereIsNoTrailNothingHappens) {
    orNone(nullptr).note({.kind = Kind::Stop});
    Trail trail(settings, "server", "", report());
    EXPECT_EQ(&orNone(&trail), &trail);
}

}  // namespace
}  // namespace axon::audit
