// SPDX-License-Identifier: GPL-2.0-or-later
#include "transport/ice/link_trust.hpp"

#include <algorithm>
#include <cstdlib>
#include <utility>

#include "certificates/trust.hpp"
#include "common/utf8.hpp"
#include "transport/ice/adapter.hpp"
#include "transport/ice/known_connections.hpp"
#include "transport/ice/peer_connection.hpp"
#include "transport/ice/tls.hpp"

namespace axon::transport {
namespace {

using certificates::Kind;

/// Longer than a machine under load lets ConnectionLimits wait.
constexpr std::chrono::seconds kForgetCome{60};

/// For people: a name that somebody else has chosen.
std::string shown(const std::string& text) {
    std::string its(cutUtf8(validUtf8(text), 64));
    for (auto& c : its)
        if (static_cast<unsigned char>(c) < 0x20 || c == 0x7F) c = '?';
    return "'" + its + "'";
}

std::string told(const PeerCertificate& its) {
    const auto kind = certificates::kindOf(its.unit);
    return kind ? std::string("the ") + toString(*kind) + " " + shown(its.name)
                : "the unknown kind " + shown(its.unit);
}

std::string listed(const std::vector<Kind>& kinds) {
    std::string text;
    for (std::size_t i = 0; i < kinds.size(); ++i)
        text += std::string(i == 0 ? "" : i + 1 == kinds.size() ? " or " : ", ") + toString(kinds[i]);
    return text;
}

std::uint16_t portOf(const std::string& address) {
    const auto colon = address.rfind(':');
    const auto port = colon == std::string::npos ? 0 : std::atoi(address.c_str() + colon + 1);
    return static_cast<std::uint16_t>(port);
}

}  // namespace

std::optional<std::string> notServer(const Ice::Connection& connection, Kind kind, const std::string& name) {
    const auto its = verifiedCertificateOf(connection);
    if (!its) return "was not shown";
    if (!name.empty()) {
        certificates::Certificate shown_one;
        shown_one.name = its->name;
        shown_one.unit = its->unit;
        const auto why = certificates::mismatch(shown_one, kind, name);
        return why.empty() ? std::nullopt : std::optional(why);
    }
    if (its->unit == toString(kind)) return std::nullopt;
    return "is that of " + told(*its) + "; expected one of the kind " + toString(kind);
}

LinkTrust::LinkTrust(const Clock& clock, Note note, audit::AuditTrail* trail)
    : note_(std::move(note)), trail_(audit::orNone(trail)), clock_(clock) {}

void LinkTrust::admit(const Ice::ObjectAdapter& adapter, std::vector<Kind> kinds) {
    const std::lock_guard lock(mutex_);
    doors_[adapter.getName()] = std::move(kinds);
    for (const auto& endpoint : listenedEndpoints(adapter)) ports_.insert(endpoint.port);
}

void LinkTrust::guard(const std::shared_ptr<Ice::Communicator>& communicator, Elsewhere elsewhere) {
    judgeCertificates(communicator, [this](const Judged& one) {
        if (one.incoming) return mayCome(one);
        const auto kind = one.certificate ? certificates::kindOf(one.certificate->unit) : std::nullopt;
        if (kind && isCalled(*kind)) return true;
        noteWrongServer(one.peer, one.certificate ? "is that of " + told(*one.certificate) +
                                                        "; expected one of a server, a router or IceStorm"
                                                  : std::string("was not shown"));
        return false;
    });
    onRefused(communicator, [this, elsewhere = std::move(elsewhere)](
                                const std::string& peer, const std::string& local, const std::string& why) {
        bool ours = false;
        {
            const std::lock_guard lock(mutex_);
            ours = ports_.contains(portOf(local));
        }
        if (!ours) return elsewhere ? elsewhere(peer, why) : void();
        record(peer, {}, "a connection was refused: " + why);  // the log has it
    });
}

bool LinkTrust::mayCome(const Judged& one) {
    const auto& certificate = one.certificate;
    std::vector<Kind> kinds;
    {
        const std::lock_guard lock(mutex_);
        const auto found = doors_.find(one.adapter);
        if (found == doors_.end()) return true;  // its gate says what it expects, and why not
        kinds = found->second;
    }
    const auto kind = certificate ? certificates::kindOf(certificate->unit) : std::nullopt;
    if (kind && std::find(kinds.begin(), kinds.end(), *kind) != kinds.end()) {
        const auto now = clock_.now();
        const std::lock_guard lock(mutex_);
        std::erase_if(come_, [now](const auto& its) { return now - its.second > kForgetCome; });
        come_[bothEnds(one.peer, one.local)] = now;
        return true;
    }
    refuse(one.peer, certificate ? certificate->name : std::string(),
           "a connection to " + one.adapter + " was refused: the certificate " +
               (certificate ? "is that of " + told(*certificate) : std::string("was not shown")) +
               "; expected one of the kind " + listed(kinds));
    return false;
}

bool LinkTrust::hasCome(const std::string& ends) {
    const std::lock_guard lock(mutex_);
    const auto found = come_.find(ends);
    if (found == come_.end()) return false;
    found->second = clock_.now();
    return true;
}

std::shared_ptr<const PeerCertificate> LinkTrust::callerOf(
    const std::shared_ptr<Ice::Connection>& connection) {
    static const auto kNobody = std::make_shared<const PeerCertificate>();
    if (!connection) return kNobody;
    {
        const std::lock_guard lock(callers_mutex_);
        if (const auto found = callers_.find(connection.get()); found != callers_.end()) return found->second;
    }
    const auto its = std::make_shared<const PeerCertificate>(
        verifiedCertificateOf(*connection).value_or(PeerCertificate{}));
    {
        const std::lock_guard lock(callers_mutex_);
        if (!callers_.emplace(connection.get(), its).second) return its;
    }
    connection->setCloseCallback([this](const std::shared_ptr<Ice::Connection>& closed) {
        const std::lock_guard lock(callers_mutex_);
        callers_.erase(closed.get());
    });
    return its;
}

bool LinkTrust::mayCall(const Ice::Current& current, Kind kind) {
    const auto its = callerOf(current.con);
    if (its->unit == toString(kind)) return true;
    disconnect(current, told(*its) + " called " + shown(current.operation) + ", which is for the kind " +
                            toString(kind));
    return false;
}

bool LinkTrust::speaksAs(const Ice::Current& current, const std::string& name, const char* what) {
    const auto its = callerOf(current.con);
    if (its->name == name) return true;
    disconnect(current, told(*its) + " " + what + " " + shown(name) + "; expected its own name");
    return false;
}

bool LinkTrust::mayTellOf(const Ice::Current& current, const std::string& entity, const std::string* at,
                          const char* what) {
    if (at == nullptr) return true;
    const auto its = callerOf(current.con);
    if (its->name == *at) return true;
    if (!strays_.admit(clock_.now())) {
        ++refused_;
        return false;
    }
    refuse(current.con ? DirectConnection::peerOf(*current.con) : std::string(), its->name,
           told(*its) + " " + what + " the entity " + shown(entity) + ", which the server " + shown(*at) +
               " has; the message is dropped");
    return false;
}

void LinkTrust::noteWrongServer(const std::string& called, const std::string& why) {
    refuse(called, {}, called + " is not used: the certificate that it shows " + why);
}

void LinkTrust::disconnect(const Ice::Current& current, const std::string& why) {
    refuse(current.con ? DirectConnection::peerOf(*current.con) : std::string(), callerOf(current.con)->name,
           why + "; it is disconnected");
    if (current.con) current.con->close(Ice::ConnectionClose::Forcefully);
}

void LinkTrust::refuse(const std::string& peer, const std::string& name, const std::string& why) {
    record(peer, name, why);
    if (lines_.admit(clock_.now())) note_("audit: link between servers, " + peer + ": " + why);
}

void LinkTrust::record(const std::string& peer, const std::string& name, const std::string& why) {
    ++refused_;
    const auto what = "link between servers: " + why;
    trail_.note({.kind = audit::Kind::Refusal,
                 .name = name,
                 .peer = peer,
                 .what = what,
                 .outcome = "PERMISSION_DENIED"});
}

}  // namespace axon::transport
