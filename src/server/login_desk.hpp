// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <condition_variable>
#include <deque>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <thread>

#include "audit/note.hpp"
#include "common/clock.hpp"
#include "common/rate_limit.hpp"
#include "server/login_guard.hpp"
#include "transport/ice/login.hpp"
#include "users/present_users.hpp"
#include "users/users.hpp"

namespace axon::server {

/// Who may open a session of this server, and as what.
///
/// A certificate must be of the door's kind (OU=client, OU=entity). A client's stands for the password of the
/// user whose name it bears; an entity's for user and password, and binds the Entity Manager to its name.
///
/// With users: name and password must be in users.cfg; the role `entity` is for Entity Managers, the other
/// three for clients. Without (the server listens on loopback only): whoever has the server's own uid, or
/// root's, is admin, everybody else operator; where the uid cannot be found out, operator. An Entity Manager
/// needs no name then.
///
/// The users may change while it runs; whether there are any may not. A log-in that is being verified
/// meanwhile counts only if the new users admit it, too.
///
/// Threads: one of its own does what takes time (verifying a password, asking the kernel whose a connection
/// is), so that Ice's threads never do; the answers are given on it. One password at a time is verified,
/// which bounds the memory: what the costliest hash wants. It serves one of each address in turn, so that who
/// tries many passwords holds up himself. Bound: 4096 log-ins wait, of one address 256, then OVERLOADED. A
/// password that was right once is known by a keyed digest, so that thousands that come back after a restart
/// are not verified one by one, and whoever comes with it is heard before those that must be verified: an
/// operator who wants to stop a robot does not wait behind somebody who tries passwords. Life: close() before
/// the gates' communicators are destroyed; it answers all that wait.
class LoginDesk final : public transport::Logins, public users::PresentUsers {
  public:
    using Note = std::function<void(const std::string& line)>;
    using OwnerOf =
        std::function<std::optional<std::uint32_t>(const std::string& peer, const std::string& local)>;

    /// `note` gets lines for the log, on any thread; `owner_of` finds the uid of a connection's other end.
    /// `trail` is told of each log-in and each refusal; null: nobody is.
    LoginDesk(std::shared_ptr<const users::Users> users, const Clock& clock, Note note, OwnerOf owner_of,
              audit::AuditTrail* trail = nullptr);
    ~LoginDesk() override;
    LoginDesk(const LoginDesk&) = delete;
    LoginDesk& operator=(const LoginDesk&) = delete;

    void client(transport::LoginRequest request, Answer answer) override;
    void entity(transport::LoginRequest request, Answer answer) override;
    /// Any thread; nothing is verified here.
    Result<transport::LoggedIn> vouchedClient(
        const std::string& user, const std::optional<transport::PeerCertificate>& certificate = {}) override;
    Result<transport::LoggedIn> vouchedEntity(
        const std::string& user, const std::optional<transport::PeerCertificate>& certificate = {}) override;
    /// A process of the server's own uid, or root's. Asks the kernel.
    bool mayVouch(const std::string& peer, const std::string& local) override;
    void turnedAway(const std::string& peer, const std::string& what, const Refusal& refusal) override;
    /// From now on these may log in, with their passwords and roles; never null. Only where there are users.
    /// Whoever is here is not touched, but for what clientRole() and mayBeEntityManager() say from now on.
    void setUsers(std::shared_ptr<const users::Users> users);
    std::optional<Role> clientRole(const std::string& user) const override;
    bool mayBeEntityManager(const std::string& user) const override;
    std::shared_ptr<const users::Access> access() const override;
    std::string fingerprint() const override;
    void close();

  private:
    enum class Door { Client, Entity };
    struct Job {
        Door door = Door::Client;
        transport::LoginRequest request;
        std::string address;  // of the peer, without its port
        Answer answer;
    };
    using Digest = std::array<unsigned char, 32>;

    void record(Door door, const std::string& user, const std::string& peer,
                const Result<transport::LoggedIn>& who) const;
    Answer recorded(Door door, const transport::LoginRequest& request, Answer answer) const;
    void enqueue(Door door, transport::LoginRequest request, Answer answer);
    void run();
    Result<transport::LoggedIn> decide(const Job& job);
    Result<transport::LoggedIn> decideWithUsers(const Job& job);
    Result<transport::LoggedIn> vouched(Door door, const std::string& user) const;
    static Result<transport::LoggedIn> admit(users::UserRole role, Door door, const std::string& user);
    /// Whether its certificate, if it showed one, is for this door.
    std::optional<Refusal> wrongCertificate(Door door,
                                            const std::optional<transport::PeerCertificate>& certificate,
                                            const std::string& peer) const;
    std::optional<users::UserRole> verify(const std::string& user, const std::string& password);
    std::shared_ptr<const users::Users> usersNow() const;
    /// Nothing for one that is longer than any password.
    std::optional<Digest> digestOf(const std::string& password) const;
    bool isKnown(const std::string& user, const Digest& digest) const;

    // Constant after construction.
    const bool has_users_;
    const Note note_;
    const OwnerOf owner_of_;
    audit::AuditTrail& trail_;
    Digest key_{};
    const SteadyClock steady_{};  // of what strangers cost, also where the laboratory's time stands
    RateLimit lines_{10};         // of the log, in a second, of log-ins that are refused before they wait
    // Of its thread only.
    LoginGuard guard_;

    mutable std::mutex mutex_;
    std::condition_variable changed_;
    // Guarded by mutex_:
    std::shared_ptr<const users::Users> users_;    // null where there are none
    std::string fingerprint_;                      // of these
    std::map<std::string, Digest> known_;          // by the names of users whose present hash it belongs to
    std::deque<Job> of_known_;                     // before the others
    std::map<std::string, std::deque<Job>> jobs_;  // of each address that has any
    std::deque<std::string> turns_;                // those addresses, next first
    std::size_t waiting_ = 0;                      // jobs of all
    bool closed_ = false;

    std::thread thread_;
};

}  // namespace axon::server
