// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <array>
#include <chrono>
#include <optional>
#include <stdexcept>
#include <string>
#include <string_view>
#include <vector>

// The laboratory's own certificates: what they say, and how they are made (docs/reference/tls.md). No I/O but
// the randomness of new keys, which GnuTLS takes from the kernel; no clock: whoever calls says what time it
// is. Threads: any.
namespace axon::certificates {

/// Certificates know wall-clock time only.
using WallTime = std::chrono::sys_seconds;

/// What a certificate is for: its OU. An entity's and a client's may be used on the calling side of a
/// connection only, the others on both sides, as servers and routers call each other.
///
///     Server       axon-server, for clients, Entity Managers and routers
///     FrontEnd     one of several front-end servers: the same, and for other servers and IceStorm
///     EntityServer one of several entity servers, likewise
///     Storm        icebox with IceStorm
///     Registry     icegridregistry, icegridnode and icegridadmin
enum class Kind { Server, FrontEnd, EntityServer, Storm, Registry, Router, Entity, Client };
inline constexpr std::array<Kind, 8> kKinds{Kind::Server,   Kind::FrontEnd, Kind::EntityServer, Kind::Storm,
                                            Kind::Registry, Kind::Router,   Kind::Entity,       Kind::Client};
/// The OU, which is also the option of axon certs.
const char* toString(Kind kind);
std::optional<Kind> kindOf(std::string_view unit);
/// Whether it may be used on the side of a connection that is called.
bool isCalled(Kind kind);
/// Whether its name is that of one of several servers (Server.Name), and its hosts follow.
bool isNamedServer(Kind kind);

/// What was asked for, or a file, cannot be used. what() says what was expected, fix() how to get there.
class Unusable : public std::runtime_error {
  public:
    Unusable(const std::string& what, std::string fix) : std::runtime_error(what), fix_(std::move(fix)) {}
    const std::string& fix() const { return fix_; }

  private:
    std::string fix_;
};

/// A certificate and its private key, both PEM.
struct Issued {
    std::string certificate;
    std::string key;
};

struct Request {
    Kind kind = Kind::Client;
    /// The first is the subject (CN): the name of the entity, the user name of the client, the Server.Name
    /// of one of several servers, whose hosts follow. A host is a DNS name or an IP address; those of a
    /// server, a router and IceStorm are all of these names. Whoever calls checks that it has reached one.
    std::vector<std::string> names;
    std::chrono::days valid{365};
};

/// Throws Unusable for names that no certificate of that kind can have.
void check(const Request& request);

/// The root of the laboratory's trust: ten years, signs servers and clients and no further authority.
Issued makeAuthority(WallTime now);

/// Signed by the authority, and valid no longer than it. Throws Unusable for what check() refuses and for an
/// authority that has expired, has another's key, or is none.
Issued issue(const Issued& authority, const Request& request, WallTime now);

struct Certificate {
    std::string name;  ///< CN
    std::string unit;  ///< OU
    std::string organisation;
    std::string issuer;              ///< CN of who signed it
    std::vector<std::string> names;  ///< DNS names and IP addresses
    bool authority = false;
    std::string serial;  ///< hexadecimal
    WallTime from{};
    WallTime until{};
};

/// All certificates in a PEM text of any content, at least one. `file` is what messages call it. Throws
/// Unusable.
std::vector<Certificate> readCertificates(std::string_view pem, const std::string& file);

enum class Validity { Valid, ExpiresSoon, Expired, NotYetValid };
inline constexpr std::chrono::days kSoon{30};
Validity validity(const Certificate& certificate, WallTime now);

/// "2026-11-21".
std::string day(WallTime time);

}  // namespace axon::certificates
