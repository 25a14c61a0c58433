// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <memory>
#include <string>

#include "common/clock.hpp"
#include "console/core/console_core.hpp"

namespace axon::console {

/// HTTP, or HTTPS, on libmicrohttpd: requests in, answers out. Nothing is decided here.
///
/// Life: construct, which listens; serve(); the destructor closes all connections and joins the thread.
/// Before it, whatever may still answer a log-in is closed.
///
/// Threads: one of its own, "axon-console", for all connections; a log-in that takes its time holds up
/// nobody. Bounds: Settings; the header of a request has at most 16 KiB, its body 4 KiB, and it must be
/// complete in time (Deadlines). A connection beyond a bound is closed. A request that gives its length twice
/// over (Transfer-Encoding and Content-Length) is refused: a proxy might see another request in it.
class HttpServer {
  public:
    struct Settings {
        std::string host = "127.0.0.1";  ///< an address of IPv4, or "localhost"
        std::uint16_t port = 0;
        // PEM; empty: HTTP.
        std::string certificate, key, key_password;
        unsigned connections_max = 256;
        unsigned connections_of_one_max = 64;  ///< from one address
        /// From one address of this machine, where a proxy stands that all browsers come through; 0: as of
        /// any other.
        unsigned connections_of_proxy_max = 0;
        bool tls_1_2 = true;  ///< besides 1.3
    };

    /// Throws std::runtime_error, saying how to fix it, where it cannot listen.
    explicit HttpServer(Settings settings);
    ~HttpServer();
    HttpServer(const HttpServer&) = delete;
    HttpServer& operator=(const HttpServer&) = delete;

    /// The port that was taken where 0 was asked for.
    std::uint16_t port() const;
    /// `core` and `clock` outlive it. Throws std::runtime_error for a certificate that cannot be used.
    void serve(ConsoleCore& core, const Clock& clock);

  private:
    struct Parts;
    std::unique_ptr<Parts> parts_;
};

}  // namespace axon::console
