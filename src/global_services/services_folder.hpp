// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <filesystem>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "common/clock.hpp"
#include "common/result.hpp"
#include "front_end_server/ports/ports.hpp"

namespace axon::global_services {

/// The global services of a front-end server: the profiles of its folder `globalservices/` (thesis A.4), as
/// its clients are given them on request. docs/reference/profiles.md says what a file may hold.
///
/// Every `*.xml` of the folder is read; names that begin with '.' are an editor's. A file is read again when
/// its inode, size or times have changed, and once more at the look after that, since it may have been read
/// in the middle of being written. What was read, and every finding, is said once for each change. A folder
/// that is not there offers nothing until it is; nothing is said of one that has never been there.
///
/// A file with an error offers no services. The name of a service is that of one file only, the first by
/// name; the others have an error that names it.
///
/// Bounds: 256 files of 1 MiB each, and 2 MiB in an answer; what is beyond has an error that says so.
///
/// Threads: onTimer() is called by one thread at a time, answer() by any. Failure: never throws for what is
/// in the folder.
class ServicesFolder final : public front_end_server::GlobalServicesPort {
  public:
    using Note = std::function<void(const std::string& line)>;

    static constexpr std::size_t kFilesMax = 256;
    static constexpr std::size_t kAnswerBytesMax = std::size_t{2} * 1024 * 1024;
    static constexpr Duration kPeriod = std::chrono::seconds{1};

    /// Looks into the folder. `note` gets lines for people, here and in the thread of onTimer().
    ServicesFolder(const std::filesystem::path& folder, const Clock& clock, Note note);
    ~ServicesFolder() override;

    /// Looks again when it is time; returns when that is.
    TimePoint onTimer();
    Result<std::string> answer(std::string_view request) override;

  private:
    class Contents;
    const Clock& clock_;
    TimePoint next_;  // confined to the thread of onTimer()
    const std::unique_ptr<Contents> contents_;
};

}  // namespace axon::global_services
