// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <fcntl.h>
#include <gtest/gtest.h>
#include <sys/wait.h>
#include <unistd.h>

#include <csignal>
#include <filesystem>
#include <fstream>
#include <sstream>
#include <string>
#include <vector>

#include "support/loopback.hpp"

namespace axon::test {

/// A program with its standard output in a file; killed at the end.
class LoggedProgram {
  public:
    LoggedProgram(const std::vector<std::string>& words, const std::filesystem::path& log) : log_(log) {
        std::vector<char*> arguments;
        for (const auto& word : words) arguments.push_back(const_cast<char*>(word.c_str()));
        arguments.push_back(nullptr);
        std::filesystem::remove(log);  // of the program before
        id_ = ::fork();
        if (id_ != 0) return;
        const int file = ::open(log.c_str(), O_WRONLY | O_CREAT | O_TRUNC, 0600);
        ::dup2(file, 1);
        ::dup2(file, 2);
        sigset_t none;
        sigemptyset(&none);
        sigprocmask(SIG_SETMASK, &none, nullptr);
        ::execvp(arguments[0], arguments.data());
        ::_exit(127);
    }
    ~LoggedProgram() { kill(); }
    LoggedProgram(const LoggedProgram&) = delete;
    LoggedProgram& operator=(const LoggedProgram&) = delete;

    void kill() {
        if (id_ <= 0) return;
        ::kill(id_, SIGKILL);
        ::waitpid(id_, nullptr, 0);
        id_ = 0;
    }
    std::string text() const {
        std::stringstream all;
        all << std::ifstream(log_).rdbuf();
        return all.str();
    }
    /// What follows `key` in the ready line, up to the next space.
    std::string ready(const std::string& key) const {
        std::string value;
        EXPECT_TRUE(waitUntil([&] { return text().find("ready ") != std::string::npos; })) << text();
        const auto all = text();
        const auto line = all.substr(all.find("ready "));
        const auto at = line.find(" " + key + "=");
        if (at == std::string::npos) return {};
        const auto begin = at + key.size() + 2;
        return line.substr(begin, line.find_first_of(" \n", begin) - begin);
    }

  private:
    const std::filesystem::path log_;
    pid_t id_ = 0;
};

}  // namespace axon::test
