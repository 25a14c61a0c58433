// SPDX-License-Identifier: GPL-2.0-or-later
#include "child.hpp"

#include <fcntl.h>
#include <signal.h>
#include <sys/prctl.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cerrno>
#include <chrono>
#include <cstdio>
#include <fstream>
#include <sstream>
#include <stdexcept>
#include <system_error>
#include <thread>

namespace axon::faults {

namespace {

using namespace std::chrono_literals;
volatile sig_atomic_t interrupts = 0;

std::string lastLines(const std::filesystem::path& file) {
    std::ifstream in(file);
    std::string all((std::istreambuf_iterator<char>(in)), {});
    return all.size() <= 1500 ? all : all.substr(all.size() - 1500);
}

}  // namespace

bool interrupted() {
    return interrupts != 0;
}
void catchInterrupts() {
    for (const int number : {SIGINT, SIGTERM}) ::signal(number, [](int) { interrupts = 1; });
}

Child::Child(const std::vector<std::string>& words, std::filesystem::path log,
             std::vector<std::string> environment)
    : log_(std::move(log)) {
    std::error_code none;
    if (const auto size = std::filesystem::file_size(log_, none); !none) log_begins_ = size;
    std::vector<char*> arguments;
    for (const auto& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
    arguments.push_back(nullptr);
    std::fflush(nullptr);  // or the child would print our buffers again
    const auto parent = ::getpid();
    pid_ = ::fork();
    if (pid_ < 0) throw std::system_error(errno, std::generic_category(), "fork");
    if (pid_ == 0) {
        ::setpgid(0, 0);  // Ctrl-C is for the run, which then ends its children itself
        ::prctl(PR_SET_PDEATHSIG, SIGKILL);
        if (::getppid() != parent) ::_exit(127);
        const int fd = ::open(log_.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0600);
        ::dup2(fd, 1);
        ::dup2(fd, 2);
        const int nothing = ::open("/dev/null", O_RDONLY);
        ::dup2(nothing, 0);
        for (auto& variable : environment) ::putenv(variable.data());
        ::execvp(arguments[0], arguments.data());
        std::perror(arguments[0]);
        ::_exit(127);
    }
}

Child::~Child() {
    kill();
    reap();
}

bool Child::running() {
    if (!ended_ && ::waitpid(pid_, nullptr, WNOHANG) == pid_) ended_ = true;
    return !ended_;
}
void Child::freeze() {
    if (!ended_) ::kill(pid_, SIGSTOP);
}
void Child::thaw() {
    if (!ended_) ::kill(pid_, SIGCONT);
}
void Child::kill() {
    if (!ended_) ::kill(pid_, SIGKILL);
}
void Child::reap() {
    if (!ended_) ::waitpid(pid_, nullptr, 0);
    ended_ = true;
}
void Child::end() {
    if (!ended_) ::kill(pid_, SIGTERM);
    for (int i = 0; i < 400 && running(); ++i) std::this_thread::sleep_for(5ms);
    kill();
    reap();
}

std::string Child::waitForLine(const std::string& begin) {
    for (int i = 0; i < 4000 && !interrupted(); ++i) {
        const bool alive = running();  // before reading: its last words are not missed
        std::ifstream in(log_);
        in.seekg(static_cast<std::streamoff>(log_begins_));
        for (std::string line; std::getline(in, line);)
            if (line.rfind(begin, 0) == 0) return line;
        if (!alive) break;
        std::this_thread::sleep_for(5ms);
    }
    throw std::runtime_error("a program did not say '" + begin + "…'; its log, " + log_.string() +
                             ", ends:\n" + lastLines(log_));
}

std::string field(const std::string& ready_line, const std::string& key) {
    std::istringstream words(ready_line);
    for (std::string word; words >> word;)
        if (word.rfind(key + "=", 0) == 0) return word.substr(key.size() + 1);
    throw std::runtime_error("no " + key + "= in: " + ready_line);
}

}  // namespace axon::faults
