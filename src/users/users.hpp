// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <functional>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "users/access.hpp"
#include "users/passwords.hpp"

namespace axon::users {

/// What a line of users.cfg allows: the three roles of clients, or to log in as an Entity Manager.
enum class UserRole { Observer, Operator, Admin, Entity };
const char* toString(UserRole role);
std::optional<UserRole> userRole(std::string_view text);

/// Text that somebody has written, in quotes and without what a terminal would obey.
std::string shown(std::string_view text);

enum class MayBeEmpty : bool { No, Yes };

inline constexpr std::size_t kFileMax = 1024 * 1024;

/// users.cfg: who may log in, and as what. Lines `name role hash`, `#` begins a comment; the hash is one that
/// isHash() accepts. Lines that begin with '@' restrict who may do what with which entities (Access).
///
/// Immutable after construction; verify() may be called from any thread and takes as long and as much memory
/// as the hash wants, some 20 MiB. Failure: misconfiguration throws std::runtime_error, `file:line: expected
/// …; fix: …`.
class Users {
  public:
    struct User {
        std::string name;
        UserRole role;
        std::string hash;
        bool operator==(const User&) const = default;
    };

    /// Pure. `file` is what messages call it.
    static Users parse(std::string_view text, const std::string& file);
    /// Refuses a file that others than its owner and group may read, or that others than its owner may write,
    /// and one without users unless it may be: the package installs such a file, and no server takes it.
    static Users read(const std::string& file, MayBeEmpty may_be_empty = MayBeEmpty::No);

    /// The role, if there is such a user and this is the password. Takes as long for an unknown user as for a
    /// wrong password. Throws std::bad_alloc.
    std::optional<UserRole> verify(const std::string& name, const std::string& password) const;
    /// The role of a user who has been verified in another way, without a password.
    std::optional<UserRole> roleOf(const std::string& name) const;
    /// Null where there is none of this name.
    const User* find(std::string_view name) const;
    const std::vector<User>& all() const { return users_; }
    /// Whether who has proved to be this user to `before` still has: a user who was removed and added again
    /// is another one, and so is one with a new password.
    bool keeps(const std::string& name, const Users& before) const;
    /// What the lines that begin with '@' say.
    const Access& access() const { return access_; }
    std::size_t size() const { return users_.size(); }
    /// Eight digits that are the same for all servers whose files say the same, whatever their comments.
    std::string fingerprint() const;

  private:
    std::vector<User> users_;
    std::map<std::string, std::size_t, std::less<>> by_name_;  // in users_
    Access access_;
};

}  // namespace axon::users
