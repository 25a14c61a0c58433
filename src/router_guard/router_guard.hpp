// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <condition_variable>
#include <list>
#include <mutex>
#include <stop_token>
#include <thread>

namespace axon::router_guard {

/// The part of the plug-in for Glacier2 (ADR 0045) that closes the router's connection to a server that does
/// not answer, so that log-ins go to another one. Without it a server that stands still keeps its connection
/// for as long as log-ins are sent over it, because for Ice whatever is sent is a sign of life.
///
/// It calls each server of Glacier2.PermissionsVerifier and Glacier2.SessionManager four times a second, over
/// the connection that Glacier2 uses, and closes it if there is no answer within a second; all sessions with
/// that server end. Threads: initialize() and destroy() one, as Ice calls the plug-in; one thread for each
/// server. Written for the C++98 mapping of Ice, which is that of glacier2router.
class RouterGuard final {
  public:
    explicit RouterGuard(Ice::CommunicatorPtr communicator);
    ~RouterGuard();
    RouterGuard(const RouterGuard&) = delete;
    RouterGuard& operator=(const RouterGuard&) = delete;
    void initialize();
    void destroy();

  private:
    void findServers(const std::stop_token& ended);
    void guard(const Ice::ObjectPrx& server, const std::stop_token& ended);
    /// False if it is over.
    bool pause(const std::stop_token& ended);

    const Ice::CommunicatorPtr communicator_;
    std::mutex mutex_;
    std::condition_variable_any end_;
    std::list<std::jthread> guards_;  // of finder_, until that has ended
    std::jthread finder_;
};

}  // namespace axon::router_guard
