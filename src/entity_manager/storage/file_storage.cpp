// SPDX-License-Identifier: GPL-2.0-or-later
#include "entity_manager/storage/file_storage.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <chrono>
#include <map>
#include <stdexcept>
#include <system_error>
#include <utility>

#include "entity_manager/storage/state_files.hpp"

namespace axon::entity_manager {

namespace fs = std::filesystem;

namespace {

constexpr std::chrono::seconds kTryAgain{1};
constexpr const char* kExtension = ".state";
// Of builds before the first release, which no release reads.
constexpr const char* kOldExtension = ".value";

[[noreturn]] void fail(const char* what, const fs::path& path) {
    throw std::system_error(errno, std::generic_category(), std::string(what) + ' ' + path.string());
}

/// Held until it is closed, also by a process that is killed. The file has the process id, for people.
Descriptor lockFolder(const fs::path& folder) {
    const auto path = folder / "lock";
    Descriptor file(::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
    if (!file.open()) fail("cannot open", path);
    if (::flock(file.get(), LOCK_EX | LOCK_NB) != 0) {
        if (errno != EWOULDBLOCK) fail("cannot lock", path);
        std::array<char, 32> holder{};
        const auto n = std::max<ssize_t>(::pread(file.get(), holder.data(), holder.size(), 0), 0);
        const std::string process(holder.data(), static_cast<std::size_t>(n));
        throw std::runtime_error("the state folder " + folder.string() +
                                 " is used by another Entity Manager" +
                                 (process.empty() ? "" : " (process " + process + ')') +
                                 "; fix: end that one, or name another folder with --state DIR (Axon.State)");
    }
    const auto process = std::to_string(::getpid());
    if (::ftruncate(file.get(), 0) != 0 || ::pwrite(file.get(), process.data(), process.size(), 0) < 0)
        return file;  // a full disk: it is locked all the same
    return file;
}

void refuseOldFiles(const fs::path& folder) {
    for (const auto& entry : fs::directory_iterator(folder)) {
        if (entry.path().extension() != kOldExtension) continue;
        throw std::runtime_error(
            "the state folder " + folder.string() + " has " + entry.path().filename().string() +
            ", a file of a build before 0.1, which this release does not read; fix: name "
            "another folder with --state DIR (Axon.State), or empty this one: either "
            "way the entity is a new one, with another UUID");
    }
}

}  // namespace

FileStorage::FileStorage(fs::path folder, std::function<void()> on_thread) : folder_(std::move(folder)) {
    makeFolder(folder_);
    lock_ = lockFolder(folder_);
    refuseOldFiles(folder_);
    thread_ = std::thread([this, on_thread = std::move(on_thread)] {
        if (on_thread) on_thread();
        run();
    });
}

FileStorage::~FileStorage() {
    {
        const std::lock_guard lock(mutex_);
        ending_ = true;
    }
    wake_.notify_one();
    thread_.join();
}

fs::path FileStorage::pathOf(std::string_view key) const {
    return folder_ / (safeName(key) + kExtension);
}

std::optional<std::string> FileStorage::load(std::string_view key) {
    const auto path = pathOf(key);
    const File file(path, O_RDONLY);
    if (!file.isOpen()) {
        if (errno == ENOENT) return std::nullopt;
        fail("cannot open", path);
    }
    std::string value;
    std::array<char, 4096> part{};
    while (true) {
        const auto n = ::read(file.fd(), part.data(), part.size());
        if (n < 0 && errno == EINTR) continue;
        if (n < 0) fail("cannot read", path);
        if (n == 0) return value;
        value.append(part.data(), static_cast<std::size_t>(n));
    }
}

/// To the disk, beside its place; the file's name.
fs::path FileStorage::write(std::string_view key, std::string_view value) const {
    auto fresh = pathOf(key);
    fresh += ".new";
    const File file(fresh, O_WRONLY | O_CREAT | O_TRUNC);
    if (!file.isOpen() || !file.writeAll(value) || ::fsync(file.fd()) != 0) fail("cannot write", fresh);
    return fresh;
}

void FileStorage::save(std::string_view key, std::string_view value) {
    const auto path = pathOf(key);
    const auto fresh = write(key, value);
    if (::rename(fresh.c_str(), path.c_str()) != 0) fail("cannot replace", path);
    synchroniseFolder(folder_);
}

void FileStorage::keep(std::string_view key, std::string_view value) {
    want(key, std::string(value));
}

void FileStorage::forget(std::string_view key) {
    want(key, std::nullopt);
}

void FileStorage::want(std::string_view key, Wish wish) {
    {
        const std::lock_guard lock(mutex_);
        waiting_.insert_or_assign(std::string(key), std::move(wish));
    }
    wake_.notify_one();
}

bool FileStorage::carryOut(const std::string& key, const Wish& wish) const {
    const auto path = pathOf(key);
    // What cannot be deleted is on a disk that a next life cannot write its epoch to either.
    if (!wish) {
        if (::unlink(path.c_str()) != 0 && errno != ENOENT) return false;
        return synchroniseFolder(folder_);  // or a loss of power brings it back
    }
    try {
        const auto fresh = write(key, *wish);
        if (::rename(fresh.c_str(), path.c_str()) != 0) return false;
    } catch (const std::system_error&) {  // the disk is full, say
        return false;
    }
    return synchroniseFolder(folder_);
}

void FileStorage::run() {
    // What could not be done since the last pause. It holds nothing else up: on a full disk nothing can be
    // written, and deleted all the same.
    std::map<std::string, Wish> failed;
    // Deletions first: the latch is one. And nothing is kept while one of them fails: that a robot is free
    // must not be on the disk before its latch is (power_loss_test.cpp tries this order).
    const auto next = [&] {
        auto found = waiting_.end();
        const bool deletion_failed =
            std::any_of(failed.begin(), failed.end(), [](const auto& one) { return !one.second; });
        for (auto at = waiting_.begin(); at != waiting_.end(); ++at) {
            const auto before = failed.find(at->first);
            if (before != failed.end() && before->second == at->second) continue;
            if (!at->second) return at;
            if (found == waiting_.end() && !deletion_failed) found = at;
        }
        return found;
    };
    bool last = false;
    std::unique_lock lock(mutex_);
    while (true) {
        if (failed.empty()) wake_.wait(lock, [this] { return ending_ || !waiting_.empty(); });
        auto at = next();
        if (at == waiting_.end()) {
            if (last || (ending_ && waiting_.empty())) return;
            if (!ending_)
                wake_.wait_for(lock, kTryAgain, [&] { return ending_ || next() != waiting_.end(); });
            if (next() != waiting_.end()) continue;
            failed.clear();  // again
            last = ending_;  // and once more at the end
            continue;
        }
        const auto [key, wish] = *at;
        lock.unlock();
        const bool done = carryOut(key, wish);
        lock.lock();
        at = waiting_.find(key);
        if (!done)
            failed.insert_or_assign(key, wish);
        else if (at->second == wish)  // and nothing else is wanted of it meanwhile
            waiting_.erase(at);
    }
}

}  // namespace axon::entity_manager
