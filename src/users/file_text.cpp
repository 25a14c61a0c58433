// SPDX-License-Identifier: GPL-2.0-or-later
#include "users/file_text.hpp"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <stdexcept>
#include <system_error>

#include "users/users.hpp"

namespace axon::users {

std::vector<std::string_view> fieldsOf(std::string_view line) {
    std::vector<std::string_view> fields;
    constexpr std::string_view kBlank = " \t";
    for (auto at = line.find_first_not_of(kBlank); at != std::string_view::npos;
         at = line.find_first_not_of(kBlank, at)) {
        const auto end = std::min(line.find_first_of(kBlank, at), line.size());
        fields.push_back(line.substr(at, end - at));
        at = end;
    }
    return fields;
}

std::string_view contentOf(std::string_view line) {
    line = line.substr(0, line.find('#'));
    while (!line.empty() &&
           (line.back() == '\r' || line.back() == '\n' || line.back() == ' ' || line.back() == '\t'))
        line.remove_suffix(1);
    return line;
}

std::string_view takeLine(std::string_view& text) {
    const auto end = std::min(text.find('\n'), text.size() - 1) + 1;
    const auto line = text.substr(0, end);
    text.remove_prefix(end);
    return line;
}

void fail(const std::string& file, const std::string& what) {
    throw std::runtime_error(file + ": " + what + " (" + std::generic_category().message(errno) + ")");
}

std::string readAll(int fd, const std::string& file) {
    std::string text;
    std::array<char, 4096> buffer;
    while (true) {
        const auto got = ::read(fd, buffer.data(), buffer.size());
        if (got < 0 && errno == EINTR) continue;
        if (got < 0) fail(file, "cannot be read");
        if (got == 0) return text;
        text.append(buffer.data(), static_cast<std::size_t>(got));
        if (text.size() > kFileMax) throw std::runtime_error(file + ": expected at most 1 MiB");
    }
}

}  // namespace axon::users
