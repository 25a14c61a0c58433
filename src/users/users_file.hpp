// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <string_view>

#include "users/users.hpp"

// Changes of users.cfg, by `axon users` and `axon-server --add-user`. What a change does not concern stays as
// it is, comments included. The old file stays whole until the new one is, and a server that looks at the
// file sees one or the other. Two changes at once: the later one is refused. All throw std::runtime_error,
// which says the fix.
namespace axon::users {

/// The text of users.cfg with this user's line replaced, or added at the end. Pure.
std::string withUser(std::string_view text, const std::string& name, UserRole role, const std::string& hash);
/// Without this user's line. Pure.
std::string withoutUser(std::string_view text, std::string_view name);

/// A user who is not there yet, in a file that is made (0600) where there is none.
void addUser(const std::string& file, const std::string& name, UserRole role, const std::string& password);
/// The same; replaces the line of one who is there.
void writeUser(const std::string& file, const std::string& name, UserRole role, const std::string& password);
void setRole(const std::string& file, const std::string& name, UserRole role);
void setPassword(const std::string& file, const std::string& name, const std::string& password);
/// Refuses to remove the last one: no server reads a file without users.
void removeUser(const std::string& file, const std::string& name);

/// What addUser() and setPassword() refuse, so that nobody types a password in vain.
void mayAdd(const std::string& file, const std::string& name);
void mayChange(const std::string& file, const std::string& name);

/// From the terminal without echo, asked twice; or, where standard input is no terminal, its first line.
/// Ctrl-C at the terminal throws, and the terminal is as it was.
std::string readNewPassword();

}  // namespace axon::users
