// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <string>
#include <vector>

namespace axon::transport {

/// Where somebody listens, or is called. Plain values; no I/O.
struct Endpoint {
    std::string host;
    std::uint16_t port = 0;
    bool tls = false;

    /// Ice's form: "tcp -h 127.0.0.1 -p 10410", "ssl -h lab -p 10410".
    std::string text() const;
    /// Ours: "127.0.0.1:10410", "ssl://lab:10410".
    std::string address() const;
};

/// Reads an endpoint of either form. Throws std::invalid_argument that says how to fix it.
Endpoint parseEndpoint(const std::string& text);

/// Reads an endpoint of either form, or several in Ice's form with ':' between them. Throws
/// std::invalid_argument that says how to fix it.
std::vector<Endpoint> parseEndpoints(const std::string& text);

/// All of them in Ice's form.
std::string textOf(const std::vector<Endpoint>& endpoints);

/// The endpoint of the signal lane as a peer must call it that called the data lane by `called` and reached
/// `address` there: at the same address by the same name, because that is what the certificate is checked
/// for.
std::string asCalled(const std::string& signal_endpoint, const Endpoint& called, const std::string& address);

}  // namespace axon::transport
