// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <sys/stat.h>
#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <optional>
#include <string>

#include "audit/line.hpp"
#include "common/descriptor.hpp"

namespace axon::audit {

/// A name as it may be in the name of a file: letters, digits, '-' and '_' stay, other bytes become "%" and
/// two digits. Of a name of more than 64 bytes the first 32 are followed by "~" and a part of its SHA-256.
/// Different names stay different.
std::string safeName(std::string_view name);

/// The files of each trail in a folder, by the trail's name and the number of the file: NAME.NUMBER.jsonl.
/// Throws std::filesystem::filesystem_error where the folder cannot be read.
std::map<std::string, std::map<std::uint64_t, std::filesystem::path>> trailFiles(
    const std::filesystem::path& folder);

/// The files of one trail: NAME.1.jsonl, NAME.2.jsonl and so on in a folder. It gives each record its number
/// and the hash of the line before it, and appends it with one write(2).
///
/// A record that would make a file longer than `bytes` begins the next file; of more than `files` the oldest
/// are deleted, also those that an earlier life with a higher bound, or a kill, has left. The next life goes
/// on where the last one ended: a line without its end, which a kill or a loss of power has left, is ended
/// and not cut off, and the hash of the next record covers it.
///
/// Threads: one. It waits for the disk. Failure: where the folder or a file cannot be used, others may write
/// to it, or another process has the trail, the constructor throws std::runtime_error, with the fix; not
/// where the disk is full or broken, which append() tries again.
class Files {
  public:
    struct Bounds {
        std::uint64_t bytes = 16U << 20U;
        int files = 8;
        // What a configuration may say (docs/reference/audit.md):
        static constexpr std::int64_t kBytesLeast = 4096, kBytesMost = std::int64_t{1} << 40U;
        static constexpr int kFilesLeast = 1, kFilesMost = 10'000;
    };
    using Write = std::function<ssize_t(int fd, const char* bytes, std::size_t count)>;
    using Sync = std::function<int(int fd)>;

    /// `write`: as write(2); `sync`: as fdatasync(2). `name` is made a safeName().
    Files(std::filesystem::path folder, const std::string& name, Bounds bounds, Write write = {},
          Sync sync = {});

    /// Fills in number and `before`. False: nothing of the record is written, and it can be tried again. A
    /// record of which only a part fits has been taken; its rest goes before the next one.
    bool append(Record record);
    /// Writes what is left of the last record. False: some still is.
    bool finish();
    /// Waits until the disk has what was written; does nothing where it has. Each file is synced before the
    /// next one begins.
    void sync();
    /// errno of what failed last.
    int error() const { return error_; }
    /// Bytes of the line without end that was found at the beginning; 0 = there was none.
    std::uint64_t unfinished() const { return unfinished_; }
    const std::filesystem::path& folder() const { return folder_; }
    /// The last record that was found at the beginning; none where the trail has none, or the disk does not
    /// answer.
    const std::optional<Record>& last() const { return last_; }

  private:
    bool open();
    bool lock();
    bool isOurs(const std::filesystem::path& path, const struct stat& facts);
    bool findEnd();
    bool openFile(std::uint64_t number);
    void deleteOld() const;
    bool append(std::string line);
    std::filesystem::path fileOf(std::uint64_t number) const;

    const std::filesystem::path folder_;
    const std::string name_;
    const Bounds bounds_;
    const Write write_;
    const Sync sync_;
    Descriptor lock_, fd_;
    std::uint64_t file_ = 0;    // number of the present file
    std::uint64_t size_ = 0;    // of it
    std::uint64_t number_ = 0;  // of the last record
    std::string hash_ = kNoHash;
    std::string rest_;  // of what was written in part
    bool unsynced_ = false;
    std::string not_ours_;  // why the folder or a file is refused
    std::uint64_t unfinished_ = 0;
    std::optional<Record> last_;
    int error_ = 0;
};

}  // namespace axon::audit
