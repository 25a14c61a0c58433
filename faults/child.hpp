// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <sys/types.h>

#include <filesystem>
#include <string>
#include <vector>

namespace axon::faults {

/// A child process in a process group of its own, killed by its own id when this goes out of scope; the
/// kernel kills it when the run itself dies. Threads: the one that made it.
class Child {
  public:
    /// Standard output and standard error are appended to the log.
    /// `environment`: "NAME=value", added to this process's own.
    Child(const std::vector<std::string>& words, std::filesystem::path log,
          std::vector<std::string> environment = {});
    ~Child();
    Child(const Child&) = delete;
    Child& operator=(const Child&) = delete;

    pid_t pid() const { return pid_; }
    bool running();
    /// SIGSTOP and SIGCONT.
    void freeze();
    void thaw();
    /// kill -9 without waiting for the end; reap() waits.
    void kill();
    void reap();
    /// SIGTERM, and SIGKILL when that does not help within two seconds.
    void end();
    /// Waits for a line of this process' own output that begins so. Throws std::runtime_error with the end of
    /// the log.
    std::string waitForLine(const std::string& begin);

  private:
    std::filesystem::path log_;
    std::uintmax_t log_begins_ = 0;
    pid_t pid_ = -1;
    bool ended_ = false;
};

/// Of "ready client=127.0.0.1:10410 …": the value of a key.
std::string field(const std::string& ready_line, const std::string& key);

/// Set by Ctrl-C: whoever waits gives up, and what there is is shown.
bool interrupted();
void catchInterrupts();

}  // namespace axon::faults
