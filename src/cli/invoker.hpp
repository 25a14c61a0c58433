// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <functional>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "cli/session.hpp"

namespace axon::cli {

/// Runs a verb where it belongs (Verb::runs): here, on a connection of its own, or in the agent.
///
/// Threads: perform on one; interrupt on any. Lives as long as the process.
class Invoker {
  public:
    /// Asks the user for the password; nothing where nobody can be asked.
    using AskPassword = std::function<std::optional<std::string>(const Settings&)>;

    Invoker(Settings settings, Connect connect, AskPassword ask_password = {});

    /// The exit status.
    int perform(const Verb& verb, Json args, Events& events);
    /// `axon checkout ENTITY… -- COMMAND…`: holds the entities while the command runs, and serves its axon
    /// commands. The command's exit status, 128 + the signal that ended it, or 126/127 as shells have it.
    int holdWhile(const Json& args, const std::vector<std::string>& command, Events& events);
    /// `axon agent run`: what `axon checkout` starts. Says on `ready_fd` that it serves, or why not.
    int serveAgent(int ready_fd);

    /// Ctrl-C (or a request to end): what runs is to come to an orderly end. False when a second one must not
    /// end this process at once, because a command that runs under it gets them too.
    bool interrupt(int signal);
    /// So many of them what runs answers itself (Verb::interrupts).
    unsigned interrupts() const { return interrupts_; }

  private:
    /// Over a connection of its own.
    int withoutAgent(const Verb& verb, Json args, Events& events);
    int start(const Verb& verb, const Json& args, Events& events);
    void onInterrupt(std::function<void(int)> what);
    /// Whether there were interrupts that nobody has taken yet.
    bool takeInterrupt();

    /// Before a connection is made in the name of a user whose password is not known.
    void needPassword();

    Settings settings_;
    const Connect connect_;
    const AskPassword ask_password_;
    bool may_ask_ = true;  // not for shell completion
    std::atomic<unsigned> interrupts_{1};
    std::mutex mutex_;
    // guarded by mutex_
    std::function<void(int)> on_interrupt_;
    unsigned pending_ = 0;  // interrupts that nobody has taken yet
    bool holding_ = false;  // in holdWhile
};

}  // namespace axon::cli
