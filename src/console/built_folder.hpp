// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <vector>

#include "common/clock.hpp"
#include "console/core/console_core.hpp"

namespace axon::console {

/// The folder with the built console, read as a whole: a request finds what was read and touches no path, so
/// none leads out of the folder.
///
/// It is read again when a file has changed, come or gone, which is looked for once a second at most, when
/// somebody asks: the console may be built while the server runs, and what was read half-way is then read
/// again. Links, names that begin with '.' and what is no regular file are left out. Bounds: 2,000 files,
/// each of 16 MiB, together 64 MiB; what exceeds them is left out, and the log says so. Files that only
/// differ by ".gz" or ".br" are one file in several codings.
///
/// Threads: that of the console. Failure: a folder that cannot be read has no files.
class BuiltFolder final : public FilesPort {
  public:
    using Note = std::function<void(const std::string& line)>;
    static constexpr std::size_t kFilesMax = 2000;
    static constexpr std::size_t kFileMax = 16 * 1024 * 1024;
    static constexpr std::size_t kAllMax = 64 * 1024 * 1024;
    static constexpr std::chrono::seconds kLook{1};

    BuiltFolder(std::filesystem::path folder, const Clock& clock, Note note);

    std::shared_ptr<const BuiltFiles> files() override;
    std::string folder() const override { return folder_.string(); }

  private:
    struct Found {
        std::filesystem::path file;
        /// What changes when it is written anew.
        std::uint64_t inode = 0;
        std::int64_t seconds = 0, nanoseconds = 0, size = 0;
        bool operator==(const Found&) const = default;
    };
    /// What there is to read, one more than kFilesMax at most; nothing where there is no first page.
    std::vector<Found> look() const;
    void read();

    const std::filesystem::path folder_;
    const Clock& clock_;
    const Note note_;
    TimePoint looks_again_{};
    std::vector<Found> found_;  // before it was read: what has changed meanwhile is noticed the next time
    std::shared_ptr<const BuiltFiles> files_ = std::make_shared<const BuiltFiles>();
};

/// Where the console of this program is: installed beside it (PREFIX/share/axon/console), or built in the
/// sources (web/console/dist). The first of them where there is neither.
std::filesystem::path consoleFolder(const std::filesystem::path& program);

/// The type of a file by its name.
std::string typeOf(const std::filesystem::path& name);

}  // namespace axon::console
