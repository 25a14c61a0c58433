// SPDX-License-Identifier: MIT
#include "stop_action.hpp"

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include <cerrno>
#include <csignal>
#include <cstring>
#include <stdexcept>
#include <utility>

namespace axon::python {
namespace {

using Clock = std::chrono::steady_clock;
using namespace std::chrono_literals;

std::string why(int error) {
    return std::generic_category().message(error);
}

void checkOpen(int descriptor) {
    if (descriptor < 0 || ::fcntl(descriptor, F_GETFD) < 0)
        throw std::invalid_argument("expected an open file descriptor, found " + std::to_string(descriptor) +
                                    "; fix: pass fileno() of the open connection");
}

std::chrono::nanoseconds checkBound(std::chrono::duration<double> within) {
    if (!(within >= 0.001s && within <= 10s))
        throw std::invalid_argument("within: expected 0.001 to 10 seconds, found " +
                                    std::to_string(within.count()));
    return std::chrono::duration_cast<std::chrono::nanoseconds>(within);
}

std::string checkBytes(std::string bytes) {
    if (bytes.empty() || bytes.size() > 4096)
        throw std::invalid_argument("expected 1 to 4096 bytes that stop the device, found " +
                                    std::to_string(bytes.size()));
    return bytes;
}

/// A descriptor that this object owns and that does not block, where the kind of file permits that without
/// changing the caller's: a second opening of the same line or pipe has flags of its own.
int ownCopy(int descriptor) {
    struct stat about {};
    if (::fstat(descriptor, &about) == 0 && (S_ISCHR(about.st_mode) || S_ISFIFO(about.st_mode))) {
        const auto path = "/proc/self/fd/" + std::to_string(descriptor);
        const int again = ::open(path.c_str(), O_WRONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC);
        if (again >= 0) return again;
    }
    const int copy = ::fcntl(descriptor, F_DUPFD_CLOEXEC, 3);
    if (copy < 0) throw std::runtime_error("duplicating the descriptor: " + why(errno));
    return copy;
}

int milliseconds(Clock::time_point until) {
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(until - Clock::now()).count();
    return left > 0 ? static_cast<int>(left) : 0;
}

}  // namespace

void StopAction::carryOut() {
    runs_.fetch_add(1);
    try {
        act();
    } catch (...) {
        failures_.fetch_add(1);
        throw;
    }
}

CloseDescriptor::CloseDescriptor(int descriptor) {
    checkOpen(descriptor);
    int ends[2];
    if (::socketpair(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0, ends) != 0)
        throw std::runtime_error("socketpair: " + why(errno));
    ::close(ends[1]);
    dead_ = ends[0];
    descriptor_ = descriptor;
}

CloseDescriptor::~CloseDescriptor() {
    ::close(dead_);
}

std::string CloseDescriptor::describe() const {
    const std::lock_guard lock(mutex_);
    return "close_fd(" + std::to_string(descriptor_) + ")";
}

void CloseDescriptor::watch(int descriptor) {
    checkOpen(descriptor);
    const std::lock_guard lock(mutex_);
    descriptor_ = descriptor;
    closed_ = false;
}

void CloseDescriptor::release() {
    const std::lock_guard lock(mutex_);
    descriptor_ = -1;
}

bool CloseDescriptor::closed() const {
    const std::lock_guard lock(mutex_);
    return closed_;
}

void CloseDescriptor::act() {
    const std::lock_guard lock(mutex_);
    if (descriptor_ < 0 || closed_) return;
    // The last close of a serial line would wait for what it has not sent.
    ::tcflush(descriptor_, TCIOFLUSH);
    ::shutdown(descriptor_, SHUT_RDWR);  // other duplicates of a socket are dead with it
    if (::dup3(dead_, descriptor_, O_CLOEXEC) < 0)
        throw std::runtime_error("close_fd(" + std::to_string(descriptor_) + "): " + why(errno));
    closed_ = true;
}

WriteBytes::WriteBytes(int descriptor, std::string bytes, std::chrono::duration<double> within)
    : bytes_(checkBytes(std::move(bytes))), within_(checkBound(within)) {
    watch(descriptor);
}

WriteBytes::WriteBytes(std::filesystem::path path, std::string bytes, std::chrono::duration<double> within)
    : path_(std::move(path)), bytes_(checkBytes(std::move(bytes))), within_(checkBound(within)) {
    if (::access(path_.c_str(), W_OK) != 0)
        throw std::invalid_argument("write_bytes: " + path_.string() + ": " + why(errno) +
                                    "; fix: name a device or file that this user may write to");
}

WriteBytes::~WriteBytes() {
    if (descriptor_ >= 0) ::close(descriptor_);
}

std::string WriteBytes::describe() const {
    return "write_bytes of " + std::to_string(bytes_.size()) + " bytes" +
           (path_.empty() ? std::string() : " to " + path_.string());
}

void WriteBytes::watch(int descriptor) {
    if (!path_.empty())
        throw std::invalid_argument("watch: this action opens " + path_.string() +
                                    " itself; fix: make it with a descriptor");
    checkOpen(descriptor);
    const int copy = ownCopy(descriptor);
    int former = -1;
    {
        const std::lock_guard lock(mutex_);
        former = std::exchange(descriptor_, copy);
    }
    if (former >= 0) ::close(former);
}

void WriteBytes::release() {
    int former = -1;
    {
        const std::lock_guard lock(mutex_);
        former = std::exchange(descriptor_, -1);
    }
    if (former >= 0) ::close(former);
}

void WriteBytes::act() {
    if (!path_.empty()) {
        struct stat about {};
        const bool regular = ::stat(path_.c_str(), &about) == 0 && S_ISREG(about.st_mode);
        const int opened =
            ::open(path_.c_str(), O_WRONLY | O_NOCTTY | O_CLOEXEC | O_NONBLOCK | (regular ? O_APPEND : 0));
        if (opened < 0) throw std::runtime_error("write_bytes: " + path_.string() + ": " + why(errno));
        try {
            writeAll(opened, bytes_);
        } catch (...) {
            ::close(opened);
            throw;
        }
        ::close(opened);
        return;
    }
    const std::lock_guard lock(mutex_);
    if (descriptor_ < 0) return;
    if (::isatty(descriptor_) == 1)
        ::tcflush(descriptor_, TCOFLUSH);  // orders that wait would come before it
    writeAll(descriptor_, bytes_);
}

bool WriteBytes::order(const std::function<bool()>& stopped, const std::string& bytes) {
    const std::lock_guard lock(mutex_);
    if (stopped()) return false;
    if (descriptor_ < 0)
        throw std::runtime_error(
            "order: this action has no descriptor; fix: make it with one, or watch() one");
    writeAll(descriptor_, bytes);
    return true;
}

void WriteBytes::writeAll(int descriptor, const std::string& bytes) const {
    const auto until = Clock::now() + within_;
    std::size_t written = 0;
    while (written < bytes.size()) {
        pollfd ready{descriptor, POLLOUT, 0};
        ::poll(&ready, 1, milliseconds(until));
        const auto* from = bytes.data() + written;
        const auto count = bytes.size() - written;
        ssize_t got = -1;
        if ((ready.revents & (POLLOUT | POLLERR | POLLHUP)) == 0) {
            errno = EAGAIN;
        } else {
            got = ::send(descriptor, from, count, MSG_DONTWAIT | MSG_NOSIGNAL);
            if (got < 0 && errno == ENOTSOCK) got = ::write(descriptor, from, count);
        }
        if (got >= 0) {
            written += static_cast<std::size_t>(got);
        } else if (errno == EAGAIN || errno == EINTR) {
            if (Clock::now() >= until)
                throw std::runtime_error("write_bytes: the device took only " + std::to_string(written) +
                                         " of " + std::to_string(bytes.size()) + " bytes in time");
        } else {
            throw std::runtime_error("write_bytes: " + why(errno));
        }
    }
}

RunCommand::RunCommand(std::vector<std::string> words, std::chrono::duration<double> within)
    : words_(std::move(words)), within_(checkBound(within)) {
    if (words_.empty() || ::access(words_.front().c_str(), X_OK) != 0)
        throw std::invalid_argument("run_command: expected the path of a program that can be run" +
                                    (words_.empty() ? std::string() : ", found '" + words_.front() + "'"));
}

RunCommand::~RunCommand() {
    if (child_ > 0) ::waitpid(child_, nullptr, WNOHANG);
}

std::string RunCommand::describe() const {
    std::string text = "run_command(";
    for (const auto& word : words_) text += (&word == words_.data() ? "" : " ") + word;
    return text + ")";
}

void RunCommand::start() {
    std::vector<char*> arguments;
    for (const auto& word : words_) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    posix_spawn_file_actions_t files;
    posix_spawnattr_t attributes;
    posix_spawn_file_actions_init(&files);
    posix_spawnattr_init(&attributes);
    posix_spawn_file_actions_addopen(&files, STDIN_FILENO, "/dev/null", O_RDONLY, 0);
    sigset_t none, all;
    sigemptyset(&none);
    sigfillset(&all);
    posix_spawnattr_setsigmask(&attributes, &none);  // this thread blocks all signals
    posix_spawnattr_setsigdefault(&attributes, &all);
    posix_spawnattr_setpgroup(&attributes, 0);  // Ctrl-C at the terminal is not for it
    posix_spawnattr_setflags(&attributes,
                             POSIX_SPAWN_SETSIGMASK | POSIX_SPAWN_SETSIGDEF | POSIX_SPAWN_SETPGROUP);
    const int error =
        ::posix_spawn(&child_, words_.front().c_str(), &files, &attributes, arguments.data(), environ);
    posix_spawn_file_actions_destroy(&files);
    posix_spawnattr_destroy(&attributes);
    if (error == 0) return;
    child_ = 0;
    throw std::runtime_error(describe() + ": " + why(error));
}

void RunCommand::act() {
    const std::lock_guard lock(mutex_);
    if (child_ == 0) start();
    const auto until = Clock::now() + within_;
    int status = 0;
    pid_t ended = 0;
    while ((ended = ::waitpid(child_, &status, WNOHANG)) == 0 && Clock::now() < until) ::poll(nullptr, 0, 1);
    if (ended == 0) throw std::runtime_error(describe() + " has not ended in time; it goes on");
    child_ = 0;
    if (ended < 0) return;  // another part of the program has collected its status
    if (WIFSIGNALED(status))
        throw std::runtime_error(describe() + " was ended by signal " + std::to_string(WTERMSIG(status)));
    if (WEXITSTATUS(status) != 0)
        throw std::runtime_error(describe() + " ended with status " + std::to_string(WEXITSTATUS(status)));
}

}  // namespace axon::python
