// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <signal.h>
#include <sys/types.h>

#include <chrono>
#include <filesystem>
#include <functional>
#include <initializer_list>
#include <optional>
#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace axon::bench {

/// Ctrl-C: whatever measures ends soon, and what there is by then is reported.
extern volatile sig_atomic_t interrupted;
void takeInterrupts();

/// A child process, killed by its own id when this goes out of scope.
class Child {
  public:
    /// What it prints goes to the log. `environment`: KEY=VALUE, besides ours. `prepare` is called in the
    /// child before the program.
    Child(const std::vector<std::string>& words, const std::filesystem::path& log,
          const std::vector<std::string>& environment = {}, const std::function<void()>& prepare = {});
    ~Child();
    Child(const Child&) = delete;
    Child& operator=(const Child&) = delete;
    /// False for ever once it has ended.
    bool running() const;
    pid_t pid() const { return pid_; }
    /// What, with see() of its log.
    std::string complaint(const std::string& what) const;

    /// The first line of the log that begins so. Throws std::runtime_error when it ends before, or never
    /// comes.
    std::string waitForLine(const std::string& begin) const;
    /// Throws std::runtime_error when it ends before the condition is true, or that takes longer than `time`.
    void waitUntil(const std::function<bool()>& condition, const std::string& what,
                   std::chrono::seconds time) const;

  private:
    pid_t pid_ = -1;
    mutable std::optional<int> status_;
    std::filesystem::path log_;
};

/// "; see LOG", with the log's last line. Whoever is told of it finds it there: the run's WorkFolder is not
/// removed.
std::string see(const std::filesystem::path& log);

/// "NAME has ended; see LOG" of the first of these that has; empty while all run. One that is null has not
/// begun.
std::string whichHasEnded(std::initializer_list<std::pair<const char*, const Child*>> all);

/// VALUE of "ready … KEY=VALUE …".
std::string field(const std::string& ready_line, const std::string& key);
/// The program's path, or empty when no package has brought it.
std::string findProgram(const std::string& name);
/// The command that starts this program once more, as one of declareProcesses() (experiment.hpp).
std::vector<std::string> ourselves(const std::string& process,
                                   const std::vector<std::string>& arguments = {});
/// This machine does not let us have as many as wished; the message says of what, and how to fix it.
class NotPermitted : public std::runtime_error {
    using std::runtime_error::runtime_error;
};
/// How many descriptors a process of ours may have: the limit is raised as far as is permitted, for those
/// that it starts, too.
std::size_t descriptorsPermitted();
/// The folder of this program, where Axon's others lie too.
std::filesystem::path programs();
/// A TCP port of 127.0.0.1 that is free now.
std::uint16_t freePort();

/// A folder for logs and boards, one for each run of this program; removed at the end, unless see() has named
/// one of its logs and that was not for Ctrl-C.
class WorkFolder {
  public:
    WorkFolder();
    ~WorkFolder();
    WorkFolder(const WorkFolder&) = delete;
    WorkFolder& operator=(const WorkFolder&) = delete;
    /// A folder in it, made if need be.
    std::filesystem::path sub(const std::string& name) const;

  private:
    std::filesystem::path path_;
};

}  // namespace axon::bench
