// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <atomic>
#include <functional>
#include <optional>
#include <string>

#include "console/core/console_core.hpp"
#include "console/core/sites.hpp"
#include "console/core/visitors.hpp"
#include "server/login_desk.hpp"

namespace axon::server {

/// Who comes in through the web console: passwords at its pages, tickets at its sessions.
///
/// With users, a session is opened with a ticket that the page was given for its cookie; a password is not
/// accepted there, so that no page has a reason to keep one. Without users a session is opened without
/// anything, and its role is that of the process, as on the clients' port. With or without, a browser that
/// connects from a page that is not ours is refused, whatever it shows.
///
/// Bound: kWaitingMax log-ins wait that came over the sessions' port, then OVERLOADED; those at the pages are
/// bounded by the connections to them.
///
/// Threads: any. setSites() is called before anybody comes in. Passwords are verified by the LoginDesk, which
/// also slows down who guesses them.
class ConsoleDesk final : public transport::Logins, public console::LoginPort {
  public:
    using Note = std::function<void(const std::string& line)>;
    static constexpr int kWaitingMax = 64;

    /// What is referred to outlives it.
    ConsoleDesk(LoginDesk& desk, bool has_users, console::Visitors& visitors, Note note);
    void setSites(console::Sites sites) { sites_.emplace(std::move(sites)); }

    /// The users are others now: whoever has logged in as one who is no longer the same has to log in again.
    void usersChanged(const users::Users& before, const users::Users& now);

    bool needed() const override { return has_users_; }
    void login(const std::string& user, const std::string& password, const console::Request& request,
               Answered answered) override;

    void client(transport::LoginRequest request, Answer answer) override;
    void entity(transport::LoginRequest request, Answer answer) override;
    /// No router is let in here.
    Result<transport::LoggedIn> vouchedClient(
        const std::string& user, const std::optional<transport::PeerCertificate>& certificate = {}) override;
    Result<transport::LoggedIn> vouchedEntity(
        const std::string& user, const std::optional<transport::PeerCertificate>& certificate = {}) override;
    bool mayVouch(const std::string&, const std::string&) override { return false; }
    void turnedAway(const std::string& peer, const std::string& what, const Refusal& refusal) override {
        desk_.turnedAway(peer, what, refusal);
    }

    /// Of the signal lane of these sessions, where their token is the proof: foreign pages are refused, and
    /// nobody waits.
    transport::Logins& signals() { return signals_; }

  private:
    class Signals final : public transport::Logins {
      public:
        explicit Signals(const ConsoleDesk& desk) : desk_(desk) {}
        void client(transport::LoginRequest request, Answer answer) override;
        void entity(transport::LoginRequest request, Answer answer) override;
        Result<transport::LoggedIn> vouchedClient(
            const std::string& user, const std::optional<transport::PeerCertificate>& certificate) override;
        Result<transport::LoggedIn> vouchedEntity(
            const std::string& user, const std::optional<transport::PeerCertificate>& certificate) override;
        bool mayVouch(const std::string&, const std::string&) override { return false; }
        void turnedAway(const std::string& peer, const std::string& what, const Refusal& refusal) override {
            desk_.desk_.turnedAway(peer, what, refusal);
        }

      private:
        const ConsoleDesk& desk_;
    };
    /// A browser that comes from a page that is not ours.
    std::optional<Refusal> foreign(const transport::LoginRequest& request) const;

    LoginDesk& desk_;
    const bool has_users_;
    console::Visitors& visitors_;
    const Note note_;
    std::optional<console::Sites> sites_;
    std::atomic<int> waiting_{0};
    Signals signals_{*this};
};

}  // namespace axon::server
