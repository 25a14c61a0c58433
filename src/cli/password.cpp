// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/password.hpp"

#include <fcntl.h>
#include <sys/stat.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <cstring>

#include "cli/agent_link.hpp"
#include "cli/table.hpp"

namespace axon::cli {
namespace {

constexpr std::size_t kLongest = 1024;

/// Up to the end of the line, without it.
std::string readLine(int fd) {
    std::string text;
    char c = 0;
    while (text.size() < kLongest) {
        const auto count = ::read(fd, &c, 1);
        if (count < 0 && errno == EINTR) continue;
        if (count <= 0 || c == '\n') break;
        text += c;
    }
    if (!text.empty() && text.back() == '\r') text.pop_back();
    return text;
}

}  // namespace

Result<std::string> readPassword(const std::filesystem::path& file) {
    const auto refused = [&](const std::string& what) {
        return Refusal{RefusalCode::PermissionDenied, "the password file " + file.string() + " " + what, {}};
    };
    const Descriptor fd(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NONBLOCK));
    if (!fd.open()) return refused(std::string("cannot be read: ") + std::strerror(errno));
    struct stat found {};
    if (::fstat(fd.get(), &found) != 0 || !S_ISREG(found.st_mode)) return refused("is not an ordinary file");
    if (found.st_uid != ::geteuid()) return refused("belongs to another user: create one of your own");
    if ((found.st_mode & 077U) != 0)
        return refused("can be read by other users: chmod 600 " + file.string() +
                       ", and change the password");
    auto password = readLine(fd.get());
    if (password.empty()) return refused("has no password in its first line");
    return password;
}

std::optional<std::string> askPassword(const std::string& user, const std::string& server) {
    const Descriptor terminal(::open("/dev/tty", O_RDWR | O_CLOEXEC | O_NOCTTY));
    termios before{};
    if (!terminal.open() || ::tcgetattr(terminal.get(), &before) != 0) return std::nullopt;
    const auto prompt = "Password of " + printable(user) + " at " + printable(server) + ": ";
    auto silent = before;
    silent.c_lflag &= ~static_cast<tcflag_t>(ECHO);
    if (::tcsetattr(terminal.get(), TCSAFLUSH, &silent) != 0) return std::nullopt;
    static_cast<void>(::write(terminal.get(), prompt.data(), prompt.size()) > 0);
    auto password = readLine(terminal.get());
    ::tcsetattr(terminal.get(), TCSAFLUSH, &before);
    static_cast<void>(::write(terminal.get(), "\n", 1) > 0);
    return password;
}

}  // namespace axon::cli
