// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/file_storage.hpp"

#include <axon/transfer.pb.h>
#include <fcntl.h>
#include <gtest/gtest.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <fstream>
#include <future>
#include <sstream>

#include "support/loopback.hpp"

namespace axon::entity_manager {
namespace {

namespace fs = std::filesystem;

// SHA-256 of "abc" (FIPS 180-2, appendix B.1).
const std::string kAbc(
    "\xba\x78\x16\xbf\x8f\x01\xcf\xea\x41\x41\x40\xde\x5d\xae\x22\x23\xb0\x03\x61\xa3\x96\x17\x7a\x9c\xb4\x10"
    "\xff\x61\xf2"
    "\x00\x15\xad",
    32);

struct Folder : testing::Test {
    Folder() {
        char name[] = "/tmp/axon-store-XXXXXX";
        folder = ::mkdtemp(name);
    }
    ~Folder() override { fs::remove_all(folder); }
    static proto::ResourceOffer offer(const std::string& id, std::uint64_t size, const std::string& sha256) {
        proto::ResourceOffer made;
        made.set_transfer_id(id);
        made.set_service("Ser/../vice");
        made.set_resource("..");
        made.set_size(size);
        made.set_sha256(sha256);
        return made;
    }
    /// The thread that writes has written it.
    static bool arrives(const FileResourceStore& store, const std::string& id) {
        return test::waitUntil([&] { return store.waiting(id).value() == 0; });
    }
    static std::string content(const std::string& path) {
        std::stringstream text;
        text << std::ifstream(path).rdbuf();
        return text.str();
    }
    fs::path folder;
};

TEST_F(Folder, OneThatCannotBeMadeIsNamedWithWhatToDo) {
    std::ofstream(folder / "file") << "x";
    try {
        const FileStorage storage(folder / "file" / "state");
        FAIL() << "it was made";
    } catch (const std::runtime_error& error) {
        const std::string said = error.what();
        EXPECT_EQ(said.find("the state folder " + (folder / "file" / "state").string() +
                            " cannot be made or used: "),
                  0U)
            << said;
        EXPECT_NE(said.find("fix: "), std::string::npos) << said;
        EXPECT_EQ(said.find("filesystem error"), std::string::npos) << said;
    }
}

TEST_F(Folder, AValueSurvivesAndNoKeyLeavesTheFolder) {
    FileStorage(folder / "s").save("../../etc/uuid", "one");
    FileStorage storage(folder / "s");
    EXPECT_EQ(storage.load("../../etc/uuid"), "one");
    storage.save("../../etc/uuid", std::string("two\0x", 5));
    EXPECT_EQ(storage.load("../../etc/uuid"), std::string("two\0x", 5));
    EXPECT_EQ(storage.load("other"), std::nullopt);
    EXPECT_EQ(std::distance(fs::directory_iterator(folder / "s"), {}), 1);
    EXPECT_EQ(std::distance(fs::directory_iterator(folder), {}), 1);
}

/// A file that does not answer, as on a disk that hangs: a pipe that is full.
struct StuckFile {
    explicit StuckFile(fs::path at) : path(std::move(at)) {
        EXPECT_EQ(::mkfifo(path.c_str(), 0600), 0);
        fd = ::open(path.c_str(), O_RDWR | O_NONBLOCK);
        while (::write(fd, "full", 4) > 0) {
        }
    }
    ~StuckFile() { ::close(fd); }
    void release() const {
        char part[4096];
        while (::read(fd, part, sizeof part) > 0) {
        }
        fs::remove(path);
    }
    const fs::path path;
    int fd;
};

TEST_F(Folder, WhatIsKeptIsNotWaitedForAndIsTriedUntilTheDiskHasIt) {
    const StuckFile stuck(folder / "6b.value.new");  // of the key "k"
    {
        FileStorage storage(folder);
        storage.keep("k", "1");
        storage.keep("k", "2");
        EXPECT_EQ(storage.load("k"), std::nullopt);
        stuck.release();
    }
    EXPECT_EQ(FileStorage(folder).load("k"), "2");
}

TEST_F(Folder, WhatIsForgottenDoesNotComeBack) {
    const StuckFile stuck(folder / "6b.value.new");
    {
        FileStorage storage(folder);
        storage.keep("k", "1");
        storage.forget("k");
        stuck.release();
    }
    EXPECT_EQ(FileStorage(folder).load("k"), std::nullopt);
}

TEST_F(Folder, WhatIsSuspendedGoesWithItsHolderAndWhatIsUnderWayStays) {
    FileResourceStore store(folder);
    (void)store.begin(offer("t1", 3, kAbc));
    ASSERT_TRUE(store.write("t1", 0, "ab").ok());
    store.suspend("t1");
    (void)store.begin(offer("t2", 3, std::string(32, 'h')));
    ASSERT_TRUE(store.write("t2", 0, "a").ok());
    store.dropSuspended();
    EXPECT_EQ(store.begin(offer("t3", 3, kAbc)).value(), 0U) << "nothing of it is left";
    EXPECT_TRUE(store.write("t2", 1, "b").ok());
    store.suspend("t2");
    EXPECT_EQ(store.begin(offer("t4", 3, std::string(32, 'h'))).value(), 2U);
}

TEST_F(Folder, WhatNobodyHasGoneOnWithForADayIsDeletedAtTheStart) {
    {
        FileResourceStore store(folder);
        (void)store.begin(offer("t1", 3, kAbc));
        ASSERT_TRUE(store.write("t1", 0, "ab").ok());
    }
    for (const auto& entry : fs::directory_iterator(folder / "incoming"))
        fs::last_write_time(entry, fs::file_time_type::clock::now() - FileResourceStore::kIncomingKept);
    { const FileResourceStore next(folder); }
    EXPECT_TRUE(fs::is_empty(folder / "incoming"));
}

TEST_F(Folder, AResourceArrivesInPartsIsCheckedAndFoundAgain) {
    std::string path;
    {
        FileResourceStore store(folder);
        EXPECT_EQ(store.begin(offer("t1", 3, kAbc)).value(), 0U);
        ASSERT_TRUE(store.write("t1", 0, "ab").ok());
        EXPECT_FALSE(store.write("t1", 1, "c").ok()) << "does not continue";
        EXPECT_FALSE(store.write("t1", 2, "cd").ok()) << "more than offered";
        store.suspend("t1");
    }
    FileResourceStore store(folder);
    EXPECT_EQ(store.begin(offer("t2", 3, kAbc)).value(), 2U) << "resumes after a restart";
    ASSERT_TRUE(store.write("t2", 2, "c").ok());
    ASSERT_TRUE(arrives(store, "t2"));
    const auto placed = store.finish("t2");
    ASSERT_TRUE(placed.ok()) << placed.refusal().message;
    EXPECT_EQ(content(placed.value()), "abc");
    EXPECT_EQ(fs::path(placed.value()).lexically_normal().string().find((folder / "resources").string()), 0U);
    EXPECT_EQ(store.find("Ser/../vice", ".."), placed.value());
    store.remove("Ser/../vice", "..");
    EXPECT_EQ(store.find("Ser/../vice", ".."), std::nullopt);
    EXPECT_TRUE(fs::exists(folder / "resources"));
}

TEST_F(Folder, AWrongHashDeletesWhatArrivedAndKeepsTheOldFile) {
    FileResourceStore store(folder);
    (void)store.begin(offer("t1", 3, kAbc));
    ASSERT_TRUE(store.write("t1", 0, "abc").ok());
    ASSERT_TRUE(arrives(store, "t1"));
    ASSERT_TRUE(store.finish("t1").ok());
    (void)store.begin(offer("t2", 3, std::string(32, 'h')));
    ASSERT_TRUE(store.write("t2", 0, "abd").ok());
    ASSERT_TRUE(arrives(store, "t2"));
    EXPECT_EQ(store.finish("t2").refusal().code, RefusalCode::HashMismatch);
    EXPECT_EQ(content(*store.find("Ser/../vice", "..")), "abc");
    EXPECT_EQ(store.begin(offer("t3", 3, std::string(32, 'h'))).value(), 0U) << "nothing of it is left";
}

TEST_F(Folder, ALaterLifeFindsWhatTheDiskHasAndNothingElse) {
    std::string path;
    {
        FileResourceStore store(folder);
        (void)store.begin(offer("t1", 3, kAbc));
        ASSERT_TRUE(store.write("t1", 0, "abc").ok());
        ASSERT_TRUE(arrives(store, "t1"));
        path = store.finish("t1").value();
        EXPECT_EQ(store.find("Ser/../vice", ".."), path) << "at once in the same life";
    }  // which waits for the disk
    EXPECT_EQ(FileResourceStore(folder).find("Ser/../vice", ".."), path);
    std::ofstream(path, std::ios::app) << "d";
    EXPECT_EQ(FileResourceStore(folder).find("Ser/../vice", ".."), std::nullopt)
        << "not what was synchronised";
    std::ofstream(path) << "abc";
    fs::remove(fs::path(path).parent_path() / "stored");
    EXPECT_EQ(FileResourceStore(folder).find("Ser/../vice", ".."), std::nullopt)
        << "as after a loss of power";
}

TEST_F(Folder, AKilledUploadGoesOnWhereItsLastNoteWas) {
    const std::string megabyte(1U << 20U, 'x');
    {
        // Never suspended, never ended: as if the process had been killed.
        auto* killed = new FileResourceStore(folder);
        (void)killed->begin(offer("t1", 40U << 20U, kAbc));
        for (std::uint64_t i = 0; i < 20; ++i) ASSERT_TRUE(killed->write("t1", i << 20U, megabyte).ok());
        ASSERT_TRUE(arrives(*killed, "t1"));
        FileResourceStore next(folder);
        EXPECT_EQ(next.begin(offer("t2", 40U << 20U, kAbc)).value(), 16U << 20U);
        delete killed;
    }
    for (const auto& entry : fs::directory_iterator(folder / "incoming"))
        if (entry.path().extension() == ".state") std::ofstream(entry.path()) << "damaged";
    FileResourceStore next(folder);
    EXPECT_EQ(next.begin(offer("t3", 40U << 20U, kAbc)).value(), 0U) << "a damaged note is worth nothing";
}

TEST_F(Folder, NobodyWaitsForADiskThatDoesNotTakeWhatIsUploaded) {
    std::promise<void> release;
    const auto released = release.get_future().share();
    std::promise<void> stuck;
    FileResourceStore store(folder);
    store.onWritten([&, released, first = true]() mutable {
        if (!std::exchange(first, false)) return;
        stuck.set_value();
        released.wait();  // as a write that does not return
    });
    (void)store.begin(offer("t1", 3, kAbc));
    ASSERT_TRUE(store.write("t1", 0, "a").ok());
    stuck.get_future().wait();
    ASSERT_TRUE(store.write("t1", 1, "b").ok());
    ASSERT_TRUE(store.write("t1", 2, "c").ok());
    EXPECT_EQ(store.waiting("t1").value(), 2U);
    EXPECT_EQ(store.finish("t1").refusal().code, RefusalCode::WrongState) << "it is not there yet";
    store.suspend("t1");
    EXPECT_EQ(store.begin(offer("t2", 3, kAbc)).value(), 3U) << "it goes on with what waits";
    EXPECT_EQ(store.waiting("t2").value(), 2U);
    store.suspend("t2");
    // Other content has nothing to wait for but its bytes.
    EXPECT_EQ(store.begin(offer("t3", FileResourceStore::kBacklog + 1, std::string(32, 'h'))).value(), 0U);
    ASSERT_TRUE(store.write("t3", 0, std::string(FileResourceStore::kBacklog + 1, 'x')).ok());
    EXPECT_EQ(store.begin(offer("t4", 3, std::string(32, 'i'))).refusal().code, RefusalCode::Overloaded)
        << "what waits is bounded";
    release.set_value();
    ASSERT_TRUE(arrives(store, "t3"));
    EXPECT_EQ(store.begin(offer("t5", 3, kAbc)).value(), 3U) << "all that was taken has been written";
    EXPECT_EQ(content(store.finish("t5").value()), "abc");
}

TEST_F(Folder, WhatGoesWithItsHolderWhileItIsBeingWrittenIsDeletedToo) {
    std::promise<void> release;
    const auto released = release.get_future().share();
    FileResourceStore store(folder);
    store.onWritten([released] { released.wait(); });
    (void)store.begin(offer("t1", 3, kAbc));
    ASSERT_TRUE(store.write("t1", 0, "ab").ok());
    store.suspend("t1");
    store.dropSuspended();
    EXPECT_EQ(store.begin(offer("t2", 3, kAbc)).refusal().code, RefusalCode::Overloaded) << "not that file again";
    release.set_value();
    ASSERT_TRUE(test::waitUntil([&] { return fs::is_empty(folder / "incoming"); }));
    EXPECT_EQ(store.begin(offer("t2", 3, kAbc)).value(), 0U);
}

TEST_F(Folder, GivenUpAndGoneOnWithAgainAndAgainItIsWhole) {
    FileResourceStore store(folder);
    constexpr std::uint64_t kParts = 300;
    std::uint64_t at = 0;
    for (; at < kParts; ++at) {
        const auto id = "t" + std::to_string(at);
        ASSERT_EQ(store.begin(offer(id, kParts + 1, kAbc)).value(), at);
        ASSERT_TRUE(store.write(id, at, "x").ok());
        store.suspend(id);
    }
    ASSERT_EQ(store.begin(offer("last", kParts + 1, kAbc)).value(), at);
    ASSERT_TRUE(store.write("last", at, "x").ok());
    ASSERT_TRUE(arrives(store, "last"));
    EXPECT_EQ(store.finish("last").refusal().code, RefusalCode::HashMismatch) << "of 301 x, not of abc";
    EXPECT_TRUE(fs::is_empty(folder / "incoming"));
}

TEST_F(Folder, ATransferThatIsNotKnownIsRefused) {
    FileResourceStore store(folder);
    EXPECT_EQ(store.write("no", 0, "x").refusal().code, RefusalCode::UnknownResource);
    EXPECT_EQ(store.finish("no").refusal().code, RefusalCode::UnknownResource);
    store.suspend("no");
}

}  // namespace
}  // namespace axon::entity_manager
