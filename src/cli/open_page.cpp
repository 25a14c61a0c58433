// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/open_page.hpp"

#include <spawn.h>
#include <sys/wait.h>

#include <cerrno>
#include <csignal>
#include <cstdlib>

namespace axon::cli {

int openPage(const std::string& page) {
    posix_spawnattr_t attributes;
    ::posix_spawnattr_init(&attributes);
    sigset_t none;
    ::sigemptyset(&none);
    ::posix_spawnattr_setsigmask(&attributes, &none);  // ours are blocked, and that would be inherited
    ::posix_spawnattr_setflags(&attributes, POSIX_SPAWN_SETSIGMASK);
    std::string opener = "xdg-open", operand = page;
    char* const words[] = {opener.data(), operand.data(), nullptr};
    pid_t child = 0;
    const int error = ::posix_spawnp(&child, "xdg-open", nullptr, &attributes, words, environ);
    ::posix_spawnattr_destroy(&attributes);
    if (error != 0) return error;
    int status = 0;
    while (::waitpid(child, &status, 0) < 0 && errno == EINTR) {
    }
    return WIFEXITED(status) && WEXITSTATUS(status) == 0 ? 0 : ENOEXEC;
}

bool hasDisplay() {
    return std::getenv("DISPLAY") != nullptr || std::getenv("WAYLAND_DISPLAY") != nullptr;
}

}  // namespace axon::cli
