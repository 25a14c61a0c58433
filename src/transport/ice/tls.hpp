// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <Ice/Ice.h>

#include <exception>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <string>

#include "certificates/trust.hpp"
#include "common/result.hpp"
#include "transport/ice/endpoint.hpp"
#include "transport/ice/login.hpp"

// TLS by IceSSL (docs/reference/tls.md): what the rest of the transport asks of it. Threads: any.
namespace axon::transport {

/// The peer's certificate, which IceSSL has verified unless it was told not to (callingEntities()); none over
/// plain TCP, and of a peer that showed none.
std::optional<PeerCertificate> certificateOf(const Ice::Connection& connection);
/// The same, and none where IceSSL has not verified it.
std::optional<PeerCertificate> verifiedCertificateOf(const Ice::Connection& connection);

bool isTls(const Ice::Connection& connection);

/// Whether these properties say how to speak TLS: which certificate to show.
bool speaksTls(const std::map<std::string, std::string>& properties);

/// By which certificates are judged.
certificates::WallTime wallTime();

/// What these properties say, read from the files that IceSSL reads: for a connection that is not IceSSL's.
/// Throws certificates::Unusable for files that cannot be read, and for what only IceSSL understands.
certificates::Credentials credentialsOf(const std::map<std::string, std::string>& properties);

/// For a communicator that calls entities, not servers, before it is made: IceSSL then accepts any
/// certificate, because its checks know servers only, and onlyEntities() decides.
std::map<std::string, std::string> callingEntities(std::map<std::string, std::string> properties);
/// The same, afterwards: who is called must show the certificate of an entity of this CA. Whose it is, is
/// for whoever calls (certificateOf).
void onlyEntities(const std::shared_ptr<Ice::Communicator>& communicator,
                  std::shared_ptr<const certificates::Trust> trust);

/// For a communicator that speaks TLS, before it is made: the plug-in, our defaults for what the
/// configuration does not say, and a logger that tells why a peer's certificate was refused, which nobody
/// else gets to know.
void prepareTls(Ice::InitializationData& init, const std::map<std::string, std::string>& configured);

/// The same, afterwards: who is called must show the certificate of a server or a router.
void checkServers(const std::shared_ptr<Ice::Communicator>& communicator);

/// A connection over TLS of which IceSSL has verified the certificate.
struct Judged {
    bool incoming = false;
    std::string adapter;  ///< of an incoming one
    std::string peer;     ///< the address at the other end, "10.0.0.7:50122"
    std::string local;    ///< the one here
    std::optional<PeerCertificate> certificate;
};
/// In place of checkServers(): `accept` decides of each connection before anything has been sent or read. On
/// Ice's threads. Whoever refuses says why.
void judgeCertificates(const std::shared_ptr<Ice::Communicator>& communicator,
                       std::function<bool(const Judged&)> accept);
/// Told of each connection that IceSSL itself has refused: the address of the other end and the one here, and
/// why. On Ice's threads, and as often as strangers cause it.
void onRefused(
    const std::shared_ptr<Ice::Communicator>& communicator,
    std::function<void(const std::string& peer, const std::string& local, const std::string& why)> refused);

/// Why an Ice exception of TLS was thrown, and what to do; nothing for others. `setting_up`: the connection
/// was being made, and a loss of it means that the other side did not like our certificate (TLS 1.3 tells the
/// caller nothing else).
std::optional<Refusal> tlsRefusal(const std::exception_ptr& error, bool setting_up);

/// Refused before anything is sent: TLS without a certificate to show. `kind` is "client", "entity" or
/// "server".
std::string certificateMissing(const std::string& address, const std::string& kind);

}  // namespace axon::transport
