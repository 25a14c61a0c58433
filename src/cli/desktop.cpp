// SPDX-License-Identifier: GPL-2.0-or-later
#include "cli/desktop.hpp"

#include <fcntl.h>
#include <poll.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <iterator>
#include <string_view>
#include <thread>

#include "common/descriptor.hpp"

extern char** environ;

namespace axon::cli {
namespace {

constexpr const char* kVariables[] = {
    "DISPLAY",         "WAYLAND_DISPLAY",     "XAUTHORITY", "DBUS_SESSION_BUS_ADDRESS",
    "XDG_RUNTIME_DIR", "XDG_CURRENT_DESKTOP", "BROWSER"};

bool isOfDesktop(std::string_view name) {
    return std::find(std::begin(kVariables), std::end(kVariables), name) != std::end(kVariables);
}

/// The exit status; nothing where it cannot be had.
int waitFor(pid_t child) {
    int status = 0;
    while (::waitpid(child, &status, 0) < 0) {
        if (errno != EINTR) return -1;
    }
    return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

void reapLater(pid_t child) {
    std::thread([child] { waitFor(child); }).detach();
}

}  // namespace

SpawnAttributes::SpawnAttributes(short extra_flags) {
    ::posix_spawnattr_init(&attributes_);
    sigset_t none;
    sigset_t all;
    ::sigemptyset(&none);
    ::sigemptyset(&all);
    for (const int signal : {SIGINT, SIGTERM, SIGHUP, SIGPIPE, SIGQUIT}) ::sigaddset(&all, signal);
    ::posix_spawnattr_setsigmask(&attributes_, &none);
    ::posix_spawnattr_setsigdefault(&attributes_, &all);
    ::posix_spawnattr_setflags(
        &attributes_, static_cast<short>(POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | extra_flags));
}

std::vector<char*> pointersTo(std::vector<std::string>& words) {
    std::vector<char*> pointers;
    for (auto& word : words) pointers.push_back(word.data());
    pointers.push_back(nullptr);
    return pointers;
}

std::vector<std::string> environmentWithoutPassword() {
    std::vector<std::string> variables;
    for (char** variable = environ; *variable != nullptr; ++variable) {
        if (!std::string_view(*variable).starts_with("AXON_PASSWORD")) variables.emplace_back(*variable);
    }
    return variables;
}

Desktop Desktop::here() {
    Desktop desktop;
    for (char** variable = environ; *variable != nullptr; ++variable) {
        const std::string_view one = *variable;
        const auto end = std::min(one.find('='), one.size());
        if (isOfDesktop(one.substr(0, end)) && end + 1 < one.size())
            desktop.variables_[std::string(one.substr(0, end))] = one.substr(end + 1);
    }
    return desktop;
}

Desktop Desktop::of(const Json& variables) {
    Desktop desktop;
    if (!variables.is_object()) return desktop;
    for (const auto& [name, value] : variables.items())
        if (isOfDesktop(name) && value.is_string()) desktop.variables_[name] = value.get<std::string>();
    return desktop;
}

bool Desktop::hasScreen() const {
    return variables_.contains("DISPLAY") || variables_.contains("WAYLAND_DISPLAY");
}

bool Desktop::takesNotifications() const {
    return hasScreen() || variables_.contains("DBUS_SESSION_BUS_ADDRESS");
}

/// 0 where it cannot be started.
pid_t Desktop::spawn(std::vector<std::string> words) const {
    auto environment = environmentWithoutPassword();
    std::erase_if(environment,
                  [](const std::string& one) { return isOfDesktop(one.substr(0, one.find('='))); });
    for (const auto& [name, value] : variables_) environment.push_back(name + "=" + value);
    posix_spawn_file_actions_t actions;
    ::posix_spawn_file_actions_init(&actions);
    ::posix_spawn_file_actions_addopen(&actions, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    // What a verb prints is read by programs too.
    ::posix_spawn_file_actions_addopen(&actions, STDOUT_FILENO, "/dev/null", O_WRONLY, 0);
    // Of its own session: Ctrl-C is for the command and not for the browser that it has opened.
    const SpawnAttributes attributes(POSIX_SPAWN_SETSID);
    pid_t child = 0;
    const int failed = ::posix_spawnp(&child, words.front().c_str(), &actions, attributes.get(),
                                      pointersTo(words).data(), pointersTo(environment).data());
    ::posix_spawn_file_actions_destroy(&actions);
    return failed == 0 ? child : 0;
}

bool Desktop::start(std::vector<std::string> words) const {
    const auto child = spawn(std::move(words));
    if (child == 0) return false;
    reapLater(child);
    return true;
}

bool Desktop::open(const std::string& file, std::chrono::milliseconds patience) const {
    if (!hasScreen()) return false;
    const auto child = spawn({"xdg-open", file});
    if (child == 0) return false;
    const Descriptor handle(static_cast<int>(::syscall(SYS_pidfd_open, child, 0)));
    pollfd watched{handle.get(), POLLIN, 0};
    if (handle.open() && ::poll(&watched, 1, static_cast<int>(patience.count())) > 0)
        return waitFor(child) == 0;
    reapLater(child);
    return true;
}

}  // namespace axon::cli
