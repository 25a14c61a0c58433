// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <string>
#include <string_view>
#include <vector>

// The text of users.cfg: its lines and their words. Private to this folder.
namespace axon::users {

std::vector<std::string_view> fieldsOf(std::string_view line);
/// The line without its comment and line end.
std::string_view contentOf(std::string_view line);
/// Takes the first line off the text, with its end where it has one.
std::string_view takeLine(std::string_view& text);
/// Throws std::runtime_error with `what` and the present errno.
[[noreturn]] void fail(const std::string& file, const std::string& what);
/// All of an open file; throws std::runtime_error beyond kFileMax.
std::string readAll(int fd, const std::string& file);

}  // namespace axon::users
