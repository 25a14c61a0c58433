// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <functional>
#include <optional>
#include <string>

#include "common/result.hpp"
#include "common/routed.hpp"

namespace axon::transport {

/// What a verified certificate says of who showed it (docs/reference/tls.md).
struct PeerCertificate {
    std::string name;  ///< CN
    std::string unit;  ///< OU: server, router, entity, client
};

/// What somebody who opens a session says of himself, and the two ends of his connection as
/// "127.0.0.1:50122".
struct LoginRequest {
    std::string user;
    std::string password;
    std::string peer;
    std::string local;
    std::optional<PeerCertificate> certificate = {};
    /// The page from which a browser connects, by the header `Origin` of its WebSocket; none of others.
    std::optional<std::string> origin = {};
    /// Behind a router: the other end of the router's connection, if the router says it.
    std::string behind_router = {};

    /// Where it comes from, for records and for what each address may do.
    const std::string& from() const { return behind_router.empty() ? peer : behind_router; }
};

/// Who it is. `user` is empty where the server runs without users.
struct LoggedIn {
    std::string user;
    Role role = Role::Operator;
    std::string entity;  ///< the only name that it may register, by its certificate; empty: any
};

/// Decides who may open a session; the two gates ask it. A password takes its time to verify, so the answer
/// may come on another thread: `answer` is called exactly once, perhaps before the call returns. Threads:
/// any.
class Logins {
  public:
    using Answer = std::function<void(Result<LoggedIn>)>;
    virtual ~Logins() = default;
    virtual void client(LoginRequest request, Answer answer) = 0;
    /// An Entity Manager.
    virtual void entity(LoginRequest request, Answer answer) = 0;

    /// Behind a router: somebody whom it has had verified by one of the two above, here or at another server,
    /// by the name alone; or by the certificate that it has seen, where it is one.
    virtual Result<LoggedIn> vouchedClient(const std::string& user,
                                           const std::optional<PeerCertificate>& certificate = {}) = 0;
    virtual Result<LoggedIn> vouchedEntity(const std::string& user,
                                           const std::optional<PeerCertificate>& certificate = {}) = 0;
    /// Whether the process at the other end of a connection on this machine (`peer`, `local` as above) may be
    /// a router, and vouch for others.
    virtual bool mayVouch(const std::string& peer, const std::string& local) = 0;

    /// Somebody at this address was refused before he had a session, for another reason than who he is:
    /// `what` he asked for, and why he did not get it. For the records.
    virtual void turnedAway(const std::string& peer, const std::string& what, const Refusal& refusal) = 0;
};

}  // namespace axon::transport
