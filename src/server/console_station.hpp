// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "common/clock.hpp"
#include "common/ids.hpp"
#include "server/login_desk.hpp"
#include "server/server.hpp"
#include "transport/sessions/door_settings.hpp"

namespace axon::server {

/// The web console of this server: its pages, and who may open a session from them. The sessions themselves
/// are the front-end server's, which listens for them.
///
/// Life: construct, which reads the settings and listens for pages; serve(), once the ports of the sessions
/// are known. Before the destructor, LoginDesk::close(). Threads: that of the HTTP server. Failure:
/// std::runtime_error, saying how to fix it.
class ConsoleStation {
  public:
    using Note = std::function<void(const std::string& line)>;

    /// What is referred to outlives it. `has_users`: the server has a users.cfg.
    ConsoleStation(const ConsoleSettings& settings, const std::map<std::string, std::string>& ice_properties,
                   LoginDesk& desk, bool has_users, const Clock& clock, RandomSource& random, Note note);
    ~ConsoleStation();

    /// Decides who opens a session.
    transport::Logins& logins();
    /// Decides who opens the signal lane of one.
    transport::Logins& signals();
    /// Where a peer finds the signal lane of the session that it opened at the address `local` from a page of
    /// this `origin`; none where it is no browser. After serve().
    std::string signalEndpoint(const std::string& local, const std::optional<std::string>& origin) const;
    /// Visits of those who are no longer the same users end.
    void usersChanged(const users::Users& before, const users::Users& now);
    /// From now on it answers.
    void serve(const transport::DoorPorts& sessions);
    /// "http://127.0.0.1:10417/", of an address that this machine reaches.
    std::string address() const;

  private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

}  // namespace axon::server
