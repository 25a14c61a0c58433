// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>

#include "common/shared_clock.hpp"
#include "lab/sockets.hpp"

namespace axon::lab {

/// The laboratory's side of a SharedClockPage: makes the file, and tells the time in it. A file that an
/// earlier laboratory has left is gone on with, for its readers' time never goes back. Throws
/// std::system_error, and std::runtime_error for a file that is something else, or that another laboratory
/// writes. Threads: one.
class ClockFile {
  public:
    explicit ClockFile(const std::string& path);
    ~ClockFile();
    ClockFile(const ClockFile&) = delete;
    ClockFile& operator=(const ClockFile&) = delete;

    /// `age` of the laboratory, which never goes back either; `rate`: its seconds in a second, 0 while it
    /// stands.
    void tell(Duration age, double rate, TimePoint real);

  private:
    const Descriptor file_;
    SharedClockPage* page_ = nullptr;
    Duration begin_{};  // the time at the age 0
};

}  // namespace axon::lab
