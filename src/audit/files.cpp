// SPDX-License-Identifier: GPL-2.0-or-later
#include "audit/files.hpp"

#include <fcntl.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <charconv>
#include <stdexcept>
#include <system_error>
#include <utility>

namespace axon::audit {

namespace fs = std::filesystem;

namespace {

constexpr std::uint64_t kTail = 16 * kLineMax;  // of a file, in which its last record is looked for
constexpr std::string_view kEnding = ".jsonl";

/// Of a disk that may have room again, or come back.
bool passes(int error) {
    return error == ENOSPC || error == EDQUOT || error == EFBIG || error == EIO || error == EROFS;
}

bool isPlain(char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '-' || c == '_';
}

std::string tailOf(int fd, std::uint64_t size) {
    std::string text(std::min(size, kTail), '\0');
    std::size_t got = 0;
    while (got < text.size()) {
        const auto n =
            ::pread(fd, text.data() + got, text.size() - got, static_cast<off_t>(size - text.size() + got));
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) break;
        got += static_cast<std::size_t>(n);
    }
    text.resize(got);
    return text;
}

}  // namespace

std::string safeName(std::string_view name) {
    static constexpr std::string_view kDigits = "0123456789ABCDEF";
    std::string safe;
    // Longer than a file system's names may be: the beginning, for people, and a hash, for uniqueness. No
    // other name has a '~'.
    const bool whole = name.size() <= 64;
    for (const char c : whole ? name : name.substr(0, 32)) {
        if (isPlain(c)) {
            safe += c;
            continue;
        }
        const auto byte = static_cast<unsigned char>(c);
        safe += {'%', kDigits[byte >> 4U], kDigits[byte & 15U]};
    }
    if (!whole) safe += '~' + hashOf(name).substr(0, 32);
    return safe.empty() ? "%" : safe;
}

std::map<std::string, std::map<std::uint64_t, fs::path>> trailFiles(const fs::path& folder) {
    std::map<std::string, std::map<std::uint64_t, fs::path>> files;
    for (const auto& entry : fs::directory_iterator(folder)) {
        const auto name = entry.path().filename().string();
        if (!name.ends_with(kEnding)) continue;
        const auto stem = name.substr(0, name.size() - kEnding.size());
        const auto dot = stem.rfind('.');
        if (dot == std::string::npos || dot == 0) continue;
        std::uint64_t number = 0;
        const auto* const end = stem.data() + stem.size();
        const auto read = std::from_chars(stem.data() + dot + 1, end, number);
        // One name for each number: "01" is no file of ours.
        if (read.ec != std::errc{} || read.ptr != end || std::to_string(number) != stem.substr(dot + 1))
            continue;
        files[stem.substr(0, dot)][number] = entry.path();
    }
    return files;
}

Files::Files(fs::path folder, const std::string& name, Bounds bounds, Write write, Sync sync)
    : folder_(std::move(folder)),
      name_(safeName(name)),
      bounds_(bounds),
      write_(write ? std::move(write)
                   : [](int fd, const char* bytes, std::size_t count) { return ::write(fd, bytes, count); }),
      sync_(sync ? std::move(sync) : [](int fd) { return ::fdatasync(fd); }) {
    if (open() || passes(error_)) return;
    if (error_ == EWOULDBLOCK)
        throw std::runtime_error("the audit trail '" + name_ + "' in '" + folder_.string() +
                                 "' is another process's; fix: end that one, or give this one another folder "
                                 "(Axon.Audit.Folder)");
    if (!not_ours_.empty()) throw std::runtime_error("the audit trail cannot be kept: " + not_ours_);
    throw std::runtime_error("the audit trail cannot be kept in '" + folder_.string() +
                             "': " + std::generic_category().message(error_) +
                             "; expected a folder that this user may write to; fix: correct "
                             "Axon.Audit.Folder, or leave it out to record nothing");
}

fs::path Files::fileOf(std::uint64_t number) const {
    return folder_ / (name_ + '.' + std::to_string(number) + std::string(kEnding));
}

bool Files::open() {
    if (!lock() || (file_ == 0 && !findEnd()) || !openFile(std::max<std::uint64_t>(file_, 1))) return false;
    deleteOld();
    return true;
}

bool Files::lock() {
    if (lock_.open()) return true;
    std::error_code failed;
    if (!fs::is_directory(folder_, failed)) {
        fs::create_directories(folder_, failed);
        if (failed) {
            error_ = failed.value();
            return false;
        }
        fs::permissions(folder_, fs::perms::owner_all, failed);
    }
    struct stat facts {};
    if (::stat(folder_.c_str(), &facts) != 0) {
        error_ = errno;
        return false;
    }
    if (!isOurs(folder_, facts)) return false;
    Descriptor fd(
        ::open((folder_ / (name_ + ".lock")).c_str(), O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600));
    if (!fd.open() || ::flock(fd.get(), LOCK_EX | LOCK_NB) != 0) {
        error_ = errno;
        return false;
    }
    lock_ = std::move(fd);
    return true;
}

/// Who else may write to it can change what has been recorded.
bool Files::isOurs(const fs::path& path, const struct stat& facts) {
    const bool foreign = facts.st_uid != ::geteuid() && facts.st_uid != 0;
    if (!foreign && (facts.st_mode & (S_IWGRP | S_IWOTH)) == 0) return true;
    error_ = EPERM;
    not_ours_ = '\'' + path.string() + '\'';
    if (foreign)
        not_ours_ +=
            " belongs to another user; expected one of this user or of root; fix: chown it, or name "
            "another folder (Axon.Audit.Folder)";
    else
        not_ours_ += std::string(" can be written to by others; fix: chmod ") +
                     (S_ISDIR(facts.st_mode) ? "700 " : "600 ") + path.string();
    return false;
}

/// The last line, whatever it is, and the last record; the newest file may be empty, or have none.
bool Files::findEnd() {
    std::map<std::uint64_t, fs::path> files;
    try {
        files = trailFiles(folder_)[name_];
    } catch (const fs::filesystem_error& failed) {
        error_ = failed.code().value();
        return false;
    }
    bool ended = false;
    for (auto file = files.rbegin(); file != files.rend(); ++file) {
        const Descriptor fd(::open(file->second.c_str(), O_RDONLY | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK));
        struct stat facts {};
        if (!fd.open() || ::fstat(fd.get(), &facts) != 0) {
            error_ = errno;
            return false;
        }
        auto text = tailOf(fd.get(), static_cast<std::uint64_t>(facts.st_size));
        bool more = !text.empty();
        const bool unfinished = !text.empty() && text.back() != '\n';
        if (!text.empty() && !unfinished) text.pop_back();
        while (more) {
            const auto at = text.rfind('\n');
            const auto line = at == std::string::npos ? text : text.substr(at + 1);
            more = at != std::string::npos;
            if (!ended) {
                hash_ = hashOf(std::string_view(line).substr(0, kLineMax + 1));  // as the reader
                if (!readLine(line) && (unfinished || line.starts_with("{\"n\":"))) unfinished_ = line.size();
                if (unfinished && file == files.rbegin()) rest_ = "\n";
                ended = true;
            }
            if (const auto record = readLine(line)) {
                number_ = record->number;
                last_ = record;
                file_ = files.rbegin()->first;
                return true;
            }
            if (more) text.resize(at);
        }
    }
    if (!files.empty()) file_ = files.rbegin()->first;
    return true;
}

bool Files::openFile(std::uint64_t number) {
    Descriptor fd(::open(fileOf(number).c_str(),
                         O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK, 0600));
    struct stat facts {};
    if (!fd.open() || ::fstat(fd.get(), &facts) != 0) {
        error_ = errno;
        return false;
    }
    if (!S_ISREG(facts.st_mode)) {
        error_ = EINVAL;
        return false;
    }
    if (!isOurs(fileOf(number), facts)) return false;
    sync();
    if (facts.st_size == 0) {
        // It may be new: its name comes to the disk as well.
        const Descriptor folder(::open(folder_.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
        if (folder.open()) ::fsync(folder.get());
    }
    fd_ = std::move(fd);
    size_ = static_cast<std::uint64_t>(facts.st_size);
    file_ = number;
    return true;
}

/// The lowest number first, and none behind one that cannot be deleted: what is left has no gap. It is tried
/// again with the next file.
void Files::deleteOld() const {
    const auto kept = static_cast<std::uint64_t>(std::max(bounds_.files, 1));
    if (file_ <= kept) return;
    try {
        const auto files = trailFiles(folder_)[name_];
        for (const auto& [number, path] : files) {
            std::error_code failed;
            if (number > file_ - kept || (!fs::remove(path, failed) && failed)) return;
        }
    } catch (const fs::filesystem_error&) {
        return;  // the folder cannot be read now
    }
}

bool Files::append(Record record) {
    if ((!fd_.open() && !open()) || !finish()) return false;
    record.number = number_ + 1;
    record.before = hash_;
    auto line = lineOf(record);
    auto hash = hashOf(line);
    line += '\n';
    if (size_ > 0 && size_ + line.size() > bounds_.bytes) {
        if (!openFile(file_ + 1)) return false;
        deleteOld();
    }
    if (!append(std::move(line))) return false;
    ++number_;
    hash_ = std::move(hash);
    return true;
}

/// False: nothing of it is written.
bool Files::append(std::string line) {
    rest_ = std::move(line);
    const auto whole = rest_.size();
    if (finish() || rest_.size() < whole) return true;
    rest_.clear();
    return false;
}

bool Files::finish() {
    while (!rest_.empty()) {
        const auto n = write_(fd_.get(), rest_.data(), rest_.size());
        if (n < 0 && errno == EINTR) continue;
        if (n <= 0) {
            error_ = n < 0 ? errno : ENOSPC;
            return false;
        }
        unsynced_ = true;
        size_ += static_cast<std::uint64_t>(n);
        rest_.erase(0, static_cast<std::size_t>(n));
    }
    return true;
}

/// One that fails is not repeated: the kernel has given up these pages.
void Files::sync() {
    if (!fd_.open() || !std::exchange(unsynced_, false)) return;
    while (sync_(fd_.get()) != 0 && errno == EINTR) {
    }
}

}  // namespace axon::audit
