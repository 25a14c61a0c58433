// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <chrono>
#include <map>
#include <mutex>
#include <string>

#include "common/clock.hpp"

namespace axon::users {

/// Whether other servers have the same users as this one, for its log. Where each machine has a file of its
/// own, a user who was removed from one of them can still log in at the servers of the others.
///
/// Threads: any. Failure: none; of more than `kMost` servers that differ, the others are not told of.
class UsersAgreement {
  public:
    /// A new file is copied from machine to machine, and taken over by each server within two seconds.
    static constexpr Duration kPatience = std::chrono::seconds{30};
    static constexpr std::size_t kMost = 256;

    /// What `server` says of its users and what this one has, by Users::fingerprint(). Returns the line for
    /// the log: once when they have differed for kPatience, and once when they no longer do; else empty.
    std::string heard(const std::string& server, const std::string& theirs, const std::string& ours,
                      TimePoint now);

  private:
    struct Difference {
        TimePoint since;
        bool told = false;
    };
    std::mutex mutex_;
    std::map<std::string, Difference> differing_;  // guarded by mutex_
};

}  // namespace axon::users
