// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <signal.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <fstream>
#include <string>
#include <vector>

namespace axon::test {

/// A robot application as a process of its own, killed at the latest with this object.
class Program {
  public:
    /// The file, and its arguments. Where it cannot be started, pid() is 0.
    explicit Program(const std::vector<std::string>& words) {
        std::vector<char*> arguments;
        for (const auto& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
        arguments.push_back(nullptr);
        if (::posix_spawn(&pid_, words.front().c_str(), nullptr, nullptr, arguments.data(), ::environ) != 0)
            pid_ = 0;
    }
    ~Program() {
        if (pid_ == 0) return;
        ::kill(pid_, SIGKILL);
        ::waitpid(pid_, nullptr, 0);
    }
    Program(const Program&) = delete;
    Program& operator=(const Program&) = delete;
    int pid() const { return pid_; }
    /// Of its DeviceGuard, which is its only child; 0 where there is none.
    int guard() const {
        const auto pid = std::to_string(pid_);
        int child = 0;
        std::ifstream("/proc/" + pid + "/task/" + pid + "/children") >> child;
        return child;
    }

  private:
    pid_t pid_ = 0;
};

}  // namespace axon::test
