// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "common/clock.hpp"
#include "host/file_mark.hpp"
#include "users/users.hpp"

namespace axon::users {

/// Looks for a new users.cfg while a server runs.
///
/// The file is read when it has changed and then stayed the same from one look to the next, and while it is
/// read, since half a file that is written in place can be a valid file with fewer users, and whoever is
/// missing in it loses their session. Nothing tells half a file whose writer pauses for longer than that: it
/// is to be replaced by a rename. A file with an error, and one that is gone, changes nothing; that is said
/// once for each change.
///
/// Threads: onTimer() is called by one thread at a time; `taken` and `note` are called in it. Failure: never
/// throws for what the file is.
class UsersWatch {
  public:
    using Note = std::function<void(const std::string& line)>;
    using Taken = std::function<void(std::shared_ptr<const Users> users)>;
    using Read = std::function<Users(const std::string& file)>;

    static constexpr Duration kPeriod = std::chrono::seconds{1};

    /// `first`: what was read of the file before. `taken` gets what differs from it. `read` throws as
    /// Users::read() does.
    UsersWatch(
        std::string file, std::shared_ptr<const Users> first, const Clock& clock, Note note, Taken taken,
        Read read = [](const std::string& its) { return Users::read(its); });

    /// Looks again when it is time; returns when that is.
    TimePoint onTimer();

  private:
    void look();
    void say(const std::string& trouble);

    const std::string file_;
    const Clock& clock_;
    const Note note_;
    const Taken taken_;
    const Read read_file_;
    // Confined to the thread of onTimer():
    std::shared_ptr<const Users> users_;
    TimePoint next_;
    std::optional<FileMark> mark_;
    bool read_ = false;  // what has this mark
    std::string trouble_;
};

/// What a server says of a file that it has taken: how many users, whether all servers have the same, and
/// whose hashes are of an older kind than new ones.
std::string summaryOf(const Users& users, const std::string& file);

}  // namespace axon::users
