// SPDX-License-Identifier: GPL-2.0-or-later
#include "child.hpp"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <sys/prctl.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <system_error>
#include <thread>

#include "common/descriptor.hpp"

namespace axon::bench {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

volatile sig_atomic_t interrupted = 0;

namespace {
bool log_named = false;
}

void takeInterrupts() {
    struct sigaction act {};
    act.sa_handler = [](int) { interrupted = 1; };
    act.sa_flags = static_cast<int>(SA_RESETHAND);  // the second one ends the process
    ::sigaction(SIGINT, &act, nullptr);
    ::sigaction(SIGTERM, &act, nullptr);
}

Child::Child(const std::vector<std::string>& words, const fs::path& log,
             const std::vector<std::string>& environment, const std::function<void()>& prepare)
    : log_(log) {
    std::fflush(nullptr);  // or the child would print our buffers again
    std::vector<char*> arguments;
    for (const auto& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    fs::remove(log);  // what an earlier one left there is nothing that this one said
    pid_ = ::fork();
    if (pid_ < 0) throw std::system_error(errno, std::generic_category(), "fork");
    if (pid_ == 0) {
        ::setpgid(0, 0);  // Ctrl-C is for the benchmark, which then ends its children itself
        ::prctl(PR_SET_PDEATHSIG, SIGKILL);
        ::close_range(3, ~0U, CLOSE_RANGE_CLOEXEC);  // Ice's sockets and pipes, which would be every child's
        for (const auto& one : environment) ::putenv(const_cast<char*>(one.c_str()));
        if (std::freopen(log.c_str(), "w", stdout) == nullptr ||
            std::freopen(log.c_str(), "a", stderr) == nullptr)
            ::_exit(127);
        try {
            if (prepare) prepare();
        } catch (const std::exception& problem) {
            std::fprintf(stderr, "%s\n", problem.what());
            std::fflush(nullptr);
            ::_exit(127);
        }
        ::execvp(arguments[0], arguments.data());
        std::perror(arguments[0]);
        ::_exit(127);
    }
}

Child::~Child() {
    if (!running()) return;  // its id may be another's by now
    ::kill(pid_, SIGKILL);
    ::waitpid(pid_, nullptr, 0);
}

bool Child::running() const {
    int status = 0;
    if (!status_ && ::waitpid(pid_, &status, WNOHANG) == pid_)
        status_ = WIFEXITED(status) ? WEXITSTATUS(status) : 128 + WTERMSIG(status);
    return !status_;
}

std::string Child::complaint(const std::string& what) const {
    return what + see(log_);
}

std::string see(const fs::path& log) {
    log_named = true;
    std::ifstream in(log);
    std::string last;
    for (std::string line; std::getline(in, line);)
        if (!line.empty()) last = line;
    return "; see " + log.string() + (last.empty() ? "" : ": " + last);
}

std::string Child::waitForLine(const std::string& begin) const {
    std::string found;
    waitUntil(
        [&] {
            std::ifstream in(log_);
            for (std::string line; std::getline(in, line);)
                if (line.rfind(begin, 0) == 0) {
                    found = line;
                    return true;
                }
            return false;
        },
        "a program did not say '" + begin + "'", 10s);
    return found;
}

void Child::waitUntil(const std::function<bool()>& condition, const std::string& what,
                      std::chrono::seconds time) const {
    const auto end = std::chrono::steady_clock::now() + time;
    while (!condition()) {
        if (interrupted) throw std::runtime_error("interrupted");
        if (!running() || std::chrono::steady_clock::now() > end) throw std::runtime_error(complaint(what));
        std::this_thread::sleep_for(5ms);
    }
}

std::string whichHasEnded(std::initializer_list<std::pair<const char*, const Child*>> all) {
    for (const auto& [name, child] : all)
        if (child != nullptr && !child->running()) return child->complaint(std::string(name) + " has ended");
    return {};
}

std::string field(const std::string& ready_line, const std::string& key) {
    std::istringstream words(ready_line);
    for (std::string word; words >> word;)
        if (word.rfind(key + "=", 0) == 0) return word.substr(key.size() + 1);
    throw std::runtime_error("no " + key + "= in: " + ready_line);
}

std::string findProgram(const std::string& name) {
    const char* path = std::getenv("PATH");
    // Daemons lie in /usr/sbin, which an ordinary user's path may lack.
    std::istringstream folders(std::string(path != nullptr ? path : "/usr/bin") + ":/usr/sbin");
    for (std::string folder; std::getline(folders, folder, ':');) {
        const auto file = fs::path(folder) / name;
        if (::access(file.c_str(), X_OK) == 0) return file.string();
    }
    return {};
}

std::size_t descriptorsPermitted() {
    rlimit limit{};
    if (::getrlimit(RLIMIT_NOFILE, &limit) != 0)
        throw std::system_error(errno, std::generic_category(), "getrlimit");
    if (limit.rlim_cur < limit.rlim_max) {
        limit.rlim_cur = limit.rlim_max;
        ::setrlimit(RLIMIT_NOFILE, &limit);
        ::getrlimit(RLIMIT_NOFILE, &limit);
    }
    return limit.rlim_cur;
}

fs::path programs() {
    return fs::canonical("/proc/self/exe").parent_path();
}

std::vector<std::string> ourselves(const std::string& process, const std::vector<std::string>& arguments) {
    std::vector<std::string> command{(programs() / "axon-bench").string(), process};
    command.insert(command.end(), arguments.begin(), arguments.end());
    return command;
}

std::uint16_t freePort() {
    const Descriptor socket(::socket(AF_INET, SOCK_STREAM, 0));
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    socklen_t size = sizeof(address);
    const bool done = ::bind(socket.get(), reinterpret_cast<sockaddr*>(&address), size) == 0 &&
                      ::getsockname(socket.get(), reinterpret_cast<sockaddr*>(&address), &size) == 0;
    if (!done) throw std::system_error(errno, std::generic_category(), "no free port");
    return ntohs(address.sin_port);
}

WorkFolder::WorkFolder() : path_(fs::temp_directory_path() / ("axon-bench-" + std::to_string(::getpid()))) {
    fs::create_directories(path_);
}

WorkFolder::~WorkFolder() {
    if (log_named && !interrupted) return;
    std::error_code ignored;
    fs::remove_all(path_, ignored);
}

fs::path WorkFolder::sub(const std::string& name) const {
    fs::create_directories(path_ / name);
    return path_ / name;
}

}  // namespace axon::bench
