// SPDX-License-Identifier: MIT
#include "stop_action.hpp"

#include <fcntl.h>
#include <poll.h>
#include <spawn.h>
#include <sys/ioctl.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <termios.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstring>
#include <optional>
#include <stdexcept>
#include <utility>

namespace axon::python {
namespace {

using Clock = std::chrono::steady_clock;
using namespace std::chrono_literals;

/// How long an order that waits, for the device or for its turn, may not notice a stop.
constexpr int kOrderLooksForStopMs = 2;

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

/// A second opening of the same line or pipe, which does not block and leaves the caller's flags alone; -1 if
/// the file is of another kind, of which a second opening would be something else, or cannot be opened.
int openAgain(int descriptor) {
    struct stat about {};
    if (::fstat(descriptor, &about) != 0) return -1;
    unsigned number = 0;
    const bool terminal = S_ISCHR(about.st_mode) && ::isatty(descriptor) == 1 &&
                          ::ioctl(descriptor, TIOCGPTN, &number) != 0;  // only a master has such a number
    if (!terminal && !S_ISFIFO(about.st_mode)) return -1;
    const auto path = "/proc/self/fd/" + std::to_string(descriptor);
    return ::open(path.c_str(), O_WRONLY | O_NONBLOCK | O_NOCTTY | O_CLOEXEC);
}

bool isSocket(int descriptor) {
    struct stat about {};
    return ::fstat(descriptor, &about) == 0 && S_ISSOCK(about.st_mode);
}

/// Nothing if the descriptor is not open.
std::optional<FileIdentity> identityOf(int descriptor) {
    struct stat about {};
    if (::fstat(descriptor, &about) != 0) return std::nullopt;
    return FileIdentity{about.st_dev, about.st_rdev, about.st_ino};
}

void discardUnsent(int descriptor) {
    if (::isatty(descriptor) == 1) ::tcflush(descriptor, TCOFLUSH);
}

/// Of a descriptor that may block.
void writeBlocking(int descriptor, const std::string& bytes, const std::function<bool()>& abandoned) {
    std::size_t written = 0;
    while (written < bytes.size() && !abandoned()) {
        const auto got = ::write(descriptor, bytes.data() + written, bytes.size() - written);
        if (got >= 0)
            written += static_cast<std::size_t>(got);
        else if (errno == EAGAIN) {  // the program has said that it does not block
            pollfd ready{descriptor, POLLOUT, 0};
            ::poll(&ready, 1, 20);
        } else if (errno != EINTR)
            throw std::runtime_error("write_bytes: " + why(errno));
    }
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
    watch(descriptor);
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
    const auto identity = identityOf(descriptor);
    const std::lock_guard lock(mutex_);
    descriptor_ = descriptor;
    identity_ = identity.value_or(FileIdentity{});
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
    if (descriptor_ < 0) return;
    const auto now = identityOf(descriptor_);
    if (!now) return;
    if (*now != identity_)
        throw std::runtime_error("close_fd(" + std::to_string(descriptor_) +
                                 "): this number means another file now, which is not closed; fix: call "
                                 "action.release() before the program closes the connection, and "
                                 "action.watch(port.fileno()) when it has opened it again");
    if (closed_) return;
    // The last close of a serial line would wait for what it has not sent.
    ::tcflush(descriptor_, TCIOFLUSH);
    ::shutdown(descriptor_, SHUT_RDWR);  // other duplicates of a socket are dead with it
    if (::dup3(dead_, descriptor_, O_CLOEXEC) < 0)
        throw std::runtime_error("close_fd(" + std::to_string(descriptor_) + "): " + why(errno));
    identity_ = identityOf(dead_).value_or(FileIdentity{});
    closed_ = true;
}

/// An open file of a device, which this object owns.
struct WriteBytes::Line {
    explicit Line(int of, bool blocking) : descriptor(of), may_block(blocking) {}
    ~Line() { ::close(descriptor); }
    Line(const Line&) = delete;
    Line& operator=(const Line&) = delete;
    const int descriptor;
    const bool may_block;
};

WriteBytes::WriteBytes(int descriptor, std::string bytes, std::chrono::duration<double> within)
    : bytes_(checkBytes(std::move(bytes))), within_(checkBound(within)) {
    watch(descriptor);
}

WriteBytes::WriteBytes(std::filesystem::path path, std::string bytes, std::chrono::duration<double> within)
    : path_(std::move(path)), bytes_(checkBytes(std::move(bytes))), within_(checkBound(within)) {
    if (::access(path_.c_str(), W_OK) != 0)
        throw std::invalid_argument("write_bytes: " + path_.string() + ": " + why(errno) +
                                    "; fix: name a device or file that this user may write to");
    jobs_ = std::make_shared<BoundedJob>();
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
    int copy = openAgain(descriptor);
    const bool may_block = copy < 0 && !isSocket(descriptor);
    if (copy < 0) copy = ::fcntl(descriptor, F_DUPFD_CLOEXEC, 3);
    if (copy < 0) throw std::runtime_error("duplicating the descriptor: " + why(errno));
    auto line = std::make_shared<Line>(copy, may_block);
    if (may_block) {  // now: a stop starts no thread
        const std::lock_guard lock(jobs_mutex_);
        if (!jobs_) jobs_ = std::make_shared<BoundedJob>();
    }
    setLine(std::move(line));
}

void WriteBytes::release() {
    setLine(nullptr);
}

void WriteBytes::setLine(std::shared_ptr<Line> line) {
    const std::lock_guard lock(mutex_);
    line_.swap(line);
}  // the former one is closed, unless a job still writes to it

void WriteBytes::act() {
    struct Waiting {
        std::atomic<int>& count;
        ~Waiting() { --count; }
    };
    ++stops_waiting_;
    const Waiting waiting{stops_waiting_};
    std::shared_ptr<BoundedJob> jobs;
    {
        const std::lock_guard lock(jobs_mutex_);
        jobs = jobs_;
    }
    if (jobs) jobs->interrupt();  // an order gives up
    if (!path_.empty()) {
        onThread(
            [path = path_, bytes = bytes_](const std::function<bool()>& abandoned) {
                struct stat about {};
                const bool regular = ::stat(path.c_str(), &about) == 0 && S_ISREG(about.st_mode);
                const int opened = ::open(
                    path.c_str(), O_WRONLY | O_NOCTTY | O_CLOEXEC | O_NONBLOCK | (regular ? O_APPEND : 0));
                if (opened < 0) throw std::runtime_error("write_bytes: " + path.string() + ": " + why(errno));
                const Line line(opened, true);
                writeBlocking(opened, bytes, abandoned);
            },
            false);
        return;
    }
    const std::lock_guard lock(mutex_);
    if (line_) write(line_, bytes_, false);
}

bool WriteBytes::order(const std::function<bool()>& stopped, const std::string& bytes) {
    std::unique_lock lock(mutex_, std::defer_lock);
    do {  // a stop has its turn for as long as `within`, and the order does not wait for it
        if (stopped() || stops_waiting_ > 0) return false;
    } while (!lock.try_lock_for(std::chrono::milliseconds(kOrderLooksForStopMs)));
    if (stopped() || stops_waiting_ > 0) return false;
    if (!line_)
        throw std::runtime_error(
            "order: this action has no descriptor; fix: make it with one, or watch() one");
    return write(line_, bytes, true);
}

bool WriteBytes::write(const std::shared_ptr<Line>& line, const std::string& bytes, bool is_order) {
    if (line->may_block)
        return onThread(
            [line, bytes, is_order](const std::function<bool()>& abandoned) {
                if (!is_order) discardUnsent(line->descriptor);
                writeBlocking(line->descriptor, bytes, abandoned);
            },
            is_order);
    if (!is_order) discardUnsent(line->descriptor);  // orders that wait would come before it
    return writeDirectly(*line, bytes, is_order);
}

bool WriteBytes::onThread(BoundedJob::Job job, bool is_order) {
    std::shared_ptr<BoundedJob> jobs;
    {
        const std::lock_guard lock(jobs_mutex_);
        jobs = jobs_;
    }
    const auto outcome = jobs->run(std::move(job), Clock::now() + within_, [&] { return giveUp(is_order); });
    if (outcome == BoundedJob::Outcome::Late)
        throw std::runtime_error("write_bytes: the device did not take the bytes in time");
    return outcome == BoundedJob::Outcome::Done;
}

bool WriteBytes::writeDirectly(const Line& line, const std::string& bytes, bool is_order) const {
    const auto until = Clock::now() + within_;
    std::size_t written = 0;
    while (written < bytes.size()) {
        if (giveUp(is_order)) return false;
        pollfd ready{line.descriptor, POLLOUT, 0};
        const int left = milliseconds(until);
        ::poll(&ready, 1, is_order ? std::min(left, kOrderLooksForStopMs) : left);
        const auto* from = bytes.data() + written;
        const auto count = bytes.size() - written;
        ssize_t got = -1;
        if ((ready.revents & (POLLOUT | POLLERR | POLLHUP)) == 0) {
            errno = EAGAIN;
        } else {
            got = ::send(line.descriptor, from, count, MSG_DONTWAIT | MSG_NOSIGNAL);
            if (got < 0 && errno == ENOTSOCK) got = ::write(line.descriptor, from, count);
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
    return true;
}

RunCommand::RunCommand(std::vector<std::string> words, std::chrono::duration<double> within)
    : words_(std::move(words)), within_(checkBound(within)) {
    if (words_.empty() || ::access(words_.front().c_str(), X_OK) != 0)
        throw std::invalid_argument("run_command: expected the path of a program that can be run" +
                                    (words_.empty() ? std::string() : ", found '" + words_.front() + "'"));
}

RunCommand::~RunCommand() {
    siginfo_t ended{};
    if (child_ >= 0) ::waitid(P_PIDFD, static_cast<id_t>(child_), &ended, WEXITED | WNOHANG);
    forget();
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
    pid_t process = 0;
    const int error =
        ::posix_spawn(&process, words_.front().c_str(), &files, &attributes, arguments.data(), environ);
    posix_spawn_file_actions_destroy(&files);
    posix_spawnattr_destroy(&attributes);
    if (error != 0) throw std::runtime_error(describe() + ": " + why(error));
    // The header of the C library in Debian 12 is not for C++.
    child_ = static_cast<int>(::syscall(SYS_pidfd_open, process, 0));
    if (child_ >= 0) return;
    if (errno == ESRCH) throw std::runtime_error(statusIsUnknown());  // it has ended already
    throw std::runtime_error(describe() + ": its end cannot be watched: " + why(errno));
}

std::string RunCommand::statusIsUnknown() const {
    return describe() +
           " has ended, but another part of this program has collected its status; fix: do not ignore "
           "SIGCHLD, "
           "and wait for your own processes only";
}

void RunCommand::forget() {
    if (child_ >= 0) ::close(std::exchange(child_, -1));
}

void RunCommand::act() {
    const std::lock_guard lock(mutex_);
    const auto until = Clock::now() + within_;
    if (child_ < 0) start();
    pollfd end{child_, POLLIN, 0};
    while (::poll(&end, 1, milliseconds(until)) < 0 && errno == EINTR) {
    }
    if (end.revents == 0) throw std::runtime_error(describe() + " has not ended in time; it goes on");
    siginfo_t ended{};
    const bool known = ::waitid(P_PIDFD, static_cast<id_t>(child_), &ended, WEXITED | WNOHANG) == 0;
    forget();
    if (!known) throw std::runtime_error(statusIsUnknown());
    if (ended.si_code != CLD_EXITED)
        throw std::runtime_error(describe() + " was ended by signal " + std::to_string(ended.si_status));
    if (ended.si_status != 0)
        throw std::runtime_error(describe() + " ended with status " + std::to_string(ended.si_status));
}

}  // namespace axon::python
