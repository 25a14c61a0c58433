// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <atomic>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "audit/note.hpp"
#include "certificates/certificate.hpp"
#include "common/clock.hpp"
#include "common/rate_limit.hpp"
#include "transport/ice/login.hpp"

namespace axon::transport {

struct Judged;

/// What somebody did who speaks in a name (LinkTrust::speaksAs).
inline constexpr const char* kAnnounced = "announced itself as";

/// Why the other end of this connection is not a server of this kind, and of this name where one is given;
/// nothing: it is. A text for a person that follows "the certificate". Reads the certificate each time.
std::optional<std::string> notServer(const Ice::Connection& connection, certificates::Kind kind,
                                     const std::string& name);

/// Who may be at the other end of the links of one of several servers that are under TLS
/// (docs/reference/tls.md, "Links between servers"): the ports for other servers, IceStorm and routers, and
/// the connections that this server opens to them.
///
/// Where in the flow: IceSSL has verified that a certificate is the CA's and asks here, before Ice has read
/// anything, whether it is of a kind that may come to that adapter. The servants behind these adapters ask
/// whether the caller may call this operation and speak in this name, and whoever opens a connection asks
/// whether the right server has answered.
///
/// Every refusal is counted; the log has at most ten in a second, the audit trail as many as it takes, but of
/// messages whose senders stay connected ten in a second.
/// Threads: any. Lifetime: outlives the communicators that it guards. Bound: it remembers one name for each
/// connection that is open, and both ends of each that was open in the last minute.
class LinkTrust {
  public:
    using Note = std::function<void(const std::string& line)>;

    /// `trail` is told of each refusal; null: nobody is.
    LinkTrust(const Clock& clock, Note note, audit::AuditTrail* trail);

    /// Only certificates of these kinds may connect to this adapter. Before it is activated.
    void admit(const Ice::ObjectAdapter& adapter, std::vector<certificates::Kind> kinds);
    /// Has IceSSL ask. Before the communicator has adapters that are active, or connections. `elsewhere` is
    /// told of connections that IceSSL itself has refused at other ports than those of links.
    using Elsewhere = std::function<void(const std::string& peer, const std::string& why)>;
    void guard(const std::shared_ptr<Ice::Communicator>& communicator, Elsewhere elsewhere = {});

    /// Whether over this connection (bothEnds()) the certificate of a kind that may come has been shown. For
    /// ConnectionLimits, which asks of each connection while it is open, once a second at least.
    bool hasCome(const std::string& ends);

    /// Who is at the other end of a connection to one of these adapters. Remembered until it closes.
    std::shared_ptr<const PeerCertificate> callerOf(const std::shared_ptr<Ice::Connection>& connection);
    /// Whether the caller is of this kind; one that is not is noted and disconnected.
    bool mayCall(const Ice::Current& current, certificates::Kind kind);
    /// Whether the caller speaks in its own name; one that does not is noted and disconnected. `what`: for
    /// people, such as "announced itself as".
    bool speaksAs(const Ice::Current& current, const std::string& name, const char* what);
    /// Whether the caller is the server that has this entity, as far as this one knows (`at`; null: no server
    /// has it, and anybody may speak for it). One that is another server is noted, and its message is to be
    /// dropped; it stays connected, because an entity that moves is known here a little later than there.
    /// `what`: for people, such as "sends a message of".
    bool mayTellOf(const Ice::Current& current, const std::string& entity, const std::string* at,
                   const char* what);

    /// A connection that this server has opened leads to somebody else. `why` as of notServer().
    void noteWrongServer(const std::string& called, const std::string& why);

    /// How many connections and calls were refused.
    std::uint64_t refused() const { return refused_.load(std::memory_order_relaxed); }

  private:
    bool mayCome(const Judged& one);
    void refuse(const std::string& peer, const std::string& name, const std::string& why);
    void record(const std::string& peer, const std::string& name, const std::string& why);
    void disconnect(const Ice::Current& current, const std::string& why);

    const Note note_;
    audit::AuditTrail& trail_;
    const Clock& clock_;
    RateLimit lines_{10};
    RateLimit strays_{10};  // messages of others' entities that are noted in a second
    std::atomic<std::uint64_t> refused_{0};
    std::mutex mutex_;
    /// Who may come, by the adapter's name. Guarded by mutex_.
    std::map<std::string, std::vector<certificates::Kind>> doors_;
    std::set<std::uint16_t> ports_;  // of those adapters; guarded by mutex_
    /// When it was asked for, or came, last, by its ends: IceSSL tells of no end. Guarded by mutex_.
    std::map<std::string, TimePoint> come_;
    std::mutex callers_mutex_;  // taken for each message, so nothing else is done under it
    /// Of open connections. Guarded by callers_mutex_.
    std::map<const Ice::Connection*, std::shared_ptr<const PeerCertificate>> callers_;
};

}  // namespace axon::transport
