// SPDX-License-Identifier: MIT
#pragma once
#include <sys/stat.h>

#include <cstdint>
#include <optional>

namespace axon {

/// What tells that a file is another one than before. A file that is written in place changes its mark with
/// each write, but who reads it in the middle has half of it: read again, or not before, once the mark has
/// stayed the same.
struct FileMark {
    std::uint64_t device = 0;
    std::uint64_t inode = 0;
    std::int64_t size = 0;
    std::int64_t modified_ns = 0;
    std::int64_t changed_ns = 0;
    std::uint32_t mode = 0;
    bool operator==(const FileMark&) const = default;

    /// Nothing where there is no regular file; errno says why.
    static std::optional<FileMark> of(const char* path) {
        struct stat status {};
        if (::stat(path, &status) != 0 || !S_ISREG(status.st_mode)) return std::nullopt;
        const auto ns = [](const timespec& time) {
            return std::int64_t{time.tv_sec} * 1'000'000'000 + time.tv_nsec;
        };
        return FileMark{status.st_dev,      status.st_ino,      status.st_size,
                        ns(status.st_mtim), ns(status.st_ctim), status.st_mode};
    }
};

}  // namespace axon
