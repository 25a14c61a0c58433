// SPDX-License-Identifier: GPL-2.0-or-later
#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace axon::server {

/// Whose process has the other end of a connection on this machine: the uid in the line of the connection
/// from `from` to `to` ("127.0.0.1:50122") in a text of the form of /proc/net/tcp or /proc/net/tcp6; nothing
/// when there is none, or the connection is not established (the kernel gives those that nobody has any more
/// to root). Pure; any text is accepted.
std::optional<std::uint32_t> socketOwner(std::string_view table, const std::string& from,
                                         const std::string& to);

/// The same, of this machine's own tables. Nothing where they cannot be read.
std::optional<std::uint32_t> socketOwner(const std::string& from, const std::string& to);

}  // namespace axon::server
