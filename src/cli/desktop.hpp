// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <spawn.h>

#include <chrono>
#include <map>
#include <string>
#include <vector>

#include "cli/session.hpp"

// How this command starts other programs, and where the desktop of its user is.
namespace axon::cli {

/// A child with the signals as a fresh program expects them: ours are blocked and taken by a thread.
class SpawnAttributes {
  public:
    explicit SpawnAttributes(short extra_flags = 0);
    ~SpawnAttributes() { ::posix_spawnattr_destroy(&attributes_); }
    SpawnAttributes(const SpawnAttributes&) = delete;
    SpawnAttributes& operator=(const SpawnAttributes&) = delete;
    const posix_spawnattr_t* get() const { return &attributes_; }

  private:
    posix_spawnattr_t attributes_{};
};

/// As exec and its relatives take them; valid as long as `words` is not changed.
std::vector<char*> pointersTo(std::vector<std::string>& words);

/// The environment of this process, NAME=VALUE, without a password: an agent has one in its own.
std::vector<std::string> environmentWithoutPassword();

/// The desktop of the user who typed a command: the variables by which programs find it. A verb may run in
/// the agent, whose own variables are those of the terminal that it was started from; json() takes them
/// there.
class Desktop {
  public:
    /// Of this process.
    static Desktop here();
    /// From json(). What is no text of a variable of a desktop is left out.
    static Desktop of(const Json& variables);
    Json json() const { return variables_; }

    bool hasScreen() const;
    bool takesNotifications() const;

    /// Starts a program in a session of its own, with this desktop instead of that of this process, without
    /// a password, and with /dev/null as its standard input and output. Does not wait. Whether it began.
    bool start(std::vector<std::string> words) const;
    /// Shows the file as this user shows such files (xdg-open). False where there is no screen or xdg-open
    /// fails. One that still runs after `patience` has become the browser.
    bool open(const std::string& file, std::chrono::milliseconds patience = kPatience) const;

  private:
    static constexpr std::chrono::milliseconds kPatience{3000};

    pid_t spawn(std::vector<std::string> words) const;

    std::map<std::string, std::string> variables_;
};

}  // namespace axon::cli
