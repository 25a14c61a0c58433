// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

namespace axon::console {

/// The console as a browser calls it.
struct Site {
    std::string origin;    ///< "http://127.0.0.1:10417"
    std::string socket;    ///< where its sessions are, as a browser names it: "ws://127.0.0.1:10418"
    std::string endpoint;  ///< the same as Ice names it: "ws -h 127.0.0.1 -p 10418 -r /axon"
    // The same of their signal lane: "ws://127.0.0.1:10419", "ws -h 127.0.0.1 -p 10419 -r /axon-signal".
    std::string signal_socket;
    std::string signal_endpoint;
    bool secure = false;  ///< by HTTPS
    bool proxy = false;   ///< a proxy stands before it

    bool operator==(const Site&) const = default;
};

/// Whether an address of IPv4, with or without a port, is one of loopback.
bool isOfThisMachine(std::string_view address);

/// Which hosts and origins are ours. A page of somebody else's site that a browser of this laboratory shows
/// can call us, even under a name of its own that suddenly leads to our address (DNS rebinding): its
/// requests are recognised by their Host or Origin.
///
/// Ours are the address at which the connection arrived, "localhost" where that is loopback, and the names
/// in the settings, each with the port on which we listen; and the origins of the proxies in the settings.
///
/// Constant after construction, pure. Threads: any.
class Sites {
  public:
    struct Settings {
        bool tls = false;
        std::uint16_t port = 0;            ///< of the pages
        std::uint16_t session_port = 0;    ///< of the sessions (WebSocket)
        std::uint16_t signal_port = 0;     ///< of their signal lane (WebSocket)
        std::vector<std::string> names;    ///< of this machine: "lab", "lab.example"
        std::vector<std::string> proxies;  ///< origins: "https://lab.example"
    };

    /// Throws std::invalid_argument, saying what was expected, for a name or an origin that is none.
    explicit Sites(const Settings& settings);

    /// By the header `Host` of a request on a connection to the address `local` ("127.0.0.1"). Nothing: it
    /// is not ours.
    std::optional<Site> ofHost(std::string_view host, std::string_view local) const;

    /// By the header `Origin` of a WebSocket on a connection to the address `local`. Nothing: it is not that
    /// of one of our pages.
    std::optional<Site> ofOrigin(std::string_view origin, std::string_view local) const;
    bool isOurs(std::string_view origin, std::string_view local) const {
        return ofOrigin(origin, local).has_value();
    }
    /// Of a peer that is no browser and names no origin: by the address to which it connected.
    Site ofAddress(const std::string& local) const;

  private:
    struct Proxy {
        std::string authority;  ///< as a browser writes it into Host
        Site site;
    };
    std::optional<Site> direct(std::string_view host, std::string_view local) const;

    const bool tls_;
    const std::uint16_t port_;
    const std::uint16_t session_port_;
    const std::uint16_t signal_port_;
    std::vector<std::string> names_;
    std::vector<Proxy> proxies_;
};

}  // namespace axon::console
