// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <chrono>
#include <functional>
#include <list>
#include <memory>
#include <string>
#include <thread>

#include "cli/agent_link.hpp"
#include "cli/session.hpp"
#include "host/wake_up.hpp"

namespace axon::cli {

/// Keeps a session for commands that come and go: takes requests on a private Unix socket, runs each verb on
/// a thread, and sends its events back.
///
/// States: serving, until stop(), or until nothing has been held and nobody connected for `linger`, or as
/// soon as nobody is connected after a check-out or a release has left nothing held. Threads: serve() runs on
/// the caller's; a thread per running request, at most kMostConnections. Ownership: of its connections, not
/// of what `perform` works on. Failure: a peer that breaks off, does not read for five seconds or sends no
/// JSON loses its connection, and its verb is interrupted: a task that somebody follows does not outlive who
/// follows it.
class Agent {
  public:
    static constexpr std::size_t kMostConnections = 32;

    struct Work {
        std::string verb;
        Json args;
        Events& events;
        std::shared_ptr<Mailbox> mailbox;
    };
    /// The exit status; nothing = this verb is to be run elsewhere.
    using Perform = std::function<std::optional<int>(const Work&)>;
    using Holds = std::function<bool()>;

    Agent(Descriptor listening, Perform perform, Holds holds, std::chrono::milliseconds linger);
    ~Agent();

    void serve();
    /// Before serve(): called on its thread at least once a second, with whether a verb is running.
    void onLook(std::function<void(bool used)> look) { look_ = std::move(look); }
    /// Any thread. Running verbs are interrupted.
    void stop();
    /// Before serve(): a connection that was not made through the listening socket.
    void adopt(Descriptor connection);

  private:
    struct Connection;
    void read(Connection& connection);
    void take(Connection& connection, const std::string& text);
    void reap();
    void wake() const;

    const Perform perform_;
    const Holds holds_;
    const std::chrono::milliseconds linger_;
    std::function<void(bool used)> look_;
    Descriptor listening_;
    WakeUp woken_;
    std::atomic<bool> stopping_{false};
    std::list<std::unique_ptr<Connection>> connections_;  // confined to serve()'s thread
    bool end_when_alone_ = false;                         // likewise
};

/// A listening Unix socket with mode 0600. An old file of that name is removed: hold the place's lock.
Result<Descriptor> listenAt(const std::filesystem::path& socket);

}  // namespace axon::cli
