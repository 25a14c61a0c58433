// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/storage/file_storage.hpp"
#include "entity_manager/storage/file_resources.hpp"
#include "entity_manager/storage/state_files.hpp"

#include <axon/transfer.pb.h>
#include <fcntl.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <stdlib.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <fstream>
#include <future>
#include <sstream>

#include "common/descriptor.hpp"
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
    template <class T>
    static T of(const Later<T>& answer) {
        EXPECT_TRUE(test::waitUntil([&] { return answer.ready(); }));
        return answer.value();
    }
    static Result<std::uint64_t> begin(FileResourceStore& store, const proto::ResourceOffer& offer,
                                       const std::string& owner = "user@host") {
        return of(store.begin(offer, owner));
    }
    /// All of it is there; the application accepts it.
    static Result<std::string> finish(FileResourceStore& store, const std::string& id) {
        if (auto checked = of(store.check(id)); !checked) return checked;
        return of(store.place(id));
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
    EXPECT_EQ(std::distance(fs::directory_iterator(folder / "s"), {}), 2) << "and the lock";
    EXPECT_EQ(std::distance(fs::directory_iterator(folder), {}), 1);
}

TEST_F(Folder, AValueLiesInAFileOfItsName) {
    FileStorage(folder).save("uuid", "one");
    EXPECT_EQ(content((folder / "uuid.state").string()), "one");
    EXPECT_EQ(fs::status(folder / "uuid.state").permissions(),
              fs::perms::owner_read | fs::perms::owner_write);
}

TEST_F(Folder, OneOfABuildBeforeTheFirstReleaseIsRefusedAndLeftAlone) {
    FileStorage(folder).save("free", "1");
    std::ofstream(folder / "75756964.value") << "one";
    try {
        const FileStorage storage(folder);
        FAIL() << "it was used";
    } catch (const std::runtime_error& error) {
        EXPECT_THAT(error.what(), testing::HasSubstr(folder.string() + " has 75756964.value"));
        EXPECT_THAT(error.what(), testing::HasSubstr("fix: name another folder with --state DIR"));
    }
    EXPECT_EQ(content((folder / "75756964.value").string()), "one");
    EXPECT_EQ(content((folder / "free.state").string()), "1");
    fs::remove(folder / "75756964.value");
    EXPECT_EQ(FileStorage(folder).load("free"), "1");
}

/// What a loss of power leaves of a write that was not over: the beginning of the new file, of any length.
TEST_F(Folder, TheBeginningOfAWriteIsNotReadAndNotInTheWay) {
    FileStorage(folder).save("latch", "old");
    const auto place = fs::directory_iterator(folder);
    const auto value = std::find_if(place, {}, [](const auto& entry) {
                           return entry.path().extension() == ".state";
                       })->path();
    const std::string fresh = "the new value";
    for (std::size_t length = 0; length <= fresh.size(); ++length) {
        std::ofstream(value.string() + ".new", std::ios::binary) << fresh.substr(0, length);
        FileStorage storage(folder);
        EXPECT_EQ(storage.load("latch"), "old") << length;
        storage.save("latch", "next");
        EXPECT_EQ(storage.load("latch"), "next") << length;
        storage.save("latch", "old");
    }
}

TEST_F(Folder, TheFolderHasOneUserAtATime) {
    {
        FileStorage first(folder);
        first.save("k", "1");
        try {
            FileStorage second(folder);
            FAIL() << "two lives of one robot";
        } catch (const std::runtime_error& error) {
            EXPECT_THAT(error.what(), testing::HasSubstr("process " + std::to_string(::getpid())));
            EXPECT_THAT(error.what(), testing::HasSubstr("--state DIR"));
        }
        EXPECT_EQ(first.load("k"), "1");
    }
    EXPECT_EQ(FileStorage(folder).load("k"), "1") << "the next life";
}

/// A file that does not answer, as on a disk that hangs: a pipe that is full.
struct StuckFile {
    explicit StuckFile(fs::path at) : path(std::move(at)) {
        EXPECT_EQ(::mkfifo(path.c_str(), 0600), 0);
        fd = Descriptor(::open(path.c_str(), O_RDWR | O_NONBLOCK));
        while (::write(fd.get(), "full", 4) > 0) {
        }
    }
    void release() const {
        fs::remove(path);  // first: what is written now must not be put in the place of the value
        char part[4096];
        while (::read(fd.get(), part, sizeof part) > 0) {
        }
    }
    const fs::path path;
    Descriptor fd;
};

TEST_F(Folder, WhatIsKeptIsNotWaitedForAndIsTriedUntilTheDiskHasIt) {
    const StuckFile stuck(folder / "k.state.new");  // of the key "k"
    {
        FileStorage storage(folder);
        storage.keep("k", "1");
        storage.keep("k", "2");
        EXPECT_EQ(storage.load("k"), std::nullopt);
        stuck.release();
    }
    EXPECT_EQ(FileStorage(folder).load("k"), "2");
    {
        const StuckFile again(folder / "k.state.new");
        FileStorage storage(folder);
        storage.keep("k", "3");
        storage.keep("k", "4");
        again.release();
        ASSERT_TRUE(test::waitUntil([&] { return storage.load("k") == "4"; }));
        storage.keep("k", "5");
        EXPECT_TRUE(test::waitUntil([&] { return storage.load("k") == "5"; })) << "it goes on afterwards";
    }
}

TEST_F(Folder, WhatIsForgottenIsNotWaitedForAndDoesNotComeBack) {
    const StuckFile stuck(folder / "k.state.new");
    {
        FileStorage storage(folder);
        storage.keep("k", "1");
        storage.forget("k");
        stuck.release();
    }
    EXPECT_EQ(FileStorage(folder).load("k"), std::nullopt);
}

TEST_F(Folder, NothingIsKeptWhileADeletionFails) {
    fs::create_directories(folder / "k.state");  // cannot be deleted as a file
    {
        FileStorage storage(folder);
        storage.forget("k");
        storage.keep("other", "1");
    }
    {
        FileStorage next(folder);
        EXPECT_EQ(next.load("other"), std::nullopt) << "a robot's latch is a deletion";
        fs::remove(folder / "k.state");
        next.forget("k");
        next.keep("other", "2");
    }
    EXPECT_EQ(FileStorage(folder).load("other"), "2");
}

TEST_F(Folder, WhatIsSuspendedIsKeptForItsOwner) {
    FileResourceStore store(folder);
    (void)begin(store, offer("t1", 3, kAbc), "one@host");
    ASSERT_TRUE(store.write("t1", 0, "ab").ok());
    store.suspend("t1");
    EXPECT_EQ(begin(store, offer("t2", 3, kAbc), "one@host").value(), 2U);
    store.suspend("t2");
    EXPECT_EQ(begin(store, offer("t3", 3, kAbc), "two@host").value(), 0U) << "it is somebody else's";
}

TEST_F(Folder, OfWhatIsSuspendedTheOldestGoesAboveTheBound) {
    FileResourceStore store(folder, 10);
    const auto keep = [&](const std::string& id, char hash, const std::string& content) {
        (void)begin(store, offer(id, 100, std::string(32, hash)));
        ASSERT_TRUE(store.write(id, 0, content).ok());
        ASSERT_TRUE(arrives(store, id));
        store.suspend(id);
        (void)of(store.absent({}));  // after all that
    };
    keep("t1", 'a', "1234");
    for (const auto& entry : fs::directory_iterator(folder / "incoming"))
        fs::last_write_time(entry, fs::file_time_type::clock::now() - std::chrono::hours{1});
    keep("t2", 'b', "1234");
    keep("t3", 'c', "1234");
    EXPECT_EQ(begin(store, offer("t4", 100, std::string(32, 'a'))).value(), 0U)
        << "twelve bytes are too many";
    EXPECT_EQ(begin(store, offer("t5", 100, std::string(32, 'b'))).value(), 4U);
    EXPECT_EQ(begin(store, offer("t6", 100, std::string(32, 'c'))).value(), 4U);
}

TEST_F(Folder, WhatNobodyHasGoneOnWithForADayIsDeletedAtTheStart) {
    {
        FileResourceStore store(folder);
        (void)begin(store, offer("t1", 3, kAbc));
        ASSERT_TRUE(store.write("t1", 0, "ab").ok());
        store.suspend("t1");
    }
    ASSERT_FALSE(fs::is_empty(folder / "incoming"));
    for (const auto& entry : fs::directory_iterator(folder / "incoming"))
        fs::last_write_time(entry, fs::file_time_type::clock::now() - FileResourceStore::kIncomingKept);
    { const FileResourceStore next(folder); }
    EXPECT_TRUE(fs::is_empty(folder / "incoming"));
}

TEST_F(Folder, AResourceArrivesInPartsIsCheckedAndFoundAgain) {
    std::string path;
    {
        FileResourceStore store(folder);
        EXPECT_EQ(begin(store, offer("t1", 3, kAbc)).value(), 0U);
        ASSERT_TRUE(store.write("t1", 0, "ab").ok());
        EXPECT_FALSE(store.write("t1", 1, "c").ok()) << "does not continue";
        EXPECT_FALSE(store.write("t1", 2, "cd").ok()) << "more than offered";
        store.suspend("t1");
    }
    FileResourceStore store(folder);
    EXPECT_EQ(begin(store, offer("t2", 3, kAbc)).value(), 2U) << "resumes after a restart";
    ASSERT_TRUE(store.write("t2", 2, "c").ok());
    ASSERT_TRUE(arrives(store, "t2"));
    const auto placed = finish(store, "t2");
    ASSERT_TRUE(placed.ok()) << placed.refusal().message;
    EXPECT_EQ(content(placed.value()), "abc");
    EXPECT_EQ(fs::path(placed.value()).lexically_normal().string().find((folder / "resources").string()), 0U);
    EXPECT_EQ(store.find("Ser/../vice", ".."), placed.value());
    EXPECT_TRUE(of(store.absent({placed.value()})).empty());
    store.remove("Ser/../vice", "..");
    EXPECT_EQ(of(store.absent({placed.value()})), std::vector{placed.value()});
    EXPECT_EQ(store.find("Ser/../vice", ".."), std::nullopt);
    EXPECT_TRUE(fs::exists(folder / "resources"));
}

TEST_F(Folder, AWrongHashDeletesWhatArrivedAndKeepsTheOldFile) {
    FileResourceStore store(folder);
    (void)begin(store, offer("t1", 3, kAbc));
    ASSERT_TRUE(store.write("t1", 0, "abc").ok());
    ASSERT_TRUE(arrives(store, "t1"));
    ASSERT_TRUE(finish(store, "t1").ok());
    (void)begin(store, offer("t2", 3, std::string(32, 'h')));
    ASSERT_TRUE(store.write("t2", 0, "abd").ok());
    ASSERT_TRUE(arrives(store, "t2"));
    EXPECT_EQ(finish(store, "t2").refusal().code, RefusalCode::HashMismatch);
    EXPECT_EQ(content(*store.find("Ser/../vice", "..")), "abc");
    EXPECT_EQ(begin(store, offer("t3", 3, std::string(32, 'h'))).value(), 0U) << "nothing of it is left";
}

TEST_F(Folder, TheOldFileStaysUntilTheNewOneIsAccepted) {
    FileResourceStore store(folder);
    (void)begin(store, offer("t1", 3, kAbc));
    ASSERT_TRUE(store.write("t1", 0, "abc").ok());
    ASSERT_TRUE(arrives(store, "t1"));
    const auto old = finish(store, "t1").value();
    // SHA-256 of the empty text.
    const std::string empty(
        "\xe3\xb0\xc4\x42\x98\xfc\x1c\x14\x9a\xfb\xf4\xc8\x99\x6f\xb9\x24\x27\xae\x41\xe4\x64\x9b\x93\x4c\xa4"
        "\x95"
        "\x99\x1b\x78\x52\xb8\x55",
        32);
    for (const bool accepted : {false, true}) {
        (void)begin(store, offer("t2", 0, empty));
        const auto looked_at = of(store.check("t2")).value();
        EXPECT_NE(looked_at, old);
        EXPECT_EQ(content(looked_at), "");
        EXPECT_EQ(content(old), "abc");
        if (accepted) {
            EXPECT_EQ(of(store.place("t2")).value(), old);
        } else {
            store.drop("t2");
        }
        EXPECT_EQ(of(store.absent({looked_at})), std::vector{looked_at});
    }
    EXPECT_EQ(content(old), "");
}

TEST_F(Folder, ALaterLifeFindsWhatTheDiskHasAndNothingElse) {
    std::string path;
    {
        FileResourceStore store(folder);
        (void)begin(store, offer("t1", 3, kAbc));
        ASSERT_TRUE(store.write("t1", 0, "abc").ok());
        ASSERT_TRUE(arrives(store, "t1"));
        path = finish(store, "t1").value();
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
        (void)begin(*killed, offer("t1", 40U << 20U, kAbc));
        for (std::uint64_t i = 0; i < 20; ++i) ASSERT_TRUE(killed->write("t1", i << 20U, megabyte).ok());
        ASSERT_TRUE(arrives(*killed, "t1"));
        FileResourceStore next(folder);
        EXPECT_EQ(begin(next, offer("t2", 40U << 20U, kAbc)).value(), 16U << 20U);
        delete killed;
    }
    for (const auto& entry : fs::directory_iterator(folder / "incoming"))
        if (entry.path().extension() == ".state") std::ofstream(entry.path()) << "damaged";
    FileResourceStore next(folder);
    EXPECT_EQ(begin(next, offer("t3", 40U << 20U, kAbc)).value(), 0U) << "a damaged note is worth nothing";
}

TEST_F(Folder, NobodyWaitsForADiskThatDoesNotTakeWhatIsUploaded) {
    std::promise<void> release;
    const auto released = release.get_future().share();
    FileResourceStore store(folder);
    (void)begin(store, offer("t0", FileResourceStore::kBacklog + 1, std::string(32, 'h')));
    std::promise<void> stuck;
    store.onAnswer([&, released, first = true]() mutable {
        if (!std::exchange(first, false)) return;
        stuck.set_value();
        released.wait();  // as a call of the disk that does not return
    });
    const auto began = store.begin(offer("t1", 3, kAbc), "user@host");
    stuck.get_future().wait();
    ASSERT_TRUE(began.ready());
    ASSERT_TRUE(store.write("t1", 0, "ab").ok());
    ASSERT_TRUE(store.write("t1", 2, "c").ok());
    EXPECT_EQ(store.waiting("t1").value(), 3U);
    EXPECT_EQ(of(store.check("t1")).refusal().code, RefusalCode::WrongState) << "it is not there yet";
    store.suspend("t1");
    const auto again = store.begin(offer("t2", 3, kAbc), "user@host");
    EXPECT_FALSE(again.ready());
    EXPECT_EQ(store.write("t2", 0, "a").refusal().code, RefusalCode::WrongState);
    const auto looked = store.absent({folder / "none"});
    store.remove("Ser/../vice", "..");
    EXPECT_EQ(store.find("Ser/../vice", ".."), std::nullopt);
    EXPECT_FALSE(looked.ready());
    ASSERT_TRUE(store.write("t0", 0, std::string(FileResourceStore::kBacklog + 1, 'x')).ok());
    EXPECT_EQ(begin(store, offer("t3", 3, std::string(32, 'i'))).refusal().code, RefusalCode::Overloaded)
        << "what waits is bounded";
    release.set_value();
    EXPECT_EQ(of(again).value(), 3U) << "all that was taken has been written";
    EXPECT_EQ(of(looked), std::vector{(folder / "none").string()});
    EXPECT_EQ(content(finish(store, "t2").value()), "abc");
}

TEST_F(Folder, WhatABlockedDiskIsAskedIsBoundedToo) {
    std::promise<void> release;
    const auto released = release.get_future().share();
    FileResourceStore store(folder);
    (void)begin(store, offer("t0", 100'000, std::string(32, 'h')));
    std::promise<void> stuck;
    store.onAnswer([&, released, first = true]() mutable {
        if (!std::exchange(first, false)) return;
        stuck.set_value();
        released.wait();
    });
    ASSERT_TRUE(store.write("t0", 0, "x").ok());
    stuck.get_future().wait();
    std::uint64_t at = 1;
    Result<void> written;
    while ((written = store.write("t0", at, "x")).ok() && at < 50'000) ++at;
    EXPECT_EQ(written.refusal().code, RefusalCode::Overloaded) << at << " pieces of one byte";
    EXPECT_EQ(begin(store, offer("t1", 3, kAbc)).refusal().code, RefusalCode::Overloaded);
    const auto behind = store.absent({});
    release.set_value();
    of(behind);
    EXPECT_EQ(begin(store, offer("t2", 3, std::string(32, 'i'))).value(), 0U);
}

TEST_F(Folder, GivenUpAndGoneOnWithAgainAndAgainItIsWhole) {
    FileResourceStore store(folder);
    constexpr std::uint64_t kParts = 300;
    std::uint64_t at = 0;
    for (; at < kParts; ++at) {
        const auto id = "t" + std::to_string(at);
        ASSERT_EQ(begin(store, offer(id, kParts + 1, kAbc)).value(), at);
        ASSERT_TRUE(store.write(id, at, "x").ok());
        store.suspend(id);
    }
    ASSERT_EQ(begin(store, offer("last", kParts + 1, kAbc)).value(), at);
    ASSERT_TRUE(store.write("last", at, "x").ok());
    ASSERT_TRUE(arrives(store, "last"));
    EXPECT_EQ(finish(store, "last").refusal().code, RefusalCode::HashMismatch) << "of 301 x, not of abc";
    EXPECT_TRUE(fs::is_empty(folder / "incoming"));
}

TEST_F(Folder, ATransferThatIsNotKnownIsRefused) {
    FileResourceStore store(folder);
    EXPECT_EQ(store.write("no", 0, "x").refusal().code, RefusalCode::UnknownResource);
    EXPECT_EQ(finish(store, "no").refusal().code, RefusalCode::UnknownResource);
    EXPECT_EQ(of(store.place("no")).refusal().code, RefusalCode::UnknownResource);
    store.suspend("no");
    store.drop("no");
}

/// A store whose profile gives its resource a url below <folder>/profiles.
struct UrlFolder : Folder {
    UrlFolder() { fs::create_directories(folder / "profiles"); }
    std::vector<ResourcePlace> locate(FileResourceStore& store, const std::string& url,
                                      bool savable = true) const {
        return of(store.locate({(folder / "profiles").string(), {}}, {{"Ser/../vice", "..", url, savable}}));
    }
    void upload(FileResourceStore& store) const {
        ASSERT_TRUE(begin(store, offer("t1", 3, kAbc)).ok());
        ASSERT_TRUE(store.write("t1", 0, "abc").ok());
        ASSERT_TRUE(arrives(store, "t1"));
    }
    fs::path map() const { return fs::canonical(folder / "profiles") / "maps/lab.map"; }
};

TEST_F(UrlFolder, AnUploadReplacesTheFileThatTheUrlNamesOnceItIsAccepted) {
    fs::create_directories(map().parent_path());
    std::ofstream(map()) << "old one";
    {
        FileResourceStore store(folder / "state");
        EXPECT_EQ(locate(store, "maps/lab.map")[0].size, 7U);
        upload(store);
        ASSERT_TRUE(of(store.check("t1")).ok());
        EXPECT_EQ(content(map()), "old one") << "nobody has accepted it yet";
        EXPECT_EQ(of(store.place("t1")).value(), map());
        EXPECT_EQ(content(map()), "abc");
    }
    FileResourceStore store(folder / "state");
    const auto place = locate(store, "maps/lab.map")[0];
    EXPECT_EQ(place.path, map());
    EXPECT_EQ(place.size, 3U);
    EXPECT_TRUE(of(store.absent({map()})).empty());
    store.remove("Ser/../vice", "..");
    EXPECT_EQ(of(store.absent({map()})).size(), 1U);
    EXPECT_TRUE(fs::is_empty(folder / "state/incoming"));
}

TEST_F(UrlFolder, WhatMayNotBeReplacedIsRefusedBeforeItIsSent) {
    std::ofstream(folder / "profiles/lab.map") << "old one";
    fs::permissions(folder / "profiles/lab.map", fs::perms::owner_read);
    FileResourceStore store(folder / "state");
    EXPECT_TRUE(locate(store, "lab.map")[0].there);
    const auto refused = begin(store, offer("t1", 3, kAbc));
    ASSERT_FALSE(refused.ok());
    EXPECT_EQ(refused.refusal().code, RefusalCode::PermissionDenied);
    EXPECT_FALSE(locate(store, "/etc/passwd")[0].refusal.ok());
    EXPECT_EQ(begin(store, offer("t2", 3, kAbc)).refusal().code, RefusalCode::BadName);
}

TEST_F(UrlFolder, WhatBecomesForbiddenMeanwhileLeavesTheOldFileAndTheUpload) {
    FileResourceStore store(folder / "state");
    (void)locate(store, "maps/lab.map");
    upload(store);
    ASSERT_TRUE(of(store.check("t1")).ok());
    fs::create_directories(folder / "outside");
    fs::create_directory_symlink(folder / "outside", folder / "profiles/maps");
    EXPECT_EQ(of(store.place("t1")).refusal().code, RefusalCode::BadName);
    EXPECT_TRUE(fs::is_empty(folder / "outside"));
    store.suspend("t1");
    EXPECT_EQ(begin(store, offer("t2", 3, kAbc)).refusal().code, RefusalCode::BadName);
}

TEST_F(UrlFolder, WithoutAUrlTheStateFolderHasItWithItsSizeInTheNextLifeToo) {
    {
        FileResourceStore store(folder / "state");
        (void)locate(store, "");
        upload(store);
        ASSERT_TRUE(finish(store, "t1").ok());
        EXPECT_EQ(locate(store, "")[0].size, 3U);
    }
    FileResourceStore store(folder / "state");
    const auto answer = store.locate({}, {{"Ser/../vice", "..", "", true}, {"Ser/../vice", "..", "", false}});
    ASSERT_TRUE(answer.ready()) << "it is known without looking";
    EXPECT_TRUE(answer.value()[0].there);
    EXPECT_EQ(answer.value()[0].size, 3U);
    EXPECT_EQ(content(answer.value()[0].path), "abc");
    EXPECT_FALSE(answer.value()[1].there) << "not savable";
}

}  // namespace
}  // namespace axon::entity_manager
