// SPDX-License-Identifier: MIT
#pragma once
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

namespace axon {

// Whose process has the other end of a connection on this machine; `from` is that end and `to` ours
// ("127.0.0.1:50122", "::1:50122").

/// The uid in the line of the connection in a text of the form of /proc/net/tcp or /proc/net/tcp6; nothing
/// when there is none, or the connection is not established (the kernel attributes
/// sockets that no process owns any longer to root). Pure; any text is accepted.
std::optional<std::uint32_t> socketOwner(std::string_view table, const std::string& from,
                                         const std::string& to);

/// What the kernel says when it is asked for that one socket by netlink (inet_diag), whatever number of
/// sockets there is.
struct KernelAnswer {
    bool heard = false;  ///< false: netlink is not permitted here, or cannot answer
    std::optional<std::uint32_t> uid;
};
KernelAnswer askKernel(const std::string& from, const std::string& to);

/// Of this machine: asks the kernel, and reads /proc/net/tcp and tcp6 only where that does not answer; they
/// take some milliseconds for thousands of sockets. Nothing where there is no such socket, or neither is
/// permitted. Threads: any.
std::optional<std::uint32_t> socketOwner(const std::string& from, const std::string& to);

}  // namespace axon
