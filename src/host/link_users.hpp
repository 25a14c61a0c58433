// SPDX-License-Identifier: MIT
#pragma once
#include <sys/types.h>

#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "common/result.hpp"

namespace axon {

/// The users whose processes may have the other end of the link between an Entity Manager and its robot
/// application: the same user, root, and the users that ports.cfg names. The kernel says which user owns a
/// connection on this machine. It does not know the user of a process on another machine, which is let in
/// (but can only connect if the application listens beyond loopback, Options::beyond_loopback).
///
/// Source: docs/explanation/threats.md. Threads: any; a value. check() asks the kernel, which takes some
/// microseconds.
class LinkUsers {
  public:
    /// This process' user, as it is when it checks, and root.
    LinkUsers() = default;

    /// Names of users or numbers, apart by spaces or commas: "axon 1001". `where` begins the message. Refused
    /// with MALFORMED for a name that this machine does not know.
    static Result<LinkUsers> parse(std::string_view names, std::string_view where);

    /// Of a connected IPv4 socket. PERMISSION_DENIED with whose it is and how to let that user in, or that
    /// the kernel does not say.
    std::optional<Refusal> check(int socket) const;

    bool admits(uid_t uid) const;

  private:
    std::vector<uid_t> uids_;
};

}  // namespace axon
