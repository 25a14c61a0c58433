// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <optional>
#include <string>

namespace axon::cli {

/// Where the web console of a server is unless its configuration says otherwise (docs/reference/ports.md),
/// by the server's address as --server gives it: "http://127.0.0.1:10417/". Over TLS where clients come over
/// TLS from another machine. Nothing for a router, which has no console.
std::optional<std::string> consoleAddress(const std::string& server);

}  // namespace axon::cli
