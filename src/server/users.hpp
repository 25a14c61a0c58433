// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstddef>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace axon::server {

/// What a line of users.cfg allows: the three roles of clients, or to log in as an Entity Manager.
enum class UserRole { Observer, Operator, Admin, Entity };
const char* toString(UserRole role);
std::optional<UserRole> userRole(std::string_view text);

/// Letters, digits, '.', '-' and '_', at most 64: they appear in logs, files and names of senders.
bool isUserName(std::string_view name);

/// users.cfg: who may log in, and as what. Lines `name role hash`, `#` begins a comment; the hash is one of
/// crypt(5): yescrypt or SHA-512, as `axon-server --add-user`, mkpasswd and `openssl passwd -6` make them.
///
/// Immutable after construction; verify() may be called from any thread and takes as long as the hash wants,
/// some milliseconds. Failure: misconfiguration throws std::runtime_error, `file:line: expected …; fix: …`.
class Users {
  public:
    /// Pure. `file` is what messages call it.
    static Users parse(std::string_view text, const std::string& file);
    /// Refuses a file that others than its owner and group may read, or that others than its owner may write.
    static Users read(const std::string& file);

    /// The role, if there is such a user and this is the password. Takes as long for an unknown user as for a
    /// wrong password.
    std::optional<UserRole> verify(const std::string& name, const std::string& password) const;
    /// The role of a user who has been verified in another way, without a password.
    std::optional<UserRole> roleOf(const std::string& name) const;
    std::size_t size() const { return users_.size(); }

  private:
    struct User {
        std::string name;
        UserRole role;
        std::string hash;
    };
    const User* find(std::string_view name) const;
    std::vector<User> users_;
};

inline constexpr std::size_t kPasswordMax = 511;  // CRYPT_MAX_PASSPHRASE_SIZE, without its zero

/// The hash of a password under a new salt: yescrypt, or SHA-512 where the library has no yescrypt. Throws
/// std::runtime_error for a password that is empty, longer than kPasswordMax bytes or has a zero byte.
std::string hashPassword(const std::string& password);

/// The text of users.cfg with this user's line replaced, or added at the end. Pure.
std::string withUser(std::string_view text, const std::string& name, UserRole role, const std::string& hash);

/// Writes the user into the file, which it makes (0600) where there is none; the old file stays whole until
/// the new one is. Throws std::runtime_error.
void writeUser(const std::string& file, const std::string& name, UserRole role, const std::string& password);

/// From the terminal without echo, asked twice; or, where standard input is no terminal, its first line.
std::string readPassword();

}  // namespace axon::server
